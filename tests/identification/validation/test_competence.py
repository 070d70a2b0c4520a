"""A model says of itself whether it is good enough to act on; records that cannot identify are told apart."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from houses import House, make_pair, record, weather

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.estimation.regression import (
    STEP_RESPONSE_H,
    before_held_out,
    held_out,
    run_regression,
    seen_rows,
)
from thermoforce_mpc.identification.validation.competence import (
    LEAD_TIMES_H,
    MOST_ERROR_K,
    MOST_RELATIVE_SD,
    is_well_known,
    missed_criteria,
    most_K,
)
from thermoforce_mpc.model.card import Competence, HorizonScore
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model

HOUSE = House()
LINEAR = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)


def good_record(seed: int = 0) -> Record:
    return record(HOUSE, 3.0, seed=seed, noise_K=0.01)


@cache
def good_model(seed: int) -> ThermalModel:
    """Of a good record, whose model most tests look at: it is identified once."""
    return identify([good_record(seed)], config=LINEAR, floor_area_m2=190.0)


def _verdict(run: Record, **options) -> Competence:
    model = identify([run], config=LINEAR, floor_area_m2=190.0, **options)
    assert model.only.card.competence is not None
    return model.only.card.competence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_a_good_record_passes_with_margin(seed):
    verdict = good_model(seed).only.card.competence
    assert verdict.competent, verdict.reasons
    assert not verdict.advice
    assert verdict.sign_probability > 0.999
    assert verdict.relative_sd < 0.5 * MOST_RELATIVE_SD
    one, six = (next(score for score in verdict.horizons if score.hours == hours) for hours in (1.0, 6.0))
    assert one.model_K < 0.5 * MOST_ERROR_K[1.0]
    assert six.model_K < 0.5 * MOST_ERROR_K[6.0]
    assert six.model_K < 0.5 * min(six.persistence_K, six.weather_K)


@pytest.mark.slow
def test_the_verdict_is_saved_and_said(tmp_path):
    model = good_model(0)
    assert load_model(model.save(tmp_path / "m")).only.card.competence == model.only.card.competence
    assert "competent: the effect of 8 h" in model.summary()
    unjudged = replace(model, cards=(replace(model.only.card, competence=None),))
    assert load_model(unjudged.save(tmp_path / "old")).only.card.competence is None
    assert "not judged" in unjudged.summary()


@pytest.mark.slow
def test_held_out_errors_are_those_of_the_predictor():
    """The shortcut over one Cholesky factor gives what predicting from every start would: checked on persistence."""
    run, verdict = good_record(), good_model(0).only.card.competence
    first = round(0.75 * run.T_zone_C[0].size)
    for score in verdict.horizons:
        steps = round(score.hours * 4)
        change = run.T_zone_C[0, first:] - run.T_zone_C[0, first - steps : -steps]
        assert score.persistence_K == pytest.approx(np.sqrt(np.mean(change**2)), rel=1e-9)


@pytest.mark.slow
def test_predictions_an_hour_ahead_are_judged_however_long_the_record():
    model = identify(record(HOUSE, 40.0, 3600.0, noise_K=0.01), config=LINEAR.model_copy(update={"order": 2}))
    verdict = model.only.card.competence
    assert verdict.competent, verdict.reasons
    assert verdict.held_out_h == pytest.approx(240.0, rel=0.02)
    assert any("960 steps are fitted as 2 runs" in note for note in model.only.card.notes)


def test_rows_of_a_thinned_record_are_an_hour_or_little_more_before_others():
    """Every 55 min, no row would be within an hour and a half before another and an hour or more."""
    rows = run_regression(record(HOUSE, 26.0, 300.0), HeatInput()).rows
    assert rows.size < 26 * 288 / 5
    ahead_h = np.subtract.outer(rows, rows)[20] / 12.0
    assert ((ahead_h >= 1.0) & (ahead_h <= 1.5)).any()


@pytest.mark.slow
def test_a_lead_time_without_data_is_said_plainly():
    coarse = record(HOUSE, 12.0, 7200.0, noise_K=0.01)
    verdict = identify(coarse, config=LINEAR.model_copy(update={"order": 2})).only.card.competence
    assert verdict.reasons == (
        "1 h ahead it cannot be judged: no held-out temperature has another 1 to 1.5 h before it",
    )
    assert "measure the zone temperature without long gaps, in steps that divide an hour" in verdict.advice


@pytest.mark.slow
def test_tests_count_an_earlier_part_that_its_fit_has_not_seen():
    run, verdict = good_record(), good_model(0).only.card.competence
    assert verdict.held_out_h == pytest.approx(18.0, abs=0.3)
    one = verdict.horizons[0]
    assert one.blocks == 10  # two parts of 18 h in blocks of 4 h, the last of each shorter

    (whole,) = held_out([run_regression(run, HeatInput())], LINEAR)
    (earlier,) = before_held_out([whole], LINEAR)
    # Half of the rows are fitted to, the quarter after them is held out.
    assert (whole.held, earlier.held) == pytest.approx((whole.rows.size / 4, whole.rows.size / 4), abs=1)
    assert earlier.seen == pytest.approx(whole.rows.size / 2, abs=1)
    (seen,) = seen_rows([earlier])
    assert (seen.rows.size, seen.held) == (earlier.seen, 0)
    np.testing.assert_array_equal(seen.target, whole.target[: earlier.seen])


@pytest.mark.slow
@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_the_sensor_of_another_room_is_not_acted_on(seed, measured):
    """Its temperature wanders and has nothing to do with the actuator."""
    run = record(HOUSE, 3.0, seed=seed, heat_measured=measured)
    walk = 21.0 + np.cumsum(np.random.default_rng(seed).normal(size=run.n_steps + 1)) * 0.12
    with pytest.raises(DataError, match="zone sensor is in the room that it serves"):
        identify([replace(run, T_zone_C=walk)], config=LINEAR, floor_area_m2=190.0)


@pytest.mark.slow
def test_sun_that_swamps_everything_is_named():
    sunny = record(House(solar_K=(15.0, 40.0)), 3.0, seed=2, noise_K=0.01)
    elsewhere = weather(3.0, 900.0, 79)[2]
    verdict = _verdict(replace(sunny, solar_W_m2=elsewhere))
    assert not verdict.competent
    assert any("6 h ahead it errs by" in reason for reason in verdict.reasons)
    assert any("sun" in advice or "signal" in advice for advice in verdict.advice)
    try:  # refused, or not competent
        dark = _verdict(replace(sunny, solar_W_m2=np.zeros(sunny.solar_W_m2.size)))
        assert not dark.competent
        told = "; ".join(dark.advice)
    except DataError as error:
        told = str(error)
    assert "no irradiance: name a signal for the sun" in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measured", "words"), [(True, "the measured heat is that of heating"), (False, "sign of cooling")]
)
def test_heating_says_nothing_of_cooling(measured, words):
    with pytest.raises(DataError, match=words):
        identify([record(HOUSE, 3.0, heat_measured=measured)], config=LINEAR, mode="cooling", floor_area_m2=190.0)


@pytest.mark.slow
def test_little_excitation_is_condemned_with_levels_and_hours():
    """An hour at a fifth of full level, now and then."""
    u = np.zeros(192)
    for start in range(0, 192, 12):
        u[start : start + 4] = 0.2
    model = identify([record(HOUSE, 2.0, u=u, noise_K=0.02, heat_measured=False)], config=LINEAR)
    verdict = model.only.card.competence
    assert not verdict.competent
    assert "known to" in verdict.reasons[0]
    advice = " | ".join(verdict.advice)
    assert "the highest level was 0.2: probe full level too" in advice
    assert "hours more" in advice


@pytest.mark.parametrize(("sd_K", "known"), [(4.03, "41"), (4.3, "43"), (np.inf, "inf")])
def test_what_misses_the_bar_by_a_hair_does_not_read_as_if_it_met_it(sd_K, known):
    """Probing said that an effect was known to ± 40 % only, need 40 %."""
    verdict = Competence(True, effect_K=10.0, effect_sd_K=sd_K, horizons=(HorizonScore(1.0, 0.502, 1.0, 1.0, 5.0, 8),))
    reasons = [missed.reason() for missed in missed_criteria(verdict, MOST_ERROR_K, 4.0) if missed.kind != "unjudged"]
    assert reasons[0] == f"the effect of 8 h at full level is known to ± {known} % only, need 40 %"
    assert reasons[1] == "1 h ahead it errs by 0.51 K, need 0.5 K"


@pytest.mark.parametrize(
    ("horizon", "kind"),
    [
        (HorizonScore(24.0, 1.47, 2.0, 0.87, -4.0, 24, -3.0), "weather"),
        (HorizonScore(6.0, 0.95, 0.9, 2.0, 3.0, 24, 4.0), "unchanged"),
        (HorizonScore(3.0, 0.30, 0.9, 0.25, -3.0, 24, -9.0), "weather"),
    ],
    ids=["weather, a day ahead", "unchanged, 6 h ahead", "weather, 3 h ahead"],
)
def test_worse_at_any_lead_time_is_not_competent(horizon, kind):
    """A room whose heated neighbours were left out passed: the day ahead was reported, but not judged."""
    good = [HorizonScore(hours, 0.1, 1.0, 1.0, 9.0, 24, -9.0) for hours in LEAD_TIMES_H if hours != horizon.hours]
    verdict = Competence(True, effect_K=10.0, effect_sd_K=1.0, horizons=(*good, horizon))
    (missed,) = missed_criteria(verdict, MOST_ERROR_K, 4.0)
    assert missed.kind == kind
    beside = {"weather": "the weather alone by 0.", "unchanged": "an unchanged temperature by 0.90 K"}[kind]
    assert f"{horizon.hours:g} h ahead it errs by {horizon.model_K:.2f} K, {beside}" in missed.reason()
    # As far from it as chance goes where predictions overlap: for plans the weather alone may not be better at all.
    chance = replace(horizon, better_t=max(horizon.better_t, -2.0), persistence_t=min(horizon.persistence_t, 2.0))
    by_chance = missed_criteria(replace(verdict, horizons=(*good, chance)), MOST_ERROR_K, 4.0)
    assert [one.kind for one in by_chance] == [kind] * (kind == "weather")


def test_a_room_that_a_thermostat_holds_is_no_reason_to_refuse_its_model():
    """A day ahead an unchanged temperature is what the thermostat makes of it; the weather alone errs by far more."""
    good = [HorizonScore(hours, 0.1, 1.0, 1.0, 9.0, 24, -9.0) for hours in LEAD_TIMES_H if hours < 12.0]
    held = [HorizonScore(hours, 1.47, 0.9, 2.35, 6.0, 24, 6.7) for hours in (12.0, 24.0)]
    verdict = Competence(True, effect_K=10.0, effect_sd_K=1.0, horizons=(*good, *held))
    assert missed_criteria(verdict, MOST_ERROR_K, 4.0) == []


def test_weather_alone_may_be_better_by_chance_only_at_once_or_in_one_part():
    """A model was competent whose own table said that it is worse than the weather alone from 3 h on."""

    def kinds(hours: float, model_K: float, better_t: float) -> list[str]:
        horizons = [HorizonScore(h, 0.1, 1.0, 1.0, 9.0, 24, -9.0) for h in LEAD_TIMES_H if h != hours]
        judged = HorizonScore(hours, model_K, 2.0, 0.2, better_t, 24, -9.0)
        verdict = Competence(True, effect_K=10.0, effect_sd_K=1.0, horizons=(*horizons, judged))
        return [one.kind for one in missed_criteria(verdict, MOST_ERROR_K, 4.0)]

    assert kinds(3.0, 0.25, -0.5) == ["weather"]
    assert kinds(1.0, 0.25, -0.5) == []
    assert kinds(3.0, 0.25, 0.5) == []
    assert kinds(3.0, 0.19, -0.5) == []


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 3])
def test_models_from_pairs_are_judged(n):
    """On pairs that were held out, or on the last part of the only one."""
    pairs = [make_pair(HOUSE, seed) for seed in range(n)]
    verdict = identify(pairs=pairs, config=LINEAR, floor_area_m2=190.0).only.card.competence
    assert verdict.competent, verdict.reasons
    assert verdict.held_out_h == pytest.approx(9.0 * n)  # the last quarter of each, since all begin at once
    assert all(score.model_K < 0.1 * score.weather_K for score in verdict.horizons)
    wrong = [replace(pair, a=replace(pair.a, T_zone_C=_wandering(pair.a, k))) for k, pair in enumerate(pairs)]
    try:
        spoiled = identify(pairs=wrong, config=LINEAR, floor_area_m2=190.0).only.card.competence
    except DataError:
        return
    assert not spoiled.competent


def _wandering(run: Record, seed: int) -> np.ndarray:
    """What a sensor reads that the actuator does not reach."""
    steps = np.random.default_rng(seed).normal(size=run.n_steps) * 0.5
    return run.T_zone_C[0, 0] + np.concatenate([[0.0], np.cumsum(steps)])


@pytest.mark.slow
@pytest.mark.parametrize("modulation", ["linear", "auto"])
def test_the_two_stages_are_judged_without_their_held_out_rows(modulation):
    config = IdentificationConfig(
        method="two_stage", modulation=modulation, heat_input="identity", sun_on_sensor=False, late_sensor=False
    )
    run = record(HOUSE, 6.0, 3600.0, noise_K=0.01)
    verdict = identify(run, config=config, floor_area_m2=190.0).only.card.competence
    assert verdict is not None
    assert verdict.held_out_h == pytest.approx(36.0, abs=1.0)
    # What the held-out rows hold is no part of the fit that is judged on them.
    T = run.T_zone_C.copy()
    T[0, 109:] += np.random.default_rng(0).normal(size=36)
    spoiled = identify(replace(run, T_zone_C=T), config=config, floor_area_m2=190.0).only.card.competence
    assert spoiled.horizons[2].model_K > 2.0 * verdict.horizons[2].model_K
    short = identify(record(HOUSE, 2.4, 3600.0, noise_K=0.01), config=config, floor_area_m2=190.0)
    assert not short.only.card.competence.competent
    assert "it cannot be judged" in short.only.card.competence.reasons[0]


@pytest.mark.slow
def test_a_given_model_is_not_judged():
    operator = identify(record(HOUSE, 2.0), config=LINEAR, floor_area_m2=190.0).only.operator
    assert ThermalModel.single(operator).only.card.competence is None


@pytest.mark.slow
def test_more_than_the_heat_can_do_is_not_competent():
    """Of a house of 190 m² as one of 2,000 m²: its heat per area cannot do what the record shows."""
    model = good_model(0).only
    heat_W_m2 = model.operator.heat_input.reference_W / 190.0
    most = most_K(STEP_RESPONSE_H, heat_W_m2)
    said = [model.card.uncertainty[f"step_response_{hours}h_K"] for hours in STEP_RESPONSE_H]
    assert (np.array(said) < 0.7 * most).all()
    assert most_K((1.0,), 2 * heat_W_m2) == pytest.approx(2 * most_K((1.0,), heat_W_m2), rel=1e-6)
    assert (np.diff(most) > 0.0).all()
    verdict = identify(good_record(), config=LINEAR, floor_area_m2=4000.0).only.card.competence
    assert not verdict.competent
    assert any("the heat can do" in reason for reason in verdict.reasons)
    assert any("floor area" in advice for advice in verdict.advice)


@pytest.mark.slow
@pytest.mark.parametrize(("times", "surely"), [(1.12, False), (2.2, True)])
def test_only_what_is_surely_more_than_the_heat_can_do_is_not_competent(times, surely):
    """An estimate a little above the bound is of a room below it as often as not."""
    area_m2 = 190.0 * times / over_bound(good_model(0).only, 190.0)
    model = identify(good_record(), config=LINEAR, floor_area_m2=area_m2).only
    assert over_bound(model, area_m2) > 1.0  # it says more at first sight
    assert any("the heat can do" in reason for reason in model.card.competence.reasons) == surely


def over_bound(model, area_m2: float) -> float:
    """The largest share of what its heat can do that a model says of full level."""
    most = most_K(STEP_RESPONSE_H, model.operator.heat_input.reference_W / area_m2)
    said = [model.card.uncertainty[f"step_response_{hours}h_K"] for hours in STEP_RESPONSE_H]
    return float((np.array(said) / most).max())


def test_the_owner_reads_whether_it_may_control_why_not_and_what_to_do():
    good = Competence(True, effect_K=10.0, effect_sd_K=1.2)
    assert "This model may act" in good.sentence()
    assert "± 12 %" in good.sentence()
    poor = Competence(
        False, ("6 h ahead it errs by 1.20 K, need 1 K",), ("probe about 24 hours more",), plainly="it is too far off"
    )
    assert poor.sentence() == ("This model may not act, since it is too far off. Next: probe about 24 hours more.")


def test_well_known_is_more_than_competent():
    known = Competence(True, effect_K=10.0, effect_sd_K=0.68)  # of which 0.5 are what no record tells
    assert is_well_known(known)
    assert not is_well_known(replace(known, effect_sd_K=0.8))
    assert not is_well_known(replace(known, competent=False))
    assert not is_well_known(None)
