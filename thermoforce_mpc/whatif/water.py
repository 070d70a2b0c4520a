"""What valves of a machine take where the water of a heating curve carries their heat, and nobody measures it."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.thermal_model import ThermalModel

LESS_PER_K = (0.11, 0.04)
"""Share by which the heat of a level falls per K of the room, 1/K, mean and standard deviation: water is about 10 K
warmer than rooms and emitters. Of 12 valves of six drawn houses, whose rooms were 0.2 to 2.1 K warmer under plans, 0.07
to 0.24, median 0.11 (houses of `bench saving --mode worth --seed 9`, 28 November 2026)."""
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


def others_by(was: Array, other: Array) -> float:
    """How far levels (A, n) are others than they were, 0 to 1; 0 of none."""
    return float(min(np.abs(other - was).sum() / max(was.sum(), 1e-9), 1.0)) if was.size else 0.0
