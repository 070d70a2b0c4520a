"""Records become runs of rooms: what drives them, what their neighbours read, and what is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from houses import House, make_pair, record

from thermoforce_mpc.data import Layout, Names, Record
from thermoforce_mpc.identification.network.building import BuildingFit, NetworkInputs, building_fit, room_run
from thermoforce_mpc.identification.network.estimate import RoomFit
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

HOUSE = House()
SINGLE = Layout.single(floor_area_m2=190.0)
# 10 kW at full level in any weather.
METERED = HeatInput(metered=MachineLoad((0.0, 0.0, 10000.0, 0.0), (-20.0, 20.0), 0.05))
TWO = Layout(
    Names(("bath", "hall"), ("radiator", "fan"), ("boiler", "chiller")),
    signs=(1, -1),
    home=(0, 1),
    machine_of=(0, 1),
    u_min=(0.0, 0.0),
    shares=(0.0, 0.0),
    floor_area_m2=(20.0, 30.0),
)


def acting(layout, *heat_inputs) -> NetworkInputs:
    """Actuators of which nothing else is unknown."""
    return NetworkInputs(layout, heat_inputs, [[] for _ in heat_inputs])


def of_two(days=1.0) -> Record:
    """A heated and a cooled room in one weather."""
    heated, cooled = record(HOUSE, days, 3600.0), record(replace(HOUSE, sign=-1), days, 3600.0, u=np.zeros(24) + 0.5)
    rows = {
        name: np.concatenate([getattr(r, name) for r in (heated, cooled)])
        for name in ("T_zone_C", "u", "heat_W", "power_W")
    }
    return Record(heated.time_s, T_out_C=heated.T_out_C, solar_W_m2=heated.solar_W_m2, names=TWO.names, **rows)


def test_a_run_has_the_weather_the_level_and_the_readings():
    history = record(HOUSE, 1.0, 3600.0)
    run = room_run(history, 0, acting(SINGLE, IDENTITY), 0.1)
    weather = weather_inputs(history.time_s, history.T_out_C, history.solar_W_m2)
    np.testing.assert_array_equal(run.inputs[:-1, : len(INPUTS)], weather)
    np.testing.assert_array_equal(run.inputs[:-1, -1], history.u[0])
    assert run.inputs.shape == (25, len(INPUTS) + 1)
    np.testing.assert_array_equal(run.readings, history.T_zone_C[0])
    assert run.step_h == 1.0
    assert run.rounding_K2 == pytest.approx(0.1**2 / 12.0)


def test_measured_heat_drives_where_there_is_some():
    history = record(HOUSE, 1.0, 3600.0)
    heat_W = np.array(history.heat_W)
    heat_W[0, 6:12] = np.nan
    drive = room_run(replace(history, heat_W=heat_W), 0, acting(SINGLE, METERED), 0.0).inputs[:-1, -1]
    known = np.isfinite(heat_W[0])
    np.testing.assert_allclose(drive[known], history.heat_W[0, known] / 10000.0, rtol=1e-9)
    np.testing.assert_allclose(drive[~known], history.u[0, ~known], rtol=1e-9)
    unmetered = room_run(history, 0, acting(SINGLE, IDENTITY), 0.0).inputs[:-1, -1]
    np.testing.assert_array_equal(unmetered, history.u[0])


def test_heat_of_cooling_drives_upwards():
    cooled = HeatInput(metered=METERED.metered)
    drive = room_run(of_two(), 1, acting(TWO, IDENTITY, cooled), 0.0).inputs[:-1, -1]
    np.testing.assert_allclose(drive, -of_two().heat_W[1] / 10000.0, rtol=1e-9)
    assert drive.min() > 0.0


def test_neighbours_are_means_of_their_readings_with_gaps_bridged():
    history = of_two()
    T_zone_C = np.array(history.T_zone_C)
    T_zone_C[1, 5] = np.nan
    run = room_run(replace(history, T_zone_C=T_zone_C), 0, acting(TWO, IDENTITY, IDENTITY), 0.0)
    neighbour = run.inputs[:-1, len(INPUTS)]
    bridged = T_zone_C[1].copy()
    bridged[5] = 0.5 * (bridged[4] + bridged[6])
    np.testing.assert_allclose(neighbour, 0.5 * (bridged[:-1] + bridged[1:]))
    assert run.inputs.shape[1] == len(INPUTS) + 2
    apart = replace(acting(TWO, IDENTITY, IDENTITY), across=False)
    assert room_run(history, 0, apart, 0.0).inputs.shape[1] == len(INPUTS) + 1


def test_a_pair_is_the_difference_of_its_runs():
    pair = make_pair(HOUSE, 3)
    run = room_run(pair.a, 0, acting(SINGLE, IDENTITY), 0.0, pair.b)
    assert run.pair
    assert not np.any(run.inputs[:, : len(INPUTS)])
    np.testing.assert_allclose(run.inputs[:-1, -1], pair.a.u[0] - pair.b.u[0])
    np.testing.assert_allclose(run.readings, pair.a.T_zone_C[0] - pair.b.T_zone_C[0])


@pytest.mark.slow
def test_rooms_know_their_heat_only_where_it_was_measured():
    runs = [room_run(of_two(), z, acting(TWO, METERED, IDENTITY), 0.0) for z in (0, 1)]
    fit = building_fit(acting(TWO, METERED, IDENTITY), [[run] for run in runs])
    assert fit.rooms[0].room.heat_W_m2[0] == pytest.approx(10000.0 / 20.0)
    assert np.isnan(fit.rooms[1].room.heat_W_m2[0])
    assert [room.room.neighbours for room in fit.rooms] == [1, 1]
    assert [room.room.signs for room in fit.rooms] == [(1,), (-1,)]


@pytest.mark.slow
def test_effects_across_rooms_go_by_their_sizes_where_no_area_is_known():
    """A small room's emitter gives little to a large one: the effects are those of rooms with areas in that ratio."""
    actuators = acting(TWO, IDENTITY, IDENTITY)
    known = building_fit(actuators, [[room_run(of_two(), z, actuators, 0.0)] for z in (0, 1)])
    unknown = replace(known, layout=replace(TWO, floor_area_m2=(np.nan, np.nan)))
    alike = unknown.responses
    sized = replace(unknown, sizes=np.array([0.8, 1.2])).responses
    np.testing.assert_allclose(sized, known.responses, rtol=1e-6)
    assert abs(alike[1, 0, -1]) > 1.2 * abs(sized[1, 0, -1])
    one_known = replace(known, layout=replace(TWO, floor_area_m2=(20.0, np.nan)), sizes=np.array([0.8, 1.2]))
    np.testing.assert_allclose(one_known.area_m2, (20.0, 24.0))


