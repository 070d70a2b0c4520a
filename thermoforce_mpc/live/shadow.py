"""What a controller that only watches would have saved, day by day, with a band: `tf-mpc worth` of its days.

The identified house is lived through each day again under the same controller, which plans anew in every step with the
forecasts, bounds and prices that the shadow had then. House, tank of hot water and controller go on from where the day
before left them, as those of a building under control do. So are houses drawn from what the model does not know; of
their savings, added up over the days, comes the band. Heat that is stored at the end of a day counts. As with `tf-mpc
saving`, a saving is claimed only where all of the band lies above 0.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from controllers.state_classes import STATE_CLASSES, model_key
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import CourseState
from thermoforce_mpc.commands.tank import LearnedTank, TankRecord
from thermoforce_mpc.data import AT_THE_METER, CONDITIONS, Boundary, Period, Record, energy_kWh
from thermoforce_mpc.errors import DataError, InputError, StorageError, counted
from thermoforce_mpc.experiment.worth import (
    Houses,
    Lived,
    LoggedTank,
    band_of,
    outside_Kh,
    planned_share,
    without_tank,
)
from thermoforce_mpc.files import read_json, write_json
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.records.journal import NAME, making_sense, read_run
from thermoforce_mpc.records.run_folder import MOST_BYTES, SHADOW
from thermoforce_mpc.records.told_steps import (
    ToldStep,
    forecast_of,
    history_before,
    told_building,
    told_loops,
    told_steps,
)
from thermoforce_mpc.state_file import StateFormat
from thermoforce_mpc.whatif.identified_house import HouseState
from thermoforce_mpc.whatif.lived_tank import TankState
from thermoforce_mpc.whatif.saving import LEAST_AFTER

_LOG = logging.getLogger(__name__)
_STATE = "shadow.npz"
# Houses drawn beside the likeliest: each costs a plan a step, and a day is judged while control waits.
_DRAWS = 4
# Least share of a day's steps with a decision; without, there is nothing to say what the controller would have done.
_LEAST_DECIDED = 0.9


@dataclass(frozen=True)
class ShadowDay:
    """A day as it was and under plans: cost, energy, kWh, K·h outside the bounds in all zones, each of both.

    `saved`: of each house, the likeliest first, currency, with what is stored. `warmer_K`: mean change of the rooms'
    temperature. `planned`: share of its steps in which plans acted. `goes_on`: house and controller began it where
    the day before had left them; else as the house was. `tank_below_Kh`: K·h of the tank below what is wanted, as it
    was and under plans; None where none was lived through.
    """

    day: str
    energy_was_kWh: float
    energy_kWh: float
    cost_was: float
    cost: float
    saved: tuple[float, ...]
    outside_was_Kh: float
    outside_Kh: float
    warmer_K: float
    planned: float
    goes_on: bool
    tank_below_Kh: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Raise `ValueError` for a day that is none, and numbers that are not finite."""
        date.fromisoformat(self.day)
        no_number = ("day", "saved", "goes_on", "tank_below_Kh")
        numbers = [value for key, value in vars(self).items() if key not in no_number]
        numbers += [*self.saved, *(self.tank_below_Kh or ())]
        if len(self.saved) != _DRAWS + 1 or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{self.day}: a number is not finite, or there is not a saving of each house")


@dataclass(frozen=True, eq=False)
class ShadowHouses:
    """Where houses and the controller of each stand at the end of `day`; `of`: tells controllers apart."""

    day: str
    of: str
    houses: tuple[HouseState, ...]
    controllers: tuple[object, ...]


_FORMAT = StateFormat((*STATE_CLASSES, HouseState, CourseState, TankState, Record, ShadowHouses))


