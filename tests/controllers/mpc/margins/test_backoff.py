"""Back-off: the chance level where forecasts are good, the expected violation elsewhere, less with recourse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.margins import backoff_K, with_recourse_K
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Observation, Record
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

LEVELS = np.arange(1, 10) / 10
STEP_S = 900.0


def normal_forecast(sd_K: np.ndarray) -> FreeForecast:
    """A forecast whose quantiles are those of a normal distribution about 20 °C."""
    return FreeForecast(LEVELS, 20.0 + norm.ppf(LEVELS)[:, None] * sd_K)


def expected_violation(sd_K: np.ndarray, distance_K: np.ndarray) -> np.ndarray:
    """E[(bound − T)+] at `distance_K` from the median, by integration of the normal distribution."""
    z = np.linspace(-8, 8, 40001)
    short = np.maximum(-(sd_K[:, None] * z + distance_K[:, None]), 0.0)
    return np.trapezoid(short * norm.pdf(z), z, axis=1)


def test_good_forecasts_are_ruled_by_the_chance_level():
    sd = np.full(48, 0.03)
    found = backoff_K(normal_forecast(sd), STEP_S, 0.2, 0.01, below=True)
    np.testing.assert_allclose(found, norm.isf(0.2) * sd, rtol=1e-9)


def test_uncertain_forecasts_are_ruled_by_the_expected_violation_of_the_next_hours():
    sd = np.linspace(0.1, 0.9, 96)
    found = backoff_K(normal_forecast(sd), STEP_S, 0.25, 0.01, below=True)
    # One z for all lead times; with the mean spread of six hours it allows just the violation given.
    z = found / sd
    np.testing.assert_allclose(z, z[0])
    mean = sd[:24].mean()
    assert expected_violation(np.array([mean]), np.array([z[0] * mean]))[0] == pytest.approx(0.01, rel=2e-3)
    assert z[0] > norm.isf(0.25)


def test_violation_does_not_grow_with_the_spread_as_it_does_at_a_chance_level():
    small, large = np.full(48, 0.1), np.full(48, 0.4)
    chance = [
        expected_violation(sd, backoff_K(normal_forecast(sd), STEP_S, 0.25, None, below=True)) for sd in (small, large)
    ]
    both = [
        expected_violation(sd, backoff_K(normal_forecast(sd), STEP_S, 0.25, 0.0135, below=True))
        for sd in (small, large)
    ]
    assert chance[1][0] == pytest.approx(4 * chance[0][0], rel=1e-3)
    assert both[1][0] == pytest.approx(both[0][0], rel=0.02)


def test_the_upper_bound_is_backed_off_from_by_the_upper_quantiles():
    skewed = FreeForecast(
        LEVELS, 20.0 + np.where(LEVELS < 0.5, 0.1, 0.4)[:, None] * norm.ppf(LEVELS)[:, None] * np.ones(48)
    )
    below = backoff_K(skewed, STEP_S, 0.3, None, below=True)
    above = backoff_K(skewed, STEP_S, 0.3, None, below=False)
    np.testing.assert_allclose(above, 4 * below)


def test_a_certain_forecast_needs_none():
    flat = FreeForecast(LEVELS, np.full((9, 48), 20.0))
    np.testing.assert_array_equal(backoff_K(flat, STEP_S, 0.1, 0.01, below=True), 0.0)


GROWING_K = np.linspace(0.1, 2.0, 96)


def quarter_hourly(K_per_h: float, pole: float = 0.99) -> OperatorParameters:
    return linear_operator([pole], [0.25 * K_per_h], step_s=STEP_S)


def test_no_more_is_kept_than_where_half_of_full_level_makes_up_for_it():
    zone = quarter_hourly(0.5)
    moves_K = 0.5 * np.cumsum(zone.impulse(96))
    kept = with_recourse_K(GROWING_K, zone)
    first = int(np.argmax(moves_K >= GROWING_K))
    assert 0 < first < 10
    np.testing.assert_array_equal(kept[: first + 1], GROWING_K[: first + 1])
    np.testing.assert_array_equal(kept[first:], GROWING_K[first])


def test_a_faster_zone_keeps_less_and_one_that_cannot_correct_keeps_all():
    fast, middle, slow = (with_recourse_K(GROWING_K, quarter_hourly(K_per_h)) for K_per_h in (4.0, 0.3, 0.02))
    np.testing.assert_array_equal(fast, np.full(96, GROWING_K[0]))
    assert fast[-1] < middle[-1] < slow[-1]
    np.testing.assert_array_equal(slow, GROWING_K)


def test_recourse_is_that_of_what_a_plan_leaves_free_when_it_does():
    zone, steps = quarter_hourly(0.5), np.arange(96)
    # Off, on and off in turn, a quarter left, at the limit for ten hours, and for good.
    shares = [1.0 + 0.0 * steps, 1.0 * (steps % 2 == 0), 0.25 + 0.0 * steps, 0.5 * (steps >= 40), 0.0 * steps]
    off, blocks, little, later, none = (with_recourse_K(GROWING_K, zone, free) for free in shares)
    for most in (off, blocks):
        np.testing.assert_array_equal(most, with_recourse_K(GROWING_K, zone))
    np.testing.assert_array_equal(none, GROWING_K)
    np.testing.assert_array_equal(later[:41], GROWING_K[:41])
    assert off[-1] < min(little[-1], later[-1])
    assert max(little[-1], later[-1]) < GROWING_K[-1]


def test_recourse_never_adds():
    rng = np.random.default_rng(1)
    for K_per_h in (0.05, 0.3, 1.0, 5.0):
        backoff = rng.uniform(0.0, 0.6, 96)
        assert (with_recourse_K(backoff, quarter_hourly(K_per_h)) <= backoff).all()


def test_recourse_is_that_of_the_heat_at_hand_and_of_either_sign():
    zone = quarter_hourly(0.5)
    cooling = replace(zone, gains=-zone.gains, sign=-1)
    np.testing.assert_array_equal(with_recourse_K(GROWING_K, cooling), with_recourse_K(GROWING_K, zone))
    # 1500 W at the -10 °C that gains are for, 2500 W at the 0 °C that are reckoned with.
    heat = MachineLoad((0.0, 0.0, 2500.0, 100.0), (-20.0, 15.0), lowest_level=1.0)
    colder, stronger = replace(zone, heat_input=HeatInput(heat, -10.0)), replace(zone, gains=zone.gains / 0.6)
    np.testing.assert_array_equal(with_recourse_K(GROWING_K, colder), with_recourse_K(GROWING_K, stronger))
    assert with_recourse_K(GROWING_K, stronger)[-1] < with_recourse_K(GROWING_K, zone)[-1]


class Widening(OutdoorResponse):
    """The exact forecast with a band that is 0.1 K wider every hour."""

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        exact = super().forecast(free_C, history, boundary).median_C
        half_K = 0.1 * np.arange(1.0, exact.size + 1)
        return FreeForecast(np.array([0.1, 0.5, 0.9]), np.stack([exact - half_K, exact, exact + half_K]), "widening")


def test_only_the_bound_that_actuation_protects_is_kept_less(monkeypatch):
    monkeypatch.setattr(MPCConfig, "backoff_max_K", 9.0)
    monkeypatch.setattr(MPCConfig, "backoff_violation_K", 9.0)
    config = MPCConfig(step_s=None, horizon_h=24.0, comfort_margin_K=0.0)
    mpc = ThermoForceMPC(simple_model(), config, free_response=Widening())
    house = SimpleHouse()
    house.reset(10 * DAY_S, DAY_S)
    seen = Observation(house.past(HOUR_S), house.forecast(DAY_S, HOUR_S))
    context = mpc.predictor.context(seen)

    def kept_K(level: float | None) -> tuple[Array, Array]:
        """Inside both bounds (24,), after a plan of this level."""
        u = np.full((1, 24), level, dtype=np.float64)
        good = None if level is None else GoodPlan(seen.time_s - HOUR_S, u, np.full((1, 24), 21.0), 0.1 * u)
        problem = mpc.instance(context, seen.history, good=good)
        return problem.lower_C[0] - seen.boundary.lower_C[0, 1:], seen.boundary.upper_C[0, 1:] - problem.upper_C[0]

    below_K, above_K = kept_K(None)
    # Half of 0.4 K in the first hour is more than the back-off of its lead.
    np.testing.assert_allclose(below_K, below_K[0])
    assert 0.0 < below_K[0] < 0.2
    assert (np.diff(above_K[:7]) > 0.0).all()
    # A plan that leaves half or more leaves what is counted on without one; at full level nothing is left.
    for level in (0.0, 0.5):
        np.testing.assert_array_equal(kept_K(level), (below_K, above_K))
    assert (np.diff(kept_K(1.0)[0]) > 0.0).all()
