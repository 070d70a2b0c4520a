"""What plans would have saved: the identified house lived through its record again, against the house itself."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from home_by_curve import SG_RULES, START, HomeByCurve, curve_model
from simple_house import GAIN_K, POLE, OutdoorResponse, outdoor_C, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.commands.costs import meters_of
from thermoforce_mpc.cli import cli
from thermoforce_mpc.commands.contacts import SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset
from thermoforce_mpc.commands.loop import LearnedCommand, LoopMap
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Block, Boundary, Names, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.experiment.worth import planned_share, who_acted, worth
from thermoforce_mpc.loop.closed_loop import StepRecord
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.model.card import Competence, ModelCard
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.identified_house import IdentifiedHouse

_ORIGIN = pd.Timestamp("2026-01-01", tz="UTC")
_DAYS, _FIRST = 14, 10 * 24
_HOURS = _DAYS * 24


def _run(u: Array) -> Record:
    """The simple house under `u` (hours,), whose power follows its level."""
    T, time_s = np.full(u.size + 1, 20.0), np.arange(u.size + 1) * HOUR_S
    for k, level in enumerate(u):
        T[k + 1] = POLE * T[k] + (1 - POLE) * float(outdoor_C(time_s[k])) + GAIN_K * level
    power = 1600.0 * (u > 0) + 2700.0 * u
    return Record(time_s, T, outdoor_C(time_s), 0 * time_s, u, power, np.full_like(u, np.nan), origin=_ORIGIN)


def _levels(seed: int) -> Array:
    return np.random.default_rng(seed).choice([0.0, 1.0], _HOURS)


def _model(sd: float) -> ThermalModel:
    steady = GAIN_K / (1 - POLE)
    known = {f"step_response_{h}h_K": steady * (1 - POLE**h) for h in (1, 2, 4, 8, 12, 24, 48)}
    known |= {name.replace("h_K", "h_sd_K"): sd * value for name, value in known.items()}
    return replace(simple_model(), cards=(ModelCard("exact", uncertainty=known),))


def _conditions(record: Record, lower_C: float = 5.0) -> Boundary:
    """Dear from 6 to 22 h."""
    n = record.time_s.size
    hour = record.time_s % DAY_S / HOUR_S
    price = np.where((hour >= 6) & (hour < 22), 0.4, 0.1)
    return Boundary(
        record.time_s, record.T_out_C, record.solar_W_m2, np.zeros(n), np.full(n, lower_C), np.full(n, 60.0), price,
        np.zeros(n),
    )  # fmt: skip


class _Nightly:
    """Heats at night alone."""

    name, step_s, horizon_s = "nightly", HOUR_S, 6 * HOUR_S

    def plan(self, observation: Observation, state: object = None) -> Plan:
        hour = observation.time_s % DAY_S / HOUR_S
        level = 0.0 if 6 <= hour < 22 else 1.0
        return Plan((Block((level,), HOUR_S),), PlanStatus.SOLVED, "by night")


def _nightly(u: Array) -> Array:
    hour = np.arange(_HOURS) % 24
    other = u.copy()
    other[_FIRST:] = np.where((hour >= 6) & (hour < 22), 0.0, 1.0)[_FIRST:]
    return other


def _house(record: Record) -> IdentifiedHouse:
    return IdentifiedHouse(_model(0.1), record, _conditions(record))


def test_left_alone_it_is_the_record_and_under_other_levels_the_other_house() -> None:
    u = _levels(1)
    record, other = _run(u), _run(_nightly(u))
    house = _house(record)
    house.reset(_FIRST * HOUR_S, 0.0)
    for _ in range(24):
        house.advance(None, HOUR_S)
    np.testing.assert_allclose(house.lived(0.0).T_zone_C, record.T_zone_C[:, : _FIRST + 25], atol=1e-9)
    np.testing.assert_allclose(house.past(HOUR_S).power_W, record.power_W[:, : _FIRST + 24])
    house.reset(_FIRST * HOUR_S, 0.0)
    for k in range(48):
        level = float(other.u[0, _FIRST + k])
        house.advance(level, HOUR_S / 4)  # parts of a step are one step
        done = house.advance(level, 3 * HOUR_S / 4)
        assert done.T_zone_C[0] == pytest.approx(other.T_zone_C[0, _FIRST + k + 1], abs=1e-6)
    np.testing.assert_allclose(house.lived(_FIRST * HOUR_S).u, other.u[:, _FIRST : _FIRST + 48])
    assert house.past(HOUR_S).time_s[-1] == (_FIRST + 48) * HOUR_S


def test_a_level_gives_less_to_a_room_that_is_warmer_than_it_was() -> None:
    record = _run(_levels(1))
    rooms = []
    for less_per_K in (0.0, 0.1):
        house = IdentifiedHouse(_model(0.1), record, _conditions(record), less_per_K=np.array([less_per_K]))
        house.reset(_FIRST * HOUR_S, 0.0)
        house.advance(None, 12 * HOUR_S)
        np.testing.assert_allclose(house.lived(0.0).T_zone_C, record.T_zone_C[:, : _FIRST + 13], atol=1e-9)
        for _ in range(24):
            house.advance(1.0, HOUR_S)
        rooms.append(house.lived(0.0).T_zone_C[0] - record.T_zone_C[0, : _FIRST + 37])
    always, falling = rooms
    step = always[_FIRST + 13 :] - POLE * always[_FIRST + 12 : -1]  # what other levels brought in each hour
    level = 1.0 - record.u[0, _FIRST + 12 : _FIRST + 36]
    np.testing.assert_allclose(step, GAIN_K * level, atol=1e-6)
    less = falling[_FIRST + 13 :] - POLE * falling[_FIRST + 12 : -1]
    np.testing.assert_allclose(less, GAIN_K * (level - 0.1 * falling[_FIRST + 12 : -1]), atol=1e-6)


# Temperatures of the room, °C, and how far its valve is open there.
_VALVE = np.array([16.0, 26.0]), np.array([1.0, 0.1])


def _of_water() -> LearnedCommand:
    """Water of a curve that keeps half of what it was each hour, and a valve that is shut where the room is warm."""
    nothing, kelvins = np.zeros(2), np.array([-3.0, 3.0])
    loop = LoopMap(
        0.5, kelvins, kelvins, 0.0, 0.0, kelvins, np.array([0.0, 0.6]), nothing, nothing, 0.1, 0.9, 30.0,
        *_VALVE, of_water=True,
    )  # fmt: skip
    return LearnedCommand(CurveOffset(kind="curve_offset", column="x"), loop, 0.0, 0.0, np.zeros(7 * 24), 0.0)


def test_the_water_behind_a_valve_that_is_nearly_shut_is_remembered() -> None:
    """It is x that a loop goes on from, and not the level; in parts of a step, and where another house goes on."""
    record = _run(_levels(1))
    begin, loops = _FIRST + 12, {record.names.actuators[0]: _of_water()}
    shut = IdentifiedHouse(_model(0.1), record, _conditions(record), commands=loops)
    # Of the hour before, an open valve shows its water; behind a shut one it is what the usual command brings.
    T, x, expected = record.T_zone_C[0, begin], record.u[0, begin - 1] or 0.3 / 0.5, []
    offsets = np.where(np.arange(24) < 12, 3.0, -2.0)
    for k, offset in enumerate(offsets):
        x = min(0.5 * x + 0.3 + 0.1 * offset, 1.0)
        expected.append(x * np.interp(T, *_VALVE))
        T = POLE * T + (1 - POLE) * record.T_out_C[begin + k] + GAIN_K * expected[-1]
    assert np.interp(T, *_VALVE) < 0.7, "levels that are not what the water is"
    shut.reset(begin * HOUR_S, 0.0)
    for offset in offsets[:14]:
        shut.advance(None, HOUR_S / 4, (offset,))
        shut.advance(None, 3 * HOUR_S / 4, (offset,))
    later = IdentifiedHouse(_model(0.1), record, _conditions(record), commands=loops, before=shut.state)
    later.reset((begin + 14) * HOUR_S, 0.0)
    for offset in offsets[14:]:
        later.advance(None, HOUR_S, (offset,))
    np.testing.assert_allclose(later.lived(begin * HOUR_S).u[0], expected, atol=5e-3)


def test_it_ends_with_its_record_and_knows_no_other_command() -> None:
    house = _house(_run(_levels(1)))
    with pytest.raises(InputError, match="no boundary of the record"):
        house.reset(1800.0, 0.0)
    house.reset(_HOURS * HOUR_S - HOUR_S, 0.0)
    assert house.forecast(6 * HOUR_S, HOUR_S).n_steps == 1
    with pytest.raises(InputError, match="the record ends"):
        house.advance(1.0, 2 * HOUR_S)
    with pytest.raises(InputError, match="it has none"):
        house.advance(1.0, HOUR_S, (21.0,))


@pytest.mark.slow
def test_what_plans_would_have_saved_is_what_they_save_in_the_house() -> None:
    u = _levels(2)
    record, other = _run(u), _run(_nightly(u))
    conditions = _conditions(record)
    said: list[str] = []
    asked = {"start_s": _FIRST * HOUR_S, "days": 4.0, "draws": 3, "seed": 1}
    found = worth(_model(0.1), record, conditions, _Nightly(), **asked, progress=said.append)
    assert [line.split(",")[0] for line in said if " again" not in line] == [f"house {k} of 4" for k in (1, 2, 3, 4)]
    assert said[-1].endswith(f"over 4 days with a plan every 1 h; house 3 saves {found.draws[1]:.2f}")
    np.testing.assert_allclose(found.planned.T_zone_C, other.T_zone_C[:, _FIRST:], atol=1e-6)
    np.testing.assert_allclose(found.as_was.T_zone_C, record.T_zone_C[:, _FIRST:], atol=1e-9)
    kWh = [(run.power_W[0, _FIRST:] / 1000.0) for run in (record, other)]
    price = conditions.price_per_kWh[0, _FIRST:-1]
    assert found.cost_was == pytest.approx(float(kWh[0] @ price))
    assert found.energy_was_kWh == pytest.approx(float(kWh[0].sum()))
    # What is stored at the end counts, so that heating less is not a saving by itself.
    stored = found.saved - float((kWh[0] - kWh[1]) @ price)
    assert found.stored == pytest.approx(stored)
    assert np.sign(stored) == np.sign(found.planned.T_zone_C[0, -1] - found.as_was.T_zone_C[0, -1])
    assert found.low < found.saved < found.high
    assert found.acted == {"actuator": {"plans": 1.0}}
    frame = found.to_dataframe()
    assert list(frame) == [
        "u_was", "T_zone_C_was", "power_W_was", "u_planned", "T_zone_C_planned", "power_W_planned", "price_per_kWh",
    ]  # fmt: skip
    assert len(frame) == 96
    # Prices that end with the record are enough.
    ending = conditions.price_per_kWh.copy()
    ending[:, -1] = np.nan
    conditions = replace(conditions, price_per_kWh=ending)
    again = worth(_model(0.1), record, conditions, _Nightly(), **asked)
    assert again.draws == found.draws
    # Of what costs more the band has the sign of the sentence.
    dearer = replace(found, saved=-0.31, low=-0.33, high=-0.28, cost_was=19.42)
    assert (
        replace(dearer, currency="EUR").sentence
        == "Plans would have cost 0.31 EUR more (90 % band 0.28 to 0.33 more) than 19.42"
    )


_CONDEMNED = Competence(False, reasons=("6 h ahead it errs by 7.00 K, need 1 K",), effect_K=7.0, effect_sd_K=5.0)
_NOT_KNOWN = "since what it does is not known well enough"


@pytest.mark.parametrize(
    ("options", "acted", "is_doubted"),
    [
        ({"gate": {"enabled": False}}, "plans", True),
        ({}, f"its own control, {_NOT_KNOWN}", False),
        ({"fallback": {"stand_back": "rule"}}, f"the on/off rule, {_NOT_KNOWN}", False),
    ],
)
def test_what_acted_is_said_and_not_what_a_verdict_would_have(
    options: dict[str, object], acted: str, is_doubted: bool
) -> None:
    """With the gate off rooms were named as left alone, although they acted."""
    record, model = _run(_levels(3)), _model(0.1)
    model = replace(model, cards=(replace(model.only.card, competence=_CONDEMNED),))
    config = MPCConfig(step_s=HOUR_S, horizon_h=6.0, **options)
    controller = ThermoForceMPC(model, config, free_response=OutdoorResponse())
    found = worth(model, record, _conditions(record), controller, start_s=_FIRST * HOUR_S, days=0.25, draws=2)
    assert found.acted_in_words == (f"What acted: {acted} 100 % of the time",)
    assert ("verdict on the model" in found.rests_on) == is_doubted


def test_what_acted_at_one_of_several_is_not_said_of_all() -> None:
    """One room that may not act made all hours hours without a plan."""
    names = Names(("a", "b", "c"), ("x", "y", "z"), ("hp",))
    acting = (PlanStatus.SOLVED, PlanStatus.SOLVED, PlanStatus.GATE)
    plan = Plan((Block((0.5, None, None), HOUR_S),), PlanStatus.GATE, "", names=names, acting=acting)
    step = StepRecord(0, 0.0, np.empty(0), SimpleNamespace(names=names), plan, "", 0.0, 0.0, 0.0, ())
    refused = replace(step, refused="refused: a level of 7")
    acted = who_acted([step, step, step, refused], names)
    assert acted == {
        "x": {"plans": 0.75, "its own control, since the plan was refused": 0.25},
        "y": {"its own control, since no plan was better": 0.75, "its own control, since the plan was refused": 0.25},
        "z": {f"its own control, {_NOT_KNOWN}": 0.75, "its own control, since the plan was refused": 0.25},
    }
    assert planned_share(acted) == 0.25


def test_what_a_meter_holds_beside_the_levels_is_no_heat_of_the_rooms() -> None:
    record = _run(_levels(2))
    hot_water = replace(record, power_W=record.power_W + 1000.0)
    conditions = replace(_conditions(record), price_per_kWh=np.full((1, record.time_s.size), 0.3))
    saved = [
        worth(_model(0.1), one, conditions, _Nightly(), start_s=_FIRST * HOUR_S, days=4.0, draws=2).saved
        for one in (record, hot_water)
    ]
    assert saved[1] == pytest.approx(saved[0], abs=0.01 * abs(saved[0])), "a kelvin less is as much heat in both"


def test_what_is_not_known_widens_the_band_and_colder_rooms_are_warmed_again() -> None:
    record = _run(_levels(3))
    asked = {"start_s": _FIRST * HOUR_S, "days": 2.0, "draws": 3}
    known, unknown = (worth(_model(sd), record, _conditions(record), _Nightly(), **asked) for sd in (0.02, 0.5))
    assert unknown.high - unknown.low > known.high - known.low
    # Heating by night alone leaves rooms colder than the bound; plans are asked to be as warm as it was.
    bound_C = float(np.min(record.T_zone_C[0, _FIRST:])) - 0.05
    colder = worth(_model(0.02), record, _conditions(record, bound_C), _Nightly(), **asked)
    assert colder.outside_was_Kh < colder.outside_Kh
    assert colder.raised_K == 0.5


class _ToBound:
    """Heats as much as the lower bound of the next hour needs."""

    name, step_s, horizon_s = "to the bound", HOUR_S, 6 * HOUR_S

    def plan(self, observation: Observation, state: object = None) -> Plan:
        alone_C = POLE * observation.history.T_zone_C[0, -1] + (1 - POLE) * float(outdoor_C(observation.time_s))
        level = float(np.clip((observation.boundary.lower_C[0, 1] - alone_C) / GAIN_K, 0.0, 1.0))
        return Plan((Block((level,), HOUR_S),), PlanStatus.SOLVED, "to the bound")


def test_no_room_is_asked_to_be_warmer_than_it_was() -> None:
    """Bounds that the house did not keep had to be paid for by plans: a house that sets back could not save."""
    record = _run(_levels(3))
    conditions = _conditions(record, float(np.quantile(record.T_zone_C[0, _FIRST:], 0.6)))
    asked = {"start_s": _FIRST * HOUR_S, "days": 3.0, "draws": 2}
    found, kept = (
        worth(_model(0.02), record, conditions, _ToBound(), bounds_kept=kept, **asked) for kept in (False, True)
    )
    assert kept.outside_Kh < 0.1 * kept.outside_was_Kh
    assert kept.raised_K == 0.0
    assert found.outside_was_Kh == kept.outside_was_Kh
    assert abs(found.outside_Kh - found.outside_was_Kh) < 0.3 * 3.0
    assert found.warmer_K[0] < 0.05 < kept.warmer_K[0]
    assert found.energy_kWh < kept.energy_kWh


def test_bounds_of_plans_are_lowered_where_these_stay_above_them() -> None:
    """A controller that keeps a kelvin inside its bounds is asked for less, not for more comfort than there was."""

    class Careful(_ToBound):
        def plan(self, observation: Observation, state: object = None) -> Plan:
            boundary = observation.boundary
            return super().plan(replace(observation, boundary=replace(boundary, lower_C=boundary.lower_C + 0.4)), state)

    record = _run(_levels(3))
    conditions = _conditions(record, float(np.quantile(record.T_zone_C[0, _FIRST:], 0.9)))
    asked = {"start_s": _FIRST * HOUR_S, "days": 3.0, "draws": 2}
    said: list[str] = []
    found = worth(_model(0.02), record, conditions, Careful(), **asked, progress=said.append)
    assert found.raised_K == -0.25, "lower by half a kelvin it would be less comfortable than it was"
    assert found.outside_Kh < found.outside_was_Kh + 0.3 * 3.0
    assert "house 1 again, to be as comfortable as it had been: plans with bounds lowered by 0.25 K" in said


# Hot water that people take, W, by hour of the day, from the meter of the machine that heats the room.
_HABIT_W = np.where(np.isin(np.arange(24), [7, 19]), 1500.0, 50.0)
_CONTACT = SGReady(kind="sg_ready", column="contact")


def _by_contact(state: Array) -> Record:
    """The simple house at half level but where its machine is blocked (1), which puts off hot water too."""
    record = _run(np.where(state == 1.0, 0.0, 0.5))
    power_W, waits_W = record.power_W[0].copy(), 0.0
    for k, one in enumerate(state):
        waits_W += _HABIT_W[k % 24]
        power_W[k], waits_W = (12.0, waits_W) if one == 1.0 else (power_W[k] + waits_W, 0.0)
    return replace(record, power_W=power_W[None])


def _states() -> Array:
    """Ordinary operation, and three days in which the machine is blocked for some hours."""
    state = np.full(_HOURS, 2.0)
    state[_FIRST - 72 : _FIRST] = np.repeat(np.random.default_rng(6).choice([1.0, 2.0], 36, p=[0.4, 0.6]), 2)
    return state


def _contact(record: Record, state: Array) -> LearnedCommand:
    states, spread = np.array([1.0, 2.0]), np.zeros(2)
    half = np.full(2, 0.5)
    loop = LoopMap(0.0, states, states, 0.0, 0.0, states, half, spread, spread, 0.0, 1.0, 14.0)
    usual = np.full(7 * 24, 2.0)
    learned = LearnedCommand(_CONTACT, loop, 2.0, DAY_S, usual, record.time_s[-1], _ORIGIN)
    return replace(learned, machine="machine", record=record, set_to=state)


class _Blocked:
    """Blocks the machine for two hours in the morning and two in the evening."""

    name, step_s, horizon_s = "blocked", HOUR_S, 6 * HOUR_S

    def plan(self, observation: Observation, state: object = None) -> Plan:
        told = _told(observation.time_s)
        return Plan((Block((None,), HOUR_S, (told,)),), PlanStatus.SOLVED, "blocked when it is dear")


def _told(time_s: float) -> float:
    return 1.0 if time_s % DAY_S / HOUR_S in (6, 7, 18, 19) else 2.0


def test_commands_are_counted_as_plans_count_them() -> None:
    """What had to wait while a machine was blocked was left out: only levels had a price."""
    was, told = _states(), _states()
    told[_FIRST:] = [_told(k * HOUR_S) for k in range(_FIRST, _HOURS)]
    record, truth = _by_contact(was), _by_contact(told)
    conditions, learned = _conditions(record), {"actuator": _contact(record, was)}
    asked = {"start_s": _FIRST * HOUR_S, "days": 1.0, "draws": 2, "commands": learned}
    found = worth(_model(0.1), record, conditions, _Blocked(), **asked)
    part = slice(_FIRST, _FIRST + 24)
    np.testing.assert_allclose(found.planned.u[0], truth.u[0, part], atol=1e-9)
    meter = meters_of(_model(0.1), learned.values())["machine"]
    both, law_W = np.stack([was, told]), np.stack([_model(0.1).power_by_law_of(0, one) for one in (record, truth)])
    at_s = HOUR_S * np.arange(_HOURS)
    course = meter.course(both, np.full(_HOURS, 2.0), HOUR_S, 1, law_W, at_s, meter.begin(2.0, 2.0, HOUR_S, 0.0))
    beside_W = meter.power_W(course, meter.mean[None], law_W, at_s)
    as_planned_W = record.power_W[0] + np.diff(law_W + beside_W, axis=0)[0]
    np.testing.assert_allclose(found.planned.power_W[0], as_planned_W[part], atol=1.0)
    price = conditions.price_per_kWh[0, part]
    cost_was, cost, true = (
        float(W @ price) / 1000.0 for W in (record.power_W[0, part], found.planned.power_W[0], truth.power_W[0, part])
    )
    assert cost_was - cost == pytest.approx(cost_was - true, rel=0.15)
    assert cost_was - true > 0.2 * cost_was
    assert found.low < found.saved < found.high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start_s": 2 * DAY_S}, r"2 days from 2026-01-03 00:00:00\+00:00 on are not .* with 7 days before"),
        ({"days": 30.0}, "are not in the record"),
        ({"price": np.nan}, "price_per_kWh is not known"),
        ({"power": None}, "was not measured"),
        ({"card": ModelCard("given")}, "does not say how well"),
    ],
)
def test_what_cannot_be_said_is_refused(change: dict[str, object], message: str) -> None:
    record, model = _run(_levels(1)), _model(0.1)
    conditions = _conditions(record)
    if "price" in change:
        conditions = replace(conditions, price_per_kWh=np.full_like(conditions.price_per_kWh, np.nan))
    if "power" in change:
        model = replace(model, power=(None,))
    if "card" in change:
        model = replace(model, cards=(change["card"],))
    asked = {"start_s": _FIRST * HOUR_S, "days": 2.0} | {k: v for k, v in change.items() if k in ("start_s", "days")}
    with pytest.raises(DataError, match=message):
        worth(model, record, conditions, _Nightly(), draws=2, **asked)


@pytest.mark.slow
def test_worth_command(tmp_path: Path) -> None:
    record, model = _run(_levels(4)), _model(0.1)
    model.save(tmp_path / "model")
    stamps = [at.isoformat() for at in record.stamps()]
    table = {"at": stamps, "room": record.T_zone_C[0], "out": record.T_out_C, "tank": 50.0}
    table |= {name: np.append(getattr(record, name)[0], np.nan) for name in ("u", "power_W")}
    pd.DataFrame(table).to_csv(tmp_path / "data.csv", index=False)
    price = _conditions(record).price_per_kWh[0]
    pd.DataFrame({"time": stamps, "price": price}).to_csv(tmp_path / "prices.csv", index=False)
    low = float(np.min(record.T_zone_C[0, -24:]))
    (tmp_path / "map.yaml").write_text(
        "time: {column: at, zone: UTC}\noutdoor: out\nstep: 60min\n"
        f"zones: {{zone: {{temperature: room, lower: {max(low, 5.0):.1f}, upper: 40}}}}\n"
        "actuators: {actuator: {zone: zone, level: u}}\nmachines: {machine: {power: power_W}}\n"
        "hot_water: {temperature: tank, comfort: else 20-80}\n"
    )

    def said(*words: str) -> tuple[int, str]:
        given = [f"--{name}={tmp_path / file}" for name, file in (("data", "data.csv"), ("map", "map.yaml"))]
        done = CliRunner().invoke(cli, ["worth", f"--model={tmp_path / 'model'}", *given, *words])
        return (
            (done.exit_code, done.output)
            if isinstance(done.exception, SystemExit | None)
            else (-1, str(done.exception))
        )

    prices, out = f"--prices={tmp_path / 'prices.csv'}", tmp_path / "worth.json"
    ask = (prices, "--days=1", "--houses=2", "--hours=6", "--set=gate.enabled=false")
    code, text = said(*ask, f"--out={out}", f"--plot={tmp_path / 'worth.png'}")
    assert code == 0, text
    assert "90 % band" in text
    assert "It rests on effects of full level known to ± 10 %" in text
    assert re.search(r"Warmth of \d+\.\d\d (less|more) is left at the end than it was", text)
    assert "hot water of machine as it was, since the house is lived through without its tank" in text
    content = json.loads(out.read_text())
    found = content["worth"]
    assert found["low"] < found["saved"] < found["high"]
    assert len(content["rows"]) == 24
    bought = sum(row["power_W_was"] / 1000.0 * row["price_per_kWh"] for row in content["rows"])
    assert found["cost_was"] == pytest.approx(bought, rel=1e-3)
    assert (tmp_path / "worth.png").stat().st_size > 10_000
    code, text = said(*ask, "--commands")
    assert code == -1
    assert "names no command" in text
    code, text = said("--days=1", "--houses=2")
    assert "price_per_kWh is not known" in text
    bill = tmp_path / "bill.yaml"
    bill.write_text("source: ours\nenergy: prices.csv\nvat: 0.5\npeak: {of: highest, per_kW_year: 40, least_kW: 2}\n")
    code, text = said(*ask, f"--prices={bill}", f"--out={out}")
    assert code == 0, text
    assert "bill.yaml: peak: not counted" in text.replace("\n", "")
    assert json.loads(out.read_text())["worth"]["cost_was"] == pytest.approx(1.5 * bought, rel=1e-3)


def test_what_had_to_wait_comes_where_another_house_goes_on() -> None:
    was, model, begin = _states(), _model(0.1), _FIRST + 4
    record = _by_contact(was)
    learned = {"actuator": _contact(record, was)}
    known = {"commands": learned, "meters": meters_of(model, learned.values())}
    whole = IdentifiedHouse(model, record, _conditions(record), **known)
    whole.reset(begin * HOUR_S, 0.0)
    for k in range(begin, begin + 6):
        whole.advance(None, HOUR_S / 4, (_told(k * HOUR_S),))  # parts of a step are one step
        whole.advance(None, 3 * HOUR_S / 4, (_told(k * HOUR_S),))
        if k == begin + 3:
            before = whole.state
    later = IdentifiedHouse(model, record, _conditions(record), **known, before=before)
    later.reset((begin + 4) * HOUR_S, 0.0)
    for k in range(begin + 4, begin + 6):
        later.advance(None, HOUR_S, (_told(k * HOUR_S),))
    np.testing.assert_allclose(later.beside_W[:, begin + 4 : begin + 6], whole.beside_W[:, begin + 4 : begin + 6], 0.1)
    assert later.beside_W[0, begin + 4] > 1000.0


class _ChargedAtNight:
    """Recommends the machine of `n` actuators to run from 2 to 4 h, and blocks it from 18 to 20 h."""

    name, step_s, horizon_s = "by night", HOUR_S, 6 * HOUR_S

    def plan(self, observation: Observation, state: object = None) -> Plan:
        hour = observation.time_s % DAY_S / HOUR_S
        told = 3.0 if 2 <= hour < 4 else 1.0 if 18 <= hour < 20 else 2.0
        return Plan((Block((None,) * 2, HOUR_S, (told,) * 2),), PlanStatus.SOLVED, "by night")


class _HomeChargedAtNight(HomeByCurve):
    """Of which the last day was lived so."""

    def wait_until(self, at: pd.Timestamp) -> None:
        begin = START - pd.Timedelta("24h")
        super().wait_until(min(at, begin))
        for k in range(24 if at == START else 0):
            self.told = 3.0 if 2 <= k < 4 else 1.0 if 18 <= k < 20 else 2.0
            super().wait_until(begin + pd.Timedelta(hours=k + 1))


def test_commands_of_a_map_are_counted_on_the_meter(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a record tells of states of SG-Ready is in what they would have cost; left alone, nothing is."""
    home = HomeByCurve(days=10, trials=3, set_by="sg_ready")
    model, cards = curve_model(home), []
    for _, _, pair in model.operator.each():
        day_K = float((pair.gains * (1.0 - pair.poles**24) / (1.0 - pair.poles)).sum())
        cards.append(ModelCard("exact", uncertainty={"step_response_24h_K": day_K, "step_response_24h_sd_K": 0.5}))
    model = replace(model, cards=tuple(cards))
    measured = read_measurements(home.measurements(), SG_RULES, step_s=HOUR_S).served()
    learned = learned_commands(measured)
    asked = {"start_s": float(measured.record.time_s[-25]), "days": 1.0, "draws": 2, "commands": learned}
    counted = worth(model, measured.record, measured.conditions, _ChargedAtNight(), **asked)
    monkeypatch.setattr("thermoforce_mpc.experiment.worth.meters_of", lambda model, learned: {})
    by_levels = worth(model, measured.record, measured.conditions, _ChargedAtNight(), **asked)
    np.testing.assert_allclose(by_levels.planned.u, counted.planned.u)
    more_W = counted.planned.power_W[0] - by_levels.planned.power_W[0]
    assert (more_W[2:4] > 20.0).all(), "warmer water than the rooms' levels tell"
    lived = _HomeChargedAtNight(days=10, trials=3, set_by="sg_ready").rows[-24 * 12 :]
    assert counted.cost == pytest.approx(sum(row["P"] * row["price"] for row in lived) / 12000.0, rel=0.03)
