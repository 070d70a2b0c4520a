"""Responses of a network as the operator's modes: exact where they have that form, near where they have not."""

from __future__ import annotations

import numpy as np
import pytest
from thermal_networks import KnownFit, effect_K, random_theta, theta_of

from thermoforce_mpc.data import Layout
from thermoforce_mpc.identification.estimation.regression import unit_steps
from thermoforce_mpc.identification.network.building import RESPONSE_H, BuildingFit
from thermoforce_mpc.identification.network.projection import projected
from thermoforce_mpc.identification.network.room import RoomNetwork

ONE, SIGNS = RoomNetwork(), np.array([1])
LONGEST_H = 1000.0  # of any building


def responses_of(theta, room=ONE):
    """Responses of a room alone."""
    return building_of(theta, room=room).responses[0]


def building_of(theta, variance=0.01, room=ONE):
    """A building of one room at θ, all of whose parameters have a variance."""
    return BuildingFit(Layout.single(), (KnownFit(room, theta, variance),))


def response_at(modes, actuator=0, hours=RESPONSE_H):
    """What the modes say, K."""
    return unit_steps(modes.log_tau[actuator], hours) @ modes.gains[actuator]


def misfit(modes, mean, actuator=0):
    """Root mean square error of the modes over that of a response (T,)."""
    return np.linalg.norm(response_at(modes, actuator) - mean) / np.linalg.norm(mean)


@pytest.mark.parametrize("tau_h", [(0.5, 3.0, 50.0), (0.2, 6.0, 200.0)])
def test_what_has_the_operators_form_is_met_exactly(tau_h):
    mean = unit_steps(np.log(tau_h), RESPONSE_H) @ np.array([0.3, 1.5, 12.0])
    modes = projected(mean[None], SIGNS, 3, LONGEST_H)
    np.testing.assert_allclose(np.exp(modes.log_tau[0]), tau_h, rtol=0.02)
    np.testing.assert_allclose(modes.gains[0], [0.3, 1.5, 12.0], rtol=0.02, atol=1e-3)
    assert misfit(modes, mean) < 1e-4


def test_a_room_of_the_priors_is_met():
    """Four modes, of which the operator's form takes three: the response in its place errs by less than 1 %."""
    modes = projected(responses_of(ONE.mean), SIGNS, 3, LONGEST_H)
    expected = [effect_K(ONE, ONE.mean, hours) for hours in RESPONSE_H]
    np.testing.assert_allclose(response_at(modes), expected, rtol=0.01, atol=0.01 * max(expected))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_modes_rise_and_gains_are_not_negative(order):
    rng = np.random.default_rng(order)
    for _ in range(5):
        modes = projected(responses_of(random_theta(ONE, rng)), SIGNS, order, LONGEST_H)
        assert modes.log_tau.shape == (1, order)
        assert (np.diff(modes.log_tau) >= 0.0).all()
        assert (modes.gains >= 0.0).all()
        assert (np.diff(response_at(modes)) > 0.0).all()


def test_modes_beyond_the_longest_stay_apart():
    """A response that rises ever on: its poles would meet at the bound."""
    mean = 0.2 * RESPONSE_H
    modes = projected(mean[None], SIGNS, 3, LONGEST_H)
    assert (np.diff(modes.log_tau) >= np.log(1.5) - 1e-9).all()
    assert np.exp(modes.log_tau[0, -1]) <= 1000.0 + 1e-6


def test_what_rises_after_the_last_response_ends_where_the_network_does():
    """A room that first warms faster than its own modes, by its neighbours': free poles end a quarter too high."""
    tau_h, gains, much_later_h = (1.0, 8.0, 30.0, 85.0), np.array([0.1, 8.0, -6.0, 18.0]), np.array([400.0])
    mean = unit_steps(np.log(tau_h), RESPONSE_H) @ gains
    modes = projected(mean[None], SIGNS, 3, longest_h=85.0)
    assert misfit(modes, mean) < 0.03
    expected = unit_steps(np.log(tau_h), much_later_h) @ gains
    np.testing.assert_allclose(response_at(modes, hours=much_later_h), expected, rtol=0.1)


def test_the_longest_time_constant_is_that_of_all_of_the_building():
    building = building_of(ONE.mean)
    hours = building.longest_h * np.array([3.0, 4.0])
    rest = [effect_K(ONE, ONE.mean, 1e6) - effect_K(ONE, ONE.mean, later) for later in hours]
    assert rest[1] / rest[0] == pytest.approx(np.exp(-1.0), rel=0.02)


