"""Times as people write them: dates of a year of 365 days, and comfort bounds by schedule."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, field_validator

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.errors import ConfigError, suggestion
from thermoforce_mpc.scenario.settings import StrictModel

if TYPE_CHECKING:  # loaded only where a calendar is
    import pandas as pd

_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}")
_NO_LEAP_YEAR = 2001


def day_of_year(date: str) -> int:
    """Day from 0 of a date such as 2026-01-17; raises `ValueError` where a year of 365 days has none."""
    if not _DATE.fullmatch(date):
        raise ValueError(f"'{date}': expected a date such as 2026-01-17")
    _, month, day = map(int, date.split("-"))
    try:
        return datetime.date(_NO_LEAP_YEAR, month, day).timetuple().tm_yday - 1
    except ValueError as error:
        raise ValueError(f"{date} is no day of a year of 365 days") from error


def window_name(window: str) -> str:
    """The name of a window; of one given by its first day as a date that day of the year; raises `ValueError`."""
    return str(day_of_year(window)) if _DATE.fullmatch(window) else window


WEEK = ("monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday")
_HOLIDAY = len(WEEK)
_DAYS = {"weekdays": range(5), "weekend": (5, 6), "holidays": (_HOLIDAY,), "daily": range(8)} | {
    name: (number,) for number, day in enumerate(WEEK) for name in (day, day[:3])
}
_RULE = re.compile(
    r"(?:(?P<days>[a-z]+(?:-[a-z]+)?)\s+)?(?:(?P<begin>\d{1,2}(?::\d\d)?)-(?P<end>\d{1,2}(?::\d\d)?)\s+)?"
    r"(?P<lower>\d+(?:\.\d+)?)-(?P<upper>\d+(?:\.\d+)?)(?:\s*°?c)?"
)
# Between these, °C, lie bounds that somebody may mean, of rooms and of tanks of hot water.
_ROOM_C, _TANK_C = (5.0, 40.0), (20.0, 80.0)


THERMOSTAT_INSIDE_K = 0.3
"""How far inside a comfort bound thermostats are set, K: as that of BOPTEST's heat pump, 21.3 for 21 °C."""


@dataclass(frozen=True)
class Rule:
    """Bounds, °C, on `days` (0 Monday to 6 Sunday, 7 holidays) from `begin_h` to `end_h`, also beyond midnight."""

    days: frozenset[int]
    begin_h: float
    end_h: float
    lower_C: float
    upper_C: float

    def holds(self, day: Array, hour: Array) -> NDArray[np.bool_]:
        """Where it holds, for kinds of day (n,) and hours (n,); beyond midnight on the day that it began on too."""
        inside = (hour >= self.begin_h) & (hour < self.end_h)
        if self.begin_h > self.end_h:
            inside = (hour >= self.begin_h) | (hour < self.end_h)
        return np.asarray(np.isin(day, list(self.days)) & inside)


@cache  # asked for in every step
def rules_from(text: str, within_C: tuple[float, float]) -> tuple[Rule, ...]:
    """The rules of a schedule, of which the first that holds counts; raises `ValueError` for a part that is none.

    `within_C`: between which bounds lie.
    """
    parts = [part.strip() for part in re.split(r"[,;\n]", text.lower().replace("–", "-")) if part.strip()]
    if not parts or not parts[-1].startswith("else "):
        raise ValueError("the last part says what holds else, as in 'weekdays 6:00-22:00 21-24, else 17-26'")
    rules = [_rule(part, within_C) for part in parts[:-1]]
    return (*rules, _rule("daily " + parts[-1].removeprefix("else "), within_C))


def _rule(text: str, within_C: tuple[float, float]) -> Rule:
    found = _RULE.fullmatch(text)
    if found is None:
        raise ValueError(f"'{text}': expected DAYS BEGIN-END LOWER-UPPER, as 'weekdays 6:00-22:00 21-24'")
    lower, upper = float(found["lower"]), float(found["upper"])
    least, most = within_C
    if not least <= lower < upper <= most:
        raise ValueError(f"'{text}': bounds are °C, the lower below the upper, from {least:g} to {most:g}")
    begin, end = (_hour(found[key], text) for key in ("begin", "end")) if found["begin"] else (0.0, 24.0)
    if begin == end:
        raise ValueError(f"'{text}': it begins and ends at the same time")
    return Rule(frozenset(_days(found["days"] or "daily", text)), begin, end, lower, upper)


def _hour(text: str, rule: str) -> float:
    hours, _, minutes = text.partition(":")
    hour = int(hours) + int(minutes or 0) / 60
    if hour > 24 or int(minutes or 0) > 59:
        raise ValueError(f"'{rule}': {text} is no time of day")
    return hour


def _days(text: str, rule: str) -> Sequence[int]:
    first, _, last = text.partition("-")
    for name in (first, last or first):
        if name not in _DAYS or (last and name not in WEEK and name not in {day[:3] for day in WEEK}):
            known = [*_DAYS]
            raise ValueError(f"'{rule}': unknown day '{name}'{suggestion(name, known)}; known: {', '.join(known)}")
    if not last:
        return tuple(_DAYS[first])
    (begin,), (end,) = _DAYS[first], _DAYS[last]
    return tuple(day % len(WEEK) for day in range(begin, end + 1 if end >= begin else end + 1 + len(WEEK)))


