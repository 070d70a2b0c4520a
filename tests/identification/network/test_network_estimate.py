"""A room's network is found from its readings, in closed loop too, and is as sure of itself as it is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import random_levels
from thermal_networks import effect_K, random_theta, simulated, theta_of, with_gap

from thermoforce_mpc.identification.network.estimate import (
    RoomFit,
    RoomRun,
    estimate_room,
    gain_of_one_more,
    posterior,
)
from thermoforce_mpc.identification.network.room import Law, Prior, RoomNetwork

METERED = RoomNetwork((1,), (50.0,))
# What people and weather bring is a quarter of the heat, for hours.
RESTLESS = {"heat_0": 50.0, "C_structure": 75.0, "disturbance_6h": 10.0, "disturbance_48h": 6.0}
QUIET = {"disturbance_1h": 0.05, "disturbance_6h": 0.05, "disturbance_48h": 0.05, "reading": 0.01}


class AtOutput(RoomNetwork):
    """The same room, whose disturbance is added to the reading instead of being heat."""

    @property
    def priors(self):
        inside = {name for name in super().priors if name.startswith("disturbance") or name.endswith("noise")}
        return super().priors | dict.fromkeys(inside, Prior(1e-3, 0.01)) | {"reading": Prior(0.5, 1.0)}


def thermostat(hour, T_C):
    """Warmer by day, and more heat the colder it is."""
    wanted_C = 20.0 if 6.0 <= hour % 24.0 < 22.0 else 18.0
    return float(np.clip(0.3 + 0.5 * (wanted_C - T_C), 0.0, 1.0))


def switched(seed):
    """Random levels, whatever the room reads."""
    levels = random_levels(2000, seed, hold=8)
    return lambda hour, T_C: float(levels[int(2.0 * hour) % 2000])


def difference(a: RoomRun, b: RoomRun) -> RoomRun:
    """A pair of runs in the same weather."""
    return RoomRun(a.inputs - b.inputs, a.readings - b.readings, a.step_h, pair=True)


def sd_of_effect(fit, hours):
    """Standard deviation of the logarithm of the effect."""
    steps = np.eye(fit.theta.size) * 1e-4
    slopes = [
        np.log(effect_K(fit.room, fit.theta + s, hours) / effect_K(fit.room, fit.theta - s, hours)) for s in steps
    ]
    return float(np.sqrt(np.array(slopes) @ fit.covariance @ np.array(slopes)) / 2e-4)


@pytest.mark.parametrize(
    ("room", "rules"),
    [
        (RoomNetwork(), (thermostat,)),
        (RoomNetwork((1, 1), (float("nan"), 40.0)), (thermostat, switched(1))),
        (RoomNetwork((1, -1), (float("nan"), 40.0), neighbours=2), (thermostat, switched(1))),
        (RoomNetwork(laws=(Law(0, "part", 0.1, 0.25),)), (thermostat,)),
    ],
    ids=["one actuator", "two actuators", "two neighbours", "unknown heat of levels"],
)
def test_the_gradient_is_that_of_differences(room, rules):
    rng = np.random.default_rng(2)
    truth = random_theta(room, rng, 0.5)
    hourly, quarter = (simulated(room, truth, rules, 1.0, seed, step_h) for seed, step_h in ((0, 1.0), (1, 0.25)))
    other = simulated(room, truth, tuple(switched(5) for _ in rules), 1.0, 0, 1.0)
    for run in (hourly, quarter, other):  # of what laws make of levels any numbers will do
        run.inputs[:, room.n_inputs - len(room.laws) :] = rng.normal(size=(run.readings.size, len(room.laws)))
    half = replace(quarter, weight=0.5)
    runs = [with_gap(hourly, slice(0, 2), slice(9, 14)), half, difference(hourly, other)]
    theta = random_theta(room, rng, 0.5)
    _, gradient = posterior(room, theta, runs)
    for i, step in enumerate(np.eye(theta.size) * 1e-5 * room.sd):
        up, down = (posterior(room, theta + s * step, runs)[0] for s in (1.0, -1.0))
        assert gradient[i] * room.sd[i] == pytest.approx((up - down) / 2e-5, rel=1e-4, abs=1e-3)


def test_a_run_of_less_weight_says_less():
    """Half of what a run says, and the same of the priors, which then keep more of a direction."""
    run = simulated(METERED, METERED.mean, (thermostat,), 1.0, 0)
    theta = random_theta(METERED, np.random.default_rng(1), 0.5)
    whole, half, prior = (posterior(METERED, theta, [replace(run, weight=w)])[0] for w in (1.0, 0.5, 0.0))
    assert half == pytest.approx(0.5 * (whole + prior))
    assert prior == pytest.approx(METERED.prior(theta)[0])
    sure, unsure = (
        RoomFit(METERED, METERED.mean, 0.0, [replace(run, weight=w)]).covariance.diagonal() for w in (1.0, 0.1)
    )
    assert (unsure > 0.999 * sure).all()
    assert (unsure > 1.2 * sure).any()


def test_rounding_of_a_reading_is_noise():
    """A sensor that reads in steps says less, and the surer a reading the more its errors count."""
    run = simulated(METERED, METERED.mean, (thermostat,), 1.0, 0)
    rounded = RoomRun(run.inputs, run.readings, run.step_h, rounding_K2=0.1**2)
    wrong = theta_of(METERED, heat_0=100.0)
    worse = [posterior(METERED, wrong, [r])[0] - posterior(METERED, METERED.mean, [r])[0] for r in (run, rounded)]
    assert worse[1] < worse[0]


def test_nothing_read_leaves_the_priors():
    run = simulated(METERED, METERED.mean, (thermostat,), 0.5, 0)
    silent = with_gap(run, slice(1, None))
    fit = estimate_room(METERED, [silent])
    expected = METERED.mean.copy()
    # What the meter says is divided between emitter and structure.
    expected[METERED.place["heat_0"]] -= np.log1p(METERED.value(expected, "heat_structure_0"))
    np.testing.assert_allclose(fit.theta, expected, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[:10], METERED.sd[:10], rtol=0.05)


def test_one_more_parameter_moves_to_the_least_of_the_parabola_through_its_neighbours():
    run = simulated(METERED, theta_of(METERED, reading=0.1), (thermostat,), 1.0, 0)
    start, h = np.zeros(METERED.mean.size), 1e-3

    def value(at: float) -> float:
        return posterior(METERED, METERED.mean + METERED.sd * np.append(start[:-1], at), [run])[0]

    slope, curvature = (value(h) - value(-h)) / (2.0 * h), (value(h) - 2.0 * value(0.0) + value(-h)) / h**2
    gained, at = gain_of_one_more(METERED, [run], start, np.zeros((start.size - 1,) * 2))
    assert at == pytest.approx(-slope / curvature, rel=0.01)
    assert gained == pytest.approx(0.5 * slope**2 / curvature, rel=0.02)


def test_a_fit_as_if_nothing_acted_is_where_its_value_is():
    run = simulated(METERED, METERED.mean, (thermostat,), 0.5, 0)
    idle = RoomFit(METERED, METERED.mean, posterior(METERED, METERED.mean, [run])[0], [run]).without(0)
    assert posterior(idle.room, idle.theta, idle.runs)[0] == pytest.approx(idle.value)


@pytest.mark.slow
def test_a_loop_that_answers_disturbances_does_not_hide_the_effect():
    """Where the disturbance is heat of the room, and not where it is an error of the reading."""
    truth = theta_of(METERED, **RESTLESS)

    def error(room, seed):
        run = simulated(METERED, truth, (thermostat,), 10.0, seed, 0.5)
        return (
            effect_K(METERED, estimate_room(room, [run], most_starts=1).theta, 48.0) / effect_K(METERED, truth, 48.0)
            - 1.0
        )

    assert abs(np.mean([error(METERED, seed) for seed in range(8)])) < 0.08
    assert np.mean([error(AtOutput((1,), (50.0,)), seed) for seed in range(3)]) < -0.4


@pytest.mark.slow
def test_bands_of_the_effect_hold_the_truth_as_often_as_they_say():
    """Of rooms of all kinds under a thermostat, 90 % bands of the effect of 2, 8 and 48 h."""
    room, off = RoomNetwork(), []
    for seed in range(20):
        truth = random_theta(room, np.random.default_rng(seed), 0.9)
        fit = estimate_room(room, [simulated(room, truth, (thermostat,), 5.0, seed, 0.5)], most_starts=1)
        for hours in (2.0, 8.0, 48.0):
            error = np.log(effect_K(room, fit.theta, hours) / effect_K(room, truth, hours))
            off.append(error / sd_of_effect(fit, hours))
    assert 0.8 <= np.mean(np.abs(off) < 1.645) <= 0.99
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.25


@pytest.mark.slow
def test_a_pair_says_what_its_runs_say():
    """The difference of two runs in the same weather, in which all but the effect cancels."""
    room = RoomNetwork()
    truth = theta_of(room, heat_0=45.0, C_structure=80.0, C_emitter_0=12.0, **QUIET)
    runs = [simulated(room, truth, (switched(seed),), 4.0, 0, 0.5) for seed in (1, 2)]
    pair = estimate_room(room, [difference(*runs)])
    both = estimate_room(room, runs)
    for hours in (2.0, 8.0, 24.0):
        assert effect_K(room, pair.theta, hours) == pytest.approx(effect_K(room, truth, hours), rel=0.05)
        assert effect_K(room, both.theta, hours) == pytest.approx(effect_K(room, truth, hours), rel=0.05)
        assert sd_of_effect(pair, hours) < 0.1


@pytest.mark.slow
def test_two_actuators_of_a_room_are_told_apart():
    """A radiator and a slower floor that is half as strong, each with random levels."""
    room = RoomNetwork((1, 1), (float("nan"), float("nan")))
    truth = theta_of(room, heat_0=60.0, heat_1=30.0, C_emitter_0=2.0, C_emitter_1=20.0, **QUIET)
    fit = estimate_room(room, [simulated(room, truth, (switched(1), switched(2)), 6.0, 0, 0.5)])
    for actuator in (0, 1):
        for hours in (1.0, 8.0):
            expected = effect_K(room, truth, hours, actuator)
            assert effect_K(room, fit.theta, hours, actuator) == pytest.approx(expected, rel=0.08)
