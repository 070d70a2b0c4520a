"""Generated houses: the draw, the physics against hand calculations, and the plant behind the `Plant` protocol."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.plants import drawn_houses
from thermoforce_mpc.plants.drawn_houses import MASSES
from thermoforce_mpc.plants.people import HOUSEHOLDS, at_home
from thermoforce_mpc.plants.random_houses import (
    GeneratedHousePlant,
    draw_house,
    house_testcase,
    physics,
    with_sunlit_part,
)
from thermoforce_mpc.plants.random_houses.draw import MACHINES, heat_pump_cop
from thermoforce_mpc.plants.random_houses.plant import bounds_C, native_setpoint_C, year_of
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec

SEED = 7


def house_with(index: int = 0, **wanted):
    """The first drawn house with these values."""
    for i in range(index, 500):
        house = draw_house(SEED, i)
        if all(getattr(house, name) == value for name, value in wanted.items()):
            return house
    raise AssertionError(f"no house with {wanted}")


def unwritten(values: np.ndarray) -> np.ndarray:
    """Not to be written, as a plant's own years: numba compiles anew, for seconds, for an array that may be written."""
    values.setflags(write=False)
    return values


SILENT = unwritten(np.zeros(10))  # noise of the sensor


def still_grid(T_out: float = 0.0, gains: float = 0.0, ventilation: float = 50.0, sun_W: float = 0.0) -> np.ndarray:
    """A year without schedules at one outdoor temperature, and with one sun through the windows."""
    grid = np.zeros((35041, physics.N_COLUMNS))
    grid[:, physics.T_OUT], grid[:, physics.GAINS], grid[:, physics.VENTILATION] = T_out, gains, ventilation
    grid[:, physics.SUN_IN] = sun_W
    return unwritten(grid)


def run(house, u: float, hours: float, grid: np.ndarray, state: np.ndarray | None = None) -> np.ndarray:
    """Record of a constant level from 20 °C throughout, or from `state`, which is advanced."""
    if state is None:
        state = np.full(physics.N_STATES, 20.0)
        state[physics.INTEGRAL :] = 0.0
    rows = np.empty((round(hours * 120), len(physics.RECORD)))
    p = physics.parameters(house)
    physics.advance(state, 0.0, rows.shape[0], drawn_houses.STEP_S, u, grid, SILENT, p, rows)
    return rows


def column(rows: np.ndarray, name: str) -> np.ndarray:
    return rows[:, physics.RECORD.index(name)]


# --- draw -----------------------------------------------------------------------------------------------------------


def test_a_house_is_drawn_again_and_differs_by_seed_and_index():
    assert draw_house(3, 5) == draw_house(3, 5)
    assert len({draw_house(3, i).floor_area_m2 for i in range(5)} | {draw_house(4, 0).floor_area_m2}) == 6


@pytest.mark.parametrize(
    ("index", "area_m2"), [(6, 80.83903146197392), (62, 81.18651034816693), (67, 185.63663667160435)]
)
def test_a_house_is_the_same_to_the_last_bit_on_every_processor(index, area_m2):
    """With NumPy's exp and log these three differ where it uses AVX-512, and with them the content keys of runs."""
    assert draw_house(2026, index).floor_area_m2 == area_m2


def test_forty_houses_cover_every_class():
    houses = [draw_house(SEED, i) for i in range(40)]
    assert {h.mass for h in houses} == set(MASSES)
    assert {h.pattern for h in houses} == set(HOUSEHOLDS)
    assert {h.machine for h in houses} == set(MACHINES)
    assert {h.emitter for h in houses} == {"floor", "radiator", "air"}
    assert {h.resolution_K for h in houses} == {0.0, 0.1, 0.5}
    assert {h.heat_metered for h in houses} == {True, False}
    assert any(h.sizing < 0.95 for h in houses)
    assert any(h.sizing > 2.0 for h in houses)
    assert any(h.sun_bias_K for h in houses)
    assert not all(h.sun_bias_K for h in houses)


