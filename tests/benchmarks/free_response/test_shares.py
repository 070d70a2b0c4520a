"""Shares of the oracle's gain: what is compared with what, from which instants, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.free_response.shares import share_rows
from benchmarks.free_response.sources import Source, house_sources
from thermoforce_mpc.data import HOUR_S, FreeForecast, Record
from thermoforce_mpc.errors import DataError


def source(days: int, step_s: float = HOUR_S) -> Source:
    """A ramp that knows nothing of the weather."""
    t = np.arange(round(days * 24 * HOUR_S / step_s) + 1.0) * step_s
    nothing = np.zeros(t.size - 1)
    history = Record(t, t / HOUR_S, np.full(t.size, 5.0), np.zeros(t.size), nothing, nothing, nothing)
    return Source("ramp", "ramps", history, t / HOUR_S, 1, 1)


class Off:
    """Knows the ramp but for a constant, and remembers what it was shown."""

    name = "off"

    def __init__(self, off_K: float, least: int = 0) -> None:
        self.off_K, self.least, self.seen = off_K, least, []

    def forecast(self, free_C, history, boundary):
        if history.n_steps < self.least:
            raise DataError("too short")
        self.seen.append((history.n_steps, float(boundary.time_s[0]), float(boundary.T_out_C[1:].std())))
        return FreeForecast([0.1, 0.5, 0.9], np.tile(boundary.time_s[1:] / HOUR_S + self.off_K, (3, 1)))


def test_shares_are_those_of_the_error_of_linear_weather_from_the_same_instants_for_every_history():
    methods = {"linear_weather": Off(1.0), "half": Off(0.5), "worse": Off(-2.0), "long": Off(0.0, least=14 * 24)}
    rows = share_rows([source(20)], methods, 3)
    by = {(row["history"], row["weather"], row["free response"]): row for row in rows}
    for history in ("1 d", "3 d", "14 d"):
        for weather in ("perfect", "medium errors"):
            for lead in ("6h", "24h"):
                share = {case[2]: row[f"share_{lead}"] for case, row in by.items() if case[:2] == (history, weather)}
                expected = {"oracle": 1.0, "linear_weather": 0.0, "half": 0.5, "worse": -1.0}
                assert share == pytest.approx(expected | ({"long": 1.0} if history == "14 d" else {}))
    seen = methods["half"].seen
    assert [size for size, _, _ in seen] == 2 * (3 * [24] + 3 * [72] + 3 * [336])
    assert len({instant for _, instant, _ in seen}) == 3
    assert all(spread == 0.0 for _, _, spread in seen[:9])
    assert all(spread > 0.0 for _, _, spread in seen[9:])  # weather errors


def test_short_records_are_left_out_and_weather_errors_where_steps_are_no_hours():
    methods = {"linear_weather": Off(1.0)}
    assert share_rows([source(10)], methods, 3) == []
    assert {row["weather"] for row in share_rows([source(16, HOUR_S / 2)], methods, 3)} == {"perfect"}


@pytest.mark.slow
def test_houses_with_people_are_the_same_houses_in_the_same_weather():
    usual, lively = house_sources(houses=1), house_sources(people=7, houses=1)
    assert [one.group for one in (*usual, *lively)] == ["houses"] * 2 + ["houses, people"] * 2
    for one, other in zip(usual, lively, strict=True):
        np.testing.assert_array_equal(one.history.T_out_C, other.history.T_out_C)
        assert np.abs(one.free_C - other.free_C).mean() > 0.05
        assert one.free_C.size == 28 * 24 + 1
