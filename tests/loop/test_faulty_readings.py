"""Readings that are missing or cannot be, in closed loop: control goes on, and the run says what was wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Levels, Measurement, Period
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_testcase

PERIOD = Period("test", start_s=16 * DAY_S, scored_s=40 * HOUR_S, warmup_s=2 * DAY_S)
NAN = float("nan")

Fault = Callable[[Measurement], Mapping[str, float]]


class FaultyPlant(EmbeddedPlant):
    """The embedded plant with readings changed: `faults` by the hour of the run that ends with them."""

    def __init__(self, faults: Mapping[int, Fault]) -> None:
        super().__init__(synthetic_weather())
        self.faults = faults

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        measurement = super().advance(u, duration_s)
        hour = int(np.ceil((measurement.time_s - PERIOD.start_s) / HOUR_S - 1e-9))
        fault = self.faults.get(hour)
        return replace(measurement, **fault(measurement)) if fault else measurement


def reads(**values: float) -> Fault:
    return lambda _: values


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    testcase = load_testcase("bestest_hydronic_heat_pump")
    config = IdentificationConfig(order=3, modulation="linear", sun_on_sensor=False, late_sensor=False)
    plant = EmbeddedPlant(synthetic_weather())
    return identify_on(plant, before=PERIOD, days=3.0, testcase=testcase, step_s=HOUR_S, config=config)


@pytest.fixture(scope="module")
def run(model: ThermalModel) -> Callable[..., RunResult]:
    def run(faults: Mapping[int, Fault]) -> RunResult:
        mpc = ThermoForceMPC(model, MPCConfig(step_s=3600.0, horizon_h=24), free_response=LinearWeather())
        return run_closed_loop(FaultyPlant(faults), mpc, PERIOD)

    return run


@pytest.fixture(scope="module")
def clean(run: Callable[..., RunResult]) -> RunResult:
    result = run({})
    assert result.fallback_levels()["solved"] == len(result.steps) == 40
    assert not any(step.notes for step in result.steps)
    assert not any("bridged" in step.plan.why for step in result.steps)
    return result


def about_as_good(result: RunResult, clean: RunResult) -> bool:
    discomfort = result.kpis["tdis_tot"] - clean.kpis["tdis_tot"]
    return bool(discomfort < 0.3 and result.kpis["cost_tot"] < 1.1 * clean.kpis["cost_tot"])


@pytest.mark.slow
@pytest.mark.parametrize("signal", ["T_out_C", "solar_W_m2"])
def test_one_missing_sample_of_the_weather_costs_at_most_one_plan(run, clean, signal):
    result = run({12: reads(**{signal: NAN})})
    assert result.fallback_levels()["solved"] >= len(result.steps) - 1
    assert about_as_good(result, clean)
    assert f"bridged {signal}: 1 value by linear interpolation" in result.steps[13].plan.why
    assert f"{signal} was not measured" in result.steps[11].notes[0]


@pytest.mark.slow
def test_a_day_without_weather_readings_is_controlled_all_the_same(run, clean):
    result = run(dict.fromkeys(range(4, 28), reads(T_out_C=NAN, solar_W_m2=NAN)))
    assert result.fallback_levels()["solved"] >= len(result.steps) - 1
    assert about_as_good(result, clean)
    assert "of them from the same hour of the nearest day" in result.steps[-1].plan.why


@pytest.mark.slow
def test_where_u_is_not_reported_what_was_applied_counts(run, clean):
    result = run(dict.fromkeys(range(4, 28), reads(u=NAN, heat_W=NAN)))
    assert result.fallback_levels()["solved"] == len(result.steps)
    assert about_as_good(result, clean)
    assert "bridged" not in result.steps[-1].plan.why


@pytest.mark.slow
@pytest.mark.parametrize("watts", [1e7, 1e12, -1e6, 1e5, np.inf])
def test_one_absurd_heat_reading_changes_next_to_nothing(run, clean, watts):
    result = run({8: reads(heat_W=watts)})
    assert result.fallback_levels()["solved"] == len(result.steps)
    assert about_as_good(result, clean)
    assert f"heat_W of {watts:.6g} W is not a number between" in result.steps[7].notes[0]
    assert not result.steps[8].notes


def test_no_absurd_reading_of_any_sensor_is_believed_or_passed_over(run, clean):
    absurd = {
        4: ("power_W", reads(power_W=1e9)),
        7: ("T_zone_C", reads(T_zone_C=850.0)),
        10: ("T_zone_C", lambda m: {"T_zone_C": m.T_zone_C + 25.0}),  # could be, but not within an hour
        13: ("T_out_C", reads(T_out_C=278.0)),  # kelvin
        16: ("solar_W_m2", reads(solar_W_m2=65535.0)),
        19: ("u", reads(u=7.0)),
        22: ("T_return_C", reads(T_return_C=-273.15)),
    }
    result = run({hour: fault for hour, (_, fault) in absurd.items()})
    noted = {step.index + 1: step.notes for step in result.steps if step.notes}
    assert list(noted) == list(absurd)
    for hour, (signal, _) in absurd.items():
        assert all(note.startswith(signal) and note.endswith("taken as not measured") for note in noted[hour])
    assert result.fallback_levels()["solved"] >= len(result.steps) - 2  # the zone sensor was silent twice
    assert about_as_good(result, clean)
