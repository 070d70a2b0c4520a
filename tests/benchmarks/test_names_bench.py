"""`bench names`: what signals are made of, and that a map takes them for it."""

from __future__ import annotations

import numpy as np

from benchmarks.names.bench import drawn, run_names_bench


def test_contacts_of_windows_and_prices_in_cents_are_made_as_such():
    signals = [signal for number in range(40) for signal in drawn(630, number)[1]]
    windows = [one for one in signals if one.role == "window"]
    assert len(windows) > 5
    assert all(set(np.unique(one.column.values)) <= {0.0, 1.0} for one in windows)
    of_wind = [one for one in signals if "wind speed" in one.column.name.lower()]
    assert {one.role for one in of_wind} <= {""}
    for one in signals:
        if one.role == "price":
            assert (one.unit == "cent per kWh") is bool(np.median(one.column.values) > 5.0)


def test_signals_of_a_few_buildings_are_taken_for_what_they_are():
    assert all(target["holds"] for target in run_names_bench(seed=630, buildings=10)["targets"])
