"""Warmth of a machine's water: the level that it follows over the time constant of the emitter.

A heat pump, or a boiler that condenses, takes more power per heat the warmer its water is. Radiators follow the level
within an hour: at full level after a pause the water is cold and heat is cheap, after an hour at that level it is not,
whether the heat is given in blocks or by a level held. Power is then that of the level and a part u·w in the warmth w;
a level or a share of time that stays, which is what a plan decides, has w = u: a part in u².
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.data.series.lag import lagged

# Times that are tried, s. A floor takes longer than the last but one: there no step of a plan warms its own water.
WATER_S = (0.25 * HOUR_S, 0.5 * HOUR_S, HOUR_S, 2.0 * HOUR_S, 6.0 * HOUR_S)
LONGEST_S = 2.0 * HOUR_S
# Share of the error of a power without it that may be left: else something else than the water makes most of it.
MOST_LEFT = 0.6
# Error over that with the measured return water up to which it stands for that: a plan sees the level, not the water.
AS_GOOD = 1.5
# Warmth at which levels are compared: that of a machine that gives half its heat.
COMPARED_AT = 0.5


def warmth(u: Array, step_s: float, water_s: float) -> Array:
    """Mean over each step of the level that the water follows over `water_s`, (n,); it begins at the mean of `u`."""
    levels = np.nan_to_num(u)
    ends = lagged(levels, float(np.exp(-step_s / water_s)), float(levels.mean()))
    return np.asarray(0.5 * (ends[:-1] + ends[1:]))


def squares_of(histories: Sequence[Record], water_s: float) -> Array:
    """Level times warmth in each step of records of one actuator, (n,)."""
    return np.concatenate([h.u[0] * warmth(h.u[0], h.step_s, water_s) for h in histories])
