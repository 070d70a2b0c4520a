"""A sensor that reads its room late: found where it is, and plans mean the temperature of the room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import OptimizeResult
from simple_house import OutdoorResponse, SimpleHouse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.network import lag
from thermoforce_mpc.identification.network.estimate import RoomFit, RoomRun, posterior
from thermoforce_mpc.identification.network.lag import late_sensor, rooms_in_time
from thermoforce_mpc.identification.network.room import LAG, RoomNetwork
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.model.forced_state import heat_drive
from thermoforce_mpc.model.free_response.rc import INPUTS
from thermoforce_mpc.model.late_sensor import LateSensor, read_late
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.thermal_model import ThermalModel, load_model
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.plants.random_houses.plant import house_testcase
from thermoforce_mpc.plants.rooms import house_of_rooms

LATE = LateSensor(720.0, 60.0, 0.99)


HOUSE = draw_house(12101, 13)


def probed(lag_s: float) -> tuple[Record, Array]:
    """Three days of a house with radiators whose sensor lags, and the true temperature at their boundaries, °C."""
    plant = GeneratedHousePlant(replace(HOUSE, lag_s=lag_s))
    start_s = plant.period("cold_week").start_s - 10 * DAY_S
    record = probe(plant, start_s, 3.0, seed=1, layout=plant.testcase.layout)
    trace = plant.recorded(float(record.time_s[0]), float(record.time_s[-1]))
    return record, np.interp(record.time_s, trace["time"], trace["T_operative"]) - 273.15


def looked_for(record: Record, **options: bool) -> tuple[list[Record], list[Pair], dict[int, LateSensor]]:
    layout = house_testcase(HOUSE).layout
    pairs = [Pair(record, record)]
    return rooms_in_time([record], pairs, layout, [HeatInput()], IdentificationConfig(**options))


def error_K(record: Record, truth: Array) -> float:
    return float(np.std(record.T_zone_C[0] - truth))


@pytest.mark.slow
def test_a_late_sensor_is_found_and_the_room_is_read_in_time():
    record, truth = probed(654.0)
    (in_time,), (pair,), late = looked_for(record)
    assert late[0].lag_s == pytest.approx(654.0, abs=300.0)
    low_s, high_s = late[0].band_s
    assert low_s < 654.0 < high_s
    assert error_K(record, truth) > 0.2
    assert error_K(in_time, truth) < 0.5 * error_K(record, truth)
    np.testing.assert_array_equal(pair.a.T_zone_C, in_time.T_zone_C)
    assert looked_for(record, late_sensor=False)[2] == {}


@pytest.mark.slow
def test_a_sensor_that_is_not_late_is_left_as_it_is():
    record, _ = probed(0.0)
    (same,), _, late = looked_for(record)
    assert late == {}
    assert same is record


@pytest.mark.slow
def test_a_model_keeps_what_it_found_and_reads_records_by_it(tmp_path):
    record, truth = probed(654.0)
    layout = house_testcase(HOUSE).layout
    model = identify(record, layout=layout, config=IdentificationConfig(modulation="linear"))
    (late,) = model.late_sensors
    assert late is not None
    assert late.in_words() in model.claims
    assert late.in_words() in model.only.card.notes
    assert error_K(model.in_rooms(record), truth) < 0.5 * error_K(record, truth)
    assert load_model(model.save(tmp_path / "model")).late_sensors == (late,)


@pytest.mark.parametrize("options", [{}, {"heat_input": "identity"}, {"cross_effects": False}])
def test_rooms_beside_each_other_are_not_asked_for_late_sensors(monkeypatch, options):
    """Their ideal sensors passed for late ones."""
    house, asked = house_of_rooms("house:3rooms:8813"), []
    house.reset(10 * DAY_S, DAY_S)
    for u in (1.0, 0.0, 1.0, 1.0):
        house.advance((u, 0.0, u), 900.0)
    record = house.past(900.0).last(4)
    monkeypatch.setattr(lag, "late_sensor", lambda room, runs: asked.append(room))
    config = IdentificationConfig(**options)
    (same,), _, late = rooms_in_time([record], [], house.layout, [HeatInput()] * 3, config)
    assert (asked, late) == ([], {})
    assert same is record
    alone = record.part(0, [0], [0])
    rooms_in_time([alone], [], house_testcase(HOUSE).layout, [HeatInput()], config)
    assert len(asked) == 1, "one room is asked"


@pytest.mark.parametrize("lag_h", [None, 0.3])
def test_slopes_of_the_posterior_with_a_late_sensor(lag_h):
    room, rng = RoomNetwork(late=True, lag_h=lag_h), np.random.default_rng(0)
    runs = [
        RoomRun(3.0 * rng.normal(size=(30, room.n_inputs)), level + 0.2 * rng.normal(size=30), 0.25, pair=pair)
        for level, pair in ((20.0, False), (0.0, True))
    ]
    theta = room.mean + 0.3 * rng.normal(size=room.mean.size)
    found = posterior(room, theta, runs)[1]
    steps = 1e-5 * np.eye(theta.size)
    expected = [
        (posterior(room, theta + step, runs)[0] - posterior(room, theta - step, runs)[0]) / 2e-5 for step in steps
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("lag_s", [240.0, 600.0])
def test_what_is_read_late_is_that_of_short_steps(lag_s):
    step_s, tau_s, gains = 900.0, np.array([240.0, 40_000.0]), np.array([1.0, 5.0])
    poles, u = np.exp(-step_s / tau_s), np.random.default_rng(0).random(8)
    fine_s, read, state = 1.0, [0.0], np.zeros(3)
    forced = [np.zeros(2)]
    system = np.zeros((4, 4))  # d(F, read, u)/dt; u stays
    system[:2, :2], system[:2, 3] = np.diag(-1.0 / tau_s), gains / tau_s
    system[2, :3] = [1.0 / lag_s, 1.0 / lag_s, -1.0 / lag_s]
    step = (
        np.eye(4) + system * fine_s + system @ system * (0.5 * fine_s**2) + system @ system @ system * (fine_s**3 / 6)
    )
    for level in u:
        state = (np.linalg.matrix_power(step, round(step_s / fine_s)) @ [*state, level])[:3]
        forced.append(state[:2])
        read.append(state[2])
    np.testing.assert_allclose(read_late(np.array(forced), poles, step_s, lag_s), read, atol=1e-8)


def switched(lag_min: float, days: int) -> RoomRun:
    """A room with a quick emitter by minutes, kept within 0.3 K of 21 °C by switching, as a record of quarter hours."""
    from scipy.linalg import expm

    room, rng = RoomNetwork(late=True), np.random.default_rng(0)
    theta, n, minutes, minute_h = room.mean.copy(), room.n_states, days * 1440, 1.0 / 60.0
    theta[[room.place[name] for name in ("heat_0", "C_emitter_0")]] += (1.0, -1.5)
    theta[room.place[LAG]] = np.log(lag_min / 60.0)
    held = np.zeros((2 * n, 2 * n))
    matrix = room.equations(theta).matrix
    held[:n, :n], held[:n, n:] = minute_h * matrix[:, :n], np.eye(n)
    held = expm(held)
    A, B = held[:n, :n], minute_h * held[:n, n:] @ matrix[:, n:]
    inputs, read_C, x, on = np.zeros((minutes, room.n_inputs)), np.full(minutes + 1, 20.0), np.zeros(n), False
    inputs[:, INPUTS.index("outdoor")] = 3.0 * np.sin(2.0 * np.pi * np.arange(minutes) / 1440)
    inputs[:, INPUTS.index("constant")] = 1.0
    x[[0, 1, 2, 3, room.seen]] = 20.0
    for k in range(minutes):
        on = read_C[k] < 21.3 and (on or read_C[k] < 20.7)
        inputs[k, room.drive(0)] = on
        x = A @ x + B @ inputs[k]
        x[0] += 0.02 * np.sqrt(minute_h) * rng.normal()
        read_C[k + 1] = x[room.seen]
    means = inputs.reshape(-1, 15, room.n_inputs).mean(axis=1)
    readings = read_C[::15] + 0.005 * rng.normal(size=minutes // 15 + 1)
    return RoomRun(np.concatenate([means, means[-1:]]), readings, 0.25)


def test_where_in_its_step_a_machine_ran_is_no_late_sensor():
    """By means of steps alone an ideal sensor was late with log odds of 7.7."""
    assert late_sensor(RoomNetwork(), [switched(0.05, days=2)]) is None


def test_a_machine_that_switches_is_placed_in_parts_of_its_step(monkeypatch):
    """Steps of 15 min: on for the last 4.5 min of the second, off after 10.5 min of the fourth; likewise of 5 min."""
    room, runs = RoomNetwork(), []

    def estimated(room: RoomNetwork, given: list[RoomRun], most_starts: int | None = None) -> RoomFit:
        return RoomFit(room, room.mean, 0.0, given)

    def searched(room: RoomNetwork, given: list[RoomRun], start: Array) -> OptimizeResult:
        runs.extend(given)
        return OptimizeResult(x=start, fun=-20.0 * room.late - (len(given[0].readings) > 6))

    monkeypatch.setattr(lag, "estimate_room", estimated)
    monkeypatch.setattr(lag, "searched", searched)
    inputs = np.zeros((6, room.n_inputs))
    inputs[:, room.drive(0)] = 0.0, 0.3, 1.0, 0.7, 0.0, 0.0
    for step_h in (0.25, 1.0 / 12.0):
        late_sensor(room, [RoomRun(inputs, np.full(6, 20.0), step_h)])
    quarters, halves = (
        next(run for run in runs if run.step_h == step_h and len(run.readings) > 6) for step_h in (0.0625, 1.0 / 24.0)
    )
    for run, levels in (
        (quarters, [0, 0, 0, 0, 0, 0, 0.2, 1, 1, 1, 1, 1, 1, 1, 0.8, 0, 0, 0, 0, 0, 0]),
        (halves, [0, 0, 0, 0.6, 1, 1, 1, 0.4, 0, 0, 0]),
    ):
        np.testing.assert_allclose(run.inputs[:, room.drive(0)], levels, atol=1e-12)
        assert np.isfinite(run.readings).sum() == 6


def test_a_record_of_a_machine_that_switches_weighs_no_more_than_some_days(monkeypatch):
    """Twelve days, of which levels that are held say that the sensor is late, and switched ones do so more."""
    weights, room = [], RoomNetwork()

    def searched(room: RoomNetwork, runs: list[RoomRun], start: Array) -> OptimizeResult:
        if len(runs[0].readings) > 97:
            weights.append({run.weight for run in runs})
        return OptimizeResult(x=start, fun=-20.0 * room.late - (len(runs[0].readings) > 97))

    def estimated(room: RoomNetwork, runs: list[RoomRun], most_starts: int | None = None) -> RoomFit:
        return RoomFit(room, room.mean, float(searched(room, runs, np.zeros(room.mean.size)).fun), runs)

    monkeypatch.setattr(lag, "searched", searched)
    monkeypatch.setattr(lag, "estimate_room", estimated)
    day = switched(0.05, days=1)
    found = late_sensor(room, [day] * 12)
    assert found is not None
    assert weights[0] == {1.0}, "what explains the record better is judged by all of it"
    assert set().union(*weights[1:]) == {5.0 / 12.0}
    assert late_sensor(room, [replace(day, step_h=0.5)] * 12) is None, "a lag of less than where heat came is known to"


@pytest.mark.parametrize(
    ("likely_min", "nats", "days", "weight", "band_min"),
    [
        ((20.0,), 20.0, 3, 0.5, (11.3, 27.7)),
        ((20.0,), 20.0, 20, 0.125, (11.3, 27.7)),
        ((20.0,), 0.0, 3, 0.5, (3.8, 26.0)),
        ((6.0, 24.0), 20.0, 3, 0.5, (3.4, 28.6)),
    ],
)
def test_how_late_a_sensor_is_said_to_be(monkeypatch, likely_min, nats, days, weight, band_min):
    """One likely lag; none, so that the prior is left; two, of which the search for the best ends at one."""
    weights, room = set(), RoomNetwork()

    def searched(room: RoomNetwork, runs: list[RoomRun], start: Array) -> OptimizeResult:
        if room.lag_h is None:
            return OptimizeResult(x=start, fun=-20.0 * room.late)
        weights.add(runs[0].weight)
        away = min(abs(np.log(60.0 * room.lag_h / one)) for one in likely_min)
        return OptimizeResult(x=start, fun=0.5 * nats * away**2)

    def estimated(room: RoomNetwork, runs: list[RoomRun], most_starts: int | None = None) -> RoomFit:
        return RoomFit(room, room.mean, 0.0, runs)

    monkeypatch.setattr(lag, "searched", searched)
    monkeypatch.setattr(lag, "estimate_room", estimated)
    steady = RoomRun(np.zeros((days * 96 + 1, room.n_inputs)), np.full(days * 96 + 1, 20.0), 0.25)
    fit, late = late_sensor(room, [steady])
    assert fit.room.lag_h == pytest.approx(late.lag_s / HOUR_S)
    assert weights == {weight, 1.0}, "how late it is goes by a part of the record, the room's temperature by all"
    low, high = (time_s / 60.0 for time_s in late.band_s)
    assert low == pytest.approx(band_min[0], rel=0.15)
    assert high == pytest.approx(band_min[1], rel=0.15)
    assert f"{late.lag_s / 60.0:.0f} min late ({low:.0f} to {high:.0f} in 90 %" in late.in_words()


def late_model() -> ThermalModel:
    model = simple_model()
    return replace(model, cards=(replace(model.cards[0], late_sensor=LATE),))


def test_a_controller_plans_from_the_room():
    house, plans = SimpleHouse(), []
    house.reset(10 * DAY_S, 24 * HOUR_S)
    history = house.past(HOUR_S)
    u = np.zeros_like(history.u)
    u[:, -1] = 1.0
    history = replace(history, u=u)
    for model in (simple_model(), late_model()):
        mpc = ThermoForceMPC(model, MPCConfig(step_s=None), free_response=OutdoorResponse())
        plans.append(mpc.plan(Observation(history, house.forecast(mpc.horizon_s, HOUR_S))))
    missed = late_model().in_rooms(history).T_zone_C[0] - history.T_zone_C[0]
    assert missed[-1] > 0.01
    assert plans[1].T_free_now_C[0] - plans[0].T_free_now_C[0] == pytest.approx(missed[-1])


@pytest.mark.parametrize("wrong", [(0.0, 60.0, 0.99), (np.nan, 60.0, 0.99), (600.0, -1.0, 0.99), (600.0, 60.0, 1.5)])
def test_times_that_are_none_are_refused(wrong):
    with pytest.raises(DataError, match="late sensor: lag_s"):
        LateSensor(*wrong)


def test_gaps_of_readings_stay_and_rest_is_read_as_it_is():
    house = SimpleHouse()
    house.reset(10 * DAY_S, 24 * HOUR_S)
    history = house.past(HOUR_S)
    T = np.array(history.T_zone_C)
    T[0, 3] = np.nan
    history = replace(history, T_zone_C=T, u=np.full_like(history.u, 0.4))
    np.testing.assert_allclose(late_model().in_rooms(history).T_zone_C, T, atol=1e-9)
    empty = history.slice(0, 0)
    assert late_model().in_rooms(empty) is empty


def test_a_late_sensor_that_was_replaced_is_not_taken_for_late_any_more():
    """Days of a room that is heated by the hour: read late until the end of the third, in time from then on."""
    model, rng = late_model(), np.random.default_rng(3)
    time_s = 900.0 * np.arange(8 * 96 + 1)
    u = np.repeat(rng.random(8 * 24) < 0.5, 4).astype(float)
    nothing = np.full(u.size, np.nan)
    still = Record(time_s, np.zeros(time_s.size), np.full(time_s.size, 5.0), 0.0 * time_s, u, nothing, nothing)
    operator = model.operator.resampled(900.0)
    heat = heat_drive(operator, still, 0, u.size)
    start = operator.steady_gains_K * heat[:, :96].mean(axis=1)[:, None]
    forced_K = np.concatenate([start[:, :, None], operator.driven(start, heat)], axis=2).sum(axis=(0, 1, 3))
    room_C = 20.0 + np.sin(time_s / DAY_S) + forced_K
    missed_K = model.late_readings(still).in_time().T_zone_C[0]
    noise_K = 0.01 * rng.standard_normal(time_s.size)
    read_C = np.where(time_s < 3 * DAY_S, room_C - missed_K, room_C) + noise_K
    record = replace(still, T_zone_C=read_C[None])
    np.testing.assert_allclose(
        model.late_readings(record.slice(0, 3 * 96 - 1)).in_time().T_zone_C[0], (room_C + noise_K)[: 3 * 96]
    )
    np.testing.assert_allclose(model.late_readings(record).in_time().T_zone_C[0], read_C)
    parts = [record.slice(0, n) for n in range(3 * 96, 8 * 96, 12)]
    late = [part.n_steps for part in parts if (model.late_readings(part).in_time().T_zone_C != part.T_zone_C).any()]
    assert 3 * 96 < late[-1] < 7 * 96
    told = [model.late_readings(record.slice(0, n + 1)).news(first=False) for n in range(late[-1], late[-1] + 12)]
    assert list(filter(None, told)) == ["the zone sensor reads the room in time: nothing is added to its readings"]
    assert model.late_readings(record).news(first=False) == ""
    assert model.late_readings(record).news(first=True) in told, "a run that begins then"
    assert model.late_readings(parts[0]).news(first=True) == ""
