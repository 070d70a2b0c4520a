"""Protocol of the suite: two climates, three daily windows, six set-point shifts (paper, section 'Intervention suite').

A season has three consecutive parts: probe, validation and test days, so that training data precede test data. Every
validation and test day has one pair per window; the six shifts are assigned in rotation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.plants.energyplus.zone import COMFORT_H, Climate, ClimateName

WindowName = Literal["morning", "afternoon", "evening"]
Part = Literal["validation", "test"]

SHIFTS_K = (1.0, -1.0, 2.0, -2.0, 3.0, -3.0)
PROBE_DAYS = (1, 3, 7, 30)
WARMUP_DAYS = 25


WINDOW_START_H: dict[WindowName, float] = {"morning": 7.0, "afternoon": 12.0, "evening": 17.0}


@dataclass(frozen=True)
class Protocol:
    """Sizes of the suite.

    Attributes:
        probe_days: numbers of probe days K; each probe ends on the last day of the probe part.
        validation_days, test_days: number of days with one pair per window.
        shift_h: duration of a shift, h; the rest of the horizon is recovery.
        horizon_h: horizon from the start of the shift, h; 24 steps of 15 min, as in the paper.
        seed: seed of internal gains and probing shifts.
    """

    probe_days: tuple[int, ...] = PROBE_DAYS
    validation_days: int = 12
    test_days: int = 44
    shift_h: float = 4.0
    horizon_h: float = 6.0
    seed: int = 1
    climates: tuple[ClimateName, ...] = field(default=("heating_chicago", "cooling_phoenix"))

    @property
    def probe_part_days(self) -> int:
        """Length of the probe part, days; the same for every size of the suite, so that the calendar is the same."""
        return max(PROBE_DAYS)


# Four test days cover every shift, each in two windows.
QUICK = Protocol(probe_days=(1,), validation_days=3, test_days=4)


def days_of(protocol: Protocol, climate: Climate, part: Part) -> list[int]:
    """Days of a part, from 1 January of the first year of the season."""
    first = climate.first_day + protocol.probe_part_days
    if part == "validation":
        return list(range(first, first + protocol.validation_days))
    # In every size of the suite, test days start after the full-size validation part.
    first += Protocol().validation_days
    return list(range(first, first + protocol.test_days))


def shift_of(day_index: int, window_index: int) -> float:
    """Shift of a pair, K: the six shifts in rotation, with an offset per window."""
    return SHIFTS_K[(day_index + 2 * window_index) % len(SHIFTS_K)]


def probing_shift(climate: Climate, n_days: int, seed: int) -> Array:
    """Set-point shifts of a probe, K, one per step: shifts of the suite or zero, held for two to four hours.

    Zero at night, where a shift would overlap the change of the set-back.
    """
    rng = np.random.default_rng([seed, n_days])
    step_h = climate.spec.step_s / HOUR_S
    per_day = round(24 / step_h)
    shift = np.zeros(n_days * per_day)
    for day in range(n_days):
        hour = COMFORT_H[0] + 1.0
        while hour < COMFORT_H[1] - 1.0:
            held = float(rng.choice([2.0, 3.0, 4.0]))
            end = min(hour + held, COMFORT_H[1] - 1.0)
            level = float(rng.choice([0.0, *SHIFTS_K]))
            shift[day * per_day + round(hour / step_h) : day * per_day + round(end / step_h)] = level
            hour = end
    return shift


def seconds(day: int, hour: float) -> float:
    """Time of `hour` on `day`, s since 1 January of the first year of the season."""
    return day * DAY_S + hour * HOUR_S
