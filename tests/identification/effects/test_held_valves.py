"""Circuits whose heat is not measured: less of it when it is mild, and while a valve stays open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import weather
from thermal_networks import effect_K

from thermoforce_mpc.data import HOUR_S, Layout, Names, Record
from thermoforce_mpc.identification import IdentificationConfig
from thermoforce_mpc.identification.effects.level_laws import (
    HELD,
    OUTDOORS,
    LevelLaw,
    laws_of,
    weather_of,
    with_outdoors,
)
from thermoforce_mpc.identification.network.building import NetworkInputs, room_run
from thermoforce_mpc.identification.network.estimate import estimate_room
from thermoforce_mpc.model.operator.heat_input import IDENTITY

CONFIG = IdentificationConfig(order=3, modulation="linear", sun_on_sensor=False)
NAMES = Names(("bedroom", "bath"), ("bedroom_valve", "bath_valve"), ("pump",))
LAYOUT = Layout(NAMES, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (20.0, 10.0))
STEP_H, DAYS = 1.0, 10.0
# Of the bedroom per m²: capacities of room, structure and floor, Wh/K; conductances to structure, outdoors, floor, and
# from the water to the floor, W/K.
C, H_STRUCTURE, H_OUTDOORS, H_FLOOR, H_WATER = np.array([15.0, 60.0, 25.0]), 10.0, 1.0, 6.0, 5.0
WATER_C = 34.0


def after(T: np.ndarray, u: float, T_out_C: float, hours: float) -> np.ndarray:
    """Room, structure and floor, °C, after some hours with the valve open by `u`."""
    dt = 0.05
    for _ in range(round(hours / dt)):
        room, structure, floor = T
        to_structure, to_room = H_STRUCTURE * (room - structure), H_FLOOR * (floor - room)
        lost, taken = H_OUTDOORS * (room - T_out_C), u * H_WATER * (WATER_C - floor)
        T = T + dt * np.array([to_room - to_structure - lost, to_structure, taken - to_room]) / C
    return T


def in_short_spells(T_out_C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Levels (n,) of a valve that opens for an hour or two, and the room's temperatures (n + 1,), °C."""
    rng = np.random.default_rng(4)
    u = np.zeros(T_out_C.size - 1)
    for begin in range(0, u.size, 8):
        if rng.random() < 0.7:
            u[begin + int(rng.integers(5)) :][: int(rng.integers(1, 3))] = 1.0
    T, read = np.array([18.5, 18.0, 19.0]), []
    for k in range(u.size):
        read.append(T[0])
        T = after(T, u[k], T_out_C[k], STEP_H)
    return u, np.array([*read, T[0]])


def record_of(T_C: float = 18.5) -> Record:
    """Days in which the bedroom, at about `T_C`, is heated in short spells, the bath most of the time."""
    time_s, T_out_C, sun = weather(DAYS, STEP_H * HOUR_S, seed=0)
    u, read = in_short_spells(T_out_C)
    noise = np.random.default_rng(1).normal(0.0, 0.01, read.size)
    T_zone_C = np.stack([read + noise + T_C - 18.5, np.full(read.size, 22.0)])
    levels = np.stack([u, np.tile([1.0, 0.0], u.size)[: u.size]])
    nothing = np.full((2, u.size), np.nan)
    return Record(time_s, T_zone_C, T_out_C, 0.0 * sun, levels, nothing[:1], nothing, names=NAMES)


def laws(record: Record, a: int = 0) -> dict[str, LevelLaw]:
    return {law.name: law for law in laws_of([record], LAYOUT, a, IDENTITY, CONFIG)}


def test_a_valve_that_opens_for_short_spells_tells_what_hours_do():
    """Its heat meets a cold floor: 30 % more than in hours, which a fit of the level alone takes for the effect."""
    record = record_of()
    begin = np.array([18.5, 18.0, 18.5])
    true_K = float((after(begin, 1.0, 0.0, 8.0) - after(begin, 0.0, 0.0, 8.0))[0])
    errors = {}
    for name, told in (("level alone", []), ("as it is", list(laws(record).values()))):
        inputs = NetworkInputs(LAYOUT, (IDENTITY, IDENTITY), (told, []), across=False)
        fit = estimate_room(inputs.room(0), [room_run(record, 0, inputs, 0.0)], most_starts=1)
        said_K = effect_K(fit.room, fit.theta, 8.0)
        errors[name] = said_K / true_K - 1.0
    assert errors["level alone"] > 0.2
    assert abs(errors["as it is"]) < 0.5 * errors["level alone"]


def test_the_heat_of_hours_at_full_level_is_that_of_the_level():
    phi, n = laws(record_of())[HELD].phi, round(8.0 / STEP_H)
    u = np.concatenate([np.zeros(48), np.ones(n), np.zeros(n)])
    less = phi(u, np.zeros(u.size))
    assert less[u == 0.0] == pytest.approx(0.0)
    assert less[48 : 48 + n].mean() == pytest.approx(0.0, abs=0.01)
    assert less[48] > 0.4 > 0.0 > -0.2 > less[48 + n - 1], "most of it comes at first"


def test_a_circuit_changes_more_with_the_weather_in_mild_weather_and_warm_rooms():
    """What its water is warmer than the room by ends a few kelvin above the temperature at which nothing is heated."""
    cold = record_of()
    mild = replace(cold, T_out_C=cold.T_out_C + 8.0)
    slopes = [laws(run)[OUTDOORS].mean for run in (cold, mild, record_of(T_C=22.5))]
    assert slopes[1] < slopes[0] < -0.02
    assert slopes[2] < slopes[0]
    reach_K = [-1.0 / slope for slope in slopes]
    assert reach_K[0] - reach_K[1] == pytest.approx(8.0, abs=0.1)
    assert reach_K[0] - reach_K[2] == pytest.approx(4.4, abs=0.1)
    summer = replace(cold, T_out_C=cold.T_out_C + 30.0)
    assert -0.2 < laws(summer)[OUTDOORS].mean < slopes[1], "a valve that opens gives something"


def test_a_slope_of_mild_weather_is_kept():
    record = record_of()
    mild = replace(record, T_out_C=8.0 + 0.3 * (record.T_out_C - record.T_out_C.mean()))
    followed = with_outdoors(IDENTITY, {OUTDOORS: (-0.1, 0.01)}, weather_of([mild], 0))
    assert followed.per_K == pytest.approx(-0.1)
