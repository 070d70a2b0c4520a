"""The share of the forecaster's error that a linear use of the weather could remove."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.free_response.limit import cross_validated, in_sample, limit_rows, weather_features
from benchmarks.free_response.sources import Source
from thermoforce_mpc.data import HOUR_S, Record

pytestmark = pytest.mark.slow

DAYS = 24


def source(weather_share: float) -> Source:
    """Hourly: the room follows outdoors of ever new weather, or a course of its own, in some hours."""
    rng = np.random.default_rng(3)
    t = np.arange(DAYS * 24 + 1.0)

    def course() -> np.ndarray:
        fronts = np.repeat(rng.normal(0.0, 5.0, t.size // 18 + 1), 18)[: t.size]
        return fronts + 3 * np.cos(2 * np.pi * t / 24)

    outdoor, own = course(), course()
    free = np.empty(t.size)
    free[0] = 15.0
    drive = 15.0 + weather_share * outdoor + (1.0 - weather_share) * own
    for k in range(1, t.size):
        free[k] = free[k - 1] + (drive[k] - free[k - 1]) / 6.0
    nothing = np.zeros(t.size - 1)
    history = Record(t * HOUR_S, free, outdoor, np.zeros(t.size), nothing, nothing, nothing)
    return Source("made up", "made up", history, free, context_steps=14 * 24, least_context_steps=7 * 24)


def test_much_can_be_removed_where_weather_moves_the_room_and_nothing_where_it_does_not():
    lines = []
    shorter = replace(source(1.0), free_C=source(1.0).free_C[:-336])
    six, day = limit_rows([source(1.0), shorter], "shipped", lines.append, most_origins=100)
    assert six["share of the backbone's error removed"] == "first 6 h"
    assert day["share of the backbone's error removed"] == "first 24 h"
    assert day["instants"] == 100
    assert [line.split(":")[1].split()[0] for line in lines] == ["limit", "left"]
    for row in (six, day):
        assert row["by weather ahead, in sample"] > row["cross-validated"] > 0.0
        assert row["by candidates too, in sample"] > row["cross-validated too"] > 0.8
        assert row["by candidates too, in sample"] > row["by residual"] > 0.8
    assert day["cross-validated"] > 0.25
    for row in limit_rows([source(0.0)], "shipped", lines.append, most_origins=100):
        assert row["cross-validated"] < 0.05
        assert row["cross-validated too"] < 0.05
        assert row["by candidates too, in sample"] < 0.3


def test_features_are_what_is_new_in_the_weather():
    made = source(1.0)
    outdoor = made.history.T_out_C
    t = np.array([200])
    found = weather_features(made, t, 24)[0]
    assert found.shape == (10, 24)
    yesterday = outdoor[201:225] - outdoor[177:201]
    usual = outdoor[201:225] - (outdoor[177:201] + outdoor[153:177] + outdoor[129:153]) / 3
    np.testing.assert_allclose(found[0, 10], yesterday[:11].mean())
    np.testing.assert_allclose(found[1, 10], yesterday[8:11].mean())
    np.testing.assert_allclose(found[2, 10], usual[:11].mean())
    np.testing.assert_allclose(found[1, 0], yesterday[0])
    np.testing.assert_allclose(found[4], (outdoor[195:201] - outdoor[171:177]).mean())
    assert (found[5:] == 0).all()


def test_a_block_is_predicted_without_its_own_errors_or_those_that_overlap():
    rng = np.random.default_rng(0)
    origins = np.arange(0, 300, 2)
    errors, features = rng.standard_normal((150, 3)), rng.standard_normal((150, 8, 3))
    block = slice(60, 90)
    predicted = (errors - cross_validated(errors, features, origins, 24))[block]
    overlapping, apart = errors.copy(), errors.copy()
    overlapping[49:101] += 100.0  # starts less than 24 before the block's first and less than 24 after its last
    apart[48] += 100.0
    np.testing.assert_allclose((overlapping - cross_validated(overlapping, features, origins, 24))[block], predicted)
    assert not np.allclose((apart - cross_validated(apart, features, origins, 24))[block], predicted)
    assert np.abs(in_sample(errors, features)).mean() < np.abs(cross_validated(errors, features, origins, 24)).mean()


def test_an_exact_answer_leaves_nothing():
    rng = np.random.default_rng(1)
    features = rng.standard_normal((120, 4, 5))
    errors = 0.3 + np.einsum("tpn,pn->tn", features, rng.standard_normal((4, 5)))
    assert np.abs(in_sample(errors, features)).max() == pytest.approx(0.0, abs=1e-4)
    assert np.abs(cross_validated(errors, features, np.arange(120), 5)).mean() < 0.2 * np.abs(errors).mean()
