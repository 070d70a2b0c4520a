"""What a record says against itself: each fault put into a simulated room, and the measured records that have one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

import thermoforce_mpc as tf
from thermoforce_mpc.data import DAY_S, HOUR_S, Layout, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.checks import remarks

STEP_S, DAYS, AREA_M2, FULL_W = 900.0, 14, 20.0, 1500.0
LAYOUT = Layout.single(floor_area_m2=AREA_M2)


def room(seed: int = 1, slab_J_K: float = 0.0) -> tuple[Record, np.ndarray]:
    """A room of 20 m² and its walls under a thermostat with a setback, electrically heated, perhaps through a slab;
    and the set-points, °C.
    """
    rng = np.random.default_rng(seed)
    n = round(DAYS * DAY_S / STEP_S)
    hour = np.arange(n + 1) * STEP_S / HOUR_S % 24
    slow = np.convolve(rng.normal(0.0, 8.0, n + 400), np.ones(192) / 192**0.5, mode="same")[200 : 201 + n]
    outdoors = 3.0 + 0.4 * slow + 3.0 * np.cos(2 * np.pi * (hour - 15) / 24)
    sun = np.clip(400.0 * np.cos(2 * np.pi * (hour - 13) / 24) - 150.0, 0.0, None)
    setpoint = np.where((hour >= 6) & (hour < 22), 21.0, 18.5)[:n]
    T = np.full((2, n + 1), 19.0)
    slab = 20.0
    u = np.zeros(n)
    for k in range(n):
        on = u[k - 1] if k else 0.0
        u[k] = float(setpoint[k] + (0.2 if on else -0.2) > T[0, k])
        air, walls = T[:, k]
        for _ in range(15):
            given = 200.0 * (slab - air) if slab_J_K else FULL_W * u[k]
            slab += 60.0 * (FULL_W * u[k] - given) / slab_J_K if slab_J_K else 0.0
            heat = given + 1.5 * sun[k]
            to_walls = 120.0 * (air - walls)
            air += 60.0 * (heat - to_walls - 12.0 * (air - outdoors[k])) / 4e5
            walls += 60.0 * (to_walls - 18.0 * (walls - outdoors[k])) / 5e6
        T[:, k + 1] = air, walls
    reading = np.round(T[0] + rng.normal(0.0, 0.02, n + 1), 2)
    power = FULL_W * u + 5.0
    return Record(STEP_S * np.arange(n + 1.0), reading, outdoors, sun, u, power, power - 5.0), setpoint


CLEAN, SETPOINT = room()


def moved(record: Record, steps: int) -> Record:
    """What acts, stamped so many steps too late."""
    return replace(
        record, **{name: np.roll(getattr(record, name), steps, axis=1) for name in ("u", "heat_W", "power_W")}
    )


def hot_water(record: Record) -> Record:
    """Full power for half an hour twice a day beside the heating."""
    at = np.arange(record.n_steps) % 96
    return replace(record, power_W=record.power_W + 2000.0 * np.isin(at, (29, 30, 82, 83)), heat_W=_unknown(record))


def set_point(record: Record, *, metered: bool) -> Record:
    """The set-points as levels."""
    u = (SETPOINT - SETPOINT.min()) / np.ptp(SETPOINT)
    return replace(
        record,
        u=u,
        heat_W=_unknown(record),
        power_W=record.power_W if metered else np.full_like(record.power_W, np.nan),
    )


def heat_pump(record: Record) -> Record:
    """A heat pump, whose COP of 3 rises by 2 % a kelvin outdoors, gives the heat."""
    return replace(record, power_W=record.heat_W / (3.0 + 0.06 * (record.T_out_C[:-1] - 3.0)))


def modulating(record: Record) -> Record:
    """The same machine, which never goes below a fifth of full level."""
    load = FULL_W * (0.2 + 0.8 * record.u)
    return replace(record, u=0.2 + 0.8 * record.u, power_W=load, heat_W=load)


def household(record: Record) -> Record:
    """Other loads of 200 W in the mean, new ones every hour."""
    other = np.repeat(np.random.default_rng(3).exponential(200.0, record.n_steps // 4), 4)
    return replace(record, power_W=record.power_W + other)


def fahrenheit(record: Record) -> Record:
    return replace(record, T_out_C=32.0 + 1.8 * record.T_out_C)


def colder(record: Record) -> Record:
    """Outdoors 10 K colder, so that the room is but few kelvin above 'degrees'."""
    return replace(record, T_out_C=record.T_out_C - 10.0)


def exchanged(record: Record) -> Record:
    """The room's readings called those of outdoors, and the reverse."""
    return replace(record, T_zone_C=record.T_out_C[None], T_out_C=record.T_zone_C[0])


