"""Operators whose modulation sees the predicted temperature: three forms agree, and the certificate tells the truth."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from later import torch, torch_operator
from operators import HEAT_MAP, random_features, random_operator

from thermoforce_mpc.errors import ArtifactError, DataError
from thermoforce_mpc.model.exported import rollout_function
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.certificate import certificate, feedback_bounds, modulation_slope
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.saved import content_sha256
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model

N = 8


def total(*args, **kwargs):
    return replace(random_operator(*args, **kwargs), feedback=True)


operators = st.builds(
    total,
    seed=st.integers(0, 2**32 - 1),
    order=st.integers(1, 3),
    scale=st.sampled_from([1e-3, 0.03, 0.1, 0.3, 1.0, 30.0, 1e50]),
    sign=st.sampled_from([1, -1]),
    gamma=st.sampled_from([0.0, 0.3, 0.75]),
    heat_input=st.sampled_from([IDENTITY, HEAT_MAP, HeatInput(u_min=-1.0)]),
)


def _loop(params, F0, u, features) -> np.ndarray:
    F, out = np.array(F0, dtype=float), []
    for t in range(len(u)):
        x = np.array(features[t])
        x[0] += F.sum()
        x = (x - params.feature_mean) / params.feature_scale
        mlp = params.output_weight @ np.tanh(params.hidden_weight @ x + params.hidden_bias) + params.output_bias
        v = float(params.heat_input(u[t], features[t, 1]))
        F = params.poles * F + params.gains * (1 + params.gamma * np.tanh(mlp)) * v
        out.append(F)
    return np.array(out)


def _jacobian(params, F0, u, features) -> np.ndarray:
    """∂F(end of step j)/∂u(step t), shape (N, N), by autodiff through the recursion."""
    module = torch_operator.ForcedResponseOperator(params)
    start, x = torch.tensor(F0), torch.tensor(features)
    return torch.autograd.functional.jacobian(lambda a: module(start, a, x).sum(-1), torch.tensor(u)).numpy()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_three_forms_follow_the_recursion(order):
    rng = np.random.default_rng(order)
    params = total(order, order, scale=0.3, heat_input=HEAT_MAP)
    assert params.feedback_active
    F0, u, features = rng.normal(size=order), rng.uniform(0, 1, (5, N)), random_features(rng, N)
    together = forced_rollout(params, F0, u, features)
    module = torch_operator.ForcedResponseOperator(params)
    for i in range(5):
        expected = _loop(params, F0, u[i], features)
        np.testing.assert_allclose(together[i], expected, atol=1e-12)
        modes, forced = rollout_function(ThermalModel.single(params), N, params.step_s, part_load="held")(
            F0, u[i], features.T
        )
        np.testing.assert_allclose(np.array(modes).T, expected, atol=1e-10)
        np.testing.assert_allclose(np.array(forced).ravel(), expected.sum(-1), atol=1e-10)
    by_torch = module(torch.tensor(F0), torch.tensor(u), torch.tensor(features)).detach().numpy()
    np.testing.assert_allclose(by_torch, together, atol=1e-10)
    blind = replace(params, feedback=False)
    assert np.abs(forced_rollout(blind, F0, u, features) - together).max() > 1e-4, "the choice must matter"
    assert torch_operator.ForcedResponseOperator(params).numpy().feedback


@pytest.mark.slow
@settings(max_examples=80, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1))
def test_every_effect_lies_in_the_certified_interval(params, seed):
    rng = np.random.default_rng(seed)
    proof = certificate(params, N)
    low, high = np.array(proof.effect_low_K), np.array(proof.effect_high_K)
    # From all-on to random, and far from the data: where feedback is strongest is unknown.
    u_min = params.heat_input.u_min
    for u in (np.ones(N), rng.uniform(u_min, 1, N), np.full(N, u_min or 1e-3)):
        features = random_features(rng, N)
        jacobian = _jacobian(params, rng.normal(size=params.order), u, features)
        room = 1e-9 * float(np.abs(params.gains).sum()) * params.heat_input.slope_bounds()[1]
        for t in range(N):
            effect = jacobian[t:, t]
            assert np.all(effect >= low[: N - t] - room)
            assert np.all(effect <= high[: N - t] + room)
    if proof.certified:
        assert np.all((low if params.sign > 0 else -high) >= -1e-6 * np.abs(params.gains).sum())
    else:
        assert any("per K" in reason for reason in proof.reasons)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1))
def test_slope_of_the_network_is_enclosed(params, seed):
    low, high = modulation_slope(params)
    x = random_features(np.random.default_rng(seed), 40)
    up, down = x.copy(), x.copy()
    up[:, 0] += 1e-4
    down[:, 0] -= 1e-4
    slope = (params.modulation(up) - params.modulation(down)) / 2e-4
    assert np.all(slope >= low - 1e-6)
    assert np.all(slope <= high + 1e-6)


def test_bounds_are_attained_by_the_worst_course():
    """Not only sound but tight: some course of feedback inside the interval reaches the lower bound."""
    params = total(5, 3, scale=0.1)
    bounds = feedback_bounds(params, 6)
    least = np.inf
    for bits in range(2**5):
        x = np.array(params.gains)
        for j in range(5):
            kappa = bounds.slope_per_K[bits >> j & 1]
            x = params.poles * x + kappa * params.gains * x.sum()
        least = min(least, x.sum())
    assert bounds.response_low_K[5] == pytest.approx(least, abs=1e-7)


def test_mild_feedback_is_certified_and_none_is_the_old_certificate():
    mild = total(3, 2, scale=0.03, gamma=0.3)
    proof = certificate(mild, 48)
    assert proof.certified, proof.reasons
    assert proof.feedback_slope_per_K[0] < 0 < proof.feedback_slope_per_K[1]
    linear = linear_operator([0.5, 0.98], [0.3, 0.05], step_s=3600.0)
    seen = replace(linear, feedback=True)
    assert not seen.feedback_active
    np.testing.assert_allclose(certificate(seen).effect_low_K, certificate(linear).effect_low_K, rtol=1e-12)


def _turns_around():
    """m falls steeply with the temperature near 20 °C: heating now switches the effect of the heating after it off."""
    linear = linear_operator([0.9], [1.0], step_s=3600.0, hidden=1)
    return replace(
        linear,
        feedback=True,
        hidden_weight=np.array([[4.0, 0.0, 0.0, 0.0]]),
        output_weight=np.array([-4.0]),
        feature_mean=np.array([20.0, 0, 0, 0]),
    )


def test_an_operator_that_turns_around_is_not_certified():
    params = _turns_around()
    features = np.tile([19.8, 5.0, 0.0, 0.0], (4, 1))
    u = np.array([0.0, 1.0, 0.0, 0.0])
    more = np.array([0.3, 1.0, 0.0, 0.0])
    effect = (forced_rollout(params, np.zeros(1), more, features) - forced_rollout(params, np.zeros(1), u, features))[
        :, 0
    ]
    assert effect[0] > 0 > effect[1], "more heat, colder afterwards"
    proof = certificate(params)
    assert not proof.certified
    (reason,) = proof.reasons
    assert "-12" in reason, "the slope of 0.75 * 4 * 4 per K must be named"
    assert "feedback: false" in reason


def test_cooling_by_a_signed_level_turns_the_feedback_around():
    """m rises with the temperature: that strengthens heating, and while the level is below 0 it weakens the effect."""
    params = replace(
        linear_operator([0.5], [2.0], step_s=3600.0, hidden=1, heat_input=HeatInput(u_min=-1.0)),
        feedback=True,
        hidden_weight=np.array([[0.5, 0.0, 0.0, 0.0]]),
        output_weight=np.array([1.0]),
        feature_mean=np.array([20.0, 0, 0, 0]),
    )
    features = np.tile([23.0, 5.0, 0.0, 0.0], (4, 1))
    cooling = np.full(4, -1.0)
    less = np.where(np.arange(4) < 1, -0.999, cooling)
    effect = (
        forced_rollout(params, np.zeros(1), less, features) - forced_rollout(params, np.zeros(1), cooling, features)
    )[:, 0]
    assert effect[0] > 0 > effect[1], "less cooling, colder afterwards"
    proof = certificate(params)
    assert not proof.certified
    assert proof.feedback_slope_per_K == (-0.375, 0.375)
    assert np.all(effect >= 0.001 * np.array(proof.effect_low_K[:4]))


def test_runaway_feedback_ends_in_an_answer():
    params = replace(total(1, 2), output_weight=np.full(32, 1e90), hidden_weight=np.full((32, 4), 1e60))
    proof = certificate(params)
    assert not proof.certified
    assert proof.effect_low_K[0] == -np.inf


def test_feedback_that_is_no_truth_value_is_refused():
    with pytest.raises(DataError, match="feedback"):
        replace(random_operator(1), feedback="zone")


def test_artifact_keeps_the_choice_and_refuses_what_is_not_proven(tmp_path):
    mild = total(3, 2, scale=0.03, gamma=0.3)
    folder = ThermalModel.single(mild).save(tmp_path / "mild")
    assert load_model(folder).only.operator.feedback
    assert '"feedback_slope_per_K"' in (folder / "model.json").read_text()
    with pytest.raises(ArtifactError, match=r"within \[-12, 0\] per K.*could reverse the effect of an action: 2 steps"):
        ThermalModel.single(_turns_around()).save(tmp_path / "turns")
    # The same weights edited in from outside.
    free = ThermalModel.single(replace(_turns_around(), feedback=False)).save(tmp_path / "edited")
    document = json.loads((free / "model.json").read_text().replace('"feedback": false', '"feedback": true', 1))
    (free / "model.json").write_text(json.dumps(document | {"sha256": content_sha256(document)}))
    with pytest.raises(ArtifactError, match="fails its certificate"):
        load_model(free)
