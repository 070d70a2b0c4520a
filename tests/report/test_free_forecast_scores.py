"""The score of the free forecasts in a run's report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from faults import shifted
from simple_house import SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.report.html import free_forecast_scores


@pytest.mark.slow
@pytest.mark.parametrize(("error_K", "coverage"), [(0.1, 1.0), (0.3, 0.0)])
def test_errors_and_coverage_are_those_of_the_free_forecast_alone(error_K, coverage):
    house = SimpleHouse()
    # What would answer the error is off: the scores are those of the forecast.
    options = {"step_s": None, "horizon_h": 24, "corrections": False, "watch": {"enabled": False}}
    config = MPCConfig.model_validate(options)
    mpc = ThermoForceMPC(simple_model(), config, free_response=shifted(error_K))
    result = run_closed_loop(house, mpc, replace(house.period("x"), scored_s=4 * DAY_S))
    rows = free_forecast_scores(result)
    assert [row["hours"] for row in rows] == [1.0, 6.0, 24.0]
    # The model and the forecast are exact but for the shift, whatever the controller did meanwhile.
    np.testing.assert_allclose([row["mae_K"] for row in rows], error_K, atol=0.03)
    assert [row["coverage"] for row in rows] == [coverage] * 3
    # Of four days, without the first two, while corrections adapt.
    assert rows[0]["n"] == 96 - 48 - 1


def test_rules_have_no_forecasts_to_score():
    from controllers.rules.thermostat import Thermostat

    house = SimpleHouse()
    assert free_forecast_scores(run_closed_loop(house, Thermostat(), house.period("x"))) == []