def test_loads_lie_where_tabula_has_them_and_floors_only_where_they_can_heat():
    houses = [draw_house(SEED, i) for i in range(200)]
    loss = np.array([h.loss_W_K / h.floor_area_m2 for h in houses])
    assert loss.min() > 0.35
    assert loss.max() < 4.0
    assert loss.min() < 0.8
    assert loss.max() > 2.2
    for h in houses:
        if h.emitter == "floor":
            assert h.loss_W_K * (20.0 - h.design_out_C) <= 70.0 * h.floor_area_m2
        assert h.capacity_W == pytest.approx(h.sizing * h.design_load_W)


def sunlit_house(kind: str, **wanted):
    """A drawn house whose floor, or glazing, the sun heats first."""
    houses = (with_sunlit_part(draw_house(SEED, i)) for i in range(200))
    return next(
        one for one in houses if one.sunlit.kind == kind and all(getattr(one, k) == v for k, v in wanted.items())
    )


def test_what_the_sun_heats_first_is_drawn_beside_a_house_and_changes_nothing_else_of_it():
    houses = [draw_house(SEED, i) for i in range(200)]
    lit = [with_sunlit_part(house) for house in houses]
    assert [replace(one, sunlit=None) for one in lit] == houses
    assert lit == [with_sunlit_part(house) for house in houses]
    skins = [one for one in lit if one.sunlit.kind == "double skin"]
    assert 70 < len(skins) < 130
    for one in skins:
        assert 0.5 * one.windows_W_K <= one.sunlit.through_W_K * (1 + 1e-9) <= 0.9 * one.windows_W_K * (1 + 2e-9)
        assert "two skins" in one.words
    assert all(one.sunlit.out_W_K == 0.0 and "floor in the sun" in one.words for one in lit if one not in skins)


# --- physics --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("emitter", ["floor", "radiator", "air"])
def test_the_energy_balance_closes(emitter):
    plant = GeneratedHousePlant(house_with(emitter=emitter))
    plant.reset(40 * DAY_S, 0.0)
    rng = np.random.default_rng(0)
    for _ in range(48):
        plant.advance(None if rng.uniform() < 0.3 else rng.uniform(), HOUR_S)
    r = plant.recorded(40 * DAY_S, 42 * DAY_S)
    stored = r["stored_J"][-1] - r["stored_J"][0]
    into = drawn_houses.STEP_S * (r["Q_machine"] + r["gain_W"] - r["loss_W"])[1:].sum()
    exchanged = drawn_houses.STEP_S * r["loss_W"][1:].sum()
    assert r["Q_machine"].max() > 0
    assert stored == pytest.approx(into, abs=1e-9 * exchanged)


@pytest.mark.parametrize("kind", ["floor", "double skin"])
def test_the_energy_balance_closes_where_the_sun_heats_a_part_first(kind):
    rows = run(sunlit_house(kind), 0.3, 6.0, still_grid(2.0, sun_W=2000.0))
    flows = column(rows, "Q_machine") + column(rows, "gain_W") - column(rows, "loss_W")
    stored = np.diff(column(rows, "stored_J"))
    np.testing.assert_allclose(stored, drawn_houses.STEP_S * flows[1:], atol=1e-9 * stored.size * 1e5)


@pytest.mark.parametrize("kind", ["floor", "double skin"])
def test_a_part_in_the_sun_takes_its_share_and_gives_it_to_what_it_touches(kind):
    lit = sunlit_house(kind)
    part, p, grid = lit.sunlit, physics.parameters(lit), still_grid(20.0, sun_W=3000.0)
    rise_K = []
    for part_C, sun in ((20.0, grid), (30.0, still_grid(20.0))):
        state = np.full(physics.N_STATES, 20.0)
        state[physics.INTEGRAL :], state[physics.SUNLIT] = 0.0, part_C
        rows = np.empty((1, len(physics.RECORD)))
        physics.advance(state, 0.0, 1, 1.0, 0.0, sun, SILENT, p, rows)
        rise_K.append(state - 20.0)
    assert rise_K[0][physics.SUNLIT] == pytest.approx(3000.0 * part.share / part.capacity_J_K, rel=0.02)
    radiant_W = 3000.0 * (1.0 - part.share)
    stored_W = p[physics.P_SURFACE_J] * rise_K[0][physics.SURFACE] + p[physics.P_MASS_J] * rise_K[0][physics.MASS]
    assert stored_W == pytest.approx(radiant_W, rel=0.02)
    given_W = 10.0 * np.array([part.air_W_K, part.surface_W_K, part.mass_W_K])
    capacity = p[[physics.P_AIR_J, physics.P_SURFACE_J, physics.P_MASS_J]]
    assert capacity * rise_K[1][[physics.AIR, physics.SURFACE, physics.MASS]] == pytest.approx(
        given_W, rel=0.03, abs=5.0
    )
    assert column(rows, "loss_W")[0] == pytest.approx(10.0 * part.out_W_K, rel=0.03, abs=5.0)


