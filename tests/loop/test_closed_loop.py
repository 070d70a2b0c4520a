from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from simple_house import SimpleHouse
from two_houses import TWO, TwoHouses

from thermoforce_mpc.data import DAY_S, HOUR_S, Block, Period, Plan, PlanStatus
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.loop import checked_blocks
from thermoforce_mpc.records.run_folder import steps_frame, trajectory_frame


def plan(*blocks: Block) -> Plan:
    return Plan(blocks, PlanStatus.RULE, "test")


class Fixed:
    name, step_s, horizon_s = "fixed", HOUR_S, 2 * HOUR_S

    def __init__(self, *blocks: Block) -> None:
        self.blocks, self.seen = blocks, []

    def plan(self, observation, state=None):
        self.seen.append(observation)
        return plan(*self.blocks)


@pytest.mark.parametrize("u", [float("nan"), float("inf"), -0.01, 1.01])
def test_an_unfit_level_never_reaches_the_plant(u):
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(Block(0.5, 1800.0), Block(u, 1800.0)), house.period("x"))
    assert {level for level, _ in house.applied} == {None}
    assert result.fallback_levels()["refused"] == len(result.steps) == 48
    assert "native control instead" in result.steps[0].refused


def test_after_a_refused_plan_the_controller_goes_on_from_the_state_before():
    class Counting(Fixed):
        def __init__(self) -> None:
            self.states = []

        def plan(self, observation, state=None):
            self.states.append(state)
            level = 2.0 if len(self.states) == 3 else 0.0  # the third is out of limits
            return replace(plan(Block(level, HOUR_S)), state=len(self.states))

    controller = Counting()
    run_closed_loop(SimpleHouse(), controller, Period("x", 10 * DAY_S, scored_s=5 * HOUR_S, warmup_s=0.0))
    assert controller.states == [None, 1, 2, 2, 4]


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_an_unfit_duration_is_replaced_by_one_step_of_native_control(duration):
    blocks, why = checked_blocks(plan(Block(0.5, duration)), HOUR_S, 10 * HOUR_S)
    assert blocks == (Block(None, HOUR_S),)
    assert why


@pytest.mark.parametrize(
    ("block", "told"),
    [
        (Block((0.5, 1.01), HOUR_S), r"level of 1.01 for 'floor': expected a number from 0 to 1"),
        (Block((0.5, float("nan")), HOUR_S), r"level of nan for 'floor'"),
        (Block((None, 0.5), HOUR_S, ((24.0, 21.0), None)), r"room set-points .* for 'radiator'"),
        (Block(0.5, HOUR_S), r"levels of 1 actuators: expected one for each of radiator, floor"),
    ],
)
def test_what_is_wrong_with_one_actuator_refuses_the_plan_for_all(block, told):
    blocks, why = checked_blocks(plan(block), HOUR_S, HOUR_S, names=TWO)
    assert blocks == (Block((None, None), HOUR_S),)
    assert re.search(told, why)
    assert checked_blocks(plan(Block((0.5, None), HOUR_S)), HOUR_S, HOUR_S, names=TWO)[1] == ""


def test_the_lowest_level_is_that_of_each_actuator():
    def refused(*u):
        return checked_blocks(plan(Block(u, HOUR_S)), HOUR_S, HOUR_S, (0.0, -0.6), TWO)[1]

    assert refused(0.0, -0.6) == ""
    assert "level of -0.1 for 'radiator': expected a number from 0 to 1" in refused(-0.1, 0.0)
    assert "level of -0.7 for 'floor': expected a number from -0.6 to 1" in refused(0.0, -0.7)


def test_every_zone_actuator_and_machine_is_recorded_by_name():
    plant = TwoHouses()
    controller = Fixed(Block((0.25, None), 1800.0), Block((0.75, 1.0), 1800.0))
    period = Period("x", 10 * 86400.0, 6 * HOUR_S, 2 * 86400.0)
    result = run_closed_loop(plant, controller, period)
    first, last = result.samples[0], result.samples[-1]
    assert result.names == TWO
    assert first.u_applied == (0.25, None)
    assert last.T_zone_C.shape == last.lower_C.shape == last.power_W.shape == (2,)
    assert last.T_zone_C[0] != last.T_zone_C[1]
    assert [level for level, _ in plant.houses[1].applied[:2]] == [None, 1.0], "native control of one actuator alone"
    u = controller.seen[-1].history.u
    np.testing.assert_allclose(u[0], 0.5)
    assert np.isnan(u[1]).all(), "half of each step was native control that nobody measured"
    rows = trajectory_frame(result.steps)
    zones = [f"{name}[{zone}]" for name in ("T_zone_C", "lower_C", "upper_C") for zone in TWO.zones]
    assert {*zones, "u_applied[radiator]", "u_measured[floor]", "power_W[boiler]", "heat_W[floor]"} <= set(rows)
    assert rows["upper_C[hall]"].iloc[0] == rows["upper_C[bath]"].iloc[0] + 1.0
    assert rows["power_W[heat pump]"].tolist() == [sample.power_W[1] for sample in result.samples]
    steps = steps_frame(result.steps)
    assert steps["T_zone_C[hall]"].tolist() == [step.T_zone_C[1] for step in result.steps]