def test_what_two_do_together_is_surer_than_what_each_does():
    """Two rooms with one neighbour each, whose walls are not told apart from their own heat."""
    layout = replace(TWO, signs=(1, 1))
    building = of_two()
    warm = replace(building, u=np.abs(building.u), T_zone_C=np.repeat(building.T_zone_C[:1], 2, axis=0))
    actuators = acting(layout, IDENTITY, IDENTITY)
    rooms = [
        RoomFit(actuators.room(z), actuators.room(z).mean, 0.0, [room_run(warm, z, actuators, 0.0)]) for z in (0, 1)
    ]
    fit = BuildingFit(layout, tuple(rooms))
    whole_K, covariance = fit.together
    np.testing.assert_allclose(whole_K, fit.responses.sum(axis=1))
    apart = np.sqrt(np.diagonal(fit.covariance, axis1=-2, axis2=-1)).sum(axis=1)
    together = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    assert together.shape == apart.shape
    assert (together < apart).all()


def test_a_part_with_few_readings_says_nothing():
    history = record(HOUSE, 1.0, 3600.0)
    short = room_run(history.slice(0, 5), 0, acting(SINGLE, IDENTITY), 0.0)
    run = room_run(history, 0, acting(SINGLE, IDENTITY), 0.0)
    with_short, without = (building_fit(acting(SINGLE, IDENTITY), [runs]) for runs in ([run, short], [run]))
    np.testing.assert_array_equal(with_short.rooms[0].theta, without.rooms[0].theta)