def rooms_called_fahrenheit(record: Record) -> Record:
    """°C of the rooms converted as if they were °F."""
    return replace(record, T_zone_C=(record.T_zone_C - 32.0) / 1.8)


def _unknown(record: Record) -> np.ndarray:
    return np.full_like(record.heat_W, np.nan)


def scaled(power: float, heat: float) -> Callable[[Record], Record]:
    return lambda record: replace(record, power_W=power * record.power_W, heat_W=heat * record.heat_W)


FAULTS: list[tuple[str, str, Callable[[Record], Record]]] = [
    ("stamps late", "time.marks: end", lambda record: moved(record, 1)),
    ("stamps late", "up to 2 steps (30 min)", lambda record: moved(record, 2)),
    ("stamps early", "time.marks: start", lambda record: moved(record, -1)),
    ("unit of power", "Wh per step taken for W, or the reverse (factor 4)", scaled(1.0, 4.0)),
    ("unit of power", "Wh per step taken for W, or the reverse (factor 4)", scaled(1.0, 0.25)),
    ("unit of power", "Wh per step taken for W, or the reverse (factor 4)", scaled(4.0, 1.0)),
    ("unit of power", "W taken for Wh per step is likely (factor 4)", scaled(4.0, 4.0)),
    ("unit of power", "unit: kW", scaled(1e-3, 1e-3)),
    ("unit of power", "unit: W", scaled(1e3, 1e3)),
    ("unit of power", "unit: kW", scaled(1.0, 1e-3)),
    ("unit of power", "rises with the outdoor temperature", lambda record: scaled(1.0, 0.25)(heat_pump(record))),
    ("unit of temperature", "unit: °F", fahrenheit),
    ("unit of temperature", "unit: °F", lambda record: fahrenheit(colder(record))),
    ("unit of temperature", "are the columns of rooms and outdoors exchanged", exchanged),
    ("unit of temperature", "check column and unit of the rooms", rooms_called_fahrenheit),
    ("meter holds another load", "hot water", hot_water),
    ("meter holds another load", "with the heat explains", lambda record: household(modulating(record))),
    ("level is no level", "warms the room", lambda record: set_point(record, metered=True)),
    ("level is no level", "the same every day", lambda record: set_point(record, metered=False)),
]


def test_nothing_is_said_of_a_record_without_a_fault():
    for seed in range(3):
        assert not remarks(room(seed)[0], LAYOUT)
    assert not remarks(heat_pump(CLEAN), LAYOUT)
    assert not remarks(modulating(CLEAN), LAYOUT)


def test_an_hour_shows_through_a_slab_and_the_lag_of_a_slab_is_no_hour():
    floor = room(slab_J_K=4e6)[0]
    floor = replace(floor, T_zone_C=np.round(floor.T_zone_C, 1))
    assert not remarks(floor, LAYOUT)
    assert [remark.kind for remark in remarks(moved(floor, 4), LAYOUT)] == ["stamps late"]
    assert [remark.kind for remark in remarks(moved(floor, -4), LAYOUT)] == ["stamps early"]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "says", "spoil"), FAULTS)
def test_a_fault_is_found_and_named_with_its_remedy(kind, says, spoil):
    found = remarks(spoil(CLEAN), LAYOUT)
    assert {remark.kind for remark in found} == {kind}
    assert all(says in remark.in_words() for remark in found)


