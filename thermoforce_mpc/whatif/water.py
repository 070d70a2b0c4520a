"""What valves of a machine take where the water of a heating curve carries their heat, and nobody measures it."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, steps_in
from thermoforce_mpc.model.thermal_model import ThermalModel

LESS_PER_K = (0.11, 0.04)
"""Share by which the heat of a level falls per K of the room, 1/K, mean and standard deviation: water is about 10 K
warmer than rooms and emitters. Of 12 valves of six drawn houses, whose rooms were 0.2 to 2.1 K warmer under plans, 0.07
to 0.24, median 0.11 (houses of `bench saving --mode worth --seed 9`, 28 November 2026)."""
EMITTERS = (1.0, 0.8)
"""How well an emitter takes heat from the water of an open valve, over how well it gives it to the room: median, and
standard deviation of the logarithm. Water that cools by a third to two thirds of what it is warmer than the room has
0.5 to 2; 20 valves of six drawn houses (seeds 33021, 33022; 30 November 2026) have 0.06 to 1.1, three of a house that
was not drawn 1.6 to 1.8. Records hardly tell it. What levels at half of theirs take errs by 15 % with it and by 25 %
without (root mean square of eight such houses), open every other hour by 10 and 13 %."""
_EMITTER_H = 3.0
VALVES_SD = 0.05
"""Relative standard deviation of what a machine of several valves takes at levels that its record does not hold: which
valves are open together sets its water. For what the same six houses took under plans the change by the law errs by −1,
5, 3, −6, 0 and 8 %."""


def of_water(model: ThermalModel) -> Array:
    """1 where an actuator is one of several valves of a machine that heats, whose heat was not metered, else 0 (A,)."""
    layout = model.layout
    several = [len(layout.fed_by(m)) > 1 for m in layout.machine_of]
    laws = [own.heat_input.law is None for own in model.operator.of_actuators]
    return np.array(
        [float(one and law and sign > 0) for one, law, sign in zip(several, laws, layout.signs, strict=True)]
    )


def emitted(u: Array, step_s: float, emitters: float, warmth: Array | None = None) -> tuple[Array, Array]:
    """Heat of valves at levels `u` (A, n), over that of a cold emitter at full level, and how warm emitters are then.

    An emitter that is warm takes less: v = u·(1 − r·y), and y follows v over `_EMITTER_H`; `emitters`: r, see
    `EMITTERS`. A valve that stays open gives u/(1 + r·u), so that half of its level is more than half of its heat.
    `warmth` (A,): y at first; None: as usual on the first day.
    """
    begin = u[:, : steps_in(DAY_S, step_s)].mean(axis=1)
    y, step = begin / (1.0 + emitters * begin) if warmth is None else warmth, step_s / HOUR_S / _EMITTER_H
    heat = np.empty_like(u)
    for k, level in enumerate(u.T):
        rate = 1.0 + emitters * level
        to, stays = level / rate, np.exp(-rate * step)
        heat[:, k] = level * (1.0 - emitters * (to + (y - to) * (1.0 - stays) / (rate * step)))
        y = to + (y - to) * stays
    return heat, y


def others_by(was: Array, other: Array) -> float:
    """How far levels (A, n) are others than they were, 0 to 1; 0 of none."""
    return float(min(np.abs(other - was).sum() / max(was.sum(), 1e-9), 1.0)) if was.size else 0.0