def test_a_double_skin_loses_what_the_windows_lost():
    skin = sunlit_house("double skin", emitter="air", mass="very light")
    with_it, without = (
        column(run(house, 0.3, 24 * 10, still_grid(5.0)), "T_operative")[-1]
        for house in (skin, replace(skin, sunlit=None))
    )
    assert with_it - 278.15 == pytest.approx(without - 278.15, rel=0.05)


@pytest.mark.slow
def test_steady_state_is_that_of_the_hand_calculation():
    # Convector: all heat to the air. Ventilation, and windows and structure in parallel behind the surface film.
    house = house_with(emitter="air", machine="electric")
    u, T_out, ventilation = 0.4, -3.0, 60.0
    rows = run(house, u, 24 * 60, still_grid(T_out, ventilation=ventilation))
    heat = u * house.capacity_W
    film = 3.45 * 4.5 * house.floor_area_m2
    fabric = house.windows_W_K + house.opaque_W_K
    air = T_out + heat / (ventilation + film * fabric / (film + fabric))
    surface = T_out + film / (film + fabric) * (air - T_out)
    assert column(rows, "T_operative")[-1] - 273.15 == pytest.approx(0.3 * air + 0.7 * surface, abs=1e-3)
    assert column(rows, "loss_W")[-1] == pytest.approx(heat, rel=1e-5)


def test_radiator_output_follows_en_442():
    house = house_with(emitter="radiator")
    p = physics.parameters(house)
    state = np.full(physics.N_STATES, 20.0)
    state[physics.INTEGRAL :], state[physics.WATER] = 0.0, 60.0
    # Within a step the water cools by its output: W ΔT^1.3 with ΔT of 40 K at the start, less what the surfaces warm.
    rows = np.empty((1, len(physics.RECORD)))
    physics.advance(state, 0.0, 1, 0.1, 0.0, still_grid(20.0), SILENT, p, rows)
    given = house.emitter_J_K * (60.0 - state[physics.WATER]) / 0.1
    assert given == pytest.approx(house.emitter_W_Kn * 40.0**1.3, rel=0.01)


def test_slow_time_constant_is_capacity_over_loss():
    house = house_with(emitter="air", mass="medium")
    rows = run(house, 0.0, 96, still_grid(0.0, ventilation=house.ventilation_W_K))
    T = column(rows, "T_operative") - 273.15
    tau_h = 48.0 / np.log(T[48 * 120 - 1] / T[-1])
    capacity = house.mass_J_K + 10e3 * house.floor_area_m2
    # The structure stands behind its film and the air runs ahead of it: 15 %.
    assert tau_h == pytest.approx(capacity / house.loss_W_K / 3600.0, rel=0.15)


def test_the_surfaces_take_time_to_follow_the_air():
    """Air 5 K above all else warms the surfaces by film over their first centimetre, taken from the structure."""
    house = house_with(emitter="air")
    p = physics.parameters(house)
    assert p[physics.P_SURFACE_J] + p[physics.P_MASS_J] == pytest.approx(house.mass_J_K)
    state = np.full(physics.N_STATES, 20.0)
    state[physics.INTEGRAL :], state[physics.AIR] = 0.0, 25.0
    rows = np.empty((1, len(physics.RECORD)))
    physics.advance(state, 0.0, 1, 1.0, 0.0, still_grid(20.0), SILENT, p, rows)
    assert state[physics.SURFACE] - 20.0 == pytest.approx(3.45 * 5.0 / 10e3, rel=0.01)


