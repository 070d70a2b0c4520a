"""The public CasADi functions of a model: of the step and pair asked for, without a kink unless it is wanted."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from operators import HEAT_MAP, random_features, random_operator

import thermoforce_mpc as tf
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator, forced_rollout
from thermoforce_mpc.model.operator.heat_input import IDENTITY

N = 24
KINDS = ("blocks", "held", "smooth", "split")


def of_one(heat_input=IDENTITY, order: int = 1, feedback: bool = False) -> tf.ThermalModel:
    pair = replace(random_operator(3, order, heat_input=heat_input), feedback=feedback)
    return tf.ThermalModel.single(pair)


def situation(order: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(order)
    return rng.normal(size=order), rng.uniform(0, 1, N), random_features(rng, N)


@pytest.mark.parametrize("step_s", [900.0, 3600.0])
@pytest.mark.parametrize("feedback", [False, True])
@pytest.mark.parametrize("order", [1, 3])
def test_the_rollout_is_the_operators_at_the_step_that_is_asked_for(step_s, order, feedback):
    model, (F0, u, x) = of_one(order=order, feedback=feedback), situation(order)
    pair = model.operator.of_actuator(0).resampled(step_s)
    found = tf.rollout_function(model, N, step_s)(F0=F0, u=u, X=x.T)
    expected = forced_rollout(pair, F0, u, x)
    np.testing.assert_allclose(np.array(found["modes"]).T, expected, atol=1e-10)
    np.testing.assert_allclose(np.array(found["forced"]).ravel(), expected.sum(axis=1), atol=1e-10)
    step = tf.step_function(model, step_s)
    np.testing.assert_allclose(np.array(step(F0, u[0], x[0])).ravel(), expected[0], atol=1e-10)
    assert (step.name_in(), step.name_out()) == (["F", "u", "x"], ["F_next"])


def test_the_gain_is_the_networks():
    model, (_, _, x) = of_one(), situation()
    m = tf.modulation_function(model).map(N)(x.T)
    np.testing.assert_allclose(np.array(m).ravel(), model.operator.of_actuator(0).modulation(x), atol=1e-12)


@pytest.mark.parametrize("part_load", KINDS)
def test_what_a_level_is_where_heat_has_a_fixed_part(part_load):
    model, (_, u, x) = of_one(HEAT_MAP), situation()
    pair, lowest = model.operator.of_actuator(0), HEAT_MAP.heat.lowest_level
    step = tf.step_function(model, 3600.0, part_load=part_load)
    inputs = (u, np.minimum(u / lowest, 1.0)) if part_load == "split" else (u,)
    found = np.array([float(step(0.0, *row, x[0])) for row in zip(*inputs, strict=True)])
    per_v = pair.gains[0] * pair.modulation(x[0])
    T_out = x[0, 1]
    held = HEAT_MAP(u, np.full(N, T_out))
    fixed = float(HEAT_MAP.heat.parts(T_out)[0]) / HEAT_MAP.reference_W
    expected = HEAT_MAP.at_lowest_level(1.0)(u, np.full(N, T_out)) if part_load == "blocks" else held
    tolerance = 0.025 * fixed if part_load == "smooth" else 1e-10
    np.testing.assert_allclose(found / per_v, expected, atol=tolerance)
    levels = np.linspace(0.0, 1.0, 200)
    off = (0.0, 0.0) if part_load == "split" else (0.0,)
    assert float(step(0.0, *off, x[0])) == pytest.approx(0.0, abs=1e-12), "off is no heat"
    if part_load != "split":
        rising = np.diff([float(step(0.0, level, x[0])) for level in levels])
        assert (rising > 0).all(), "more level is more heat"


def test_all_kinds_are_the_same_where_heat_was_not_measured():
    model, (F0, u, x) = of_one(), situation()
    found = []
    for kind in KINDS:
        levels = (u, u) if kind == "split" else (u,)
        found.append(np.array(tf.rollout_function(model, N, part_load=kind)(F0, *levels, x.T)[1]))
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("part_load", ["blocks", "smooth", "split"])
def test_ipopt_finds_its_way_without_the_kink(part_load):
    """Hold 20 °C at the least level: at most 100 iterations, and the bound is kept."""
    _, _, x = situation()
    pair = replace(random_operator(3, heat_input=HEAT_MAP), poles=[0.95], gains=[0.5])
    model, F0 = tf.ThermalModel.single(pair), np.array([1.0])
    lowest, free_C = HEAT_MAP.heat.lowest_level, 19.0
    rollout = tf.rollout_function(model, N, 3600.0, part_load=part_load)
    u, on, slack = ca.SX.sym("u", N), ca.SX.sym("on", N), ca.SX.sym("slack", N)
    split = part_load == "split"
    forced = rollout(F0, *((u, on) if split else (u,)), x.T)[1].T
    rows = ca.vertcat(free_C + forced + slack - 20.0, on - u, u - lowest * on)
    cost = ca.sum1(u) + 100.0 * ca.sum1(slack) + 1e-6 * ca.sumsqr(u)
    solver = ca.nlpsol("s", "ipopt", {"x": ca.vertcat(u, on, slack), "f": cost, "g": rows}, {
        "print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 100}})  # fmt: skip
    ends = {"lbx": 0.0, "ubx": [1.0] * 2 * N + [np.inf] * N, "lbg": 0.0, "ubg": np.inf}
    found = solver(x0=0.3, **ends)
    assert solver.stats()["return_status"] == "Solve_Succeeded"
    assert float(ca.mmax(found["x"][2 * N :])) < 1e-5


def test_pairs_are_found_by_name():
    own, other = random_operator(1), random_operator(1)
    other = replace(other, gains=0.1 * other.gains)
    operator = BuildingOperator(("bath", "hall"), ("valve", "fan"), ((own, None), (other, own)), (0, 1))
    model = replace(of_one(), operator=operator, free=(None, None), cards=(*of_one().cards,) * 2,
                    machine_of=(0, 0), shares=(0.5, 0.5), floor_area_m2=(60.0, 20.0))  # fmt: skip
    x = situation()[2]
    direct = tf.step_function(model, 3600.0, actuator="valve")(0.0, 1.0, x[0])
    through = tf.step_function(model, 3600.0, actuator="valve", zone="hall")(0.0, 1.0, x[0])
    assert float(through) == pytest.approx(0.1 * float(direct))
    for names, message in (
        ({}, "name the actuator; the model has valve, fan"),
        ({"actuator": "valves"}, "no actuator 'valves', did you mean 'valve'"),
        ({"actuator": "valve", "zone": "attic"}, "no zone 'attic'; the model has bath, hall"),
        ({"actuator": "fan", "zone": "bath"}, "fan has no effect on bath"),
    ):
        with pytest.raises(DataError, match=message):
            tf.step_function(model, **names)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda model: tf.step_function(model, 0.0), "step_s is 0.0"),
        (lambda model: tf.step_function(model, float("nan")), "step_s is nan"),
        (lambda model: tf.rollout_function(model, 0), "n_steps is 0"),
        (lambda model: tf.rollout_function(model, 2.5), "n_steps is 2.5"),
        (lambda model: tf.step_function(model, part_load="soft"), "part_load is 'soft', expected blocks, held, smooth"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(DataError, match=message):
        call(of_one())
