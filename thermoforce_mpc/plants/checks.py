"""Input checks shared by all simulated plants, with common messages."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from thermoforce_mpc.boundary.weather.year import YEAR_S
from thermoforce_mpc.data import DAY_S, Array, Period
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.scenario.room_setpoints import RoomSetpoints
from thermoforce_mpc.scenario.testcase import Actuator


def day_period(name: str, named: Iterable[str]) -> Period:
    """Return the window of two weeks from start day `name`; `named` lists the named windows for the message.

    Raises:
        InputError: `name` is not a number, or not a day of the year.
    """
    try:
        day = float(name)
    except ValueError:
        known = ", ".join(named) or "nothing else"
        raise InputError(f"period '{name}': expected {known} or a start day") from None
    if not 0.0 <= day < 365.0:
        raise InputError(f"period '{name}': a start day lies between 0 and 365")
    return Period(f"day {day:g}", day * DAY_S)


def check_start(start_s: float, warmup_s: float) -> None:
    """Raise `InputError` unless both are finite, nonnegative seconds and the start lies inside the year."""
    for label, value in (("start", start_s), ("warm-up", warmup_s)):
        if not (isinstance(value, int | float) and math.isfinite(value) and value >= 0):
            raise InputError(f"{label} of {value!r} s: expected a finite, nonnegative number of seconds")
    if start_s >= YEAR_S:
        raise InputError(f"start of {start_s:g} s lies beyond the year ({YEAR_S:g} s)")


def check_level_and_duration(u: float | None, duration_s: float, lowest: float = 0.0) -> None:
    """Raise `InputError` unless `u` is None or in [`lowest`, 1] and `duration_s` is positive and less than a year."""
    number = u is None or (isinstance(u, int | float | np.number) and math.isfinite(u) and lowest <= u <= 1.0)
    if not number:
        raise InputError(f"level of {u!r}: expected a number from {lowest:g} to 1, or None")
    if not (isinstance(duration_s, int | float | np.number) and 0 < duration_s < YEAR_S):
        raise InputError(f"step of {duration_s!r} s: expected a positive number, less than a year")


def plant_inputs(
    actuator: Actuator | RoomSetpoints, u: float | None, band_C: tuple[float, float] | None, T_zone_C: float
) -> dict[str, float]:
    """Return the inputs for a level with the room at `T_zone_C` or, for room set-points, the band to keep, °C.

    Raises:
        InputError: a band for an actuator without room set-points, or one that is not two rising finite numbers.
    """
    if isinstance(actuator, RoomSetpoints):
        if band_C is not None and not (all(map(math.isfinite, band_C)) and band_C[0] <= band_C[1]):
            raise InputError(
                f"room set-points of {band_C!r} °C: expected a heating set-point not above the cooling one"
            )
        if band_C is None and u is not None and u not in (-1.0, 0.0, 1.0) and u != actuator.lowest:
            raise InputError(f"level of {u:g} without room set-points: a loop can only be driven to its limits")
        return actuator.inputs(u, band_C)
    if band_C is not None:
        raise InputError(f"room set-points of {band_C!r}: the actuator '{actuator.point}' has none")
    return actuator.inputs(u, T_zone_C)


def forecast_times(now_s: float, horizon_s: float, interval_s: float) -> Array:
    """Return the instants from `now_s` to `horizon_s` ahead every `interval_s`, s, shape (N + 1,).

    Raises:
        InputError: horizon or interval is not positive, or the horizon is shorter than the interval.
    """
    if not (math.isfinite(horizon_s) and math.isfinite(interval_s) and 0 < interval_s <= horizon_s):
        raise InputError(f"forecast of {horizon_s!r} s every {interval_s!r} s: expected 0 < interval <= horizon")
    steps = np.arange(math.floor(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
    return np.asarray(now_s + steps * interval_s, dtype=np.float64)


def check_record_step(step_s: float) -> None:
    """Raise `InputError` unless a record can be asked for at steps of `step_s`: finite and positive, s."""
    if not (math.isfinite(step_s) and step_s > 0):
        raise InputError(f"history at {step_s!r} s: expected a positive number of seconds")
