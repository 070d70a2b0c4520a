"""The type of arrays, units, widths of bands, instants as people write them, and those that go up in equal steps."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import DataError, InputError

HOUR_S = 3600.0
DAY_S = 86400.0
DAY_H = 24
PLAN_STEP_S, PLAN_H = 900.0, 48.0
"""Step, s, and horizon, h, of plans where nobody names others, and the step of records and rules beside them.

Power is metered and priced by the quarter hour. A slab's effect comes and goes within two days, and prices are known to
the end of the next: no more would change what is done now."""
YEAR_S = 365 * DAY_S
"""A year of weather, prices and schedules, s: it has no 29 February, and repeats."""

CLOCKS_S, ZONES_S = 300.0, 1200.0
"""How far two clocks are apart at most that are both set, s; and from when on one is probably of another zone: zones
differ by half an hour at least, less what a reading is old."""

ZERO_C_K = 273.15
"""0 °C in K."""

J_PER_KWH = 3.6e6

NORMAL_90, NORMAL_95 = 1.2816, 1.645
"""Quantiles 0.9 and 0.95 of the normal distribution: half of an 80 % and a 90 % band, standard deviations."""

Array = NDArray[np.float64]

# Tolerance of equal steps, s: clocks in milliseconds and summed steps round; more is a missing sample.
CLOCK_ROUNDING_S = 0.01
# Tolerance on instants and steps that should be the same, s: plants round their clocks.
CLOCK_TOLERANCE_S = 1.0


@overload
def energy_kWh(power_W: Array, duration_s: Array | float) -> Array: ...
@overload
def energy_kWh(power_W: float, duration_s: float) -> float: ...
def energy_kWh(power_W: Any, duration_s: Any) -> Any:
    """Energy of mean powers, W, that last so long, s; of shapes that broadcast."""
    return power_W * duration_s / J_PER_KWH


def steps_in(seconds: float, step_s: float) -> int:
    """How many steps of `step_s` a time has, to the nearest, one at least."""
    return max(1, round(seconds / step_s))


def cost_per_W(price_per_kWh: Array | float, duration_s: float) -> Any:
    """Cost of a watt that lasts so long, s, at prices per kWh of any shape, currency/W."""
    return price_per_kWh * duration_s / J_PER_KWH


def in_fahrenheit(T_C: Any) -> Any:
    """Temperatures of any shape, °C, in °F."""
    return 1.8 * T_C + 32.0


def in_celsius(T_F: Any) -> Any:
    """Inverse of `in_fahrenheit`."""
    return (T_F - 32.0) / 1.8


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


def seconds_of(at: str, option: str = "--at") -> float:
    """Seconds since 1 January of a time as people write it.

    '16 06:30' is half past six of day 16 (days from 0, as `--period`), '16.5' noon of it, '01-17 06:30' and
    '17 Jan 06:30' the calendar's, '1405800s' seconds. Raises `InputError` for anything else.
    """
    text = at.strip()
    if match := re.fullmatch(r"(\d+(?:\.\d+)?) ?s", text):
        return float(match[1])
    if match := re.fullmatch(r"(\d+(?:\.\d+)?)(?: ?d)?(?: +(\d{1,2}):(\d{2}))?", text):
        return float(match[1]) * DAY_S + HOUR_S * int(match[2] or 0) + 60.0 * int(match[3] or 0)
    for form in ("%m-%d %H:%M", "%m-%dT%H:%M", "%d %b %H:%M"):
        try:
            moment = datetime.strptime(f"2021 {text}", f"%Y {form}")
        except ValueError:
            continue
        return (moment - datetime(2021, 1, 1)).total_seconds()
    raise InputError(
        f"{option} {at}: not a time; write '16 06:30' (day from 0, as --period), '01-17 06:30' or '1405800s'"
    )


def hour_of_day(time_s: Array | float) -> Array:
    """Hour of the day, from 0 up to 24, at `time_s` of any shape, s since midnight of any day."""
    return np.asarray(np.asarray(time_s) % DAY_S / HOUR_S)


def whole_hour(time_s: Array | float) -> NDArray[np.intp]:
    """Number of the hour of the day, 0 to 23, that holds `time_s` of any shape, s since midnight of any day.

    A clock that rounds begins it up to `CLOCK_TOLERANCE_S` early.
    """
    return np.asarray(_hour_that_holds(np.asarray(time_s)), dtype=np.intp)


def hour_at(time_s: float) -> int:
    """`whole_hour` of one time, s, in a tenth of its CPU."""
    return int(_hour_that_holds(time_s))


def _hour_that_holds(time_s: Any) -> Any:
    return (time_s + CLOCK_TOLERANCE_S) % DAY_S // HOUR_S


def words_of(time_s: float) -> str:
    """A time for people: day from 0 and clock."""
    day, minutes = divmod(round(time_s / 60.0), 24 * 60)
    return f"day {day} {minutes // 60:02d}:{minutes % 60:02d}"


# First day after each month of a year of 365 days.
_MONTH_ENDS = np.cumsum([31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31])


def month_of(time_s: Array | float) -> Array:
    """Months, 1 to 12, of `time_s`, s since 1 January, in years of 365 days."""
    return np.asarray(np.searchsorted(_MONTH_ENDS, np.floor(np.asarray(time_s) / DAY_S) % 365, side="right") + 1)
