"""A model says of itself whether it is good enough to act on; records that cannot identify are told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, make_pair, record, weather

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.estimation.modes import wide_priors
from thermoforce_mpc.identification.estimation.regression import run_regression
from thermoforce_mpc.identification.validation.competence import (
    MOST_ERROR_K,
    MOST_RELATIVE_SD,
    HeldOutErrors,
    is_well_known,
    missed_criteria,
)
from thermoforce_mpc.identification.validation.held_out import Case, held_out
from thermoforce_mpc.identification.validation.held_out_fit import earlier_fold
from thermoforce_mpc.model.competence import Competence, HorizonScore
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model

HOUSE = House()
LINEAR = IdentificationConfig(modulation="linear")


def _verdict(run: Record, **options) -> Competence:
    model = identify([run], config=LINEAR, floor_area_m2=190.0, **options)
    assert model.only.card.competence is not None
    return model.only.card.competence


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3])
def test_a_good_record_passes_with_margin(seed):
    verdict = _verdict(record(HOUSE, 3.0, seed=seed, noise_K=0.01))
    assert verdict.competent, verdict.reasons
    assert not verdict.advice
    assert verdict.sign_probability > 0.999
    assert verdict.relative_sd < 0.5 * MOST_RELATIVE_SD
    one, six, _ = verdict.horizons
    assert one.model_K < 0.5 * MOST_ERROR_K[1.0]
    assert six.model_K < 0.5 * MOST_ERROR_K[6.0]
    assert six.model_K < 0.5 * min(six.persistence_K, six.weather_K)


def test_the_verdict_is_saved_and_said(tmp_path):
    model = identify([record(HOUSE, 3.0)], config=LINEAR, floor_area_m2=190.0)
    assert load_model(model.save(tmp_path / "m")).only.card.competence == model.only.card.competence
    assert "competent: the effect of 8 h" in model.summary()
    unjudged = replace(model, cards=(replace(model.only.card, competence=None),))
    assert load_model(unjudged.save(tmp_path / "old")).only.card.competence is None
    assert "not judged" in unjudged.summary()


def test_held_out_errors_are_those_of_the_predictor():
    """The shortcut over one Cholesky factor gives what predicting from every start would: checked on persistence."""
    run = record(HOUSE, 3.0, noise_K=0.01)
    verdict = _verdict(run)
    first = round(0.75 * run.T_zone_C[0].size)
    for score in verdict.horizons:
        steps = round(score.hours * 4)
        change = run.T_zone_C[0, first:] - run.T_zone_C[0, first - steps : -steps]
        assert score.persistence_K == pytest.approx(np.sqrt(np.mean(change**2)), rel=1e-9)


@pytest.mark.parametrize(("days", "step_s"), [(40.0, 3600.0), (23.0, 300.0)], ids=["long", "rows 55 min apart"])
def test_predictions_an_hour_ahead_are_judged_however_long_the_record(days, step_s):
    """Rows of long records are thinned; some must remain an hour, or little more, before others."""
    model = identify(record(HOUSE, days, step_s, noise_K=0.01), config=LINEAR.model_copy(update={"order": 2}))
    verdict = model.only.card.competence
    assert verdict.competent, verdict.reasons
    assert verdict.held_out_h == pytest.approx(6.0 * days, rel=0.02)
    assert any("960 steps are fitted as 2 runs" in note for note in model.only.card.notes) == (days == 40.0)


def test_a_lead_time_without_data_is_said_plainly():
    coarse = record(HOUSE, 12.0, 7200.0, noise_K=0.01)
    verdict = identify(coarse, config=LINEAR.model_copy(update={"order": 2})).only.card.competence
    assert verdict.reasons == (
        "1 h ahead it cannot be judged: no held-out temperature has another 1 to 1.5 h before it",
    )
    assert "measure the zone temperature without long gaps, in steps that divide an hour" in verdict.advice


def test_tests_count_an_earlier_part_that_its_fit_has_not_seen():
    run = record(HOUSE, 3.0, noise_K=0.01)
    verdict = _verdict(run)
    assert verdict.held_out_h == pytest.approx(18.0, abs=0.3)
    one = verdict.horizons[0]
    assert one.blocks == 10  # two parts of 18 h in blocks of 4 h, the last of each shorter

    case = Case(run_regression(run, HeatInput(), LINEAR), (run,), float(run.time_s[0]))
    regression, priors = case.regression, wide_priors(2)
    fold = earlier_fold([case], held_out([case], LINEAR), priors, LINEAR, 1)
    ((_, split),) = fold.runs
    # Half of the rows are fitted to, the quarter after them is held out.
    assert split.train.size == pytest.approx(regression.rows.size / 2, abs=1)
    assert split.judged.size == pytest.approx(regression.rows.size / 4, abs=1)
    later = np.arange(regression.rows.size) >= split.judged[0]
    changed = replace(case, regression=replace(regression, target=regression.target + 3.0 * later))
    again = earlier_fold([changed], held_out([changed], LINEAR), priors, LINEAR, 1)
    assert again.fit.gains == pytest.approx(fold.fit.gains, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_the_sensor_of_another_room_is_not_acted_on(seed, measured):
    """Its temperature wanders and has nothing to do with the actuator."""
    run = record(HOUSE, 3.0, seed=seed, heat_measured=measured)
    walk = 21.0 + np.cumsum(np.random.default_rng(seed).normal(size=run.n_steps + 1)) * 0.12
    with pytest.raises(DataError, match="zone sensor is in the room that it serves"):
        identify([replace(run, T_zone_C=walk)], config=LINEAR, floor_area_m2=190.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_sun_that_swamps_everything_is_named(seed):
    sunny = record(House(solar_K=(15.0, 40.0)), 3.0, seed=seed, noise_K=0.01)
    elsewhere = weather(3.0, 900.0, seed + 77)[2]
    verdict = _verdict(replace(sunny, solar_W_m2=elsewhere))
    assert not verdict.competent
    assert any("6 h ahead it errs by" in reason for reason in verdict.reasons)
    assert any("sun" in advice or "signal" in advice for advice in verdict.advice)
    dark = _verdict(replace(sunny, solar_W_m2=np.zeros(sunny.solar_W_m2.size)))
    assert not dark.competent
    assert any("no irradiance: name a signal for the sun" in advice for advice in dark.advice)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("measured", "words"), [(True, "the measured heat is that of heating"), (False, "sign of cooling")]
)
def test_heating_says_nothing_of_cooling(measured, words):
    with pytest.raises(DataError, match=words):
        identify([record(HOUSE, 3.0, heat_measured=measured)], config=LINEAR, mode="cooling", floor_area_m2=190.0)


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
    found = {1.0: HeldOutErrors(*(np.zeros(3),) * 3, np.zeros(3, dtype=np.intp), np.zeros(3))}
    reasons, _ = missed_criteria(verdict, found, [record(HOUSE, 1.0)], MOST_ERROR_K)
    assert reasons[0] == f"the effect of 8 h at full level is known to ± {known} % only, need 40 %"
    assert reasons[1] == "1 h ahead it errs by 0.51 K, need 0.5 K"


def test_what_cannot_be_judged_is_not_judged():
    pairs_only = identify(pairs=[make_pair(HOUSE, seed) for seed in range(3)], config=LINEAR, floor_area_m2=190.0)
    assert pairs_only.only.card.competence is None
    assert ThermalModel.single(pairs_only.only.operator).only.card.competence is None


def test_well_known_is_more_than_competent():
    known = Competence(True, effect_K=10.0, effect_sd_K=0.5)
    assert is_well_known(known)
    assert not is_well_known(replace(known, effect_sd_K=1.3))
    assert not is_well_known(replace(known, competent=False))
    assert not is_well_known(None)