class ShadowBook:
    """The days of a shadow in a run folder, kept in `shadow.json`; where its houses stand is in `shadow.npz`."""

    def __init__(
        self,
        folder: Path,
        model: ThermalModel,
        controller: Controller,
        commands: Mapping[str, LearnedCommand] | None = None,
        key: str = "",
        tank_log: Callable[[], tuple[TankRecord, pd.Timestamp] | None] = lambda: None,
    ) -> None:
        """Go on with the days that are there, if they are of this controller; others, and a file that cannot be read,
        are put aside, and the log says so.

        `controller`: that of the shadow, with what it would set by `commands`; `key`: tells it from others; `tank_log`:
        what was measured of a tank until now, and what its seconds count from, None where nothing was.
        """
        self._folder, self._model, self._controller = folder, model, controller
        self._commands, self._key, self._tank_log = commands, key, tank_log
        self.days: list[ShadowDay] = []
        self._today: date | None = None
        self._over: pd.Timestamp | None = None
        if (folder / SHADOW).exists():
            try:
                told = read_json(folder / SHADOW, MOST_BYTES)
                if told.get("of") != key:
                    raise ValueError("its days are of another model or other options")
                self.days = [_day_told(day) for day in told["days"]]
            except (InputError, ValueError, KeyError, TypeError, AttributeError) as error:
                aside = folder / f"{Path(SHADOW).stem}-before.json"
                _LOG.warning("%s: begun anew (%s); it is kept as %s", folder / SHADOW, error, aside.name)
                with suppress(OSError):
                    (folder / SHADOW).replace(aside)

    def day_over(self, instant: pd.Timestamp) -> str:
        """What the days so far say, at the second decision of a day, when the journal has the last; else ''.

        Where a controller was started again, the day before counts too, if the journal has it.

        Raises `DataError` where a day cannot be judged, and as `read_run`.
        """
        if self._over is not None:
            begin, self._over = self._over, None
            self._today = instant.date()
            if f"{begin:%Y-%m-%d}" not in [known.day for known in self.days]:
                self.days.append(self._judged(begin))
                days = [asdict(day) for day in self.days]
                of = {"of": self._key, "model": model_key(self._model)}
                write_json(self._folder / SHADOW, {"said": self.in_words, **of, "days": days})
            return self.in_words
        before, self._today = self._today, instant.date()
        if before is None:  # started again: the day before may have ended meanwhile
            yesterday = instant.normalize() - pd.DateOffset(days=1)
            self._over = yesterday if _decided_in(self._folder / NAME, yesterday) else None
        elif before != self._today:
            self._over = pd.Timestamp(before, tz=instant.tz)
        return ""

    @property
    def in_words(self) -> str:
        """What the days say together, and of a tank that the controller plans for."""
        tank: LearnedTank | None = getattr(self._controller, "hot_water", None)
        if tank is None:
            return in_words(self.days)
        known = [day.tank_below_Kh for day in self.days if day.tank_below_Kh is not None]
        told = [in_words(self.days)]
        if known:
            was_Kh, planned_Kh = np.sum(known, axis=0)
            told.append(f"hot water {planned_Kh:.1f} instead of {was_Kh:.1f} K·h below what is wanted")
        if len(known) < len(self.days):
            of = f"in {counted(len(self.days) - len(known), 'day')} " * bool(known)
            told.append(of + without_tank(tank.machine))
        return "; ".join(told)

    def _judged(self, begin: pd.Timestamp) -> ShadowDay:
        """The day from `begin`, midnight, on, from the journal, and where it leaves the houses, which is kept.

        Raises:
            DataError: too few decisions were made in it, or levels or temperatures were not measured.
            JournalError: the journal cannot be read.
        """
        told = _told_day(self._folder / NAME, begin)
        houses = Houses(
            self._model,
            told.record,
            self._controller,
            draws=_DRAWS,
            seed=0,
            commands=self._commands,
            hot_water=self._logged_tank(told.record.origin),
        )
        before = self._before(begin)
        lived: list[Lived] = []
        for k in range(_DRAWS + 1):
            stands, state = (None, None) if before is None else (before.houses[k], before.controllers[k])
            lived.append(
                houses.lived(k, told.period, told.conditions, forecasts=told.forecasts, before=stands, state=state)
            )
        after = ShadowHouses(
            f"{begin:%Y-%m-%d}",
            self._key,
            tuple(replace(one.after, record=replace(one.after.record, origin=None)) for one in lived),
            tuple(one.controller for one in lived),
        )
        try:
            _FORMAT.write(self._folder / _STATE, after)
        except (StorageError, TypeError) as error:
            _LOG.warning("the next day of the shadow begins as the house was: %s", error)
        return _day(begin, told, lived, goes_on=before is not None)

    def _logged_tank(self, origin: pd.Timestamp) -> LoggedTank | None:
        """The tank that is planned, in seconds from `origin`; None where nothing was measured of it."""
        tank: LearnedTank | None = getattr(self._controller, "hot_water", None)
        if tank is None or (found := self._tank_log()) is None:
            return None
        logged, counted_from = found
        shift_s = (counted_from - origin).total_seconds()
        return LoggedTank(tank, replace(logged, time_s=logged.time_s + shift_s))

    def _before(self, begin: pd.Timestamp) -> ShadowHouses | None:
        """Where the houses stand at `begin`; None where the day before was not judged."""
        if not (self._folder / _STATE).exists():
            return None
        try:
            before = _FORMAT.read(self._folder / _STATE)
        except InputError as error:
            _LOG.warning("the shadow begins anew as the house was: %s", error)
            return None
        yesterday = (begin - pd.Timedelta(hours=12)).date().isoformat()
        fits = isinstance(before, ShadowHouses) and (before.day, before.of) == (yesterday, self._key)
        return before if fits and len(before.houses) == _DRAWS + 1 else None