def test_air_leads_and_a_slab_lags():
    """After full level for 15 min an air-heated house is far ahead of a floor-heated one of the same load."""
    heated = {}
    for emitter in ("air", "floor"):
        house = house_with(emitter=emitter, mass="very light")
        rows = run(house, 1.0, 0.25, still_grid(0.0, ventilation=house.ventilation_W_K))
        idle = run(house, 0.0, 0.25, still_grid(0.0, ventilation=house.ventilation_W_K))
        heated[emitter] = column(rows, "T_operative")[-1] - column(idle, "T_operative")[-1]
    assert heated["air"] > 0.5
    assert 0.0 < heated["floor"] < 0.05


@pytest.mark.parametrize("emitter", ["floor", "radiator", "air"])
@pytest.mark.parametrize("machine", MACHINES)
def test_more_level_never_cools(emitter, machine):
    house = house_with(emitter=emitter, machine=machine)
    grid = still_grid(2.0, ventilation=house.ventilation_W_K)
    rng = np.random.default_rng(1)
    states = [np.full(physics.N_STATES, 20.0) for _ in range(2)]
    for state in states:
        state[physics.INTEGRAL :] = 0.0
    least = np.inf
    for _ in range(48):
        low = rng.uniform(0.0, 1.0)
        high = rng.uniform(low, 1.0)
        lower, higher = (run(house, u, 0.5, grid, state) for u, state in zip((low, high), states, strict=True))
        least = min(least, float((column(higher, "T_operative") - column(lower, "T_operative")).min()))
    assert least >= -1e-9
    assert column(higher, "T_operative")[-1] > column(lower, "T_operative")[-1]


def test_heat_pump_power_depends_on_lift_level_and_fixed_loss():
    fixed = house_with(machine="heat pump with fixed loss")
    p = physics.parameters(fixed)
    heat, power, _ = physics.machine(p, 1.0, 2.0, 35.0)
    assert power == pytest.approx(fixed.fixed_W + heat / heat_pump_cop(fixed.carnot, 2.0, 35.0 + fixed.spread_K / 2))
    # A colder outdoor or a warmer water costs more per heat, and colder air gives less heat.
    colder, warmer = physics.machine(p, 1.0, -8.0, 35.0), physics.machine(p, 1.0, 2.0, 45.0)
    assert colder[0] < heat
    assert colder[1] / colder[0] > power / heat
    assert warmer[0] == pytest.approx(heat)  # below the limit of the water temperature less 10 K
    assert warmer[1] > power
    # Half level costs more than half with a fixed loss; without one, less: the water is colder.
    assert physics.machine(p, 0.5, 2.0, 35.0)[1] > 0.5 * power + 0.4 * fixed.fixed_W
    plain = physics.parameters(replace(fixed, machine="heat pump", fixed_W=0.0))
    assert physics.machine(plain, 0.5, 2.0, 35.0)[1] < 0.5 * physics.machine(plain, 1.0, 2.0, 35.0)[1]


def test_the_cop_lies_where_data_sheets_have_it():
    assert 3.2 < heat_pump_cop(0.48, 2.0, 35.0) < heat_pump_cop(0.62, 2.0, 35.0) < 4.4
    assert 1.8 < heat_pump_cop(0.55, -7.0, 55.0) < 2.5
    assert heat_pump_cop(0.55, 30.0, 20.0) < 11.0


def test_below_its_lowest_level_a_machine_cycles():
    house = house_with(machine="boiler")
    p = physics.parameters(house)
    at_lowest = np.array(physics.machine(p, house.lowest_level, 5.0, 40.0))
    np.testing.assert_allclose(physics.machine(p, 0.5 * house.lowest_level, 5.0, 40.0), 0.5 * at_lowest)


def test_a_boiler_condenses_with_cold_return_water():
    house = house_with(machine="boiler", emitter="radiator")
    p = physics.parameters(house)
    (cold_heat, cold_gas, _), (hot_heat, hot_gas, _) = (physics.machine(p, 0.5, 5.0, water) for water in (30.0, 70.0))
    assert hot_heat / hot_gas == pytest.approx(house.efficiency)
    assert cold_heat / cold_gas > house.efficiency + 0.08