def test_rooms_of_all_kinds_are_met_within_a_few_per_cent():
    rng = np.random.default_rng(7)
    rooms = [responses_of(random_theta(ONE, rng)) for _ in range(12)]
    misfits = [misfit(projected(responses, SIGNS, 3, LONGEST_H), responses[0]) for responses in rooms]
    assert np.median(misfits) < 0.01
    assert max(misfits) < 0.05


def test_more_modes_meet_a_slow_floor_better():
    theta = theta_of(ONE, C_emitter_0=30.0, heat_structure_0=0.4)
    responses = responses_of(theta)
    misfits = [misfit(projected(responses, SIGNS, order, LONGEST_H), responses[0]) for order in (1, 2, 3)]
    assert misfits[0] > misfits[1] > misfits[2]


def test_what_comes_through_a_wall_has_time_constants_of_its_own():
    """A fast radiator of the zone, and two of rooms beside it, whose heat comes late: positive modes of the radiator's
    time constants would give it at once.
    """
    own = unit_steps(np.log((0.1, 3.0, 20.0)), RESPONSE_H) @ np.array([12.0, 3.0, 4.0])
    late = unit_steps(np.log((1.2, 8.0, 24.0)), RESPONSE_H)
    through_walls = late @ np.array([[0.05, 0.4], [1.5, 0.5], [4.0, 2.0]])
    modes = projected(np.stack([own, *through_walls.T]), np.ones(3), 3, LONGEST_H)
    np.testing.assert_allclose(response_at(modes), own, rtol=0.01)
    np.testing.assert_array_equal(modes.log_tau[1], modes.log_tau[2])
    for actuator in (1, 2):
        np.testing.assert_allclose(response_at(modes, actuator), through_walls[:, actuator - 1], rtol=0.03)
    assert max(misfit(modes, mean, a) for a, mean in enumerate([own, *through_walls.T])) < 0.01


def test_a_small_response_is_met_beside_a_large_one():
    """A near room's valve does little and soon, a far one's much and late; both have the same time constants."""
    own = unit_steps(np.log((0.1, 3.0, 20.0)), RESPONSE_H) @ np.array([12.0, 3.0, 4.0])
    large = unit_steps(np.log((2.0, 15.0, 30.0, 120.0)), RESPONSE_H) @ np.array([0.05, 1.0, 5.0, 20.0])
    small = unit_steps(np.log((0.5, 4.0, 60.0)), RESPONSE_H) @ np.array([0.02, 0.3, 0.6])
    modes = projected(np.stack([own, large, small]), np.ones(3), 3, LONGEST_H)
    later = RESPONSE_H >= 1.0
    np.testing.assert_allclose(response_at(modes, 2)[later], small[later], rtol=0.05)
    np.testing.assert_allclose(response_at(modes, 1)[later], large[later], rtol=0.12)


def through_layers(tau_h):
    """Response at `RESPONSE_H` of lags of different time constants (r,), h, in a row."""
    shares = [np.prod([own / (own - other) for other in tau_h if other != own]) for own in tau_h]
    return sum(share * -np.expm1(-RESPONSE_H / own) for share, own in zip(shares, tau_h, strict=True))


@pytest.mark.slow
def test_rounding_of_a_response_does_not_choose_its_modes():
    """What comes through layers suits several sets of modes about as well; the best is found, whatever the rounding."""
    rng = np.random.default_rng(290)
    for _ in range(12):
        first, second = np.exp(rng.uniform(np.log([0.3, 3.0, 20.0]), np.log([3.0, 20.0, 120.0]), (2, 3)))
        lags = (first, (second[1], first[2]), second)
        responses = np.stack([size * through_layers(tau_h) for size, tau_h in zip((1.0, 4.0, 2.0), lags, strict=True)])
        rounded = responses * (1.0 + 1e-9 * rng.standard_normal(responses.shape))
        longest_h = max(*first, *second)
        before, after = (projected(each, np.ones(3, int), 3, longest_h) for each in (responses, rounded))
        for actuator in range(3):
            expected = response_at(before, actuator)
            np.testing.assert_allclose(response_at(after, actuator), expected, rtol=1e-4, atol=1e-4)
            assert misfit(before, responses[actuator], actuator) < 0.02