@dataclass(frozen=True, eq=False)
class _ToldDay:
    """A day as the journal tells it: the record until its end, bounds and prices at the record's boundaries, and the
    forecasts of its steps, by their begin.
    """

    record: Record
    conditions: Boundary
    forecasts: Mapping[float, Boundary]
    period: Period


def _steps_told(path: Path, begin: pd.Timestamp) -> tuple[pd.Timestamp, list[ToldStep], float, float]:
    """What seconds count from, the steps of the journal, and begin and end of the day from `begin` on, s."""
    entries = read_run(path).entries
    origin = told_building(entries[0].content).origin
    if origin is None:
        raise InputError(f"{path}: is of a simulated building")
    steps = list(told_steps(told_loops(entries).get("thermoforce_mpc", [])))
    # Days of 23 and 25 hours, too.
    begin_s, end_s = (float((at - origin).total_seconds()) for at in (begin, begin.normalize() + pd.DateOffset(days=1)))
    return origin, steps, begin_s, end_s


def _decided_in(path: Path, begin: pd.Timestamp) -> bool:
    """Whether the journal, if there is one, has a decision of the day from `begin` on; raises as `read_run`."""
    if not path.exists():
        return False
    with making_sense(path):
        _, steps, begin_s, end_s = _steps_told(path, begin)
        return any(begin_s - 1.0 < step.time_s < end_s - 1.0 for step in steps)


def _told_day(path: Path, begin: pd.Timestamp) -> _ToldDay:
    with making_sense(path):
        origin, steps, begin_s, end_s = _steps_told(path, begin)
        at = [i for i, step in enumerate(steps) if begin_s - 1.0 < step.time_s < end_s - 1.0]
        later = next((i for i, step in enumerate(steps) if step.time_s > end_s - 1.0), None)
        acted = sum(any(u is not None for block in steps[i].blocks for u in block.u) for i in at)
    if not at or later is None:
        raise DataError(f"{begin:%d %b}: no decision was made in it: the day does not count")
    if acted > (1.0 - _LEAST_DECIDED) * len(at):  # one that was killed may have set what it decided
        raise DataError(f"{begin:%d %b}: control acted in {acted} of {len(at)} steps: the day does not count")
    with making_sense(path):
        record = replace(history_before(steps[: later + 1]), origin=origin)
        # Of the house that is lived through the meter is not known.
        nothing: dict[str, Any] = dict.fromkeys(AT_THE_METER, np.empty(0))
        forecasts = {
            float(round(steps[i].time_s)): replace(given, **nothing)
            for i in at
            if (given := steps[i].forecast()[0]) is not None
        }
        known = [forecast_of(steps[: i + 1]) for i in [*at, later]]
    first = record.nearest(begin_s)
    n = record.nearest(end_s) - first
    if first < 1 or first + n > record.n_steps or len(at) < _LEAST_DECIDED * n:
        raise DataError(f"{begin:%d %b}: {len(at)} of {n} decisions were made in it: the day does not count")
    period = Period("day", float(record.time_s[first]), n * record.step_s, 0.0)
    return _ToldDay(record, _in_force(record, known), forecasts, period)