class Comfort(StrictModel):
    """Comfort bounds of the zones by schedule, in the place of the test case's."""

    within_C: ClassVar[tuple[float, float]] = _ROOM_C

    schedule: str | dict[str, str] = Field(
        description="rules DAYS BEGIN-END LOWER-UPPER (°C), of which the first that holds counts, and what holds else: "
        "'weekdays 6:00-22:00 21-24, else 17-26'; or one such text a zone, by name, and `others`. Days: weekdays, "
        "weekend, holidays, daily, or names of days as mon-thu",
        examples=["weekdays 6:00-22:00 21-24, else 17-26"],
    )
    holidays: tuple[str, ...] = Field(
        (),
        description="dates such as 2026-12-25; they are no weekdays, and a Sunday where no rule names holidays",
        examples=[["2026-12-25"]],
    )

    @field_validator("schedule")
    @classmethod
    def _can_be_read(cls, value: str | dict[str, str]) -> str | dict[str, str]:
        for text in value.values() if isinstance(value, dict) else (value,):
            rules_from(text, cls.within_C)
        return value

    @field_validator("holidays")
    @classmethod
    def _are_days(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for date in value:
            day_of_year(date)
        return value

    def bounds_C(self, time_s: Array, zones: Sequence[str], first_weekday: str) -> tuple[Array, Array]:
        """Lower and upper bounds of `zones`, each (Z, n), °C, at times (n,), s since 1 January, a `first_weekday`.

        Raises:
            ConfigError: a zone that there is not, or one without a schedule.
        """
        texts = self._of_zones(zones)
        whole = np.floor(np.asarray(time_s) / DAY_S)
        hour = (time_s - whole * DAY_S) / HOUR_S
        day = (whole + WEEK.index(first_weekday)) % len(WEEK)
        holiday = np.isin(whole % 365, [day_of_year(date) for date in self.holidays])
        bounds = np.array([_bounds(rules_from(text, self.within_C), day, hour, holiday) for text in texts])
        return bounds[:, 0], bounds[:, 1]

    def bounds_at(self, at: pd.DatetimeIndex, zones: Sequence[str]) -> tuple[Array, Array]:
        """As `bounds_C`, at instants of a calendar (n,), on the clock of their zone; holidays count in their year."""
        texts = self._of_zones(zones)
        hour = np.asarray(at.hour + at.minute / 60.0 + at.second / 3600.0, dtype=np.float64)
        holiday = np.isin(at.strftime("%Y-%m-%d"), [_full_date(date) for date in self.holidays])
        day = np.asarray(at.day_of_week, dtype=np.float64)
        bounds = np.array([_bounds(rules_from(text, self.within_C), day, hour, holiday) for text in texts])
        return bounds[:, 0], bounds[:, 1]

    @property
    def by_hour(self) -> bool:
        """Whether bounds of a zone change within a day, so that it matters of which clock hours are."""
        texts = [self.schedule] if isinstance(self.schedule, str) else self.schedule.values()
        return any(rule.end_h - rule.begin_h != 24.0 for text in texts for rule in rules_from(text, self.within_C))

    def strictest_C(self, zones: Sequence[str]) -> list[tuple[float, float]]:
        """The highest lower and the lowest upper bound of each of `zones`, °C; raises as `bounds_C`."""
        rules = [rules_from(text, self.within_C) for text in self._of_zones(zones)]
        return [(max(rule.lower_C for rule in of), min(rule.upper_C for rule in of)) for of in rules]

    def _of_zones(self, zones: Sequence[str]) -> list[str]:
        if isinstance(self.schedule, str):
            return [self.schedule] * len(zones)
        unknown = [name for name in self.schedule if name not in (*zones, "others")]
        if unknown:
            raise ConfigError(
                f"comfort.schedule: no zone '{unknown[0]}'{suggestion(unknown[0], zones)}; zones: {', '.join(zones)}"
            )
        missing = [zone for zone in zones if zone not in self.schedule and "others" not in self.schedule]
        if missing:
            raise ConfigError(f"comfort.schedule: nothing for {', '.join(missing)}; name them, or give `others`")
        return [self.schedule.get(zone, self.schedule.get("others", "")) for zone in zones]


def _full_date(date: str) -> str:
    year, month, day = map(int, date.split("-"))
    return f"{year:04d}-{month:02d}-{day:02d}"


def _bounds(rules: Sequence[Rule], day: Array, hour: Array, holiday: NDArray[np.bool_]) -> Array:
    """Bounds (2, n), °C, by the first rule that holds; a holiday that no rule names is a Sunday."""
    named = any(_HOLIDAY in rule.days and len(rule.days) == 1 for rule in rules)
    kind = np.where(holiday, _HOLIDAY if named else WEEK.index("sunday"), day)
    first = np.argmax([rule.holds(kind, hour) for rule in rules], axis=0)
    return np.array([[rule.lower_C for rule in rules], [rule.upper_C for rule in rules]])[:, first]


def _schedule_alone(value: object) -> object:
    return {"schedule": value} if isinstance(value, str) else value


class TankComfort(Comfort):
    """Lowest and highest temperature of a tank of hot water by schedule, °C."""

    within_C: ClassVar[tuple[float, float]] = _TANK_C


OfTankComfort = Annotated[TankComfort, BeforeValidator(_schedule_alone, json_schema_input_type=str | TankComfort)]
"""A schedule of a tank's temperatures; a mere text stands for one without holidays."""

OfComfort = Annotated[Comfort, BeforeValidator(_schedule_alone, json_schema_input_type=str | Comfort)]
"""A schedule of comfort bounds; a mere text stands for one without holidays."""
