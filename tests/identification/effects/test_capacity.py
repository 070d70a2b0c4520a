"""What a machine of several metered circuits has, from what they took together."""

from __future__ import annotations

import numpy as np
import pytest
from houses import random_levels

from thermoforce_mpc.data import Layout, Names, Record
from thermoforce_mpc.identification.effects.couplings import with_metered_shares
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput

NAMES = Names(("living", "bed"), ("floor", "radiator"), ("pump",))
LAYOUT = Layout(NAMES, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (50.0, 50.0))
# At 10 °C a circuit takes 2 kW, at 0 °C 3 kW.
LAW = MachineLoad((0.0, 0.0, 3000.0, -100.0), (-15.0, 25.0))


@pytest.mark.parametrize(("limit_W", "share"), [(2500.0, 0.8), (np.inf, 1 / 3)])
def test_the_most_that_was_taken_is_a_limit_only_where_levels_asked_for_more(limit_W, share):
    """In mild weather a machine gives all that its circuits take: that says nothing of what it has in the cold."""
    n = 192
    u, T_out_C = np.stack([random_levels(n, seed, levels=(0.0, 1.0)) for seed in (1, 2)]), np.full(n + 1, 10.0)
    asked_W = LAW(u, T_out_C[:-1])
    heat_W = asked_W * np.minimum(1.0, limit_W / np.maximum(asked_W.sum(axis=0), 1.0))
    power_W = heat_W.sum(axis=0, keepdims=True) / 3.0
    time_s, T_zone_C = np.arange(n + 1) * 900.0, np.full((2, n + 1), 20.0)
    history = Record(time_s, T_zone_C, T_out_C, np.zeros(n + 1), u, power_W, heat_W, names=NAMES)
    heat_inputs = [HeatInput(heat=LAW, reference_C=10.0)] * 2
    assert with_metered_shares(LAYOUT, heat_inputs, [history]).shares == pytest.approx((share, share))
