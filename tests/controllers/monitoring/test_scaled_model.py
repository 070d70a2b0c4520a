"""A model scaled to what was measured does in every zone what its machine gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import simple_model

from controllers.monitoring.watch import GAIN_BOUNDS, scaled
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel


def test_a_weaker_machine_warms_the_neighbours_less_too():
    """Measured heat does in every zone what it did; a level brings less of it to all."""
    load = MachineLoad((0.0, 0.0, 5000.0, 50.0), (-10.0, 15.0))
    head = linear_operator([0.8, 0.98], [0.3, 0.05], step_s=HOUR_S, heat_input=HeatInput(heat=load))
    neighbour = replace(head, gains=0.2 * head.gains)
    operator = BuildingOperator(("bath", "study"), ("heater",), ((head,), (neighbour,)), (0,))
    building = ThermalModel(operator, (None,), (None, None), (ModelCard(),), ("heater",))
    weaker = scaled(building.actuator(0), gain=1.0, heat=0.8, n_steps=48)
    assert weaker is not None
    adapted = building.with_actuators([weaker.model]).operator
    features = np.tile([18.0, 5.0, 0.0, 0.0], (2, 24, 1))
    at_full = [one.rollout(np.zeros((2, 1, 2)), np.ones((1, 24)), features) for one in (operator, adapted)]
    np.testing.assert_allclose(at_full[1], 0.8 * at_full[0], rtol=1e-12)
    for (z, a, before), (_, _, after) in zip(operator.each(), adapted.each(), strict=True):
        per_W = before.gains / before.heat_input.reference_W
        np.testing.assert_allclose(after.gains / after.heat_input.reference_W, per_W, rtol=1e-12, err_msg=f"{z}, {a}")


@pytest.mark.parametrize(("gain", "kept"), [(0.01, GAIN_BOUNDS[0]), (1.4, 1.4), (50.0, GAIN_BOUNDS[1])])
def test_the_gain_stays_within_bounds(gain, kept):
    identified = simple_model().only
    found = scaled(identified, gain, heat=1.0, n_steps=48)
    assert (found.gain, found.adapted) == (kept, True)
    np.testing.assert_allclose(found.model.operator.gains, kept * identified.operator.gains)
