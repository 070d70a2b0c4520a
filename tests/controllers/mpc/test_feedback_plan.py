"""A model whose gain sees the predicted temperature is planned with by Ipopt, and never by the quadratic programme."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.monitoring.watch import scaled
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.modulation import prove
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel


def seeing_model() -> ThermalModel:
    """The simple house's model, with a gain that falls by a third from 18 to 24 °C."""
    zone = simple_model().only
    weights = np.zeros_like(zone.operator.hidden_weight)
    weights[0, 0] = 1.0
    output = np.zeros(weights.shape[0])
    output[0] = -0.3
    operator = replace(
        zone.operator,
        hidden_weight=weights,
        output_weight=output,
        feature_mean=np.array([21.0, 0.0, 0.0, 0.0]),
        feature_scale=np.array([3.0, 5.0, 100.0, 1.0]),
        feedback=True,
    )
    return ThermalModel.of_zone(replace(zone, operator=operator))


def test_ipopt_plans_with_it_and_its_prediction_is_the_operators():
    model = seeing_model()
    assert certificate(model.only.operator).certified
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    observation = Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))
    mpc = ThermoForceMPC(model, MPCConfig(step_s=None, horizon_h=24.0), free_response=OutdoorResponse())
    plan = mpc.plan(observation)
    assert plan.status is PlanStatus.SOLVED
    context = mpc.predictor.context(observation)
    np.testing.assert_allclose(plan.T_forced_K, context.predict(plan.u).forced_K, atol=1e-4)
    blind = ThermoForceMPC(
        ThermalModel.of_zone(replace(model.only, operator=replace(model.only.operator, feedback=False))),
        MPCConfig(step_s=None, horizon_h=24.0),
        free_response=OutdoorResponse(),
    ).plan(observation)
    assert np.abs(blind.T_forced_K - plan.T_forced_K).max() > 0.01, "what the gain sees must matter"


def nearly_reversed(slope: float) -> OperatorParameters:
    """A gain that falls with the temperature: what heat did fades fast, and what it took from later heat does not."""
    poles = np.exp(-1.0 / np.array([1.0, 40.0]))
    linear = linear_operator(poles, 4.0 * (1.0 - poles), step_s=HOUR_S, hidden=1)
    falls = {"hidden_weight": np.array([[1.0, 0.0, 0.0, 0.0]]), "output_weight": np.array([-slope])}
    return replace(linear, **falls, feedback=True)


def test_it_is_certified_at_the_step_and_horizon_at_which_it_is_used():
    zone = simple_model().only
    model = ThermalModel.of_zone(replace(zone, operator=nearly_reversed(0.15)))
    assert certificate(model.only.operator).certified

    def controller(**options):
        return ThermoForceMPC(model, MPCConfig(**options), free_response=OutdoorResponse())

    for options in ({"step_s": None}, {"horizon_h": 12.0}):
        controller(**options)
    with pytest.raises(ControllerConfigError, match=r"not certified at .*step_s 900 over horizon_h 48: .*per K"):
        controller()
    with pytest.raises(DataError, match="at 900 s is not certified"):
        prove(model.only.operator)


def test_a_scaled_operator_is_certified_over_the_horizon():
    zone = replace(simple_model().only, operator=nearly_reversed(0.11).resampled(900.0))
    for n_steps, certified in ((48, True), (192, False)):
        assert scaled(zone, 1.0, 1.0, n_steps) is not None
        assert (scaled(zone, 1.3, 1.0, n_steps) is not None) == certified


@pytest.mark.slow
def test_the_quadratic_programme_refuses_it():
    with pytest.raises(ControllerConfigError, match="gain depends on the predicted temperature"):
        ThermoForceMPC(seeing_model(), MPCConfig(solver="qp"), free_response=OutdoorResponse())
