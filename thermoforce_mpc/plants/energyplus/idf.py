"""Objects, schedules and calendar of an IDF file, as the engine reads them."""

from __future__ import annotations

import calendar
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from functools import cache

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.zone import YEAR

_CLOCK_S = 1e-6
_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")


def idf_objects(text: str, kind: str) -> list[list[str]]:
    """Return the fields of every object of a kind, without comments; the kind itself is left out."""
    objects = (
        [field.strip() for field in statement.split(",")] for statement in re.sub(r"![^\n]*", "", text).split(";")
    )
    return [fields[1:] for fields in objects if fields[0].lower() == kind.lower()]


@dataclass(frozen=True)
class Calendar:
    """Days of the engine's year (`zone.YEAR`, from a Monday) and of those after it.

    `holidays` and the ends of `daylight_saving` (None: none) are days as the engine's file gives them: 'July 4',
    '3rd Monday in January', 'Last Monday in May'. Daylight saving time holds on its first day, its last, and between.
    """

    holidays: tuple[str, ...] = ()
    daylight_saving: tuple[str, str] | None = None

    @classmethod
    def of(cls, text: str) -> Calendar:
        """Return the calendar of an IDF file; raises `PlantError` for a special day that is no holiday of one day."""
        special = idf_objects(text, "RunPeriodControl:SpecialDays")
        for name, _, days, kind in special:
            if (float(days), kind) != (1.0, "Holiday"):
                raise PlantError(f"EnergyPlus: special day '{name}' has {days} days as {kind}, expected 1 as Holiday")
        saving = idf_objects(text, "RunPeriodControl:DaylightSavingTime")
        return cls(tuple(row[1] for row in special), (saving[0][0], saving[0][1]) if saving else None)

    def kind(self, day: int) -> str:
        """Return 'Holiday' or the weekday of a day since 1 January of the engine's year (0)."""
        at = date(YEAR, 1, 1) + timedelta(days=day)
        if at in _dates(self.holidays, at.year):
            return "Holiday"
        return _DAYS[at.weekday()]

    def clock_s(self, time_s: Array) -> Array:
        """Return the time of clocks, s: an hour later than `time_s` (any shape) in daylight saving time."""
        days, index = np.unique(np.floor((time_s + _CLOCK_S) / DAY_S).astype(int), return_inverse=True)
        dates = [date(YEAR, 1, 1) + timedelta(days=int(day)) for day in days]
        ends = [_dates(self.daylight_saving, at.year) if self.daylight_saving else (date.max, date.min) for at in dates]
        saving = np.array([first <= at <= last for at, (first, last) in zip(dates, ends, strict=True)])
        return np.asarray(time_s + HOUR_S * saving[index].reshape(np.shape(time_s)))


@dataclass(frozen=True)
class Schedule:
    """Compact schedule of whole years.

    `rules` are kinds of days, as in 'Weekdays' or 'AllOtherDays', with the hours until which each value holds and the
    values; the first rule that covers a day counts.
    """

    name: str
    rules: tuple[tuple[frozenset[str], tuple[float, ...], tuple[float, ...]], ...]

    @classmethod
    def of(cls, text: str, name: str) -> Schedule:
        """Return the schedule `name` of an IDF file; raises `PlantError` if it is missing or differs over the year."""
        schedules = [fields for fields in idf_objects(text, "Schedule:Compact") if fields[0].lower() == name.lower()]
        if len(schedules) != 1:
            raise PlantError(f"EnergyPlus: the file has {len(schedules)} schedules '{name}', expected one")
        through, *fields = schedules[0][2:]
        if through.lower() != "through: 12/31" or any(field.lower().startswith("through") for field in fields):
            raise PlantError(
                f"EnergyPlus: schedule '{name}' differs over the year; only one of whole years can be read"
            )
        rules: list[tuple[frozenset[str], list[float], list[float]]] = []
        for field in fields:
            word, _, rest = field.partition(":")
            if word.lower() == "for":
                rules.append((frozenset(rest.split()), [], []))
            elif word.lower() == "until":
                hours, minutes = rest.split(":")
                rules[-1][1].append(float(hours) + float(minutes) / 60.0)
            else:
                rules[-1][2].append(float(field))
        return cls(name, tuple((kinds, tuple(until), tuple(values)) for kinds, until, values in rules))

    @property
    def values(self) -> tuple[float, ...]:
        """All values of the schedule."""
        return tuple(value for _, _, values in self.rules for value in values)

    def at(self, time_s: Array, calendar: Calendar) -> Array:
        """Return values over the steps that begin at `time_s` (n,), s since 1 January; raises `PlantError`."""
        clock_s = calendar.clock_s(np.asarray(time_s, dtype=np.float64)) + _CLOCK_S
        day = np.floor(clock_s / DAY_S).astype(int)
        hour = (clock_s - day * DAY_S) / HOUR_S
        days, index = np.unique(day, return_inverse=True)
        kinds = np.array([calendar.kind(int(one)) for one in days])[index]
        out = np.empty(day.shape)
        for kind in set(kinds.tolist()):
            here = kinds == kind
            until, values = self._rule(kind)
            out[here] = np.asarray(values)[np.searchsorted(until, hour[here], side="right")]
        return out

    def _rule(self, kind: str) -> tuple[Sequence[float], Sequence[float]]:
        names = {"AllDays", "AllOtherDays", "Holidays" if kind == "Holiday" else kind}
        if kind in _DAYS[:5]:
            names.add("Weekdays")
        for kinds, until, values in self.rules:
            if kinds & names:
                return until, values
        raise PlantError(f"EnergyPlus: schedule '{self.name}' has no rule for a {kind}")


@cache
def _dates(days: tuple[str, ...], year: int) -> tuple[date, ...]:
    return tuple(_date(day, year) for day in days)


def _date(day: str, year: int) -> date:
    months = {name: number for number, name in enumerate(calendar.month_name) if name}
    nth = re.fullmatch(r"(\d)(?:st|nd|rd|th) (\w+) in (\w+)", day)
    last = re.fullmatch(r"Last (\w+) in (\w+)", day)
    plain = re.fullmatch(r"(\w+) (\d+)", day)
    if plain:
        return date(year, months[plain[1]], int(plain[2]))
    if not (nth or last):
        raise PlantError(f"EnergyPlus: day '{day}': expected 'July 4', '3rd Monday in January' or 'Last Monday in May'")
    weekday, month = (nth[2], months[nth[3]]) if nth else (last[1], months[last[2]])  # type: ignore[index]
    of_month = [
        date(year, month, number)
        for number in range(1, calendar.monthrange(year, month)[1] + 1)
        if _DAYS[date(year, month, number).weekday()] == weekday
    ]
    return of_month[int(nth[1]) - 1] if nth else of_month[-1]