def three_rooms(hot_water_W: float = 0.0) -> tuple[Record, Layout]:
    """Three rooms whose heaters hang on one meter; half an hour of hot water twice a day on it."""
    each = [room(seed)[0] for seed in (1, 4, 9)]
    names = Names(("a", "b", "c"), ("ha", "hb", "hc"), ("machine",))
    shares, area = (1 / 3,) * 3, (AREA_M2,) * 3
    layout = Layout(names, (1, 1, 1), (0, 1, 2), (0, 0, 0), (0.0, 0.0, 0.0), shares, area)
    at = np.arange(each[0].n_steps) % 96
    meter = sum(one.power_W for one in each) + hot_water_W * np.isin(at, (24, 25, 82, 83))
    T, u = (np.concatenate([getattr(one, name) for one in each]) for name in ("T_zone_C", "u"))
    time_s, T_out_C, sun = (getattr(each[0], name) for name in ("time_s", "T_out_C", "solar_W_m2"))
    return Record(time_s, T, T_out_C, sun, u, meter, np.full(u.shape, np.nan), names=names), layout


def test_hot_water_on_a_meter_that_several_rooms_share_is_found():
    assert not remarks(*three_rooms())
    (found,) = remarks(*three_rooms(2500.0))
    assert found.kind == "meter holds another load"
    assert "in bursts at the same hours of the day" in found.words
    assert "take the other load (hot water" in found.remedy


def test_valves_are_levels_also_where_warmer_water_warms_a_room_beside_them():
    """A house on a heating curve: water that is warmer at times takes more power, and a room that hardly calls for it
    feels the pipes."""
    record, layout = three_rooms(2500.0)
    rng, n = np.random.default_rng(6), record.n_steps
    warmer = np.convolve(rng.normal(0.0, 1.0, n + 16), np.ones(16) / 4.0, mode="valid")[:n]
    u, T = record.u.copy(), record.T_zone_C.copy()
    u[2] = np.where(rng.random(n) < 0.02, 1.0, 0.0)
    felt = np.convolve(warmer, 0.15 * 0.9 ** np.arange(40))[:n]
    T[2, 1:] = 20.0 + 0.1 * (record.T_out_C[1:] - 3.0) + felt
    power_W = FULL_W * (u[0] + u[1]) + 2500.0 * np.isin(np.arange(n) % 96, (24, 25, 82, 83)) + 900.0 + 600.0 * warmer
    spoiled = replace(record, u=u, T_zone_C=T, power_W=np.maximum(power_W, 0.0)[None])
    kinds = [found.kind for found in remarks(spoiled, layout)]
    assert "level is no level" not in kinds
    assert "meter holds another load" in kinds


def test_gaps_are_no_fault_and_hide_none():
    lost = np.random.default_rng(2).random(CLEAN.n_steps) < 0.03
    holed = replace(CLEAN, u=np.where(lost, np.nan, CLEAN.u), heat_W=np.where(lost, np.nan, CLEAN.heat_W))
    assert not remarks(holed, LAYOUT)
    assert [remark.kind for remark in remarks(moved(holed, 1), LAYOUT)] == ["stamps late"]
    assert not remarks(CLEAN.slice(0, 30), LAYOUT), "too short to tell"
    assert not remarks(replace(CLEAN, T_zone_C=np.full_like(CLEAN.T_zone_C, np.nan)), LAYOUT)


@pytest.mark.slow
def test_the_model_card_or_the_refusal_says_what_the_record_says():
    linear = tf.IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False)
    days = CLEAN.slice(0, 5 * 96)
    model = tf.identify(scaled(1.0, 4.0)(days), layout=LAYOUT, config=linear)
    assert any(note.startswith("unit of power: ") for note in model.cards[0].notes), model.cards[0].notes
    with pytest.raises(DataError, match=r"no effect of the actuator .*; stamps late: .* time\.marks: end"):
        tf.identify(moved(days, 1), layout=LAYOUT, config=linear)


