"""Identification on the real test case: the figures this project promises, on data it did not make."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.operator.data import cut, read_hourly_pairs, read_run
from benchmarks.operator.score import score_pairs
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify

AREA_M2 = 192.0


@pytest.fixture(scope="module")
def pairs(shared):
    return read_hourly_pairs(shared / "boptest_hp")


@pytest.mark.slow
def test_pairs_of_other_days_are_predicted(pairs):
    days = sorted({p.start_day for p in pairs})
    training = [p.pair for p in pairs if days.index(p.start_day) % 4 == 0]
    testing = [p for p in pairs if days.index(p.start_day) % 2 == 1]
    config = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
    selected = identify(pairs=training, config=config, floor_area_m2=AREA_M2)
    first = identify(pairs=training, config=config.model_copy(update={"order": 1}), floor_area_m2=AREA_M2)
    scores = score_pairs(selected.only.operator, testing)
    assert selected.only.operator.order == 3
    assert scores.rmse_K <= 0.035
    assert scores.sign_accuracy >= 0.995
    assert scores.rmse_K <= 0.5 * score_pairs(first.only.operator, testing).rmse_K


@pytest.mark.slow
@pytest.mark.parametrize(("days", "limit_K"), [(1, 0.16), (3, 0.1)])
def test_few_days_of_one_run_are_enough(shared, pairs, days, limit_K):
    run = read_run(shared / "boptest_hp" / "excite_jan.csv.gz")
    model = identify(
        [cut(run, 0, days)],
        config=IdentificationConfig(epochs=150, sun_on_sensor=False, late_sensor=False),
        floor_area_m2=AREA_M2,
    )
    scores = score_pairs(model.only.operator, pairs)
    assert scores.rmse_K <= limit_K
    assert scores.sign_accuracy >= 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("month", "day"), [("jan", 11), ("apr", 3), ("apr", 10)])
def test_the_days_that_tell_least_of_the_machine_are_enough(shared, pairs, month, day):
    """Cold ones with a narrow range outdoors, mild ones that never saw full: what is missing is the heat capacity."""
    run = read_run(shared / "boptest_hp" / f"excite_{month}.csv.gz")
    config = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
    scores = score_pairs(identify([cut(run, day, 1)], config=config, floor_area_m2=AREA_M2).only.operator, pairs)
    assert scores.rmse_K <= 0.3
    assert scores.sign_accuracy >= 0.99


@pytest.mark.slow
@pytest.mark.parametrize("day", [0, 19])
def test_feedback_does_not_drop_the_delay(shared, pairs, day):
    """Three days of the native controller, in which a few hours would have spoken for a single mode."""
    run = read_run(shared / "boptest_hp" / "native_d7_28d.csv.gz")
    config = IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
    model = identify([cut(run, day, 3)], config=config, floor_area_m2=AREA_M2)
    assert model.only.operator.order == 3
    assert score_pairs(model.only.operator, pairs).rmse_K <= 0.16


def test_a_day_without_heating_is_refused(shared):
    run = read_run(shared / "boptest_hp" / "excite_apr.csv.gz")
    quiet = next(cut(run, d, 1) for d in range(27) if np.ptp(cut(run, d, 1).u) == 0)
    with pytest.raises(DataError, match="u is constant at 0"):
        identify([quiet])