def test_the_machine_throttles_at_the_water_limit():
    house = house_with(machine="boiler", emitter="radiator")
    rows = run(replace(house, capacity_W=6 * house.capacity_W), 1.0, 24.0, still_grid(0.0))
    assert column(rows, "T_supply").max() - 273.15 < house.water_limit_C + house.spread_K
    assert column(rows, "Q_machine")[-1] < house.capacity_W * 6


# --- sensor and records ---------------------------------------------------------------------------------------------


def measured_K(house, hours: float = 12.0, u: float = 0.5) -> tuple[GeneratedHousePlant, dict[str, np.ndarray]]:
    plant = GeneratedHousePlant(house)
    plant.reset(100 * DAY_S, 0.0)
    for _ in range(round(4 * hours)):
        plant.advance(u, 900.0)
    return plant, plant.recorded(100 * DAY_S, 100 * DAY_S + hours * HOUR_S)


def test_the_sensor_changes_what_is_measured_and_not_what_is_judged():
    house = replace(draw_house(SEED, 0), noise_sd_K=0.0, resolution_K=0.0, lag_s=0.0, sun_bias_K=0.0)
    exact, truth = measured_K(house)
    np.testing.assert_allclose(truth["T_measured"], truth["T_operative"], atol=1e-9)
    for flaw, check in (
        ({"resolution_K": 0.5}, lambda T: np.abs((T - 273.15) % 0.5).max() < 1e-6),
        ({"noise_sd_K": 0.05}, lambda T: 0.04 < np.std(T - truth["T_measured"]) < 0.06),
        ({"sun_bias_K": 3.0, "sun_facade": "south"}, lambda T: 0.5 < (T - truth["T_measured"]).max() <= 3.0),
    ):
        plant, record = measured_K(replace(house, **flaw))
        assert check(record["T_measured"]), flaw
        assert record["T_operative"].tobytes() == truth["T_operative"].tobytes()
        assert plant.kpis() == exact.kpis()
        assert not np.array_equal(plant.past(900.0).T_zone_C, exact.past(900.0).T_zone_C)


def test_a_slow_sensor_lags_by_its_time_constant():
    house = replace(draw_house(SEED, 0), noise_sd_K=0.0, resolution_K=0.0, lag_s=600.0, sun_bias_K=0.0)
    _, record = measured_K(house, u=1.0)
    measured, true = record["T_measured"], record["T_operative"]
    approached = (1.0 - np.exp(-30.0 / 600.0)) * (true[1:] - measured[:-1])
    np.testing.assert_allclose(np.diff(measured), approached, atol=1e-9)
    assert abs(true - measured).max() > 0.05


@pytest.mark.parametrize("metered", [True, False])
def test_power_is_always_measured_and_heat_only_with_a_meter(metered):
    plant = GeneratedHousePlant(replace(draw_house(SEED, 0), heat_metered=metered))
    plant.reset(10 * DAY_S, DAY_S)
    m = plant.advance(1.0, 900.0)
    past = plant.past(900.0)
    assert m.power_W > 0
    assert m.u == 1.0
    assert np.isfinite(past.power_W).all()
    for value in (m.heat_W, m.T_return_C, past.heat_W, past.T_return_C):
        assert np.isfinite(value).all() == metered


# --- plant ----------------------------------------------------------------------------------------------------------


def test_it_is_a_plant_and_the_same_inputs_give_the_same_bytes():
    house = draw_house(SEED, 1)
    records = []
    for _ in range(2):
        plant = GeneratedHousePlant(house)
        assert isinstance(plant, Plant)
        start = plant.reset(20 * DAY_S, 2 * DAY_S)
        assert start.time_s == 20 * DAY_S
        for u in (None, 0.3, 1.0):
            plant.advance(u, 900.0)
        year_of.cache_clear()  # made anew, not taken over
        past = plant.past(900.0)
        assert past.n_steps == 2 * 96 + 3
        assert past.time_s[-1] == 20 * DAY_S + 2700.0
        np.testing.assert_allclose(past.u[0, -2:], [0.3, 1.0])
        records.append(past.T_zone_C.tobytes() + past.power_W.tobytes())
    assert records[0] == records[1]


