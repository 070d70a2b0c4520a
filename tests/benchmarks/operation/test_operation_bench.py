"""Records of operation beside probing: controllers, scores and verdicts of the bench."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.operation import bench
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, Layout
from thermoforce_mpc.plants.embedded import EmbeddedPlant


@pytest.fixture(scope="module")
def plant() -> EmbeddedPlant:
    return EmbeddedPlant(synthetic_weather())


@pytest.mark.slow
@pytest.mark.parametrize("operation", bench.OPERATIONS)
def test_an_operation_keeps_the_house_warm(plant: EmbeddedPlant, operation: str) -> None:
    record = bench.operated(plant, Layout.single(), operation, 20 * DAY_S, 2)
    assert record.n_steps == 48
    assert record.time_s[0] == 20 * DAY_S
    assert 17.0 < record.T_zone_C.min() < record.T_zone_C.max() < 26.0
    levels = np.unique(record.u.round(6))
    assert levels.min() >= 0.0
    assert levels.max() <= 1.0
    assert levels.size > 2


def test_a_pair_differs_by_its_levels_only(plant: EmbeddedPlant) -> None:
    one, other = bench.pair_of_days(plant, Layout.single(), 12)
    assert one.T_zone_C[0, 0] == other.T_zone_C[0, 0]
    assert (one.T_out_C == other.T_out_C).all()
    assert np.abs(one.T_zone_C - other.T_zone_C).max() > 0.5


@pytest.mark.slow
def test_three_days_of_a_thermostat_tell_the_effect() -> None:
    (row,) = bench.run_case(bench.Case(bench.EMBEDDED, "thermostat", 8, (3,)))
    assert row["competent"]
    assert 0.0 < row["share"] < 0.4


def test_a_confident_model_that_is_wrong_fails_the_target() -> None:
    row = {"building": "b", "operation": "o", "days": 3, "rmse_K": 0.5, "share": 0.8, "competent": True, "why": ""}
    assert not bench.targets([row])[0].holds
    assert bench.targets([row | {"competent": False}])[0].holds
    (line,) = bench.summary([row, row | {"rmse_K": np.nan, "competent": False, "why": "refused: no effect"}])
    assert (line["model"], line["competent"], line["what it says"]) == ("1 of 2", "1 of 2", "refused: no effect")
    assert line["effect_rmse_K"] == 0.5


def test_heat_is_not_measured(plant: EmbeddedPlant) -> None:
    record = bench.operated(plant, Layout.single(), "thermostat", 20 * DAY_S, 1)
    assert np.isfinite(record.heat_W).all()
    assert np.isnan(bench.as_usually_measured(record).heat_W).all()
    assert (bench.as_usually_measured(record).u == record.u).all()
