"""The operator follows a building that changes, and only where the data say so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, random_levels, record

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.estimation.adaptation import AdaptationConfig, OnlineAdaptation
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator import BuildingOperator, HeatInput, certificate, linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.settings import validate

HOUSE = House(machine_W=(0.0, 10000.0), slope_per_K=0.0)
LINEAR = IdentificationConfig(order=3, modulation="linear")
ON = AdaptationConfig(enabled=True)
STEP_S = 3600.0


@pytest.fixture(scope="module", params=[False, True], ids=["heat unknown", "heat measured"])
def measured(request):
    return request.param


@pytest.fixture(scope="module")
def model(measured):
    return identify(
        [record(HOUSE, 5.0, noise_K=0.01, heat_measured=measured)], config=LINEAR, floor_area_m2=190.0, step_s=STEP_S
    ).only


def _degrading(measured: bool, to: float = 0.8, days: float = 24.0, u=None):
    """A run whose machine gives `to` of its heat after the first third."""
    n = round(days * 24)
    u = random_levels(n, 4, hold=4) if u is None else u
    left = np.where(np.arange(n) < n // 3, 1.0, to)
    run = record(HOUSE, days, STEP_S, seed=4, u=u * left, noise_K=0.01, heat_measured=measured)
    return replace(run, u=u)


def _effect(operator) -> float:
    """What six hours of full actuation have done after a day, K."""
    v = operator.heat_input(np.ones(6), np.zeros(6))
    return float(np.convolve(operator.impulse(24), v)[23])


@pytest.mark.slow
def test_a_machine_that_weakens_by_a_fifth_is_noticed(model, measured):
    run = _degrading(measured)
    found = OnlineAdaptation(model, ON).update(None, run.last(run.n_steps))  # all of it at once
    fixed, adapted = _effect(model.operator), _effect(found.model.operator)
    assert adapted / fixed == pytest.approx(0.8, abs=0.06)
    third = [s for s in found.steps if s.time_s <= run.time_s[run.n_steps // 3]]
    assert third[-1].gain * third[-1].heat == pytest.approx(1.0, abs=0.06), "nothing had changed by then"
    last = found.steps[-1]
    if measured:
        assert last.heat == pytest.approx(0.8, abs=0.05)
        assert last.gain == pytest.approx(1.0, abs=0.06), "the building is as it was"
    else:
        assert last.heat == 1.0
    assert certificate(found.model.operator).certified
    assert {s.outcome for s in found.steps} == {"updated", "not informative"}


@pytest.mark.slow
def test_step_by_step_is_the_same_as_at_once(model, measured):
    run = _degrading(measured, days=3.0)
    adaptation, piecewise = OnlineAdaptation(model, ON), None
    whole = adaptation.update(None, run)
    for n in range(1, run.n_steps + 1):
        piecewise = adaptation.update(piecewise, run.slice(0, n))
    assert [s.time_s for s in piecewise.steps] == [s.time_s for s in whole.steps]
    for a, b in zip(piecewise.steps, whole.steps, strict=True):
        assert (a.outcome, a.gain, a.heat) == (b.outcome, pytest.approx(b.gain, abs=0.01), pytest.approx(b.heat))


def test_off_by_default(model, measured):
    state = OnlineAdaptation(model).update(None, _degrading(measured))
    assert state.model is model
    assert state.steps == ()


def test_weeks_without_excitation_leave_everything_as_it_is(model, measured):
    run = _degrading(measured, u=np.full(24 * 24, 0.35))
    adaptation = OnlineAdaptation(model, ON).update(None, run)
    operator = adaptation.model.operator
    assert {s.outcome for s in adaptation.steps} == {"not informative"}
    assert len({s.gain_sd for s in adaptation.steps}) == 1, "nothing is forgotten for want of data"
    np.testing.assert_allclose(operator.poles, model.operator.poles, rtol=1e-12)
    # Measured heat needs no excitation: it is compared with the map directly.
    assert adaptation.steps[-1].heat == (pytest.approx(0.8, abs=0.05) if measured else 1.0)


def test_bounds_are_kept_whatever_happens(model, measured):
    config = AdaptationConfig(enabled=True, gain_bounds=(0.9, 1.1), forgetting_days=2.0, time_constant_sd=1.0)
    adaptation = OnlineAdaptation(model, config).update(None, _degrading(measured, to=0.1))
    operator = adaptation.model.operator
    assert min(s.gain for s in adaptation.steps) >= 0.9 - 1e-12
    assert min(s.heat for s in adaptation.steps) >= 0.9 - 1e-12
    low, high = model.operator.pole_bounds.T
    assert np.all((operator.poles >= low) & (operator.poles <= high))
    assert certificate(operator).certified


def test_a_weaker_machine_warms_the_neighbours_less_too():
    """Measured heat does in every zone what it did; a level brings less of it to all."""
    load = MachineLoad((0.0, 0.0, 5000.0, 50.0), (-10.0, 15.0))
    head = linear_operator([0.8, 0.98], [0.3, 0.05], step_s=HOUR_S, heat_input=HeatInput(heat=load))
    neighbour = replace(head, gains=0.2 * head.gains)
    operator = BuildingOperator(("bath", "study"), ("heater",), ((head,), (neighbour,)), (0,))
    building = ThermalModel(operator, (None,), (None, None), (ModelCard(),), ("heater",))
    adaptation = OnlineAdaptation(building.actuator(0))
    weaker = adaptation.rescaled(adaptation.started(), gain=1.0, heat=0.8)
    assert weaker is not None
    adapted = building.with_actuators([weaker.model]).operator
    features = np.tile([18.0, 5.0, 0.0, 0.0], (2, 24, 1))
    at_full = [one.rollout(np.zeros((2, 1, 2)), np.ones((1, 24)), features) for one in (operator, adapted)]
    np.testing.assert_allclose(at_full[1], 0.8 * at_full[0], rtol=1e-12)
    for (z, a, before), (_, _, after) in zip(operator.each(), adapted.each(), strict=True):
        per_W = before.gains / before.heat_input.reference_W
        np.testing.assert_allclose(after.gains / after.heat_input.reference_W, per_W, rtol=1e-12, err_msg=f"{z}, {a}")


def test_a_silent_sensor_is_not_learned_from(model, measured):
    run = _degrading(measured, days=2.0)
    T = np.array(run.T_zone_C[0])
    T[1:] = np.nan
    adaptation = OnlineAdaptation(model, ON).update(None, replace(run, T_zone_C=T))
    assert {s.outcome for s in adaptation.steps} == {"not measured"}
    np.testing.assert_array_equal(adaptation.model.operator.gains, model.operator.gains)


def test_bounds_must_hold_the_identified_gain():
    with pytest.raises(ConfigError, match="must be positive and include 1"):
        validate(AdaptationConfig, {"gain_bounds": [1.1, 1.5]}, "adaptation")


@pytest.mark.parametrize("name", ["T_out_C", "u"])
def test_gaps_are_bridged_and_a_block_full_of_them_is_not_looked_at(model, measured, name):
    run = _degrading(measured, days=6.0)
    values = np.array(getattr(run, name))
    values[..., [3, 40]] = np.nan
    values[..., 72:84] = np.nan
    adaptation = OnlineAdaptation(model, ON)
    whole = adaptation.update(None, run)
    holed = adaptation.update(None, replace(run, **{name: values}))
    assert [step.outcome for step in holed.steps].count("not measured") == 1
    assert holed.steps[6].outcome == "not measured"
    assert holed.steps[-1].gain * holed.steps[-1].heat == pytest.approx(
        whole.steps[-1].gain * whole.steps[-1].heat, abs=0.08
    )
