"""House of rooms as a plant: records, KPIs by room, forecasts, native control and refused inputs."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import DAY_S, HOUR_S, Names
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import GRID_S
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.plants.rooms import HouseOfRooms, draw_rooms, house_of_rooms, physics
from thermoforce_mpc.plants.rooms.plant import bounds_C, gains_W, in_use, native_setpoints_C, people, weather_grid
from thermoforce_mpc.protocols import Plant

SEED = 7
TUESDAY = 7 * DAY_S


def plant_at(day: float = 20.0, n: int = 3, warmup: float = 0.0, price: str = "constant") -> HouseOfRooms:
    plant = HouseOfRooms(draw_rooms(n, SEED))
    plant.reset(day * DAY_S, warmup * DAY_S, price)
    return plant


@pytest.mark.slow
def test_the_record_samples_temperatures_and_means_the_rest_at_any_step():
    plant = plant_at(warmup=1.0)
    rng = np.random.default_rng(0)
    applied = rng.uniform(size=(3, 6))
    for levels in applied.T:
        m = plant.advance(levels, 900.0)
    past = plant.past(900.0)
    assert past.names == m.names == Names(plant.zones, plant.actuators, ("heat_pump",))
    assert past.time_s.size == 96 + 6 + 1
    assert past.time_s[-1] == 20 * DAY_S + 5400.0
    assert past.T_zone_C.shape == (3, 103)
    assert past.u.shape == past.heat_W.shape == (3, 102)
    assert past.power_W.shape == (1, 102)
    np.testing.assert_allclose(past.u[:, -6:], applied)
    np.testing.assert_array_equal(past.T_zone_C[:, -1], m.T_zone_C)
    for name in ("u", "heat_W", "power_W"):
        np.testing.assert_allclose(getattr(past, name)[:, -1], getattr(m, name))
    # Coarser steps are means of finer ones; samples are picked.
    coarse = plant.past(1800.0)
    np.testing.assert_allclose(coarse.heat_W, past.heat_W.reshape(3, -1, 2).mean(axis=2))
    np.testing.assert_allclose(coarse.power_W, past.power_W.reshape(1, -1, 2).mean(axis=2))
    np.testing.assert_array_equal(coarse.T_zone_C, past.T_zone_C[:, ::2])
    assert plant.past(5 * DAY_S).u.shape == (3, 0)


def test_it_is_a_plant_whose_layout_says_what_each_valve_serves():
    plant = plant_at()
    assert isinstance(plant, Plant)
    layout = plant.layout
    assert [layout.actuators_of(z) for z in range(3)] == [[0], [1], [2]]
    assert layout.fed_by(0) == [0, 1, 2]
    assert layout.shares == pytest.approx(
        [room.emitter_W / plant.house.heat_pump.capacity_W for room in plant.house.rooms]
    )
    assert plant.forecast(HOUR_S, 900.0).names == layout.names


@pytest.mark.slow
def test_same_inputs_give_the_same_bytes_and_steps_may_be_split():
    ends = []
    for parts in (1, 3, 1):
        plant = plant_at(warmup=0.5)
        for _ in range(parts):
            plant.advance([0.5, None, None], 2700.0 / parts)
        ends.append(plant.past(900.0).T_zone_C.tobytes() + plant.past(900.0).heat_W.tobytes())
    assert ends[0] == ends[2]
    np.testing.assert_allclose(np.frombuffer(ends[0]), np.frombuffer(ends[1]), rtol=1e-9)


def test_a_snapshot_branches():
    plant = plant_at(warmup=0.5)
    here = plant.snapshot()
    first = plant.advance([1.0, 0.0, 0.0], HOUR_S)
    plant.restore(here)
    other = plant.advance([0.0, 0.0, 0.0], HOUR_S)
    assert other.time_s == first.time_s
    assert first.T_zone_C[0] > other.T_zone_C[0]
    plant.restore(here)
    again = plant.advance([1.0, 0.0, 0.0], HOUR_S)
    assert again.T_zone_C.tobytes() == first.T_zone_C.tobytes()
    assert plant.past(900.0).time_s.size == 48 + 4 + 1


def test_discomfort_is_by_room_and_the_total_is_the_mean_over_rooms():
    plant = plant_at(warmup=2.0)
    assert plant.kpis()["tdis_tot"] == 0.0
    plant.advance(np.zeros(3), 2 * DAY_S)
    plant.advance(np.ones(3), 0.5 * DAY_S)
    kpis = plant.kpis()
    rooms = zone_kpis(kpis)
    time_s, rows = plant.recorded(20 * DAY_S, 23 * DAY_S)
    lower, upper = bounds_C(plant.house, time_s)
    T = rows[:, physics.ROOMS : physics.ROOMS + 3].T
    expected = np.trapezoid(np.maximum(lower - T, 0) + np.maximum(T - upper, 0), time_s / HOUR_S)
    np.testing.assert_allclose(list(rooms.values()), expected)
    assert tuple(rooms) == plant.zones
    assert max(rooms.values()) > 1.0
    assert kpis["tdis_tot"] == pytest.approx(expected.mean())
    energy_kWh = np.trapezoid(rows[:, physics.POWER], time_s) / 3.6e6
    assert kpis["ener_tot"] == pytest.approx(energy_kWh / plant.house.floor_area_m2)
    assert kpis["cost_tot"] == pytest.approx(kpis["ener_tot"] * tariffs.CONSTANT)


def test_forecasts_have_a_row_for_each_room_and_the_tariff_asked_for():
    plant = plant_at(price="dynamic")
    ahead = plant.forecast(DAY_S, HOUR_S)
    assert ahead.time_s[0] == 20 * DAY_S
    assert ahead.lower_C.shape == ahead.upper_C.shape == ahead.occupancy.shape == (3, 25)
    assert ahead.T_out_C.shape == (25,)
    assert set(ahead.price_per_kWh[0]) == {tariffs.DYNAMIC_DAY, tariffs.DYNAMIC_NIGHT}
    plant.advance(np.zeros(3), DAY_S)
    assert plant.past(HOUR_S).T_out_C[1:] == pytest.approx(ahead.T_out_C[1:], abs=0.5)
    plant.advance(np.ones(3), DAY_S)
    time_s, rows = plant.recorded(20 * DAY_S, 22 * DAY_S)
    paid = np.trapezoid(rows[:, physics.POWER] * tariffs.dynamic(time_s), time_s) / 3.6e6
    assert plant.kpis()["cost_tot"] == pytest.approx(paid / plant.house.floor_area_m2)


def test_rooms_are_used_at_their_hours():
    house = draw_rooms(9, SEED)
    hours = np.arange(0.0, 24.0)
    time_s = TUESDAY + hours * HOUR_S
    kinds = {kind: set(hours[in_use(house, kind, time_s)]) for kind in ("living", "bath", "bedroom")}
    assert kinds["bath"] <= {6.0, 7.0, 8.0, 18.0, 19.0, 20.0, 21.0}
    assert {22.0, 23.0, 0.0, 5.0} <= kinds["bedroom"]
    assert not kinds["living"] & {22.0, 23.0, 0.0, 5.0}
    lower, upper = bounds_C(house, time_s)
    i = [room.kind for room in house.rooms].index("bath")
    assert (lower[i, 3], upper[i, 3]) == (15.0, 30.0)
    # Everybody is somewhere; by night in the bedrooms.
    there = people(house, time_s)
    assert set(np.round(there.sum(axis=0), 9)) <= {0.0, float(house.people)}
    assert there[:, 3].sum() == pytest.approx(there[[r.kind == "bedroom" for r in house.rooms], 3].sum())
    assert there[:, 3].sum() == house.people


def test_gains_are_people_and_appliances_that_vary_on_their_own_in_each_room():
    house = draw_rooms(5, SEED)
    time_s = TUESDAY + np.arange(0.0, 28 * DAY_S, 900.0)
    appliances = gains_W(house, time_s) - 80.0 * people(house, time_s)
    assert (appliances > 0).all()
    noise = np.log(appliances)
    noise -= np.array([[n[h::96].mean() for h in range(96)] for n in noise])[:, np.arange(time_s.size) % 96]
    apart = np.corrcoef(noise)
    assert np.abs(apart[np.triu_indices(5, 1)]).max() < 0.4


def test_native_set_points_are_back_up_before_a_room_is_used():
    house = next(h for h in (draw_rooms(5, s) for s in range(SEED, 99)) if h.sizing > 1.3)
    time_s = TUESDAY + np.arange(0.0, 7 * DAY_S, 900.0)
    setpoints = native_setpoints_C(house, time_s)
    lower, _ = bounds_C(house, time_s)
    for room, T, least in zip(house.rooms, setpoints, lower, strict=True):
        used = least == room.lower_C
        assert T[used].min() == T.max() == pytest.approx(room.lower_C + 0.4)
        assert T.min() == pytest.approx(T.max() - (1.0 if room.emitter == "floor" else 2.0)) or used.mean() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 8])
def test_native_control_keeps_rooms_near_their_bounds(n):
    plant = plant_at(n=n)
    period = plant.period("cold_week")
    plant.reset(period.start_s, period.warmup_s)
    plant.advance(None, period.scored_s)
    past = plant.past(HOUR_S)
    assert set(np.unique(plant.recorded(0.0, 99 * DAY_S)[1][:, physics.ROOMS + n : physics.ROOMS + 2 * n])) == {
        0.0,
        1.0,
    }
    assert past.T_zone_C.min() > 15.0
    assert past.T_zone_C.max() < 28.0
    assert plant.kpis()["tdis_tot"] < 5.0
    assert plant.kpis()["ener_tot"] > 0.1


def test_weeks_are_the_coldest_and_a_sunny_one():
    plant = plant_at()
    cold, sunny = plant.period("cold_week"), plant.period("sunny_week")
    assert cold.scored_s == sunny.scored_s == 7 * DAY_S

    def mean(period, name):
        return plant.weather.at(name, period.start_s + np.arange(0, 7 * DAY_S, 900.0)).mean()

    assert mean(cold, "T_dry_C") < mean(sunny, "T_dry_C")
    assert mean(cold, "global_W_m2") < mean(sunny, "global_W_m2")
    assert plant.period("44").start_s == 44 * DAY_S
    with pytest.raises(InputError, match="cold_week"):
        plant.period("warm_week")


def test_sun_reaches_a_room_through_its_own_facades():
    plant = house_of_rooms("house:5rooms")
    noon, day = 12 * 4, round(100 * DAY_S / GRID_S)
    sun = weather_grid(plant.house, plant.weather)[day : day + 96, physics.SUN : physics.SUN + len(plant.zones)]
    for room, light in zip(plant.house.rooms, sun.T, strict=True):
        south, _, north, _ = room.windows_m2
        assert light.max() < 1000.0 * sum(room.windows_m2) * plant.house.g_value
        assert (light[noon] / sum(room.windows_m2) > 100.0) == (south > north)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ([0.5, 1.2, 0.0], "level of 1.2 for 'bath_valve'"),
        ([0.5, -0.1, 0.0], "level of -0.1 for 'bath_valve'"),
        ([0.5, 0.1], "levels of 2 actuators: expected one for each of living_valve, bath_valve, bedroom_valve"),
    ],
)
def test_wrong_levels_are_refused_by_name(levels, message):
    plant = plant_at()
    assert plant.actuators == ("living_valve", "bath_valve", "bedroom_valve")
    with pytest.raises(InputError, match=message):
        plant.advance(levels, 900.0)
    assert plant.past(900.0).u.shape == (3, 0)


def test_other_wrong_inputs_are_refused():
    plant = plant_at()
    with pytest.raises(InputError, match="tariff 'flat'"):
        plant.reset(0.0, 0.0, "flat")
    with pytest.raises(InputError, match="step of 0"):
        plant.advance(None, 0.0)
    with pytest.raises(InputError, match="forecast"):
        plant.forecast(0.0, 900.0)
    with pytest.raises(InputError, match="history"):
        plant.past(0.0)


def test_one_thermostat_switches_all_circuits_by_its_room():
    plant = plant_at()
    plant.reference = "living"
    begin_s = plant.forecast(HOUR_S, HOUR_S).time_s[0]
    plant.advance(None, 2 * HOUR_S, (24.0,) * 3)
    warm = plant.advance(None, 900.0, (24.0,) * 3)
    cold = plant.advance(None, 900.0, (10.0,) * 3)
    assert (warm.u == 1.0).all()
    assert (cold.u == 0.0).all()
    plant.advance(None, DAY_S)
    _, rows = plant.recorded(begin_s, begin_s + 2.5 * HOUR_S + DAY_S)
    room_C, levels = rows[:, physics.ROOMS], rows[:, physics.ROOMS + 3 : physics.ROOMS + 6]
    assert (levels == levels[:, :1]).all()
    by_itself = slice(-round(DAY_S / 30.0), None)
    begins = np.flatnonzero(np.diff(levels[by_itself, 0]) > 0.0)
    assert begins.size > 1
    assert room_C[by_itself][begins].max() < plant.thermostat_C[0]
    with pytest.raises(InputError, match="the thermostat in living sets all rooms"):
        plant.advance(None, 900.0, (21.0, 22.0, 21.0))
    plant.reference = "cellar"
    with pytest.raises(InputError, match="there is no room 'cellar'; there are living, bath, bedroom"):
        plant.advance(None, 900.0)
