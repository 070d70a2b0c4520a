"""Plans of many buildings: as if each were planned alone, and what is wrong with one costs that one."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simple_house import SimpleHouse, simple_model
from waiting import LONG_S

from benchmarks.free_response.scales import SMALLER
from controllers import MPCConfig, ThermoForceMPC
from controllers.actuation.actuator import ActuationConfig
from controllers.checks import ControllerConfigError, PackedState
from controllers.many.portfolio import Portfolio, plan_many
from controllers.many.worker import read_shared, write_shared
from controllers.optimisation.solvers.highs import Highs
from controllers.optimisation.solvers.ipopt import IpoptConfig, IpoptSolver
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.free_response.backbones.chronos_family import BoltBackbone

HOURLY = {"step_s": None, "horizon_h": 24.0}
WEATHER_MODEL = MPCConfig(**HOURLY, free_response={"name": "linear_weather"})
# The smallest scale of the forecaster.
FORECASTER = MPCConfig(
    **HOURLY, free_response={"name": "residual", "options": {"backbone": str(SMALLER["shipped_tiny"])}}
)
# Long enough for the plans of houses that do answer, on any machine, s.
LATE_S = 8.0
# A float32 of 20 °C is exact to 2e-6 K; batches of another size round elsewhere.
SAME_K = 2e-5


def seen(T_start_C: float = 21.0, price: float = 0.25) -> Observation:
    house = SimpleHouse(T_start_C)
    house.reset(10 * 86400.0, 6 * 86400.0)
    boundary = house.forecast(24 * HOUR_S, HOUR_S)
    return Observation(house.past(HOUR_S), replace(boundary, price_per_kWh=0 * boundary.price_per_kWh + price))


def later(observation: Observation) -> Observation:
    """An hour later, as if it had gone on evenly."""
    after = {name: getattr(observation, name) for name in ("history", "boundary")}
    return Observation(**{name: replace(one, time_s=one.time_s + HOUR_S) for name, one in after.items()})


def houses(n: int) -> dict[str, Observation]:
    return {f"house {i}": seen(18.0 + i, 0.2 + 0.05 * i) for i in range(n)}


def models(n: int) -> dict:
    return {f"house {i}": replace(simple_model()) for i in range(n)}


def same(ours, theirs, tolerance: float = 0.0) -> None:
    assert (ours.status, ours.blocks, ours.acting) == (theirs.status, theirs.blocks, theirs.acting)
    for name in ("u", "T_free_C", "T_free_low_C", "T_forced_K", "slack_K"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=0.0, atol=tolerance)


@pytest.mark.slow
def test_plans_and_forecasts_made_together_are_those_made_alone_in_one_pass_of_the_forecaster(monkeypatch):
    passes, inner = [], BoltBackbone.quantiles_C
    monkeypatch.setattr(
        BoltBackbone, "quantiles_C", lambda self, contexts: (passes.append(len(contexts)), inner(self, contexts))[1]
    )
    observations = houses(4)
    with Portfolio(models(4), FORECASTER) as portfolio:
        first = portfolio.plan(observations)
        assert passes == [4]
        second = portfolio.plan(
            {name: later(one) for name, one in observations.items()}, {n: p.state for n, p in first.items()}
        )
        assert passes == [4, 4]
    alone = ThermoForceMPC(simple_model(), FORECASTER)
    for name, observation in observations.items():
        plan = alone.plan(observation)
        same(first[name].plan, plan, SAME_K)
        same(second[name].plan, alone.plan(later(observation), plan.state), SAME_K)
        assert first[name].reason == ""


def test_the_same_input_gives_the_same_bytes_in_any_company():
    observations = houses(3)
    with Portfolio(models(3), WEATHER_MODEL) as portfolio:
        first = portfolio.plan(observations)
        states = {name: planned.state for name, planned in first.items()}
        after = {name: later(one) for name, one in observations.items()}
        once, again = portfolio.plan(after, states), portfolio.plan(after, states)
        alone = portfolio.plan({"house 1": after["house 1"]}, states)
    for name in observations:
        same(once[name].plan, again[name].plan)
    same(once["house 1"].plan, alone["house 1"].plan)
    assert list(once) == list(observations)


def test_what_is_wrong_with_a_building_costs_that_building(monkeypatch):
    observations, buildings, options = houses(3), models(3), dict.fromkeys(models(3), WEATHER_MODEL)
    condemned = replace(simple_model().only.card, competence=Competence(False, reasons=("it errs by 7 K",)))
    buildings |= {
        "not competent": replace(simple_model(), cards=(condemned,)),
        "no power": replace(simple_model(), power=(None,)),
        "bad step": simple_model(),
        "bad state": simple_model(),
        "no forecast": simple_model(),
        "one instant": simple_model(),
        "no solution": simple_model(),
    }
    one = seen()
    observations |= dict.fromkeys(buildings.keys() - observations.keys(), one) | {
        "bad step": Observation(one.history.resample(2), one.boundary),
        "no forecast": Observation(replace(one.history, T_zone_C=one.history.T_zone_C * np.nan), one.boundary),
        "one instant": Observation(one.history, one.boundary.head(0)),
        "unknown": one,
        "unknown, one instant": Observation(one.history, one.boundary.head(0)),
    }
    options |= dict.fromkeys(buildings.keys() - {"no solution"}, WEATHER_MODEL)

    class OneIteration(MPCConfig):
        ipopt = IpoptConfig(max_iterations=1)

    # Ipopt is asked where HiGHS fails.
    options["no solution"] = OneIteration(**HOURLY, free_response={"name": "linear_weather"}, solver="milp")
    build = IpoptSolver.__init__

    def unless_one_iteration(self, operator, shape, config):
        assert config.max_iterations > 1, "out of order"
        build(self, operator, shape, config)

    monkeypatch.setattr(Highs, "__call__", lambda *given: 1 / 0)
    monkeypatch.setattr(IpoptSolver, "__init__", unless_one_iteration)
    found = plan_many(buildings, observations, {"bad state": "a state"}, config=options)
    expected = plan_many(models(3), houses(3), config=WEATHER_MODEL)
    for name, planned in expected.items():
        same(found[name].plan, planned.plan)
        assert not found[name].reason
    said = {
        "not competent": (PlanStatus.GATE, "it errs by 7 K"),
        "no power": (PlanStatus.NATIVE, "without measured power"),
        "bad step": (PlanStatus.NATIVE, "step 0 of"),
        "bad state": (PlanStatus.NATIVE, "state is a str"),
        "no forecast": (PlanStatus.NATIVE, "never measured"),
        "no solution": (PlanStatus.THERMOSTAT, "highs: raised ZeroDivisionError"),
        "one instant": (PlanStatus.NATIVE, "boundary forecast has 0 steps"),
        "unknown": (PlanStatus.NATIVE, "no model of building 'unknown'"),
        "unknown, one instant": (PlanStatus.NATIVE, "no model of building 'unknown, one instant'"),
    }
    for name, (status, reason) in said.items():
        assert found[name].plan.status is status, name
        assert reason in found[name].reason
        levels = [u for block in found[name].plan.blocks for u in block.u]
        assert all(u is None or 0.0 <= u <= 1.0 for u in levels)


def test_minimum_times_hold_after_a_step_that_was_left_to_the_buildings_own_controller():
    config = WEATHER_MODEL.model_copy(
        update={"actuation": ActuationConfig(mode="duty", min_on_s=7200.0, min_off_s=7200.0)}
    )

    def after(hours: int, *levels: float) -> Observation:
        one = seen(15.0)
        u = np.array(one.history.u)
        u[0, -len(levels) :] = levels
        one = replace(one, history=replace(one.history, u=u))
        for _ in range(hours):
            one = later(one)
        return one

    with Portfolio({"a": simple_model()}, config) as portfolio:
        first = portfolio.plan({"a": after(0, 0.0, 0.0, 0.0)})["a"]
        assert first.plan.blocks[-1].u == (1.0,)
        short = replace(after(1, 0.0, 0.0, 1.0), boundary=after(1, 0.0).boundary.head(3))
        left = portfolio.plan({"a": short}, {"a": first.state})["a"]
        assert left.plan.status is PlanStatus.NATIVE
        found = portfolio.plan({"a": after(2, 0.0, 1.0, 0.0)}, {"a": left.state})["a"]
    assert [block.u for block in found.plan.blocks] == [(0.0,)], "it has been off for an hour of two"


def test_a_state_of_another_building_costs_one_plan():
    state = plan_many({"b": simple_model()}, {"b": seen()}, config=WEATHER_MODEL)["b"].state
    other = replace(state, margins=replace(state.margins, unused=np.zeros(2)))
    with Portfolio({"a": simple_model()}, WEATHER_MODEL) as portfolio:
        first = portfolio.plan({"a": seen()}, {"a": other})["a"]
        assert (first.plan.status, first.state) == (PlanStatus.NATIVE, None)
        assert "state is of 2 machines" in first.reason
        assert not portfolio.plan({"a": later(seen())}, {"a": first.state})["a"].reason


def test_a_state_of_a_later_plan_costs_one_plan():
    with Portfolio({"a": simple_model()}, WEATHER_MODEL) as portfolio:
        after = portfolio.plan({"a": later(seen())}, {"a": None})["a"].state
        first = portfolio.plan({"a": seen()}, {"a": after})["a"]
        assert (first.plan.status, first.state) == (PlanStatus.NATIVE, None)
        assert "later than the observation" in first.reason


def test_a_plan_holds_until_it_expires_and_then_the_buildings_own_controller_acts():
    now = seen()
    planned = Portfolio({"a": simple_model()}, WEATHER_MODEL, grace_s=300.0).plan({"a": now})["a"]
    assert planned.begins_s == now.time_s
    assert planned.expires_s == now.time_s + HOUR_S + 300.0
    blocks, at = planned.plan.blocks, planned.begins_s
    for block in blocks:
        assert planned.block_at(at) == planned.block_at(at + block.duration_s - 1.0) == block
        at += block.duration_s
    assert planned.block_at(planned.expires_s - 1.0) == blocks[-1]
    assert planned.block_at(planned.expires_s) is None
    assert planned.block_at(planned.begins_s - 1.0) is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"workers": 0},
        {"grace_s": -1.0},
        {"deadline_s": 0.0},
        {"grace_s": float("nan")},
        {"grace_s": float("inf")},
        {"workers": 1.5},
    ],
)
def test_numbers_without_sense_are_refused(wrong):
    with pytest.raises(ControllerConfigError, match="expected one process or more"):
        Portfolio({"a": simple_model()}, **wrong)


def test_options_of_a_building_without_a_model_and_what_is_no_model_options_or_observation_are_refused():
    with pytest.raises(ControllerConfigError, match="no model of building 'b'"):
        Portfolio({"a": simple_model()}, {"b": WEATHER_MODEL})
    with pytest.raises(ControllerConfigError, match="building 'b' is a str, expected ThermalModel"):
        Portfolio({"a": simple_model(), "b": "b.model"})
    with pytest.raises(ControllerConfigError, match="building 'a' is a dict, expected MPCConfig"):
        Portfolio({"a": simple_model()}, {"a": HOURLY})
    with pytest.raises(ControllerConfigError, match="building 'a' is a str, expected MPCConfig"):
        Portfolio({"a": simple_model()}, "thermoforce_mpc")
    with pytest.raises(DataError, match="building 'a': a dict is no Observation"):
        plan_many({"a": simple_model()}, {"a": {}})


class Deadly:
    """A state that ends the process that reads it."""

    def __reduce__(self):
        return os._exit, (3,)


class Slow:
    """A state, or part of a model, that takes longer to read than any plan of these tests."""

    def __reduce__(self):
        return time.sleep, (600.0,)


class Unreadable:
    """A state that cannot be read where it was sent."""

    def __reduce__(self):
        return getattr, ("", "no_such_state")


@pytest.mark.slow
def test_processes_give_the_same_plans_and_what_kills_one_or_cannot_travel_costs_its_building(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    observations, after = houses(4), {name: later(one) for name, one in houses(4).items()}
    here = plan_many(models(4), observations, config=WEATHER_MODEL)
    expected = plan_many(models(4), after, {n: one.state for n, one in here.items()}, config=WEATHER_MODEL)
    with Portfolio(models(4), WEATHER_MODEL, workers=2) as portfolio:
        first = portfolio.plan(observations)
        for name, one in first.items():
            same(one.plan, here[name].plan)
        states = {name: one.state for name, one in first.items()}
        assert all(isinstance(state, PackedState) and first[n].plan.state is state for n, state in states.items())
        # As the process keeps it, as it does not any more, and as it was stored meanwhile.
        for given in (states, states, pickle.loads(pickle.dumps(states))):
            for name, one in portfolio.plan(after, given).items():
                same(one.plan, expected[name].plan)
        # Houses 0 and 2 share a process, as 1 and 3 do.
        found = portfolio.plan(after, states | {"house 0": lambda: 0, "house 1": Unreadable()})
        for name in ("house 2", "house 3"):
            same(found[name].plan, expected[name].plan)
        assert {found[f"house {i}"].plan.status for i in (0, 1)} == {PlanStatus.NATIVE}
        assert "pickle" in found["house 0"].reason
        assert "no_such_state" in found["house 1"].reason
        found = portfolio.plan(after, states | {"house 2": Deadly()})
        for name in ("house 0", "house 1", "house 3"):
            same(found[name].plan, expected[name].plan)
        assert found["house 2"].plan.status is PlanStatus.NATIVE
        assert "its process died while planning it" in found["house 2"].reason
        same(portfolio.plan(after, states)["house 2"].plan, expected["house 2"].plan)
        folders = list(tmp_path.glob("tf-mpc-plans-*"))
        assert len(folders) == 2
        assert not any(any(folder.iterdir()) for folder in folders)
    assert not any(folder.exists() for folder in folders)
    same(
        ThermoForceMPC(simple_model(), WEATHER_MODEL).plan(after["house 3"], states["house 3"]),
        expected["house 3"].plan,
    )
    same(plan_many(models(4), after, states, config=WEATHER_MODEL)["house 2"].plan, expected["house 2"].plan)


def test_parcels_travel_in_files_that_are_gone_then_or_in_memory_where_there_is_no_room(tmp_path, monkeypatch):
    shared = write_shared(lambda file: file.write(b"plans"), str(tmp_path))
    assert Path(shared.path).parent == tmp_path
    assert bytes(read_shared(shared)) == b"plans"
    assert not any(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError):
        read_shared(shared)

    def full(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "mkstemp", full)
    assert bytes(read_shared(write_shared(lambda file: file.write(b"plans"), str(tmp_path)))) == b"plans"


@pytest.mark.slow
def test_a_deadline_holds_for_all_that_wait_behind_and_while_processes_start(monkeypatch):
    monkeypatch.setattr("controllers.many.portfolio.AT_A_TIME", 1)  # as with hundreds of houses a process
    with Portfolio(models(8), WEATHER_MODEL, workers=2) as portfolio:
        portfolio.plan(houses(8))
        portfolio.deadline_s = LATE_S
        found = portfolio.plan(houses(8), {"house 0": Slow()})
        left = [name for name, one in found.items() if "no plan within 8 s" in one.reason]
        assert left == ["house 0", "house 2", "house 4", "house 6"]
        assert isinstance(found["house 0"].state, Slow), "its run goes on from where it was"
        assert {found[f"house {n}"].reason for n in (1, 3, 5, 7)} == {""}
    starting = models(8)
    for model in starting.values():
        vars(model)["kept for ever"] = Slow()  # its process starts for ten minutes
    with Portfolio(starting, WEATHER_MODEL, workers=2, deadline_s=0.1) as portfolio:
        began = time.monotonic()
        found = portfolio.plan(houses(8))
        assert time.monotonic() - began < LONG_S
        assert {one.reason for one in found.values()} == {"no plan within 0.1 s: native control"}


_UNGUARDED = """
from simple_house import SimpleHouse, simple_model
from controllers.many.portfolio import plan_many
from thermoforce_mpc.data import Observation

house = SimpleHouse()
house.reset(10 * 86400.0, 6 * 86400.0)
observation = Observation(house.past(3600.0), house.forecast(24 * 3600.0, 3600.0))
names = ("house 0", "house 1")
found = plan_many(dict.fromkeys(names, simple_model()), dict.fromkeys(names, observation), workers=2)
print({one.reason for one in found.values()})
"""


@pytest.mark.slow
def test_a_program_without_a_guard_around_its_processes_falls_back_at_once_and_says_why(tmp_path):
    """Its processes would run it anew, each up to where it starts processes."""
    script = tmp_path / "plans.py"
    script.write_text(_UNGUARDED, encoding="utf-8")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        [sys.executable, str(script)], env=env, capture_output=True, text=True, timeout=LONG_S, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count("its process ended as it started (exit code 1") == 1
    assert '__name__ == "__main__"' in ended.stdout
    assert ended.stderr.count("EngineError: a process that is being started would start processes in turn") == 2
