"""Records of operation: the part that tells most, what they cannot tell, and the probing by hand that would."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from houses import weather

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.by_hand import as_changes, probe_schedule
from thermoforce_mpc.identification.probing.operation import findings, telling_part
from thermoforce_mpc.plants.embedded import EmbeddedPlant

HEATING = Layout.single("heating")


def operated(u: np.ndarray, days: float) -> Record:
    """Hourly record with the levels `u` (A, n); the temperatures do not matter for what is expected."""
    time_s, T_out, solar = weather(days, HOUR_S, seed=3)
    names = Names(("zone",), tuple(f"heater_{a}" for a in range(len(u))), ("machine",))
    unknown = np.full((len(u), time_s.size - 1), np.nan)
    names = Names(("zone",), ("actuator",), ("machine",)) if len(u) == 1 else names
    origin = pd.Timestamp("2025-01-01", tz="Europe/Brussels")
    T = np.full((1, time_s.size), 21.0)
    return Record(time_s, T, T_out, solar, u, unknown[:1], unknown, unknown[:1], origin=origin, names=names)


def drawn(n: int, seed: int = 0) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).integers(0, 2, n // 3 + 1), 3)[:n].astype(float)


def test_the_days_that_tell_most_are_used():
    u = np.full((1, 60 * 24), 0.4)
    u[0, 28 * 24 : 42 * 24] = drawn(14 * 24)
    record = operated(u, 60)
    part, note = telling_part(record, HEATING)
    assert part.n_steps == 28 * 24
    assert np.ptp(part.u) == 1.0
    assert note.startswith("of 60 days, the 28 that tell most about acting were used: 2025-02-")
    short = record.last(27 * 24)
    assert telling_part(short, HEATING)[0] is short
    T = record.T_zone_C.copy()
    T[0, 20 * 24 :] = np.nan
    assert np.isfinite(telling_part(replace(record, T_zone_C=T), HEATING)[0].T_zone_C).mean() >= 0.5
    with pytest.raises(DataError, match="known for half of the time"):
        telling_part(replace(record, T_zone_C=T * np.nan), HEATING)


def test_levels_are_set_by_day_on_the_hour_and_control_is_given_back():
    record = operated(np.full((1, 72), 0.4), 3)
    plan = probe_schedule(record, HEATING, awake=(8, 20), levels=(0.0, 0.5, 1.0))
    assert plan.probed == ("actuator",)
    hours = (plan.time_s[:-1] % DAY_S) / HOUR_S
    set_by_hand = np.isfinite(plan.u[0])
    np.testing.assert_array_equal(set_by_hand, (hours >= 8) & (hours < 20))
    assert plan.by_hand_h == set_by_hand.sum()
    assert set(plan.u[0, set_by_hand]) <= {0.0, 0.5, 1.0}
    assert plan.time_s[0] >= record.time_s[-1]
    time_s, u = as_changes(plan)
    assert np.isnan(u[0, -1])
    rebuilt = u[0, np.searchsorted(time_s, plan.time_s[:-1], side="right") - 1]
    np.testing.assert_array_equal(rebuilt, plan.u[0])


def test_a_month_and_more_can_be_added_to():
    record = operated(np.full((1, 30 * 24), 0.4), 30)
    plan = probe_schedule(record, HEATING, start_s=float(record.time_s[-1]) + 100 * DAY_S + 7 * HOUR_S)
    assert np.isfinite(plan.u).any()
    with pytest.raises(DataError, match="zone: its temperature was not measured"):
        probe_schedule(replace(record, T_zone_C=record.T_zone_C * np.nan), HEATING)


def test_only_what_is_not_known_is_probed():
    n = 14 * 24
    record = operated(np.array([drawn(n), np.full(n, 0.3)]), 14)
    layout = Layout(record.names, (1, 1), (0, 0), (0, 0), (0.0, 0.0), (0.0, 0.0), (np.nan,))
    plan = probe_schedule(record, layout, competent=[True, False], days=2)
    assert plan.probed == ("heater_1",)
    assert np.isnan(plan.u[0]).all()
    assert plan.u.shape == (2, 48)
    both = probe_schedule(record, layout)
    assert both.probed == ("heater_0", "heater_1")
    assert not np.array_equal(both.u[0], both.u[1], equal_nan=True), "each has draws of its own"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"levels": (1.0, 0.0)}, "start with 0"),
        ({"levels": (0.0,)}, "start with 0"),
        ({"awake": (20, 8)}, "hours from 20 to 8"),
        ({"awake": (8, 10)}, "at least 6 h"),
        ({"days": 8}, "give 1 to 7"),
    ],
)
def test_schedules_that_nobody_can_run_are_refused(changes, message):
    with pytest.raises(DataError, match=message):
        probe_schedule(operated(np.full((1, 72), 0.4), 3), HEATING, **changes)
    with pytest.raises(DataError, match="heats and cools"):
        probe_schedule(operated(np.full((1, 72), 0.4), 3), replace(HEATING, u_min=(-1.0,)))


@pytest.mark.slow
def test_run_by_hand_the_schedule_tells_what_operation_did_not():
    plant = EmbeddedPlant(synthetic_weather())
    record = Record.beginning(plant.reset(60 * DAY_S, 5 * DAY_S))
    for _ in range(2 * 96):
        record = record.extended(plant.advance(None, 900.0))
    before = findings(record, HEATING)[0]
    assert not before.competent
    plan = probe_schedule(record, HEATING, lower_C=np.array([21.0]), upper_C=np.array([24.0]), competent=[False])
    assert plan.discomfort_Kh[0] < 5.0
    while record.time_s[-1] < plan.time_s[-1]:
        hour = int((record.time_s[-1] - plan.time_s[0]) // HOUR_S)
        by_hand = plan.u[0, hour] if hour >= 0 else np.nan
        record = record.extended(plant.advance(None if np.isnan(by_hand) else by_hand, 900.0))
    after = findings(record, HEATING)[0]
    assert after.competent, after.words
