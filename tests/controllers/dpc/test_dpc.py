"""Differentiable predictive control on a house whose model is exact."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from simple_house import GAIN_K, POLE, OutdoorResponse, SimpleHouse, simple_model

from controllers import ThermoForceMPC
from controllers.checks import ControllerConfigError
from controllers.dpc.config import DPCConfig
from controllers.dpc.controller import DPC
from controllers.dpc.policy import Policy, drive_parts, load_policy
from controllers.mpc.config import MPCConfig
from controllers.registry import build_controller
from controllers.rules.thermostat import Thermostat
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import HOUR_S, Observation, PlanStatus
from thermoforce_mpc.errors import ArtifactError
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.rooms import house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.simulation.closed_loop import run_closed_loop

CONFIG = {"step_s": None, "horizon_h": 24.0, "free_response": {"name": "rc"}}


def model() -> ThermalModel:
    """The exact model of the simple house with its free response."""
    weights = np.zeros((1, len(INPUTS)))
    weights[0, 0] = 1.0 - POLE
    free = RcParameters(np.array([POLE]), weights, HOUR_S, np.array([0.05]))
    return replace(simple_model(), free=(free,))


def configured(iterations: int = 200, **options: object) -> DPCConfig:
    return DPCConfig(**{**CONFIG, "training": {"iterations": iterations, "buildings": 24}, **options})


@cache
def trained() -> Policy:
    return DPC(model(), configured()).policy


def controller(policy: Policy | None = None, **options: object) -> DPC:
    return DPC(model(), configured(1, **options), policy=policy or trained())


def observation() -> Observation:
    house = SimpleHouse()
    house.reset(10 * 86400.0, 2 * 86400.0)
    return Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S))


@pytest.mark.slow
def test_in_closed_loop_it_is_comfortable_and_near_the_mpc() -> None:
    house = SimpleHouse()
    ours = run_closed_loop(house, controller(), house.period("x"))
    mpc = ThermoForceMPC(model(), MPCConfig(**CONFIG), free_response=OutdoorResponse())
    best = run_closed_loop(house, mpc, house.period("x"))
    rule = run_closed_loop(house, Thermostat(), house.period("x"))
    assert {name: n for name, n in ours.fallback_levels().items() if n} == {"solved": 48}
    assert ours.kpis["tdis_tot"] < best.kpis["tdis_tot"] + 0.3
    assert ours.kpis["cost_tot"] < 1.05 * best.kpis["cost_tot"]
    assert ours.kpis["cost_tot"] < rule.kpis["cost_tot"]


@pytest.mark.slow
def test_training_lowers_the_cost_and_its_seed_gives_the_same_policy() -> None:
    losses: list[float] = []
    first = DPC(model(), configured(40), progress=lambda done, loss: losses.append(loss)).policy
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])
    again = DPC(model(), configured(40)).policy
    other = DPC(model(), configured(40, training={"iterations": 40, "buildings": 24, "seed": 2})).policy
    assert all((a == b).all() for a, b in zip(first.weights, again.weights, strict=True))
    assert not all((a == b).all() for a, b in zip(first.weights, other.weights, strict=True))


def test_discomfort_counts_in_training_per_floor_area() -> None:
    def first_loss(area_m2: float) -> float:
        losses: list[float] = []
        sized = replace(model(), floor_area_m2=(area_m2,))
        _ = DPC(sized, configured(1), progress=lambda done, loss: losses.append(loss)).policy
        return losses[0]

    ones, twos, threes = (first_loss(192.0 * times) for times in (1, 2, 3))
    assert first_loss(float("nan")) == ones
    assert twos - ones == pytest.approx(threes - twos)
    assert twos > ones + 0.01


def test_what_is_trained_is_what_acts() -> None:
    """The compiled policy in closed loop ends where the torch rollout ends."""
    from controllers.dpc import training
    from controllers.dpc.policy import lead_steps
    from controllers.dpc.situations import Drawer
    from thermoforce_mpc.model.operator.torch_module import ForcedResponseOperator

    policy, zone, n = trained(), model().only, 30
    assert zone.power is not None
    assert zone.free is not None
    operator, module = zone.operator, ForcedResponseOperator(zone.operator)
    leads = torch.from_numpy(lead_steps(HOUR_S))
    network = training.Network(policy.weights[0].shape[0], 1)
    values = [value for layer in network.layers for value in (layer.weight, layer.bias)]
    for value, known in zip(values, policy.weights, strict=True):
        value.data = torch.from_numpy(known.copy())
    found = Drawer(zone.free, HOUR_S, 1, 5).draw(3, n + 24)
    course = training.course_of(found, operator, zone.power, HOUR_S)
    started = training.states_near_band(course, module, 1.0)
    _, ended = training.rollout(network, module, course, started, 0, n, leads, (1.0, 1.0), 5.0, HOUR_S)
    for b in range(3):
        features = np.zeros((n, 4))
        ahead = np.stack([found.T_free_C[b], found.lower_C[b], found.upper_C[b]])
        fixed, per_u = drive_parts(operator, features)
        F0 = started[b].detach().numpy()
        u = policy.levels(F0, operator, (fixed, per_u), ahead, course.relative[b].numpy())
        F = float(F0[0])
        for level in u:
            F = POLE * F + GAIN_K * level
        assert pytest.approx(float(ended[b, 0].detach()), abs=1e-9) == F
        assert 0.0 <= u.min() <= u.max() <= 1.0


def test_it_is_trained_on_the_heat_of_a_level_at_the_outdoor_temperature() -> None:
    """A heat pump without a heat meter, which gives less at full level where it is colder."""
    from controllers.dpc import training
    from controllers.dpc.situations import Drawer

    zone = model().only
    assert zone.power is not None
    assert zone.free is not None
    factor = HeatInput(reference_C=5.0, per_K=0.03, T_out_range_C=(-5.0, 12.0))
    operator = replace(zone.operator, heat_input=factor)
    found = Drawer(zone.free, HOUR_S, 1, 5).draw(3, 40)
    course = training.course_of(found, operator, zone.power, HOUR_S)
    heat = factor.outdoor_factor(found.T_out_C)
    assert np.ptp(heat) > 0.05
    np.testing.assert_allclose(course.drive_per_u.numpy(), heat, rtol=1e-12)
    price = found.price_per_kWh / 1000.0 * zone.power(np.ones(()), found.T_out_C)
    np.testing.assert_allclose(course.relative.numpy(), price / heat, rtol=1e-12)


def test_it_heats_ahead_of_the_bound_and_rests_in_the_warmth() -> None:
    plan = controller().plan(observation())
    # The house cools at 3 °C outdoors: bounds that rise at 20:00 must be prepared for, and are met.
    assert plan.slack_K.max() < 0.3
    before = [level for time_s, level in zip(plan.time_s, plan.u[0], strict=True) if 14 <= time_s % 86400 / HOUR_S < 20]
    assert max(before) > 0.5
    warm = observation()
    boundary = replace(warm.boundary, lower_C=warm.boundary.lower_C - 10.0)
    assert controller().plan(Observation(warm.history, boundary)).u.max() < 0.1


def test_a_policy_that_gives_nonsense_falls_back() -> None:
    broken = replace(trained(), weights=tuple(np.full_like(w, np.nan) for w in trained().weights))
    plan = controller(broken).plan(observation())
    assert plan.status in (PlanStatus.THERMOSTAT, PlanStatus.SHIFTED)
    assert "not finite" in plan.why
    assert all(np.isfinite(block.u[0]) for block in plan.blocks if block.u[0] is not None)


def test_saved_policy_plans_the_same_and_is_refused_when_edited_or_foreign(tmp_path: Path) -> None:
    first, second = (trained().save(tmp_path / name) for name in ("a", "b"))
    for file in ("policy.json", "weights.safetensors"):
        assert (first / file).read_bytes() == (second / file).read_bytes()
    read = controller(load_policy(first)).plan(observation())
    assert (read.u == controller().plan(observation()).u).all()
    with pytest.raises(ArtifactError, match="exists already"):
        trained().save(first)
    document = json.loads((first / "policy.json").read_text())
    (first / "policy.json").write_text(json.dumps(document | {"highest": 0.5}))
    with pytest.raises(ArtifactError, match="damaged or edited"):
        load_policy(first)
    raw = bytearray((second / "weights.safetensors").read_bytes())
    raw[-1] ^= 1
    (second / "weights.safetensors").write_bytes(raw)
    with pytest.raises(ArtifactError, match="sha256"):
        load_policy(second)
    slower = linear_operator(np.array([0.98]), np.array([GAIN_K]), step_s=HOUR_S)
    foreign = replace(model(), operator=ThermalModel.single(slower).operator)
    with pytest.raises(ControllerConfigError, match="trained for another model"):
        DPC(foreign, configured(1), policy=trained())
    with pytest.raises(ControllerConfigError, match="steps of 3600 s"):
        DPC(model(), configured(1, step_s=1800.0), policy=trained())


def test_what_it_is_not_made_for_is_refused_by_name() -> None:
    with pytest.raises(ControllerConfigError, match="peak_price_per_kW"):
        controller(objective={"peak_price_per_kW": 1.0})
    with pytest.raises(ControllerConfigError, match="linear free response"):
        DPC(simple_model(), DPCConfig(step_s=None, horizon_h=24.0))
    names = house_of_rooms("house:2rooms").layout.names
    pair = model().only.operator
    from thermoforce_mpc.model.operator.building import BuildingOperator

    building = BuildingOperator(names.zones, names.actuators, ((pair, None), (None, pair)), (0, 1))
    one = model()
    several = ThermalModel(building, one.power, one.free * 2, one.cards * 2, names.machines, (0, 0), (0.5, 0.5))
    with pytest.raises(ControllerConfigError, match="2 zones and 2 actuators"):
        DPC(several)


def test_from_the_command_line(tmp_path: Path) -> None:
    folder = model().save(tmp_path / "model")
    command = ["train", str(folder), "--testcase", "bestest_hydronic_heat_pump", "--out", str(tmp_path / "policy")]
    short = ["--set", "training.iterations=2", "--set", "training.buildings=2", "--set", "step_s=3600"]
    done = CliRunner().invoke(cli, [*command, *short], catch_exceptions=False)
    assert done.exit_code == 0
    assert "policy of 2 iterations" in done.output
    assert CliRunner().invoke(cli, [*command, *short]).exit_code != 0
    (tmp_path / "else").mkdir()
    refused = CliRunner().invoke(cli, [*command, *short, "--out", str(tmp_path / "else"), "--force"])
    assert "else: not overwritten, since it holds no policy.json" in str(refused.exception)
    assert "of 2  loss" not in refused.output, "refused before the training"
    options = {"policy": str(tmp_path / "policy"), "step_s": 3600.0}
    built = build_controller("dpc", options, load_testcase("bestest_hydronic_heat_pump"), model())
    assert isinstance(built, DPC)
    assert "policy of 2 iterations" in built.actuation_in_words
    assert "training.iterations" in CliRunner().invoke(cli, ["controllers", "dpc"]).output