def _in_force(record: Record, forecasts: Sequence[Boundary]) -> Boundary:
    """What the latest of `forecasts` says of each boundary of `record`; NaN before the first."""
    names = record.names
    rows: dict[str, Any] = {"time_s": record.time_s}
    for name in CONDITIONS:
        if name == "time_s":
            continue
        like = np.asarray(getattr(forecasts[0], name))
        rows[name] = np.full((*like.shape[:-1], record.time_s.size), math.nan)
        for forecast in forecasts:
            at = np.round((forecast.time_s - record.time_s[0]) / record.step_s).astype(np.intp)
            inside = (at >= 0) & (at < record.time_s.size)
            rows[name][..., at[inside]] = np.asarray(getattr(forecast, name))[..., inside]
    return Boundary(**rows, names=names)


def _day(begin: pd.Timestamp, told: _ToldDay, lived: Sequence[Lived], *, goes_on: bool) -> ShadowDay:
    likeliest, first = lived[0], told.record.nearest(told.period.start_s)
    was = likeliest.was
    energy_was = energy_kWh(was.power_W, was.step_s)
    price = told.conditions.price_per_kWh[:, first : first + was.n_steps]
    return ShadowDay(
        day=f"{begin:%Y-%m-%d}",
        energy_was_kWh=float(energy_was.sum()),
        energy_kWh=likeliest.energy_kWh,
        cost_was=float((energy_was * price).sum()),
        cost=likeliest.cost,
        saved=tuple(one.saved for one in lived),
        outside_was_Kh=outside_Kh(was, told.conditions, first),
        outside_Kh=likeliest.outside_Kh,
        warmer_K=float(np.nanmean(likeliest.record.T_zone_C[:, 1:] - was.T_zone_C[:, 1:])),
        planned=planned_share(likeliest.acted),
        goes_on=goes_on,
        tank_below_Kh=None if (tank := likeliest.tank) is None else (tank.below_was_Kh, tank.below_Kh),
    )


def _day_told(told: Mapping[str, Any]) -> ShadowDay:
    tank = told.get("tank_below_Kh")
    return ShadowDay(**{**told, "saved": tuple(told["saved"]), "tank_below_Kh": None if tank is None else tuple(tank)})


def in_words(days: Sequence[ShadowDay]) -> str:
    """What the days say together, in a sentence; of fewer than a week that it is too early."""
    if len(days) < LEAST_AFTER:
        return f"shadow: {counted(len(days), 'day')} of the {LEAST_AFTER} that an account needs"

    def total(name: str) -> float:
        return sum(float(getattr(day, name)) for day in days)

    saved, *drawn = np.sum([day.saved for day in days], axis=0).tolist()
    low, high = band_of(saved, drawn)
    share = 100.0 * saved / max(total("cost_was"), 1e-9)
    claim = "would have saved" if low > 0.0 else "no saving can be claimed: the band holds 0;"
    if high < 0.0:
        claim = "would have saved nothing:"
    planned = 100.0 * float(np.mean([day.planned for day in days]))
    return (
        f"shadow, {len(days)} days: {claim} {saved:+.2f} of {total('cost_was'):.2f} ({share:+.1f} %, 90 % band "
        f"{low:+.2f} to {high:+.2f}); {total('energy_kWh'):.1f} instead of {total('energy_was_kWh'):.1f} kWh; rooms "
        f"{total('outside_Kh'):.1f} instead of {total('outside_was_Kh'):.1f} K·h outside their bounds; "
        f"{planned:.0f} % of the steps planned"
    )
