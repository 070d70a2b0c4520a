"""The paper's proposition as a property: sign and bounds of ∂F(t+k)/∂u(t), for any weights, by two roads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from later import torch, torch_operator
from operators import HEAT_MAP, random_features, random_operator

from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.certificate import certificate, modulation_interval
from thermoforce_mpc.model.operator.heat_input import IDENTITY

N = 12

operators = st.builds(
    random_operator,
    seed=st.integers(0, 2**32 - 1),
    order=st.integers(1, 3),
    scale=st.sampled_from([1e-3, 1.0, 30.0, 1e6, 1e50]),
    sign=st.sampled_from([1, -1]),
    gamma=st.sampled_from([0.0, 0.3, 0.75, 0.999]),
    heat_input=st.sampled_from([IDENTITY, HEAT_MAP]),
)
feature_sizes = st.sampled_from([1.0, 1e3, 1e40])


def _jacobian_by_autodiff(params, F0, u, features) -> np.ndarray:
    """∂F(end of step j)/∂u(step t), shape (N, N)."""
    module = torch_operator.ForcedResponseOperator(params)

    def total(actions: torch.Tensor) -> torch.Tensor:
        return module(torch.tensor(F0), actions, torch.tensor(features)).sum(-1)

    return torch.autograd.functional.jacobian(total, torch.tensor(u)).numpy()


def _impulse_bounds(params) -> tuple[np.ndarray, np.ndarray]:
    """The proposition's bounds by lag, written out anew from the paper (eq:marginal), largest magnitude second."""
    lags = np.arange(N)
    impulse = params.sign * sum(g * a**lags for a, g in zip(params.poles, params.gains, strict=True))
    slope_low, slope_high = params.heat_input.slope_bounds()
    return impulse * (1 - params.gamma) * slope_low, impulse * (1 + params.gamma) * slope_high


@pytest.mark.slow
@settings(max_examples=150, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1), size=feature_sizes)
def test_effect_keeps_its_sign_and_bounds_by_autodiff(params, seed, size):
    rng = np.random.default_rng(seed)
    features = random_features(rng, N) * size
    u, F0 = rng.uniform(0, 1, N), rng.normal(size=params.order) * 5
    jacobian = _jacobian_by_autodiff(params, F0, u, features)
    low, high = _impulse_bounds(params)
    # A pure delay is a difference of modes: near zero its sign is known to rounding only.
    rounding = 1e-13 * float(np.abs(params.gains).sum()) * params.heat_input.slope_bounds()[1]
    for j in range(N):
        for t in range(N):
            effect = jacobian[j, t] * params.sign
            if t > j:
                assert effect == 0.0, "the future acts on the past"
            else:
                assert low[j - t] * (1 - 1e-9) - rounding <= effect <= high[j - t] * (1 + 1e-9) + rounding


@settings(max_examples=100, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1), size=feature_sizes)
def test_effect_keeps_its_sign_and_bounds_by_finite_difference(params, seed, size):
    rng = np.random.default_rng(seed)
    features = random_features(rng, N) * size
    u = rng.uniform(0.1, 0.8, N)
    t, rise = int(rng.integers(N)), 0.1
    more = u.copy()
    more[t] += rise
    F0 = np.zeros(params.order)
    base = forced_rollout(params, F0, u, features).sum(-1)
    effect = (forced_rollout(params, F0, more, features).sum(-1) - base) * params.sign / rise
    low, high = _impulse_bounds(params)
    rounding = 1e-12 * max(1.0, float(np.abs(base).max()))
    assert np.all(effect[:t] == 0.0)
    assert np.all(effect[t:] >= low[: N - t] - rounding)
    assert np.all(effect[t:] <= high[: N - t] + rounding)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1), size=feature_sizes)
def test_modulation_stays_inside_its_bounds(params, seed, size):
    m = params.modulation(random_features(np.random.default_rng(seed), 50) * size)
    assert np.all(m >= 1 - params.gamma)
    assert np.all(m <= 1 + params.gamma)
    assert np.all(m > 0)
    low, high = modulation_interval(params)
    assert np.all(m >= low - 1e-12)
    assert np.all(m <= high + 1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(params=operators, seed=st.integers(0, 2**32 - 1))
def test_certificate_contains_every_effect(params, seed):
    proof = certificate(params, N)
    assert proof.certified, proof.reasons
    features = random_features(np.random.default_rng(seed), 4)
    for x in features:
        effect = params.impulse(N) * params.modulation(x)
        slope_low, slope_high = params.heat_input.slope_bounds()
        for slope in (slope_low, slope_high):
            assert np.all(effect * slope >= np.array(proof.effect_low_K) - 1e-12)
            assert np.all(effect * slope <= np.array(proof.effect_high_K) + 1e-12)
    assert np.all(np.array(proof.effect_low_K) * params.sign >= 0)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(params=operators, step_s=st.sampled_from([60.0, 300.0, 900.0, 3600.0, 14400.0]))
def test_sign_holds_at_every_step_length(params, step_s):
    other = params.resampled(step_s)
    lags = np.arange(200)
    impulse = params.sign * sum(g * a**lags for a, g in zip(other.poles, other.gains, strict=True))
    assert impulse.min() >= -1e-12 * np.abs(other.gains).sum()


def test_certificate_is_refused_when_no_action_has_an_effect():
    params = random_operator(0)
    dead = type(params)(**{**vars(params), "gains": np.zeros(1)})
    proof = certificate(dead)
    assert not proof.certified
    assert "no action has an effect" in proof.reasons[0]


@pytest.mark.parametrize("sign", [1, -1])
def test_effect_formula_is_the_rollouts_derivative(sign):
    params = random_operator(5, order=3, sign=sign)
    rng = np.random.default_rng(2)
    features = random_features(rng, N)
    jacobian = _jacobian_by_autodiff(params, np.zeros(3), rng.uniform(0, 1, N), features)
    # Paper eq:marginal; its a^k counts the steps after the action's own step has ended: lag k here is a^(k−1) g m(x_t).
    effect = params.impulse(N - 3) * params.modulation(features[3])
    np.testing.assert_allclose(jacobian[3:, 3], effect, rtol=1e-9)