def test_plants_of_one_house_share_a_year_that_none_can_change():
    first, second = (GeneratedHousePlant(draw_house(SEED, 1)) for _ in range(2))
    assert first.weather is second.weather
    _, grid, noise = year_of(first.house)
    assert all(kept is again for kept, again in zip((grid, noise), year_of(second.house)[1:], strict=True))
    for values in (grid, noise):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0


def test_steps_may_be_split():
    ends = []
    for parts in (1, 3):
        plant = GeneratedHousePlant(draw_house(SEED, 2))
        plant.reset(20 * DAY_S, 0.0)
        for _ in range(parts):
            plant.advance(0.5, 2700.0 / parts)
        ends.append(plant.recorded(0.0, 30 * DAY_S)["T_operative"])
    np.testing.assert_array_equal(*ends)


def test_kpis_are_those_of_the_record():
    house = draw_house(SEED, 3)
    plant = GeneratedHousePlant(house)
    assert plant.kpis()["cost_tot"] == 0.0
    plant.reset(20 * DAY_S, 5 * DAY_S)
    plant.advance(0.0, 1.5 * DAY_S)
    plant.advance(1.0, 0.5 * DAY_S)
    kpis, r = plant.kpis(), plant.recorded(20 * DAY_S, 22 * DAY_S)
    lower, _ = bounds_C(house, r["time"])
    cold = np.maximum(lower - (r["T_operative"] - 273.15), 0.0)
    assert kpis["tdis_tot"] == pytest.approx(np.trapezoid(cold, r["time"]) / 3600.0, rel=1e-6)
    assert kpis["tdis_tot"] > 1.0
    price = 0.07 if house.machine == "boiler" else 0.2535
    assert kpis["cost_tot"] == pytest.approx(kpis["ener_tot"] * price)
    assert plant.forecast(HOUR_S, 900.0).price_per_kWh[0].tolist() == [price] * 5


def test_weeks_are_the_coldest_and_a_sunny_one_with_heating():
    plant = GeneratedHousePlant(draw_house(SEED, 4))
    cold, sunny = plant.period("cold_week"), plant.period("sunny_week")
    assert cold.scored_s == sunny.scored_s == 7 * DAY_S

    def mean(period, name):
        days = period.start_s + np.arange(0, 7 * DAY_S, 900.0)
        return plant.weather.at(name, days).mean()

    assert mean(cold, "T_dry_C") < mean(sunny, "T_dry_C")
    assert mean(cold, "global_W_m2") < mean(sunny, "global_W_m2")
    assert plant.period("44").start_s == 44 * DAY_S
    # What `tf-mpc run` and `compare` take by default.
    assert (plant.period("peak_heat_day"), plant.period("typical_heat_day")) == (cold, sunny)
    with pytest.raises(InputError, match="cold_week"):
        plant.period("warm_week")


def test_wrong_inputs_are_refused():
    plant = GeneratedHousePlant(draw_house(SEED, 0))
    with pytest.raises(InputError, match="tariff 'free'"):
        plant.reset(0.0, 0.0, "free")
    with pytest.raises(InputError, match="level"):
        plant.advance(1.2, 900.0)


@pytest.mark.parametrize("machine", ["boiler", "electric"])
def test_native_control_holds_comfort_and_modulates_where_the_machine_does(machine):
    for i in range(500):
        house = draw_house(SEED, i)
        if house.machine == machine and house.sizing >= 1.0 and house.resolution_K < 0.5 and not house.sun_bias_K:
            break
    plant = GeneratedHousePlant(house)
    period = plant.period("cold_week")
    plant.reset(period.start_s, period.warmup_s)
    plant.advance(None, period.scored_s)
    level = plant.recorded(period.start_s, period.start_s + period.scored_s)["level"]
    assert plant.kpis()["tdis_tot"] < 2.0
    assert level.max() > 0
    between = (level > 0.02) & (level < 0.98)
    assert between.any() == (machine == "boiler")


