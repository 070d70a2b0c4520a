"""The two weeks of the year in which drawn houses are judged."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Period
from thermoforce_mpc.plants.checks import day_period

WEEKS = ("cold_week", "sunny_week")
_WEEK_OF = {"peak_heat_day": "cold_week", "typical_heat_day": "sunny_week"}
NAMES = (*WEEKS, *_WEEK_OF)
# First days of the weeks a window is chosen from, and least heat load of the sunny week relative to the design load.
_COLD_DAYS, _SUNNY_DAYS, _LEAST_LOAD = range(17, 53), range(60, 111), 0.12


def week_or_day(
    name: str, *, T_out_C: Array, global_W_m2: Array, load_W: Array, design_load_W: float, grid_s: float
) -> Period:
    """Return the week 'cold_week' or 'sunny_week', or two weeks from a start day.

    cold_week: lowest mean outdoor temperature of the weeks that start on day 17 to 52. sunny_week: most global
    radiation of those that start on day 60 to 110 and whose heat load at 20 °C is 12 % of the design load or more;
    without such a week the one with the highest heat load.

    BOPTEST's names stand for them: 'peak_heat_day' for the cold week, 'typical_heat_day' for the sunny one.

    Args:
        name: name of the week, or day of the year.
        T_out_C, global_W_m2: outdoor temperature and irradiance of the year every `grid_s`, shape (n,).
        load_W: heat losses at 20 °C less gains and sun, shape (n,).
        design_load_W: heat load of the house at its design outdoor temperature.
        grid_s: step of the grid, s.

    Raises:
        InputError: `name` is neither of these nor a day of the year.
    """
    name = _WEEK_OF.get(name, name)
    if name not in WEEKS:
        return day_period(name, WEEKS)
    week = round(7 * DAY_S / grid_s)

    def means(values: Array, days: range) -> Array:
        firsts = [round(day * DAY_S / grid_s) for day in days]
        return np.array([values[first : first + week].mean() for first in firsts])

    if name == "cold_week":
        day = _COLD_DAYS[int(np.argmin(means(T_out_C, _COLD_DAYS)))]
    else:
        load, sun = means(load_W, _SUNNY_DAYS), means(global_W_m2, _SUNNY_DAYS)
        needed = load >= _LEAST_LOAD * design_load_W
        day = _SUNNY_DAYS[int(np.argmax(np.where(needed, sun, -np.inf) if needed.any() else load))]
    return Period(name, day * DAY_S, scored_s=7 * DAY_S)
