"""Operator of several zones and actuators."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from operators import random_operator

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator, forced_rollout, single
from thermoforce_mpc.model.operator.parameters import OperatorParameters

N = 12


def pairs_of(head: OperatorParameters, shares: list[float]) -> tuple[OperatorParameters | None, ...]:
    return tuple(replace(head, gains=share * head.gains) if share else None for share in shares)


def three_rooms(rng: np.random.Generator) -> BuildingOperator:
    """Three rooms, a heater in two of them and one that cools the third; the first two are neighbours."""
    first, second = random_operator(rng, order=3), random_operator(rng, order=3)
    cold = replace(first, sign=-1, gains=-first.gains, hidden_bias=first.hidden_bias + 0.1)
    columns = (pairs_of(first, [1, 0.2, 0]), pairs_of(second, [0.3, 1, 0]), pairs_of(cold, [0, 0, 1]))
    return BuildingOperator(
        ("living", "bed", "bath"), ("floor", "radiator", "fan"), tuple(zip(*columns, strict=True)), (0, 1, 2)
    )


def given(rng: np.random.Generator, operator: BuildingOperator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    Z, A, r = operator.shape
    F0 = rng.normal(size=(Z, A, r)) * (operator.gains != 0)
    features = np.stack(
        [rng.uniform(15, 25, (Z, N)), rng.uniform(-5, 15, (Z, N)), rng.uniform(0, 500, (Z, N)), np.zeros((Z, N))], -1
    )
    return F0, rng.uniform(size=(A, N)), features


def test_zone_is_the_sum_of_its_pairs() -> None:
    rng = np.random.default_rng(1)
    operator = three_rooms(rng)
    F0, u, features = given(rng, operator)
    modes = operator.rollout(F0, u, features)
    assert modes.shape == (3, 3, N, 3)
    for z, a, pair in operator.each():
        expected = forced_rollout(pair, F0[z, a], u[a], features[operator.home[a]])
        np.testing.assert_allclose(modes[z, a], expected, atol=1e-12)
    assert not modes[2, :2].any()
    assert not modes[:2, 2].any()


def test_one_step_is_the_first_of_many() -> None:
    rng = np.random.default_rng(2)
    operator = three_rooms(rng)
    F0, drive = rng.normal(size=operator.shape), rng.uniform(0.0, 1.0, (3, N))
    np.testing.assert_allclose(operator.advance(F0, drive[:, 0]), operator.driven(F0, drive)[:, :, 0], atol=1e-12)


def test_pairs_may_differ_in_order() -> None:
    rng = np.random.default_rng(6)
    fast, slow = random_operator(rng, order=1), random_operator(rng, order=3)
    operator = BuildingOperator(("bath", "study"), ("fan", "floor"), ((fast, None), (None, slow)), (0, 1))
    F0, u, features = given(rng, operator)
    modes = operator.rollout(F0, u, features)
    assert modes.shape == (2, 2, N, 3)
    np.testing.assert_allclose(modes[0, 0, :, :1], forced_rollout(fast, F0[0, 0, :1], u[0], features[0]), atol=1e-12)
    np.testing.assert_allclose(modes[1, 1], forced_rollout(slow, F0[1, 1], u[1], features[1]), atol=1e-12)
    assert not modes[0, 0, :, 1:].any()


def test_one_zone_with_one_actuator_is_the_plain_operator() -> None:
    rng = np.random.default_rng(2)
    plain = random_operator(rng, order=2)
    operator = single(plain)
    F0, u, features = given(rng, operator)
    np.testing.assert_array_equal(
        operator.rollout(F0, u, features)[0, 0], forced_rollout(plain, F0[0, 0], u[0], features[0])
    )
    assert operator.n_trained == plain.n_trained


def test_every_pair_is_certified_by_its_sign() -> None:
    certificates = three_rooms(np.random.default_rng(4)).certificates()
    assert all(proof.certified for proof in certificates.values())
    assert min(certificates["bed", "floor"].effect_low_K) >= 0
    assert max(certificates["bath", "fan"].effect_high_K) <= 0
    assert ("bath", "floor") not in certificates


def test_resampled_pair_by_pair() -> None:
    operator = three_rooms(np.random.default_rng(5))
    other = operator.resampled(2 * operator.step_s)
    for (*_, before), (*_, after) in zip(operator.each(), other.each(), strict=True):
        np.testing.assert_allclose(after.poles, before.poles**2)
    np.testing.assert_allclose(other.steady_gains_K, operator.steady_gains_K)


def test_counts_modulation_of_an_actuator_once() -> None:
    operator = three_rooms(np.random.default_rng(6))
    network = operator.of_actuator(0).n_trained - 6
    assert operator.n_trained == 5 * 6 + 3 * network


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"zones": ("living", "living", "bath")}, "names of zones"),
        ({"home": (0, 1, 0)}, "fan has no effect in its home zone living"),
        ({"home": (0, 1)}, "home"),
        ({"actuators": ("floor", "radiator")}, "pairs are not 3 zones of 2 actuators"),
    ],
)
def test_refuses_what_does_not_fit(change: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        replace(three_rooms(np.random.default_rng(7)), **change)  # type: ignore[arg-type]


def test_refuses_pairs_of_one_actuator_that_deliver_differently() -> None:
    operator = three_rooms(np.random.default_rng(8))
    other = replace(operator.pairs[1][0], output_bias=5.0)  # type: ignore[type-var]
    rows = (operator.pairs[0], (other, *operator.pairs[1][1:]), operator.pairs[2])
    with pytest.raises(DataError, match="floor on bed: output_bias differs"):
        replace(operator, pairs=rows)