def test_schedules():
    away = house_with(pattern="away")
    tuesday, saturday = 0.0, 4 * DAY_S
    hours = np.array([6.9, 7.0, 12.0, 20.0])
    assert at_home(away.pattern, tuesday + hours * HOUR_S).tolist() == [True, False, False, True]
    assert at_home(away.pattern, saturday + hours * HOUR_S).all()
    lower, upper = bounds_C(away, tuesday + hours * HOUR_S)
    assert (lower[1], upper[1]) == (15.0, 30.0)
    always = house_with(pattern="always")
    lower, upper = bounds_C(always, np.arange(0, 7 * DAY_S, 900.0))
    assert set(lower) == {always.lower_C}
    # The native set-point is up before people are home, and not set back where the machine could not recover.
    setpoint = native_setpoint_C(replace(away, sizing=2.0), tuesday + np.array([12.0, 19.9, 20.0]) * HOUR_S)
    assert setpoint[0] < setpoint[1] == setpoint[2]
    weak = native_setpoint_C(replace(away, sizing=0.8), tuesday + np.array([12.0, 20.0]) * HOUR_S)
    assert weak[0] == weak[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["generated:7:0", "house:2rooms:7"])
def test_a_forecast_beyond_new_year_has_the_presence_that_the_house_then_has(name):
    """Gains and native set-points repeat with the year; a year is no whole number of weeks."""
    plant, week_s = build_plant(PlantSpec(), load_testcase(name), 1), 8 * DAY_S
    plant.reset(0.0, 0.0)
    first = plant.forecast(week_s - 3600.0, 3600.0)
    plant.reset(364 * DAY_S, 0.0)
    later = plant.forecast(DAY_S + week_s - 3600.0, 3600.0)
    for had, has in ((first.lower_C, later.lower_C), (first.occupancy, later.occupancy)):
        np.testing.assert_array_equal(np.atleast_2d(has)[:, 24:], np.atleast_2d(had))


def test_the_test_case_has_no_defaults_and_the_house_s_own_thermostat():
    house = draw_house(SEED, 5)
    testcase = house_testcase(house)
    assert testcase.thermostat_C == pytest.approx(house.lower_C + 0.3)
    assert testcase.floor_area_m2 == house.floor_area_m2
    assert testcase.mode == "heating"
    assert not any((testcase.defaults.actuation, testcase.defaults.probing, testcase.defaults.identification))


def test_the_synthetic_year_can_be_warmer_and_clearer():
    plain, other = synthetic_weather(3), synthetic_weather(3, warmer_K=2.0, clearer=0.6)
    assert other.global_W_m2.mean() > 1.1 * plain.global_W_m2.mean()
    assert 1.5 < other.T_dry_C.mean() - plain.T_dry_C.mean() < 2.6
    assert synthetic_weather(3, warmer_K=0.0, clearer=0.0).fingerprint == plain.fingerprint
    assert other.name != plain.name


def test_a_house_is_found_by_the_name_of_its_test_case():
    testcase = load_testcase(f"generated:{SEED}:3")
    assert testcase == house_testcase(draw_house(SEED, 3))
    with build_plant(PlantSpec(), testcase, 1) as plant:
        assert plant.house == draw_house(SEED, 3)
    with pytest.raises(ConfigError, match="expected generated:SEED:INDEX"):
        load_testcase("generated:7")


@pytest.mark.parametrize("gas", [True, False], ids=["boiler", "electric"])
def test_the_tariff_prices_electricity_and_gas_costs_the_same_in_all(gas):
    house = next(h for h in (draw_house(SEED, i) for i in range(100)) if (h.machine == "boiler") == gas)
    plant = GeneratedHousePlant(house)
    costs = {}
    for price in ("constant", "dynamic", "highly_dynamic"):
        plant.reset(20 * DAY_S, DAY_S, price)
        ahead = plant.forecast(DAY_S, HOUR_S).price_per_kWh
        assert (np.ptp(ahead) > 0) == (price != "constant" and not gas)
        plant.advance(1.0, 8 * HOUR_S)  # from midnight: an hour of the day price
        costs[price] = plant.kpis()["cost_tot"]
    assert (costs["dynamic"] < costs["constant"]) == (not gas)
    assert len(set(costs.values())) == (1 if gas else 3)
