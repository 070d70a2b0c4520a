"""What is simulated: two climates, three daily windows, six set-point shifts (paper, section 'Intervention suite').

A season has three parts, in this order, so that nothing learned has seen what comes later: probe days, validation days,
test days. Every day of the last two has one pair per window; which shift it gets goes round through all six.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.plants.energyplus.zone import ZoneSpec

ClimateName = Literal["heating_chicago", "cooling_phoenix", "small_office"]
WindowName = Literal["morning", "afternoon", "evening"]
Part = Literal["validation", "test"]

SHIFTS_K = (1.0, -1.0, 2.0, -2.0, 3.0, -3.0)
PROBE_DAYS = (1, 3, 7, 30)
WARMUP_DAYS = 25


@dataclass(frozen=True)
class Climate:
    """One of the two buildings: its zone, the day its season's probe part begins, and its set-points.

    `comfort_C` holds from 05:00 to 23:00, `setback_C` at night: every window, with its horizon, lies between.
    """

    name: ClimateName
    label: str
    spec: ZoneSpec
    first_day: int
    comfort_C: float
    setback_C: float

    @property
    def sign(self) -> int:
        """+1 heating, −1 cooling."""
        return 1 if self.spec.mode == "heating" else -1


CLIMATES: dict[ClimateName, Climate] = {
    "heating_chicago": Climate(
        "heating_chicago",
        "Heating (Chicago)",
        ZoneSpec("Chicago-OHare", "heating", capacity_W=4000.0, insulation_m=0.10),
        first_day=344,  # 11 December
        comfort_C=21.0,
        setback_C=19.0,
    ),
    "cooling_phoenix": Climate(
        "cooling_phoenix",
        "Cooling (Phoenix)",
        ZoneSpec("Phoenix", "cooling", capacity_W=3500.0, insulation_m=0.08, window_shgc=0.35),
        first_day=155,  # 5 June
        comfort_C=25.0,
        setback_C=27.0,
    ),
}

WINDOW_START_H: dict[WindowName, float] = {"morning": 7.0, "afternoon": 12.0, "evening": 17.0}
_COMFORT_H = (5.0, 23.0)


@dataclass(frozen=True)
class Protocol:
    """Sizes of the suite.

    Attributes:
        probe_days: K, numbers of probe days that are simulated; all end on the last day of the probe part.
        validation_days, test_days: one pair per window on each.
        shift_h: how long a shift lasts; after it the horizon shows the recovery.
        horizon_h: from the start of the shift; 24 steps of 15 min, as the paper's forecasts.
        seed: of internal gains and probing shifts.
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
        """Length of the probe part: fixed, so that every size of the suite has the same calendar."""
        return max(PROBE_DAYS)


# Four days: every shift comes up, each in two windows.
QUICK = Protocol(probe_days=(1,), validation_days=3, test_days=4)


def days_of(protocol: Protocol, climate: Climate, part: Part) -> list[int]:
    """Days of a part, counted from 1 January of the season's first year."""
    first = climate.first_day + protocol.probe_part_days
    if part == "validation":
        return list(range(first, first + protocol.validation_days))
    # Test days follow a full-size validation part in every size of the suite.
    first += Protocol().validation_days
    return list(range(first, first + protocol.test_days))


def shift_of(day_index: int, window_index: int) -> float:
    """Shift of a pair, K: six in turn, begun elsewhere in each window."""
    return SHIFTS_K[(day_index + 2 * window_index) % len(SHIFTS_K)]


def base_setpoint(climate: Climate, n_days: int) -> Array:
    """The occupant's set-points over `n_days` from midnight, °C, one per step."""
    step_h = climate.spec.step_s / HOUR_S
    hour = np.arange(round(n_days * 24 / step_h)) * step_h % 24.0
    comfortable = (hour >= _COMFORT_H[0]) & (hour < _COMFORT_H[1])
    return np.where(comfortable, climate.comfort_C, climate.setback_C)


def gains(climate: Climate, first_day: int, n_days: int, seed: int) -> Array:
    """Internal gains as a share of the full ones, one per step; the same day has the same gains in every run.

    A daily profile times what people happened to do that day: no model can know it, every model has to live with it.
    """
    step_h = climate.spec.step_s / HOUR_S
    per_day = round(24 / step_h)
    hour = np.arange(per_day) * step_h
    profile = np.where((hour >= 6) & (hour < 9), 0.7, np.where((hour >= 16) & (hour < 23), 0.8, 0.3))
    days = []
    for day in range(first_day, first_day + n_days):
        rng = np.random.default_rng([seed, day])
        hourly = rng.uniform(0.6, 1.4) * rng.lognormal(0.0, 0.4, 24)
        days.append(np.clip(profile * np.repeat(hourly, round(1 / step_h)), 0.0, 2.0))
    return np.concatenate(days)


def probing_shift(climate: Climate, n_days: int, seed: int) -> Array:
    """Set-point shifts of a probe, K, one per step: levels of the suite or none, held for two to four hours.

    None at night, where a shift would meet the edge of the set-back.
    """
    rng = np.random.default_rng([seed, n_days])
    step_h = climate.spec.step_s / HOUR_S
    per_day = round(24 / step_h)
    shift = np.zeros(n_days * per_day)
    for day in range(n_days):
        hour = _COMFORT_H[0] + 1.0
        while hour < _COMFORT_H[1] - 1.0:
            held = float(rng.choice([2.0, 3.0, 4.0]))
            end = min(hour + held, _COMFORT_H[1] - 1.0)
            level = float(rng.choice([0.0, *SHIFTS_K]))
            shift[day * per_day + round(hour / step_h) : day * per_day + round(end / step_h)] = level
            hour = end
    return shift


def seconds(day: int, hour: float) -> float:
    """Time of a day's hour, s since 1 January of the season's first year."""
    return day * DAY_S + hour * HOUR_S
