"""An open window: found by a steep fall or its contact, said, respected for a while, and taken back."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from simulated_building import RULES, START, SimulatedBuilding, mpc

from thermoforce_mpc.data import Boundary, Layout, Record
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.live.windows import PAUSE_S, as_if_empty, open_windows, steep_falls, without
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

STEP_S, DAYS = 900.0, 4


def room(gain_K=0.25, loss=0.02, seed=1):
    """Temperature, outdoors and level of a room whose heating is switched by the quarter of an hour, as it is."""
    rng = np.random.default_rng(seed)
    n = round(DAYS * 86400.0 / STEP_S)
    out_C = 3.0 + 4.0 * np.sin(np.arange(n + 1) * 2.0 * np.pi / 96.0)
    T, u = np.full(n + 1, 21.0), np.zeros(n)
    for k in range(n):
        u[k] = float(T[k] < 21.0) if k % 96 not in range(88, 96) else 0.0
        T[k + 1] = T[k] + gain_K * u[k] - loss * (T[k] - out_C[k]) * 0.5 + rng.normal(0.0, 0.02)
    return T, out_C, u[None]


def record(T, out_C, u, names=None):
    time_s = STEP_S * np.arange(T.size)
    return Record(time_s, T[None], out_C, 0.0 * out_C, u, np.zeros((1, T.size - 1)), np.zeros(u.shape))


def aired(T, k, fall_K=1.2, back_K=0.0):
    """The same with a window open in step `k`: the air of the room is exchanged."""
    T = T.copy()
    T[k + 1 :] -= fall_K
    T[k + 2 :] += back_K
    return T


def test_a_room_that_heats_and_cools_by_itself_has_no_window_open():
    for gain_K, loss in ((0.25, 0.02), (1.5, 0.12), (3.0, 0.2)):  # a house, a light room, an air unit
        T, out_C, u = room(gain_K, loss)
        assert not steep_falls(T, out_C, u, STEP_S)[0].any()


@pytest.mark.parametrize("seed", range(3))
def test_a_window_is_found_in_the_step_in_which_it_is_opened(seed):
    T, out_C, u = room(seed=seed)
    assert np.flatnonzero(steep_falls(aired(T, 300), out_C, u, STEP_S)[0]).tolist() == [300]


def test_nothing_is_claimed_where_something_else_may_be_the_cause():
    T, out_C, u = room()
    fell = aired(T, 300)
    turned_down = u.copy()
    turned_down[0, 292:300], turned_down[0, 300:] = 1.0, 0.0
    unknown = u.copy()
    unknown[0, 300] = np.nan
    assert not steep_falls(fell, out_C, turned_down, STEP_S)[0].any(), "its heat was turned down"
    assert not steep_falls(fell, out_C, unknown, STEP_S)[0].any(), "nobody knows what acted"
    assert not steep_falls(fell, out_C + 16.0, u, STEP_S)[0].any(), "outdoors it is as warm"
    assert not steep_falls(fell[200:], out_C[200:], u[:, 200:], STEP_S)[0].any(), "not known how it usually falls"


@pytest.mark.parametrize(("before", "after"), [(0.05, 0.0), (0.0, -0.03), (-0.04, -0.12)])
def test_a_small_level_that_ends_or_cools_is_no_window(before, after):
    """A light room that an air unit holds at a twentieth of its power, and one that it begins to cool."""
    T, out_C, u = room()
    u = np.where(np.arange(u.size) < 300, before, after)[None]
    assert not steep_falls(aired(T, 300), out_C, u, STEP_S)[0].any()
    held = np.full_like(u, before)
    assert np.flatnonzero(steep_falls(aired(T, 300), out_C, held, STEP_S)[0]).tolist() == [300]


def test_the_pause_ends_after_half_an_hour_or_when_the_room_comes_back():
    T, out_C, u = room()
    whole = record(aired(T, 300), out_C, u)
    open_in = [k for k in range(296, 310) if open_windows(whole.slice(0, k), Layout.single())]
    assert open_in == [301, 302]
    back = record(aired(T, 300, back_K=0.7), out_C, u)
    assert [k for k in range(296, 310) if open_windows(back.slice(0, k), Layout.single())] == [301]
    (window,) = open_windows(whole.slice(0, 301), Layout.single()).values()
    assert window.until_s == whole.time_s[301] + PAUSE_S
    assert "it fell 1.1 K in 15 min (0.5 K are steep)" in window.why


def test_what_is_read_meanwhile_counts_as_not_measured_and_nothing_is_needed():
    T, out_C, u = room()
    cut = record(aired(T, 300), out_C, u).slice(0, 302)
    windows = open_windows(cut, Layout.single())
    masked = without(cut, windows).T_zone_C[0]
    assert np.isnan(masked[301:]).all()
    assert np.isfinite(masked[:301]).all()
    at_s = cut.time_s[-1] + STEP_S * np.arange(5)
    one, none = np.ones(5), np.zeros(5)
    ahead = as_if_empty(Boundary(at_s, none, none, none, 20.0 * one, 23.0 * one, one, none), windows)
    assert ahead.lower_C[0].tolist() == [16.0] * 5, "with bounds of later a plan would heat for them now"
    assert ahead.upper_C[0].tolist() == [28.0] * 5


def test_a_contact_says_it_and_nobody_guesses_there():
    T, out_C, u = room()
    cut = record(aired(T, 300), out_C, u).slice(0, 302)
    contact = np.zeros(cut.time_s.size)
    assert open_windows(cut, Layout.single(), {"zone": contact}) == {}
    contact[-3:] = 1.0
    (window,) = open_windows(cut, Layout.single(), {"zone": contact}).values()
    assert window.since_s == cut.time_s[-4]
    assert window.why == "a window is open"
    contact[-20:] = 1.0
    assert open_windows(cut, Layout.single(), {"zone": contact}) == {}, "for five hours: that is how the room is"
    assert open_windows(cut, Layout.single(), {"zone": np.full(contact.size, np.nan)}), "a dead contact says nothing"


class WithContact(SimulatedBuilding):
    """Its window is open from 2:20 to 3:30, or so many hours later."""

    later_h = 0.0

    def measurements(self):
        table = super().measurements()
        hours = (table["time"] - START) / pd.Timedelta("1h") - self.later_h
        table["contact"] = np.where((hours >= 2.3) & (hours < 3.5), "open", "closed")
        table.loc[hours >= 2.3, "T"] -= 0.8 * (hours[hours >= 2.3] < 3.5)
        return table


class WithReedContact(WithContact):
    """A contact as Zigbee2MQTT tells of it: true while the window is closed."""

    def measurements(self):
        table = super().measurements()
        told = table.pop("contact")
        return table.assign(**{"zigbee2mqtt/window#contact": np.where(told == "open", "0", "1")})


WINDOWED = MeasurementMap.model_validate(RULES | {"zones": {"zone": RULES["zones"]["zone"] | {"window": "contact"}}})


REED = "zigbee2mqtt/window#contact"


@pytest.mark.parametrize(("made", "window"), [(WithContact, "contact"), (WithReedContact, REED)])
def test_what_a_controller_reads_and_is_asked_for_while_it_is_open(made, window):
    house = made()
    rules = RULES | {"zones": {"zone": RULES["zones"]["zone"] | {"window": window}}}
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    for hours, is_open in ((2, False), (3, True), (4, False)):
        house.wait_until(at := START + pd.Timedelta(hours=hours))
        T_C = building.record(at).T_zone_C[0]
        assert np.isnan(T_C[-1]) == is_open
        assert np.isfinite(T_C[:-1]).all()
        lower_C = building.forecast(6 * 3600.0, 3600.0).lower_C[0]
        assert (lower_C == (16.0 if is_open else 20.0)).all()
        assert any("zone: a window is open; nothing is needed" in note for note in building.left_out) == is_open


def test_contacts_of_two_kinds_are_not_summed_in_silence():
    zone = RULES["zones"]["zone"] | {"window": {"column": ["hall", REED]}}
    with pytest.raises(ValueError, match="open: say it"):
        MeasurementMap.model_validate(RULES | {"zones": {"zone": zone}})


@pytest.mark.slow
def test_a_controller_says_it_heats_nothing_meanwhile_not_even_for_later_and_goes_on():
    """Before, it heated half of the hour in which the window was open, for the bounds of the hours after it."""
    house, decisions = WithContact(), []
    house.later_h = 4.0  # when the house has cooled to its lower bound
    building = LiveBuilding(house, WINDOWED, 3600.0)
    control(building, mpc(), clock=house, steps=9, delay_s=0.0, told=decisions.append)
    said = [any("a window is open; nothing is needed" in note for note in decision.notes) for decision in decisions]
    assert said == [False] * 7 + [True, False]
    assert [str(decision.plan.status) for decision in decisions] == ["solved"] * 7 + ["bridged", "solved"]
    heats = [any(block.u[0] for block in decision.blocks) for decision in decisions]
    assert heats[5:] == [True, True, False, True]
