"""The paper's two-stage estimator on a building that is eq:arx."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import random_levels, weather

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.zones.two_stage import fit_two_stage

A, C, D, E, G = 0.96, 0.03, 4e-4, 0.25, 0.5


def arx_run(u=None, *, days=4.0, seed=0, noise_K=0.0, lasts=0.0, sign=1, thermostat=False) -> Record:
    """`lasts`: correlation of what disturbs the room from one step to the next."""
    time_s, T_out, solar = weather(days, 3600.0, seed)
    n = time_s.size - 1
    rng = np.random.default_rng(seed)
    u = random_levels(n, seed, hold=5) if u is None else np.array(u)
    T, disturbed = [19.0], 0.0
    for t in range(n):
        if thermostat:
            u[t] = float(T[-1] < 19.5)
        w, s = 0.5 * (T_out[t] + T_out[t + 1]), 0.5 * (solar[t] + solar[t + 1])
        disturbed = lasts * disturbed + np.sqrt(1.0 - lasts**2) * noise_K * rng.normal()
        T.append(A * T[-1] + sign * G * u[t] + C * w + D * s + E + disturbed)
    return Record(time_s, np.array(T), T_out, solar, u, np.full(n, np.nan), np.full(n, np.nan))


def test_exact_on_its_own_equation():
    fit = fit_two_stage([arx_run(), arx_run(seed=5)])
    np.testing.assert_allclose([fit.a, fit.c, fit.d, fit.e, fit.g], [A, C, D, E, G], rtol=1e-5)
    assert fit.rmse_K < 1e-6


def test_thermostat_feedback_does_not_hide_the_gain():
    """The reason for two stages: u is a function of T here, yet the gain comes out."""
    fit = fit_two_stage([arx_run(days=8.0, thermostat=True, noise_K=0.01)])
    assert fit.g == pytest.approx(G, rel=0.1)
    assert fit.g_sd < 0.1 * G
    assert 0 < fit.a_sd < 0.05


@pytest.mark.parametrize("lasts", [0.0, 0.8])
def test_standard_errors_are_those_of_errors_that_follow_one_another(lasts):
    """Of forty buildings in which a disturbance goes on for hours pole and gain vary as each of them says."""
    fits = [fit_two_stage([arx_run(days=10.0, seed=k, noise_K=0.05, lasts=lasts)]) for k in range(40)]
    for name in ("a", "g"):
        spread = np.std([getattr(fit, name) for fit in fits])
        assert 0.6 < spread / np.mean([getattr(fit, f"{name}_sd") for fit in fits]) < 1.4, name


def test_gain_is_clipped_to_its_sign():
    cooled = arx_run(sign=-1)
    assert fit_two_stage([cooled], sign=1).g == 0.0
    fit = fit_two_stage([cooled], sign=-1)
    assert fit.g == pytest.approx(-G, rel=1e-4)
    assert fit.operator().sign == -1


def test_pole_keeps_to_its_box():
    fit = fit_two_stage([arx_run()], time_constant_h=(1.0, 10.0))
    assert fit.a == pytest.approx(np.exp(-1 / 10))


def test_parts_are_the_papers():
    fit = fit_two_stage([arx_run()])
    operator, free = fit.operator(), fit.free_model()
    assert (operator.order, operator.n_trained) == (1, 2)
    assert operator.poles[0] == free.poles[0] == fit.a
    np.testing.assert_array_equal(free.weights[0, :3], [fit.c, fit.d, fit.e])


def test_what_it_cannot_use_is_refused():
    with pytest.raises(DataError, match="0 steps with the actuator off"):
        fit_two_stage([arx_run(np.full(96, 0.5))])
    with pytest.raises(DataError, match="0 on"):
        fit_two_stage([arx_run(np.zeros(96))])
    other = arx_run()
    slow = replace(other, time_s=other.time_s * 2)
    with pytest.raises(DataError, match="resample"):
        fit_two_stage([other, slow])


def test_identify_offers_it_as_a_method():
    config = IdentificationConfig(method="two_stage", modulation="linear")
    model = identify([arx_run()], config=config)
    assert model.only.operator.order == 1
    np.testing.assert_allclose([model.only.operator.poles[0], model.only.operator.gains[0]], [A, G], rtol=1e-5)
    np.testing.assert_allclose(model.only.free.weights[0, :3], [C, D, E], rtol=1e-5)
    run = arx_run()
    with pytest.raises(DataError, match="needs single runs"):
        identify(pairs=[Pair(run, arx_run(u=1.0 - run.u[0]))], config=config)


def test_the_papers_operator_has_195_parameters_and_uses_them():
    model = identify(
        [arx_run()], config=IdentificationConfig(method="two_stage", heat_input="identity", modulation="always")
    )
    operator = model.only.operator
    assert (operator.n_trained, operator.n_used, operator.n_effective) == (195, 195, 195)
    assert operator.poles[0] == pytest.approx(A, rel=0.01)
    assert operator.drive(np.ones(1), np.array([[15.0, 4.0, 50.0, 0.0]]))[0] * operator.gains[0] == pytest.approx(
        G, rel=0.05
    )


@pytest.mark.slow
@pytest.mark.parametrize("modulation", ["linear", "auto"])
def test_pairs_correct_what_a_wrong_second_stage_found(modulation):
    """While the actuator is on, windows are open: the second stage sees too little, a difference of pairs does not."""
    run = arx_run()
    T = np.array(run.T_zone_C[0])
    for t in range(run.n_steps):
        loss = 0.4 * G * run.u[0, t]  # a disturbance that goes with the action
        T[t + 1] = A * T[t] + C * run.T_out_C[t] + D * run.solar_W_m2[t] + E + G * run.u[0, t] - loss
    biased = replace(run, T_zone_C=T)
    rng = np.random.default_rng(3)
    pairs = []
    for k in range(4):
        first, second = (arx_run(np.repeat(rng.choice([0.0, 0.5, 1.0], 24), 4)) for _ in range(2))
        shift = 86400.0 * 7 * k
        pairs.append(Pair(*(replace(h, time_s=h.time_s + shift) for h in (first, second)), label=str(k)))
    config = IdentificationConfig(method="two_stage", modulation=modulation)
    alone = identify([biased], config=config).only.operator
    both = identify([biased], pairs, config=config)
    rows = np.concatenate([pair.a.T_zone_C[0] - pair.b.T_zone_C[0] for pair in pairs])
    assert both.only.operator.order == 1
    assert np.abs(rows).max() > 0.5
    steady = both.only.operator.gains[0] * both.only.operator.modulation(np.zeros((1, 4)))[0] / G
    assert alone.gains[0] / G < 0.8
    assert steady == pytest.approx(1.0, abs=0.12)
    assert len(both.only.card.data) == 9


def test_two_stages_of_another_order_are_refused():
    with pytest.raises(ConfigError, match="two_stage is of order 1"):
        IdentificationConfig(method="two_stage", order=3)


@pytest.mark.slow
@pytest.mark.parametrize("with_pairs", [False, True])
def test_actions_of_the_wrong_sign_are_refused_as_by_the_joint_method(with_pairs):
    """Actions that cool where heating is declared: a model without any effect would be of no use to a controller."""
    runs = [arx_run(sign=-1)]
    n = runs[0].n_steps
    pairs = [Pair(*(arx_run(random_levels(n, seed, hold=5), sign=-1) for seed in (1, 2)))] if with_pairs else []
    messages = []
    for method in ("two_stage", "joint"):
        with pytest.raises(DataError, match="no effect of the actuator with the sign of heating") as refused:
            identify(runs, pairs, config=IdentificationConfig(method=method, modulation="linear"))
        messages.append(str(refused.value))
    assert all("check the sign of u" in message for message in messages)
    found = identify(runs, pairs, config=IdentificationConfig(method="two_stage"), mode="cooling")
    assert found.only.operator.sign == -1


def test_actions_without_any_effect_are_refused():
    run = arx_run(noise_K=0.01)
    still = arx_run(0.0 * run.u[0], noise_K=0.01)
    idle = replace(run, u=random_levels(run.n_steps, 77, hold=5), T_zone_C=still.T_zone_C)
    for mode in ("heating", "cooling"):
        with pytest.raises(DataError, match=f"no effect of the actuator with the sign of {mode}"):
            identify([idle], config=IdentificationConfig(method="two_stage"), mode=mode)


def test_how_likely_it_is_that_the_actuator_acts_is_on_the_card():
    model = identify([arx_run()], config=IdentificationConfig(method="two_stage"))
    assert model.only.card.scores["acts_log_odds"] > 5.0