@pytest.mark.slow
@pytest.mark.parametrize("metered", [True, False])
def test_a_set_point_taken_for_a_level_makes_no_competent_model(metered):
    spoilt, linear = (
        set_point(CLEAN, metered=metered).slice(0, 7 * 96),
        tf.IdentificationConfig(modulation="linear", sun_on_sensor=False, late_sensor=False),
    )
    verdict = tf.identify(spoilt, layout=LAYOUT, config=linear).cards[0].competence
    assert not verdict.competent
    assert verdict.reasons[0].startswith("level is no level: ")
    assert "set-point" in verdict.advice[0]
    assert "does not say what it did" in verdict.sentence()


@pytest.fixture(scope="module")
def measured(shared) -> Path:
    folder = shared / "measured_buildings"
    if not folder.is_dir():
        pytest.skip("the measured buildings are not there")
    return folder


def rules(folder: Path, name: str) -> dict[str, Any]:
    return yaml.safe_load((folder / name).read_text(encoding="utf-8"))


@pytest.mark.slow
def test_measured_heat_that_is_stamped_at_its_end(measured):
    ours = rules(measured, "all23e.yaml")
    marked = tf.read_measurements(measured / "ehbe" / "ehbe_2023_15min.csv", ours)
    assert not remarks(marked.record, marked.layout)
    del ours["time"]["marks"]
    found = tf.read_measurements(measured / "ehbe" / "ehbe_2023_15min.csv", ours)
    (remark,) = remarks(found.record, found.layout)
    assert remark.kind == "stamps late"
    assert "1 step (15 min)" in remark.words


@pytest.mark.slow
def test_measured_set_points_are_no_levels(measured):
    table = pd.read_csv(measured / "ehbe" / "ehbe_2023_15min.csv")
    rooms = [f"T{k:02d}" for k in range(1, 10)]
    for name in rooms:
        asked = table[f"{name}_SET"]
        table[f"L{name[1:]}"] = (asked - asked.min()) / (asked.max() - asked.min())
    table["P"] = table[[f"{name}_Wh" for name in rooms]].sum(axis=1)
    found = tf.read_measurements(table, rules(measured, "set23e.yaml"))
    assert [remark.kind for remark in remarks(found.record, found.layout)] == ["level is no level"]


@pytest.mark.slow
def test_measured_rooms_beside_the_only_one_of_the_map(measured):
    file = measured / "ehbe" / "ehbe_2019_15min.csv"
    alone = tf.read_measurements(file, rules(measured, "one19.yaml")).understood.beside
    assert len(alone) == 1
    assert alone[0].startswith("neighbours left out: T01_TEMP, T02_TEMP")
    assert "name them as zones" in alone[0]
    together = tf.read_measurements(file, rules(measured, "all19.yaml"))
    assert not together.understood.beside
    assert not remarks(together.record, together.layout)


@pytest.mark.parametrize("days", [4, 14])
def test_a_boiler_that_is_better_at_part_load_is_no_heat_pump_in_other_units(days):
    """Mild days are those of part load; a heat pump's ratio rises with the weather at equal load."""
    record = CLEAN.slice(0, 96 * days)
    T_out = record.T_out_C[:-1]
    load = np.clip((14.0 - T_out) / 14.0, 0.1, 1.0) * (record.u[0] > 0.0)
    noise = np.random.default_rng(5).normal(0.0, 0.02, record.n_steps)

    def doubts(ratio: np.ndarray) -> list[str]:
        metered = replace(record, u=load[None], power_W=1500.0 * load[None], heat_W=(1500.0 * load * ratio)[None])
        return [one.words for one in remarks(metered, LAYOUT) if one.kind == "unit of power"]

    assert doubts(1.0 - 0.3 * load**2 + noise) == []
    (words,) = doubts(0.25 * 3.2 * np.exp(0.022 * T_out + noise))
    assert "units of heat come from one of energy" in words


