"""The operator in its three forms (numpy, torch, CasADi), its size, its steps and its refusals."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from later import torch, torch_operator
from operators import HEAT_MAP, random_features, random_operator

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.exported import rollout_function, step_function
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.casadi_export import ExportedGain, heat_input_expression, modulation_function
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, feature_matrix, linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

N = 24


def _loop(params: OperatorParameters, F0, u, features) -> np.ndarray:
    """Paper eq:operator, step by step, as printed."""
    F, out = np.array(F0, dtype=float), []
    for t in range(len(u)):
        x = (features[t] - params.feature_mean) / params.feature_scale
        mlp = params.output_weight @ np.tanh(params.hidden_weight @ x + params.hidden_bias) + params.output_bias
        m = 1 + params.gamma * np.tanh(mlp)
        v = float(params.heat_input(u[t], features[t, 1]))
        F = params.poles * F + params.gains * m * v
        out.append(F)
    return np.array(out)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("heat_input", [IDENTITY, HEAT_MAP], ids=["identity", "heat"])
def test_rollouts_equal_the_printed_recursion(order, heat_input):
    rng = np.random.default_rng(order)
    params = random_operator(order, order, heat_input=heat_input)
    F0, u, features = rng.normal(size=order), rng.uniform(0, 1, N), random_features(rng, N)
    expected = _loop(params, F0, u, features)
    module = torch_operator.ForcedResponseOperator(params)
    by_torch = module(torch.tensor(F0), torch.tensor(u), torch.tensor(features)).detach().numpy()
    np.testing.assert_allclose(forced_rollout(params, F0, u, features), expected, atol=1e-12)
    np.testing.assert_allclose(by_torch, expected, atol=1e-12)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.integers(1, 3),
    scale=st.sampled_from([0.1, 1.0, 10.0]),
    heat_input=st.sampled_from([IDENTITY, HEAT_MAP]),
)
def test_casadi_equals_torch(seed, order, scale, heat_input):
    rng = np.random.default_rng(seed)
    params = random_operator(seed, order, scale=scale, heat_input=heat_input)
    module = torch_operator.ForcedResponseOperator(params)
    F0, u, features = rng.normal(size=order) * 5, rng.uniform(0, 1, N), random_features(rng, N)
    by_torch = module(torch.tensor(F0), torch.tensor(u), torch.tensor(features)).detach().numpy()
    modes, forced = rollout_function(ThermalModel.single(params), N, params.step_s, part_load="held")(F0, u, features.T)
    assert np.abs(np.array(modes).T - by_torch).max() <= 1e-10
    assert np.abs(np.array(forced).ravel() - by_torch.sum(-1)).max() <= 1e-10
    m = np.array(modulation_function(params).map(N)(features.T)).ravel()
    assert np.abs(m - module.modulation(torch.tensor(features)).detach().numpy()).max() <= 1e-10
    np.testing.assert_allclose(ExportedGain(params, N)(features), m, rtol=0.0, atol=1e-15)
    one = np.array(
        step_function(ThermalModel.single(params), params.step_s, part_load="held")(F0, u[0], features[0])
    ).ravel()
    assert np.abs(one - by_torch[0]).max() <= 1e-10


def test_casadi_derivative_equals_autodiff():
    rng = np.random.default_rng(9)
    params = random_operator(9, 3, heat_input=HEAT_MAP)
    F0, u, features = rng.normal(size=3), rng.uniform(0.3, 1, N), random_features(rng, N)
    plan = ca.MX.sym("u", N)
    forced = rollout_function(ThermalModel.single(params), N, params.step_s, part_load="held")(F0, plan, features.T)[1]
    by_casadi = np.array(ca.Function("j", [plan], [ca.jacobian(forced, plan)])(u))
    module = torch_operator.ForcedResponseOperator(params)
    by_torch = torch.autograd.functional.jacobian(
        lambda actions: module(torch.tensor(F0), actions, torch.tensor(features)).sum(-1), torch.tensor(u)
    ).numpy()
    np.testing.assert_allclose(by_casadi, by_torch, atol=1e-10)


def test_only_parameters_that_bear_on_a_prediction_are_effective():
    kept = random_operator(0, 3)
    assert (kept.n_trained, kept.n_used, kept.n_effective) == (199, 199, 199)
    assert kept.parameters_in_words == "199 trained parameters, 199 used"
    dropped = replace(kept, output_weight=np.zeros(32))
    assert (dropped.n_trained, dropped.n_used, dropped.n_effective) == (199, 6, 6)
    assert dropped.parameters_in_words == "199 trained parameters, 6 used: the network was not kept"
    for linear in (replace(dropped, hidden_weight=np.zeros((32, 4))), replace(kept, gamma=0.0)):
        assert (linear.n_trained, linear.n_used, linear.n_effective) == (6, 6, 6)
        assert linear.parameters_in_words == "6 trained parameters, 6 used"
    half = replace(kept, output_weight=np.where(np.arange(32) < 16, kept.output_weight, 0.0))
    assert half.parameters_in_words == "199 trained parameters, 199 used, 103 effective"


@pytest.mark.parametrize(("order", "count"), [(1, 195), (2, 197), (3, 199)])
def test_number_of_trained_parameters(order, count):
    params = random_operator(0, order)
    module = torch_operator.ForcedResponseOperator(params)
    assert params.n_trained == count
    assert sum(p.numel() for p in module.parameters() if p.requires_grad) == count
    assert {p.dtype for p in module.parameters()} == {torch.float64}


def test_candidates_are_rolled_out_together():
    rng = np.random.default_rng(4)
    params = random_operator(4, 3)
    u, features, F0 = rng.uniform(0, 1, (7, N)), random_features(rng, N), rng.normal(size=3)
    together = forced_rollout(params, F0, u, features)
    assert together.shape == (7, N, 3)
    for i in range(7):
        np.testing.assert_allclose(together[i], _loop(params, F0, u[i], features), atol=1e-12)


@pytest.mark.parametrize("step_s", [900.0, 300.0, 7200.0])
def test_resampled_operator_says_the_same_at_common_times(step_s):
    params = random_operator(6, 3)
    other = params.resampled(step_s)
    x, hours = random_features(np.random.default_rng(0), 1), 6
    coarse, fine = (
        forced_rollout(p, np.array([1.0, 2.0, 3.0]), np.full(n, 0.7), np.repeat(x, n, axis=0))
        for p, n in ((params, hours), (other, round(hours * 3600 / step_s)))
    )
    np.testing.assert_allclose(coarse[-1], fine[-1], rtol=1e-12)
    np.testing.assert_allclose(other.time_constants_h, params.time_constants_h, rtol=1e-12)


def test_features_are_what_the_docstring_says():
    time_s = np.array([0.0, 3 * 3600.0, 15 * 3600.0, 24 * 3600.0])
    x = feature_matrix(np.arange(4.0), np.full(4, 5.0), np.full(4, 100.0), time_s)
    assert x.shape == (4, 4)
    np.testing.assert_allclose(x[:, 3], [np.cos(-2 * np.pi * 15 / 24), -1.0, 1.0, x[0, 3]])
    np.testing.assert_allclose(x[:, :3], [[i, 5.0, 100.0] for i in range(4)])
    with pytest.raises(DataError, match="solar"):
        feature_matrix(np.zeros(2), np.zeros(2), np.array([1.0, np.nan]), np.zeros(2))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"poles": np.array([1.0])}, "poles"),
        ({"poles": np.array([0.0])}, "poles"),
        ({"gains": np.array([-0.1])}, "gains"),
        ({"gains": np.array([0.1, 0.1])}, "gains"),
        ({"poles": np.array([0.8, 0.6]), "gains": np.ones(2)}, "increase"),
        ({"poles": np.array([0.5, 0.9]), "gains": np.array([1.0, -0.1])}, "beyond the first"),
        (
            {"poles": np.array([0.5, 0.9]), "gains": np.array([-2.0, 1.0])},
            "give an initial response",
        ),
        ({"gamma": 1.0}, "gamma"),
        ({"sign": 0}, "sign"),
        ({"step_s": 0.0}, "step_s"),
        ({"hidden_weight": np.full((32, 4), np.nan)}, "hidden_weight"),
        ({"hidden_weight": np.zeros((32, 3))}, "hidden_weight"),
        ({"output_bias": np.inf}, "output_bias"),
        ({"feature_scale": np.zeros(4)}, "feature_scale"),
    ],
)
def test_impossible_operators_are_refused(change, word):
    params = linear_operator(np.array([0.8]), np.array([0.1]), step_s=3600.0)
    with pytest.raises(DataError, match=word):
        replace(params, **change)


def test_rollout_refuses_what_does_not_fit():
    params = random_operator(0, 2)
    features = random_features(np.random.default_rng(0), N)
    with pytest.raises(DataError, match="same steps"):
        forced_rollout(params, np.zeros(2), np.zeros(N - 1), features)
    with pytest.raises(DataError, match="F0"):
        forced_rollout(params, np.zeros(3), np.zeros(N), features)
    with pytest.raises(DataError, match="finite"):
        forced_rollout(params, np.zeros(2), np.full(N, np.nan), features)


def test_parameters_are_frozen_to_the_last_number():
    params = random_operator(0)
    with pytest.raises(ValueError, match="read-only"):
        params.poles[0] = 0.5


def test_actuator_map_is_monotone_and_switches_below_its_lowest_level():
    u = np.linspace(0, 1, 101)
    for T in (-30.0, -4.0, 5.0, 15.0, 40.0):
        assert np.all(np.diff(HEAT_MAP(u, np.full(101, T))) > 0)
    # Below the lowest level the machine cycles there: everything is proportional to u.
    np.testing.assert_allclose(HEAT_MAP(0.1, 0.0), 0.5 * HEAT_MAP(0.2, 0.0))
    np.testing.assert_allclose(HEAT_MAP(1.0, 0.0), 1.0)
    # Outside the range seen the nearer end holds.
    np.testing.assert_allclose(HEAT_MAP(0.5, -30.0), HEAT_MAP(0.5, -4.0))


def test_slope_bounds_contain_the_slopes():
    low, high = HEAT_MAP.slope_bounds()
    u = np.linspace(0, 1, 401)
    slopes = np.concatenate([np.diff(HEAT_MAP(u, np.full(401, T))) / np.diff(u) for T in np.linspace(-10, 20, 31)])
    assert slopes.min() >= low - 1e-9
    assert slopes.max() <= high + 1e-9
    assert slopes.min() == pytest.approx(low)
    assert slopes.max() == pytest.approx(high)


def test_heat_that_was_not_metered_changes_with_the_weather_in_every_form():
    heat = HeatInput(reference_C=4.0, per_K=-0.03, T_out_range_C=(-5.0, 15.0))
    u, T_C = ca.SX.sym("u"), ca.SX.sym("T")
    exported = ca.Function("v", [u, T_C], [heat_input_expression(heat, u, T_C)])
    for level, at_C, factor in ((1.0, 4.0, 1.0), (0.5, 9.0, 0.85), (0.5, -20.0, 1.27), (1.0, 30.0, 0.67)):
        assert float(exported(level, at_C)) == pytest.approx(level * factor)
        assert float(heat(np.asarray(level), np.asarray(at_C))) == pytest.approx(level * factor)
    assert heat.slope_bounds() == pytest.approx((0.67, 1.27))
    assert IDENTITY.slope_bounds() == (1.0, 1.0)


def test_actuator_maps_that_are_not_monotone_are_refused():
    with pytest.raises(DataError, match="not increasing"):
        MachineLoad((1000.0, 0.0, 5000.0, 600.0), (-20.0, 15.0))
    with pytest.raises(DataError, match="lowest level"):
        MachineLoad((1000.0, 0.0, 5000.0, 0.0), (0.0, 15.0), lowest_level=0.0)


def test_heat_with_a_term_in_the_square_of_the_level_is_refused():
    """Torch, CasADi and the programmes know heat as linear in the level above the lowest."""
    with pytest.raises(DataError, match=r"no term in u² \(500 W\)"):
        HeatInput(heat=MachineLoad((0.0, 0.0, 5000.0, 50.0), (-10.0, 15.0), curve_W=500.0))


@pytest.mark.parametrize("lowest", [0.05, -10.5])
def test_the_lowest_level_is_off_or_that_of_cooling(lowest):
    with pytest.raises(DataError, match=f"lowest level {lowest:g}"):
        HeatInput(u_min=lowest)


def test_other_levels_need_to_have_been_seen():
    unseen = HeatInput(MachineLoad((0.0, 0.0, 9000.0, 0.0), (0.0, 10.0), levels_seen=False))
    assert unseen.at_lowest_level(1.0) == unseen
    with pytest.raises(DataError, match="intermediate levels"):
        unseen.at_lowest_level(0.3)
    duty = HEAT_MAP.at_lowest_level(1.0)
    np.testing.assert_allclose(duty(0.25, 3.0), 0.25 * HEAT_MAP(1.0, 3.0))


@pytest.mark.slow
def test_using_an_operator_imports_neither_torch_nor_casadi():
    code = (
        "import sys, numpy as np\n"
        "from thermoforce_mpc.model.operator.building import forced_rollout\n"
        "from thermoforce_mpc.model.operator.parameters import linear_operator\n"
        "import thermoforce_mpc.model.predictor, thermoforce_mpc.model.saved\n"
        "p = linear_operator([0.9], [0.1], step_s=3600.0)\n"
        "forced_rollout(p, np.zeros(1), np.ones(3), np.zeros((3, 4)))\n"
        "sys.exit(', '.join(m for m in ('torch', 'casadi') if m in sys.modules) or 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_modulation_has_a_value_for_each_set_of_features_whether_it_sees_them_or_not():
    constant = linear_operator(np.array([0.9]), np.array([0.3]), step_s=3600.0)
    for params in (constant, random_operator(3)):
        assert params.modulation(np.ones((5, 7, 4))).shape == (5, 7)
    assert (constant.modulation(np.ones((5, 7, 4))) == 1.0).all()
