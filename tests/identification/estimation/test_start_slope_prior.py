"""The prior on how fast full level moves the zone at first: an air-heated room is not a slab."""

import numpy as np
import pytest
from pydantic import ValidationError

from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.modes import mode_priors
from thermoforce_mpc.model.operator.heat_input import IDENTITY


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_given_start_slope_replaces_the_default_and_nothing_else(order):
    default = mode_priors(order, IdentificationConfig(), IDENTITY, None)
    given = mode_priors(order, IdentificationConfig(start_slope_K_per_h=(5.0, 10.0)), IDENTITY, None)
    assert (given.gain_mean[0], given.gain_sd[0]) == (5.0, 10.0)
    assert given.gain_mean[0] != default.gain_mean[0]
    assert np.array_equal(given.gain_mean[1:], default.gain_mean[1:])
    assert given.slowest_rate == default.slowest_rate


def test_a_start_slope_without_spread_is_refused():
    with pytest.raises(ValidationError, match="start_slope_K_per_h has standard deviation 0"):
        IdentificationConfig(start_slope_K_per_h=(5.0, 0.0))
