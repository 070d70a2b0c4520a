"""Every method on a zone whose answer is known: what a sound one must find, and what an unsound one cannot."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from paired_windows import GAINS_K, N, data, window

from benchmarks.free_response.baselines.seasonal_naive import SeasonalNaive
from benchmarks.interventions.dataset import Probe
from benchmarks.interventions.methods import curve, thermoforce
from benchmarks.interventions.methods.base import (
    best,
    clearly_better,
    effect_rmse,
    plans,
    predicted_effect,
    true_effect,
)
from benchmarks.interventions.methods.curve import EXPONENTS, curved
from benchmarks.interventions.methods.registry import (
    BEST,
    METHODS,
    MONOTONE,
    TWO_STATE,
    find_method,
)
from benchmarks.interventions.methods.remembering import Remembering
from benchmarks.interventions.methods.thermoforce import (
    LinearEffect,
    SuperpositionPredictor,
    build_thermoforce,
)
from benchmarks.interventions.suite import score_cells, training_of
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.model.free_response.registry import build_free_response

pytestmark = pytest.mark.usefixtures("identified_once")

FREE = build_free_response("persistence")


@pytest.fixture(scope="module")
def climate():
    return data()


@pytest.fixture(scope="module")
def training(climate):
    return training_of(climate, 3)


@pytest.fixture(scope="module")
def size(climate):
    """RMS of the true effects, K."""
    return float(np.sqrt(np.mean([true_effect(w) ** 2 for w in climate.part("test")])))


def test_the_raw_forecast_answers_every_plan_alike(climate, training, size):
    raw = METHODS["tsfm"].build(training, FREE)
    assert effect_rmse(raw, climate.part("test")) == pytest.approx(size)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [("tsfm_covariates", 0.4), ("tsfm_covariates_ar", 0.4), ("rc_probe", 0.05)])
def test_baselines_find_most_of_the_effect_when_the_data_allow_it(climate, training, size, name, share):
    """A baseline that cannot learn a linear zone without noise would be a weak one."""
    daily = SeasonalNaive()
    assert effect_rmse(METHODS[name].build(training, daily), climate.part("test")) < share * size


@pytest.mark.slow
@pytest.mark.parametrize(("name", "share"), [(MONOTONE, 0.17), (TWO_STATE, 0.03), ("thermoforce_unconstrained", 0.2)])
def test_ours_find_the_effect_with_its_sign_and_without_violations(climate, training, size, name, share, monkeypatch):
    # A network that is trained for a sixth of the usual time does for a zone without noise.
    monkeypatch.setattr(thermoforce, "IdentificationConfig", partial(IdentificationConfig, epochs=60))
    # Each exponent is an identification; which of many is found has tests of its own below.
    monkeypatch.setattr(curve, "EXPONENTS", (1.0, 0.8))
    cells = score_cells(name, METHODS[name].build(training, FREE), climate, 3)
    assert [c.window for c in cells] == ["morning", "afternoon", "evening"]
    assert max(c.effect_rmse_K for c in cells) < share * size
    assert min(c.sign_accuracy for c in cells) == 1.0
    if name != "thermoforce_unconstrained":
        assert sum(c.violations for c in cells) == 0


@pytest.mark.slow
def test_two_states_find_the_time_constants_and_gains_of_the_zone(training):
    found = build_thermoforce(training, FREE, orders=(2,), modulation="linear").model.only.operator
    assert found.time_constants_h == pytest.approx([1.2, 20.0], rel=0.15)
    assert found.steady_gains_K == pytest.approx(GAINS_K, rel=0.1)


@pytest.mark.slow
def test_a_curve_is_not_found_where_there_is_none(training):
    predictor = build_thermoforce(training, FREE, orders=(2,), modulation="linear", exponents=EXPONENTS[:2])
    assert predictor.exponent == 1.0


def test_the_curve_is_concave_rises_and_keeps_its_ends():
    u = np.linspace(0.0, 1.0, 101)
    for exponent in EXPONENTS:
        v = curved(u, exponent)
        assert (v[0], v[-1]) == (0.0, pytest.approx(1.0))
        assert (np.diff(v) > 0).all()
        assert (np.diff(v, 2) <= 1e-12).all()
    assert curved(u, 1.0) == pytest.approx(u)
    assert curved(np.array([0.5]), 0.8)[0] == pytest.approx(0.5339, abs=1e-4)


@pytest.mark.slow
def test_a_curve_is_found_where_there_is_one(training):
    """The zone answers v(u): its records are those of the linear zone, whose control went through the inverse of v."""
    levels = np.linspace(0.0, 1.0, 4001)

    def bent(record):
        return replace(record, u=np.interp(record.u[0], curved(levels, 0.8), levels))

    pair = Pair(bent(training.probe.pair.a), bent(training.probe.pair.b))
    windows = [
        replace(w, factual=bent(w.factual), perturbed=bent(w.perturbed), history=bent(w.history))
        for w in training.validation
    ]
    probe = Probe(bent(training.probe.history), pair)
    # Its neighbours, and none: those further away answer less alike.
    tried = (1.0, 0.85, 0.8, 0.75)
    assert set(tried) < set(EXPONENTS)
    predictor = build_thermoforce(
        replace(training, probe=probe, validation=windows), FREE, orders=(2,), modulation="linear", exponents=tried
    )
    assert predictor.exponent == 0.8
    assert predictor.model.only.operator.steady_gains_K == pytest.approx(GAINS_K, rel=0.1)


@pytest.mark.slow
def test_choosing_by_effects_alone_is_choosing_by_the_whole_prediction(climate, training):
    model = build_thermoforce(training, FREE, orders=(2,), modulation="linear").model
    alone, whole = LinearEffect(model, "", 0.8), SuperpositionPredictor(model, FREE, "", 0.8)
    for w in climate.part("test")[:2]:
        assert predicted_effect(alone, w) == pytest.approx(predicted_effect(whole, w), abs=1e-9)


@pytest.mark.slow
def test_a_method_is_told_nothing_of_what_came_of_its_plans(climate, training):
    """Futures replaced by nonsense must not change an answer."""
    one = climate.part("test")[0]
    blind = replace(
        one,
        factual=replace(one.factual, T_zone_C=np.full(N + 1, 99.0), u=np.full(N, 0.123)),
        perturbed=replace(one.perturbed, T_zone_C=np.full(N + 1, -99.0)),
    )
    for name in ("tsfm", "tsfm_covariates", "rc", TWO_STATE):
        predictor = METHODS[name].build(training, FREE)
        asked = plans(one)
        assert predictor.respond(one, asked).tobytes() == predictor.respond(blind, asked).tobytes(), name


@pytest.mark.slow
def test_the_surrogate_learns_more_than_nothing_and_twice_the_same(climate, training, size, monkeypatch):
    from benchmarks.interventions.methods import surrogate

    short = partial(surrogate.build_surrogate, epochs=40, settings=((0.2, 1e-4),))
    monkeypatch.setattr(surrogate, "build_surrogate", short)
    one, two = (METHODS["surrogate"].build(training, FREE) for _ in range(2))
    windows = climate.part("test")
    assert effect_rmse(one, windows) < 0.5 * size
    assert one.respond(windows[0], plans(windows[0])).tobytes() == two.respond(windows[0], plans(windows[0])).tobytes()


def test_choices_follow_the_effect_and_a_diverged_candidate_is_never_chosen():
    class Times:
        note = ""

        def __init__(self, factor):
            self.factor = factor

        def respond(self, window, u):
            return self.factor * u

    windows = [window(40, "morning", 2.0)]
    truth = float(true_effect(windows[0]).mean() / (plans(windows[0])[1] - plans(windows[0])[0]).mean())
    assert best({"nan": Times(np.nan), "far": Times(0.0), "near": Times(truth)}, windows) == "near"


class Answers:
    """Predictor whose effect is the true one times a factor, but for the steps of small effects, times another."""

    note = ""

    def __init__(self, large, small):
        self.large, self.small = large, small

    def respond(self, window, u):
        truth = true_effect(window)
        effect = truth * np.where(np.abs(truth) > 0.5 * np.abs(truth).max(), self.large, self.small)
        return np.stack([np.zeros(truth.size), effect])


def test_among_candidates_that_are_level_signs_decide_and_only_among_those():
    windows = [window(40, "morning", 2.0)]
    level = {"wrong signs": Answers(0.8, -0.01), "right signs": Answers(0.8, 0.01)}
    assert best(level, windows) == "right signs"
    apart = {"wrong signs": Answers(0.8, -0.01), "right signs": Answers(0.5, 0.01)}
    assert best(apart, windows) == "wrong signs"


def test_a_network_must_be_clearly_better_and_lose_no_sign():
    windows = [window(40, "morning", 2.0)]
    linear = Answers(0.8, 1.0)
    assert clearly_better(Answers(0.9, 1.0), linear, windows)
    assert not clearly_better(Answers(0.81, 1.0), linear, windows)
    assert not clearly_better(Answers(1.0, -0.01), linear, windows)


def test_the_forecaster_is_asked_each_question_once_and_answers_as_before(climate):
    class Counting:
        name = "counting"
        asked = 0

        def forecast(self, free_C, history, boundary):
            self.asked += 1
            return FREE.forecast(free_C, history, boundary)

    inner = Counting()
    remembering = Remembering(inner)
    one, two = climate.part("test")[:2]
    for w in (one, two, one):
        answer = remembering.forecast(w.history.T_zone_C[0], w.history, w.boundary)
        again = FREE.forecast(w.history.T_zone_C[0], w.history, w.boundary)
        assert answer.quantiles_C.tobytes() == again.quantiles_C.tobytes()
    assert inner.asked == 2
    remembering.forecast(one.history.T_zone_C[0] + 1e-9, one.history, one.boundary)
    assert inner.asked == 3


def test_names_and_days_that_do_not_exist_say_what_there_is(climate):
    with pytest.raises(ConfigError, match=rf"unknown method 'magic'.*{BEST}"):
        find_method("magic")
    with pytest.raises(DataError, match="7 probe days were not simulated; there are 3"):
        training_of(climate, 7)
