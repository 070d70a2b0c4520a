"""What a controller that only watches would have saved, day by day, as a band.

Plans of a shadow are made from the rooms as the building's own control keeps them, so the first steps of many plans are
no course. Each whole day is therefore judged by the one plan that was made at its begin: its levels, as they were
planned for the whole day on the forecast of then, take the place of those of the building in the weather that came
(`thermoforce_mpc.whatif.counterfactual`). Their last hours are moved until the rooms end the day as they did, so that
nothing is saved by rooms that are left colder. Errors of the model have one sign on all days: the bands of days add up.
As with `tf-mpc saving`, a saving is claimed only where all of the band lies above 0.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Record
from thermoforce_mpc.errors import DataError, InputError, counted
from thermoforce_mpc.files import read_bounded
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.records.journal import NAME, making_sense, read_run
from thermoforce_mpc.records.journal_values import planned_of
from thermoforce_mpc.records.run_folder import write_json
from thermoforce_mpc.records.told_steps import forecast_of, history_before, told_building, told_loops, told_steps
from thermoforce_mpc.whatif.counterfactual import Counterfactual, counterfactual
from thermoforce_mpc.whatif.saving import LEAST_AFTER

_LOG = logging.getLogger(__name__)
_FILE, _MOST_BYTES = "shadow.json", 10_000_000
# The end of a day that is moved so that rooms end as they did, h, and how near the search comes, as a level.
_END_H, _HALVINGS = 6.0, 10
# A plan that began so much later does not stand for the day, s.
_LATE_S = HOUR_S


@dataclass(frozen=True)
class ShadowDay:
    """A day as it was and as it was planned at its begin: energy as metered (where it is not, by the model), kWh, and
    the plan's by the model, with its 90 % band, in which is also by what share the model misses what was metered on
    that very day; cost at the prices in force, and its band; K·h outside the bounds, mean over zones; change of the
    rooms' mean temperature at its end, K, where the levels could not make up for all of it.
    """

    day: str
    energy_kWh: float
    planned_kWh: float
    planned_low_kWh: float
    planned_high_kWh: float
    cost: float
    planned_cost: float
    planned_low_cost: float
    planned_high_cost: float
    discomfort_Kh: float
    planned_discomfort_Kh: float
    left_K: float


class ShadowBook:
    """The days of a shadow in a run folder, kept in `shadow.json`."""

    def __init__(self, folder: Path, model: ThermalModel) -> None:
        """Go on with the days that are there; a file that cannot be read is begun anew, and the log says so."""
        self._folder, self._model = folder, model
        self.days: list[ShadowDay] = []
        self._today: date | None = None
        self._over: pd.Timestamp | None = None
        if (folder / _FILE).exists():
            try:
                told = json.loads(read_bounded(folder / _FILE, _MOST_BYTES, InputError))
                self.days = [ShadowDay(**day) for day in told["days"]]
            except (InputError, ValueError, KeyError, TypeError) as error:
                _LOG.warning("%s: begun anew (%s)", folder / _FILE, error)

    def day_over(self, instant: pd.Timestamp) -> str:
        """What the days so far say, at the second decision of a day, when the journal has the last; else ''.

        Raises `DataError` where a day cannot be judged, and as `read_run`.
        """
        if self._over is not None:
            begin, self._over = self._over, None
            self._today = instant.date()
            day = judged_day(self._folder, self._model, begin)
            if day.day not in [known.day for known in self.days]:
                self.days.append(day)
                write_json(self._folder / _FILE, {"said": in_words(self.days), "days": [asdict(d) for d in self.days]})
            return in_words(self.days)
        if self._today is not None and instant.date() != self._today:
            self._over = pd.Timestamp(self._today, tz=instant.tz)
        self._today = instant.date()
        return ""


def in_words(days: Sequence[ShadowDay]) -> str:
    """What the days say together, in a sentence; of fewer than a week that it is too early."""
    if len(days) < LEAST_AFTER:
        return f"shadow: {counted(len(days), 'day')} of the {LEAST_AFTER} that an account needs"

    def total(name: str) -> float:
        return sum(float(getattr(day, name)) for day in days)

    saved = total("energy_kWh") - total("planned_kWh")
    low, high = total("energy_kWh") - total("planned_high_kWh"), total("energy_kWh") - total("planned_low_kWh")
    share = 100.0 * saved / max(total("energy_kWh"), 1e-9)
    cost = total("cost") - total("planned_cost")
    low_cost, high_cost = total("cost") - total("planned_high_cost"), total("cost") - total("planned_low_cost")
    claim = "would have saved" if low_cost > 0.0 else "no saving can be claimed: the band holds 0;"
    if high_cost < 0.0:
        claim = "would have saved nothing:"
    words = (
        f"shadow, {len(days)} days: {claim} {saved:+.1f} kWh ({share:+.1f} %, 90 % band {low:+.1f} to {high:+.1f}), "
        f"{cost:+.2f} of cost ({low_cost:+.2f} to {high_cost:+.2f}); rooms {total('planned_discomfort_Kh'):.1f} "
        f"instead of {total('discomfort_Kh'):.1f} K·h outside their bounds"
    )
    left_K = float(np.mean([day.left_K for day in days]))
    return words if abs(left_K) < 0.05 else f"{words}; days end {left_K:+.2f} K away from how they did"


def judged_day(folder: Path, model: ThermalModel, begin: pd.Timestamp) -> ShadowDay:
    """The day from `begin`, midnight, on, from the journal in `folder`.

    Raises:
        DataError: no plan was made at its begin, or levels or temperatures were not measured in it.
        JournalError: the journal cannot be read.
    """
    path = folder / NAME
    with making_sense(path):
        entries = read_run(path).entries
        origin = told_building(entries[0].content).origin
        if origin is None:
            raise InputError(f"{path}: is of a simulated building")
        steps = list(told_steps(told_loops(entries).get("thermoforce_mpc", [])))
        begin_s = float((begin - origin).total_seconds())
        at = next((i for i, step in enumerate(steps) if step.time_s >= begin_s - 1.0), None)
        planned = {} if at is None else planned_of(steps[at].told)
        if at is None or not planned or steps[at].time_s > begin_s + _LATE_S:
            raise DataError(f"{begin:%d %b}: nothing was planned at its begin: the day does not count")
        record, boundary = history_before(steps), forecast_of(steps[: at + 1])
    first = int(np.searchsorted(record.time_s, steps[at].time_s - 1.0))
    n = min(round(DAY_S / record.step_s), planned["u"].shape[1], record.n_steps - first)
    other = _ending_as_it_did(model, record, planned["u"][:, :n], steps[at].time_s)
    price = boundary.price_per_kWh[:, :n]
    kWh = record.step_s / J_PER_KWH
    metered_W = record.power_W[:, first : first + n]
    was_W = np.where(np.isfinite(metered_W), metered_W, other.power_W)
    costs = [float(np.nansum(power * price) * kWh) for power in (was_W, other.power_other_W)]
    energy, by_model = (float(np.nansum(power) * kWh) for power in (was_W, other.power_W))
    planned_kWh, low_kWh, high_kWh = (
        float(np.nansum(each)) for each in (other.energy_other_kWh, other.energy_low_kWh, other.energy_high_kWh)
    )
    off_kWh = abs(by_model - energy) * planned_kWh / max(by_model, 1e-9)
    low_kWh, high_kWh = max(low_kWh - off_kWh, 0.0), high_kWh + off_kWh

    def outside_Kh(T_C: Array) -> float:
        return float(np.nansum(boundary.outside_K(T_C)) / len(T_C) * record.step_s / HOUR_S)

    paid = costs[1] / planned_kWh if planned_kWh > 0.0 else 0.0
    return ShadowDay(
        day=f"{begin:%Y-%m-%d}",
        energy_kWh=energy,
        planned_kWh=planned_kWh,
        planned_low_kWh=low_kWh,
        planned_high_kWh=high_kWh,
        cost=costs[0],
        planned_cost=costs[1],
        planned_low_cost=costs[1] - paid * (planned_kWh - low_kWh),
        planned_high_cost=costs[1] + paid * (high_kWh - planned_kWh),
        discomfort_Kh=outside_Kh(other.measured_C),
        planned_discomfort_Kh=outside_Kh(other.other_C),
        left_K=float(np.nanmean(other.effect_K[:, -1])),
    )


def _ending_as_it_did(model: ThermalModel, record: Record, u: Array, start_s: float) -> Counterfactual:
    """The counterfactual of the levels `u` (A, n), those of the last hours moved until the rooms end as they did."""
    last, signs = max(1, round(_END_H * HOUR_S / record.step_s)), np.array(model.layout.signs, dtype=np.float64)
    lowest = np.array(model.layout.lowest)[:, None]

    def moved(by: float) -> Counterfactual:
        levels = u.copy()
        levels[:, -last:] = np.clip(levels[:, -last:] + by * signs[:, None], lowest, 1.0)
        return counterfactual(model, record, levels, start=start_s)

    low, high = -1.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        found = moved(middle)
        if float(np.nanmean(found.effect_K[:, -1])) > 0.0:
            high = middle
        else:
            low = middle
    return found
