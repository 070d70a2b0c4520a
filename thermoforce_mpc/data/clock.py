"""The type of arrays, units of time and energy, and instants that go up in equal steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import DataError

HOUR_S = 3600.0
DAY_S = 86400.0
YEAR_S = 365 * DAY_S
"""A year of weather, prices and schedules, s: it has no 29 February, and repeats."""

ZERO_C_K = 273.15
"""0 °C in K."""

J_PER_KWH = 3.6e6

Array = NDArray[np.float64]

# Tolerance of equal steps, s: clocks in milliseconds and summed steps round; more is a missing sample.
CLOCK_ROUNDING_S = 0.01
# Tolerance on instants and steps that should be the same, s: plants round their clocks.
CLOCK_TOLERANCE_S = 1.0


def check_clock(time_s: Array, what: str) -> None:
    """Refuse instants that do not go up in equal steps; raises `DataError` naming the first step that is wrong."""
    steps = np.diff(time_s)
    if not steps.size or (steps[0] > 0 and np.abs(steps - steps[0]).max() <= CLOCK_ROUNDING_S):
        return
    sound = np.sort(steps[steps > 0])
    usual = float(sound[(sound.size - 1) // 2]) if sound.size else float("nan")
    first = int(np.argmin(np.abs(steps - usual) <= CLOCK_ROUNDING_S))
    among = f" among steps of {usual:.10g} s" if sound.size else ""
    raise DataError(
        f"{what}: time_s goes from {time_s[first]:.10g} s (index {first}) to {time_s[first + 1]:.10g} s: a step of "
        f"{steps[first]:.10g} s{among}; steps must be equal and positive: resample, with NaN where nothing was measured"
    )