@pytest.mark.parametrize("tick_kWh", [0.001, 1.0])
def test_a_heat_meter_of_whole_kWh_is_of_no_other_unit(tick_kWh):
    """Its steps are told minutes after the boiler ran: by the quarter hour its ratio goes with load and weather."""
    record, rng = CLEAN.slice(0, 96 * 14), np.random.default_rng(5)
    hours, T_out = np.arange(record.n_steps) / 4.0, record.T_out_C[:-1]
    load_W = 250.0 * (20.0 - T_out) * (1.0 + 0.3 * np.sin(hours * np.pi / 12.0)) + rng.normal(0, 300, hours.size)
    heat_W = 1.9 * np.clip(load_W, 0.0, None) * (np.floor(hours * 1.5) % 2 == 0)
    told_kWh = np.floor(np.cumsum(heat_W) / 4000.0 / tick_kWh) * tick_kWh
    metered = replace(
        record,
        u=(heat_W / heat_W.max())[None],
        power_W=heat_W[None] / 0.9 + 20.0,
        heat_W=np.diff(told_kWh, prepend=0.0)[None] * 4000.0,
    )
    house = replace(LAYOUT, floor_area_m2=(150.0,))
    assert [one.words for one in remarks(metered, house) if one.kind == "unit of power"] == []


def test_three_days_of_a_heat_pump_in_even_weather_are_no_other_unit():
    """As three days of probing the embedded plant: the ratio hardly goes with 7 K of weather, and its days agree."""
    record = CLEAN.slice(0, 96 * 3)
    T_out = record.T_out_C[:-1]
    load = np.where(np.arange(record.n_steps) // 6 % 2, 1.0, 0.5)
    of_days = np.repeat([0.003, -0.006, 0.003], 96) * (T_out - T_out.mean())
    heat = 3.0 * 400.0 * load * np.exp(-0.004 * (T_out - T_out.mean()) + of_days)
    metered = replace(record, u=load[None], power_W=400.0 * load[None], heat_W=heat[None])
    assert not [one for one in remarks(metered, LAYOUT) if one.kind == "unit of power"]


def test_a_heat_pump_of_constant_power_is_no_other_unit():
    """Its ratio goes with the heat, which goes with the weather: at equal heat the weather does nothing more."""
    record = CLEAN.slice(0, 96 * 3)
    T_out = record.T_out_C[:-1]
    on = (np.arange(record.n_steps) // 4 % 2).astype(float)
    noise = np.random.default_rng(4).normal(0.0, 0.01, record.n_steps)
    heat_W = 1200.0 * on * (1.0 + 0.025 * (T_out - T_out.mean()) + noise)
    metered = replace(record, u=on[None], power_W=400.0 * on[None], heat_W=heat_W[None])
    assert not [one for one in remarks(metered, LAYOUT) if one.kind == "unit of power"]
    steady = replace(metered, heat_W=3.0 * metered.power_W * np.exp(noise))
    assert "too much for a boiler" in str(remarks(steady, LAYOUT))


@pytest.mark.parametrize(("starts", "doubted"), [(1, False), (8, True)])
def test_a_mild_day_with_one_start_tells_no_size(starts, doubted):
    """A heater of a generated house (140930:1) in a sunny week: 33 W but for a quarter of an hour."""
    idle = CLEAN.last(96)
    u, power = np.full((1, 96), 0.001), np.full((1, 96), 1.0)
    u[0, :starts], power[0, :starts] = 0.4, 28.0 if doubted else 400.0
    found = remarks(replace(idle, u=u, power_W=power, heat_W=_unknown(idle)), LAYOUT)
    assert ("unit of power" in [remark.kind for remark in found]) is doubted


def test_a_chiller_of_one_efficiency_is_no_boiler_in_other_units():
    """A steady 2.9 units of cold from one of energy in any weather; as heat of a machine that only heats a doubt."""
    cold_W = 0.8 * FULL_W * CLEAN.u * (1.0 + 0.2 * np.sin(np.arange(CLEAN.n_steps)))
    chiller = replace(CLEAN, power_W=cold_W / 2.86 + 2.0, heat_W=-cold_W)
    units = [remark for remark in remarks(chiller, LAYOUT) if remark.kind == "unit of power"]
    assert units == []
    assert "too much for a boiler" in str(remarks(replace(chiller, heat_W=cold_W), LAYOUT))