def test_the_columns_of_one_zone_carry_no_names():
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(Block(0.5, HOUR_S)), house.period("x"))
    assert list(trajectory_frame(result.steps)) == [
        "start_s", "duration_s", "T_zone_C", "T_out_C", "solar_W_m2", "lower_C", "upper_C", "price_per_kWh",
        "u_applied", "u_measured", "power_W", "heat_W",
    ]  # fmt: skip
    assert "T_zone_C" in steps_frame(result.steps)


def test_an_empty_plan_is_one_step_of_native_control():
    assert checked_blocks(plan(), HOUR_S, 10 * HOUR_S)[0] == (Block(None, HOUR_S),)


def test_blocks_are_cut_at_the_end_of_the_window():
    blocks, why = checked_blocks(plan(Block(1.0, 1800.0), Block(0.0, 1800.0)), HOUR_S, 2000.0)
    assert blocks == (Block(1.0, 1800.0), Block(0.0, 200.0))
    assert not why


def test_the_history_holds_step_means_and_grows_by_one_step_each_time():
    house = SimpleHouse()
    controller = Fixed(Block(1.0, 900.0), Block(0.0, 2700.0))
    result = run_closed_loop(house, controller, house.period("x"))
    lengths = [seen.history.n_steps for seen in controller.seen]
    assert lengths == list(range(48, 96)), "two days of warm-up, then one step a plan"
    last = controller.seen[-1].history
    np.testing.assert_allclose(last.u[0, 48:], 0.25)
    np.testing.assert_allclose(np.diff(last.time_s), HOUR_S)
    assert last.T_zone_C[0, -1] == controller.seen[-1].T_zone_C == result.steps[-1].T_zone_C


def test_a_window_that_ends_inside_a_step_is_run_to_its_end():
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(Block(0.5, HOUR_S)), replace(house.period("x"), scored_s=2.5 * HOUR_S))
    assert [sample.duration_s for sample in result.samples] == [HOUR_S, HOUR_S, 0.5 * HOUR_S]


@pytest.mark.parametrize("seconds", [1800.0, 5400.0])
def test_a_plan_that_is_not_one_step_long_never_reaches_the_plant(seconds):
    """Its means over a step would stand in the history as those of another length."""
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(Block(1.0, seconds)), house.period("x"))
    assert house.applied[0] == (None, HOUR_S)
    assert f"blocks of {seconds:g} s in all for a step of 3600 s" in result.steps[0].refused


@pytest.mark.parametrize("seconds", [(-900.0, 4500.0), (0.0, 3600.0), (float("nan"), 3600.0)])
def test_a_block_of_no_time_refuses_the_plan_though_the_sum_is_right(seconds):
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(*(Block(1.0, one) for one in seconds)), house.period("x"))
    assert house.applied[0] == (None, HOUR_S)
    assert f"refused step of {seconds[0]!r} s" in result.steps[0].refused


def test_samples_carry_the_bounds_and_price_in_force():
    house = SimpleHouse()
    result = run_closed_loop(house, Fixed(Block(0.0, HOUR_S)), house.period("x"))
    at = {round((s.start_s % 86400) / HOUR_S): s.lower_C[0] for s in result.samples[:24]}
    assert (at[6], at[8], at[19], at[20]) == (21.0, 15.0, 15.0, 21.0)


def test_a_failing_plant_ends_the_run_but_not_the_record():
    house = SimpleHouse(fail_at_s=10.5 * 86400)
    seen = []
    with pytest.raises(PlantError, match="lost its connection"):
        run_closed_loop(house, Fixed(Block(0.0, HOUR_S)), house.period("x"), on_step=seen.append)
    assert len(seen) == 12
