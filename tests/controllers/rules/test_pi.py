"""The PI controller: its law by hand, no wind-up, anticipation, and that it holds a house."""

from __future__ import annotations

import numpy as np
import pytest
from simple_house import SimpleHouse

from controllers.checks import ControllerConfigError
from controllers.registry import controller_config
from controllers.rules.pi import PIConfig, PIController
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Layout, Observation, Period, PlanStatus, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.scenario import Scenario


def observation(T: float, time_s: float, lower_C: float | list[float] = 21.0) -> Observation:
    n = 2 if isinstance(lower_C, float) else len(lower_C)
    line, times = np.ones(n), time_s + 900.0 * np.arange(n)
    lower = lower_C * line if isinstance(lower_C, float) else np.array(lower_C)
    history = Record([time_s], [T], [0.0], [0.0], [], [], [])
    return Observation(history, Boundary(times, 0 * line, 0 * line, line, lower, 24 * line, line, line))


# Any level is held: what is asked for shows as it is.
HELD = {"mode": "modulating", "lowest_level": 0.0}


class Run:
    """A controller in one run."""

    def __init__(self, **options) -> None:
        self.controller, self.state = PIController(PIConfig(**options)), None

    def plan(self, seen: Observation):
        plan = self.controller.plan(seen, self.state)
        self.state = plan.state
        return plan


def share(run: Run, T: float, time_s: float, **kind) -> float:
    blocks = run.plan(observation(T, time_s, **kind)).blocks
    return sum((block.u[0] or 0.0) * block.duration_s for block in blocks) / sum(block.duration_s for block in blocks)


def test_the_law_by_hand():
    pi = Run(kp=0.5, ti_s=3600.0, offset_K=0.0, lead_h=0.0, actuation=HELD, off_below=0.0)
    assert share(pi, 20.6, 0.0) == pytest.approx(0.2)  # 0.5 · 0.4 K, nothing integrated yet
    assert share(pi, 20.6, 900.0) == pytest.approx(0.2 + 0.5 * 0.4 * 900 / 3600)
    assert share(pi, 20.8, 1800.0) == pytest.approx(0.1 + 0.05 + 0.5 * 0.2 * 900 / 3600)


def test_a_long_cold_spell_does_not_wind_up():
    pi = Run(offset_K=0.0, lead_h=0.0)
    for k in range(200):
        assert share(pi, 15.0, 900.0 * k) == 1.0
    assert share(pi, 21.2, 900.0 * 200) == 0.0


def test_a_rising_bound_is_met_before_it_comes():
    config = {"kp": 1.0, "offset_K": 0.0, "lead_h": 0.5}
    rising = [15.0, 15.0, 21.0, 21.0]
    assert share(Run(**config), 20.0, 0.0, lower_C=rising) == 1.0
    assert share(Run(**config), 20.0, 0.0, lower_C=[15.0, 15.0, 15.0, 21.0]) == 0.0


def test_duty_switches_in_blocks_keeps_minimum_times_and_is_off_below_its_threshold():
    pi = Run(kp=0.5, offset_K=0.0, lead_h=0.0, off_below=0.15)
    first, second = (pi.plan(observation(T, t)).blocks for T, t in ((20.2, 0.0), (21.5, 900.0)))
    assert [(block.u[0], block.duration_s) for block in first] == [(0.0, 600.0), (1.0, 300.0)]
    assert [(block.u[0], block.duration_s) for block in second] == [(1.0, 300.0), (0.0, 600.0)], "on for its minimum"
    assert share(Run(kp=0.5, offset_K=0.0, lead_h=0.0, off_below=0.15), 20.8, 0.0) == 0.0


@pytest.mark.parametrize(("T_zone_C", "expected"), [(20.2, [(0.0, 300.0), (0.7, 600.0)]), (19.4, [(0.8, 900.0)])])
def test_a_modulating_machine_runs_at_least_at_its_lowest_level(T_zone_C, expected):
    pi = Run(kp=0.5, offset_K=0.0, lead_h=0.0, actuation={"mode": "modulating", "lowest_level": 0.7})
    blocks = pi.plan(observation(T_zone_C, 0.0)).blocks
    assert [(block.u[0], block.duration_s) for block in blocks] == [
        (pytest.approx(level), seconds) for level, seconds in expected
    ]


def test_cooling_follows_the_upper_bound():
    pi = Run(mode="cooling", offset_K=0.0, lead_h=0.0)
    assert share(pi, 25.0, 0.0) == 1.0
    assert share(pi, 23.5, 900.0) == 0.0


def test_a_silent_sensor_hands_over_to_native_control():
    plan = PIController().plan(observation(float("nan"), 0.0))
    assert plan.blocks[0].u == (None,)
    assert plan.status is PlanStatus.RULE


def test_a_bound_that_is_not_known_hands_over_to_native_control():
    plan = PIController(PIConfig(lead_h=0.0)).plan(observation(20.0, 0.0, lower_C=[float("nan"), 21.0]))
    assert plan.blocks[0].u == (None,)
    assert "comfort bound missing" in plan.why


def test_bounds_of_an_hour_ago_are_refused():
    now, before = observation(20.0, 3600.0), observation(20.0, 0.0)
    with pytest.raises(DataError, match="3600 s before now"):
        PIController(PIConfig()).plan(Observation(now.history, before.boundary))


def test_a_step_too_short_for_blocks_is_refused():
    with pytest.raises(ControllerConfigError, match=r"blocks of 300 s cannot share a step of 300 s"):
        PIController(PIConfig(step_s=300.0))


def test_it_is_a_baseline_as_any_other():
    """Its actuation counts for how the machine is probed, as that of the others."""
    scenario = Scenario(testcase="bestest_hydronic_heat_pump", baselines=("pi", "thermostat"))
    Experiment.of(scenario)
    options = {"actuation": {"mode": "modulating", "lowest_level": 0.6}}
    held = controller_config("pi", options, load_testcase("bestest_hydronic_heat_pump"))
    assert held.actuation.lowest_level == 0.6
    zone = load_testcase("energyplus_heating_chicago")
    assert controller_config("pi", {}, zone).actuation.mode == "modulating"


def test_room_set_points_that_heat_and_cool_are_left_to_the_thermostat():
    says = "pi does not heat and cool by the room set-points of actuator; use thermostat"
    with pytest.raises(ControllerConfigError, match=says):
        PIController(layout=Layout.single("both", -0.5))
    for controller, baselines in (("pi", ()), ("thermostat", ("pi",))):
        with pytest.raises(ControllerConfigError, match=says):
            Experiment.of(Scenario(testcase="bestest_air", controller={"name": controller}, baselines=baselines))


def test_twice_on_the_same_window_is_twice_the_same():
    period = Period("winter", 10 * DAY_S, 2 * DAY_S, DAY_S)
    pi = PIController()
    first, second = (run_closed_loop(SimpleHouse(), pi, period).kpis for _ in range(2))
    assert (first["tdis_tot"], first["cost_tot"]) == (second["tdis_tot"], second["cost_tot"])


def test_it_holds_a_house_near_its_set_point():
    period = Period("winter", 10 * DAY_S, 2 * DAY_S, DAY_S)
    result = run_closed_loop(SimpleHouse(), PIController(PIConfig(lead_h=0.0)), period)
    night = [s for s in result.samples if DAY_S + 2 * HOUR_S < s.start_s - period.start_s < DAY_S + 7 * HOUR_S]
    assert len(night) > 15
    assert {float(s.lower_C[0]) for s in night} == {21.0}
    assert np.mean([s.T_zone_C[0] for s in night]) == pytest.approx(21.3, abs=0.2)
