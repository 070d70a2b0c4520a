"""Computing time of each part (paper table 'Computational cost') and of the MPC solve (not in the paper)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.interventions.dataset import Dataset, Probe
from benchmarks.interventions.methods.base import Training
from benchmarks.interventions.methods.thermoforce import identified
from benchmarks.interventions.suite import training_of
from benchmarks.paper.printed import EFFICIENCY_MS, PARAMETERS
from controllers.mpc.controller import ThermoForceMPC
from controllers.registry import build_controller
from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.machine.power import fit_power
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.energyplus.zone import Climate, base_setpoint, electric_power_W
from thermoforce_mpc.plants.testcases import load_testcase

Row = dict[str, Any]
Say = Callable[[str], None]

_HORIZON_H = 48.0
REPEATS = 20


def efficiency(
    data: Dataset, days: int, backbone: str, seed: int, say: Say, repeats: int = REPEATS
) -> tuple[list[Row], list[Target]]:
    """Median wall time of every part after `days` probe days, ms, and trained parameters, with the paper's figures.

    `repeats`: how often rollout, forecast and control step are timed; identification three times at most, with a
    network once.
    """
    say("timing identification, rollout, forecast and solve")
    climate = next(iter(data.climates.values()))
    training = training_of(climate, days, seed)
    free = build_free_response("chronos", backbone=backbone, resolutions="one")
    linear_ms = _milliseconds(lambda: identified(training, 1, modulation="linear"), min(3, repeats))
    began = time.perf_counter()
    model = identified(training, 1, modulation="always")
    neural_ms = 1e3 * (time.perf_counter() - began)
    window = climate.part("test")[0]
    history, boundary = window.history.last(512), window.boundary
    features = np.tile([20.0, 0.0, 100.0, 0.0], (24, 1))
    u = np.full(24, 0.5)
    operator = model.only.operator
    rollout_ms = _milliseconds(lambda: forced_rollout(operator, np.zeros(1), u, features), repeats)
    forecast_ms = _milliseconds(lambda: free.forecast(history.T_zone_C[0], history, boundary), repeats)
    measured = {
        "RC identification (3 days)": linear_ms,
        "operator training": neural_ms,
        "forced rollout (24 steps)": rollout_ms,
        "free forecast (512 to 24)": forecast_ms,
    }
    rows: list[Row] = [
        {"component": name, "unit": "ms", "here": value, "paper": EFFICIENCY_MS[name]}
        for name, value in measured.items()
    ]
    for name, value in control_step(training, model, repeats).items():
        rows.append({"component": name, "unit": "ms", "here": value, "paper": None})
    n_trained = float(model.operator.n_trained)
    rows.append({"component": "trained parameters", "unit": "1", "here": n_trained, "paper": float(PARAMETERS)})
    targets = [Target(f"{name}, ms", value, EFFICIENCY_MS[name]) for name, value in measured.items()]
    targets.append(Target("trained parameters", n_trained, float(PARAMETERS)))
    return rows, targets


def control_step(training: Training, model: ThermalModel, repeats: int = REPEATS) -> Mapping[str, float]:
    """Median time of the MPC solve over 48 h at 15 min and of the whole control step over `repeats`, ms.

    The controller has the defaults of the plant of this climate. Its machine runs at any level above a lowest one, so a
    solve is one quadratic programme per first level. It plans for the last two days before the probe with the measured
    weather.

    Raises:
        DataError: the test case has no machine, or the solver failed.
    """
    testcase = load_testcase(f"energyplus:{training.climate.name}")
    zone = testcase.energyplus
    past = training.probe.history
    if zone is None:
        raise DataError(f"test case '{testcase.name}' has no `energyplus` section: it has no machine to plan for")
    power = electric_power_W(zone, testcase.mode, past.heat_W, past.T_out_C[:-1])
    lowest = testcase.defaults.actuation.get("lowest_level")
    powered = replace(model, power=(fit_power([replace(past, power_W=power)], lowest_level=lowest),))
    # Repeated planning at one instant gives no data for calibration.
    free = {"name": "residual", "options": {"calibrate": False}}
    # What a step costs does not depend on whether the model is good enough to act.
    options = {"step_s": past.step_s, "horizon_h": _HORIZON_H, "free_response": free, "gate": {"enabled": False}}
    controller = build_controller("thermoforce_mpc", options, testcase, powered)
    if not isinstance(controller, ThermoForceMPC):
        raise TypeError("the registry's thermoforce_mpc is not a ThermoForceMPC")
    observation = _observation(training.probe, training.climate, zone.band_K)
    solve, whole, state = [], [], None
    for _ in range(repeats + 1):
        began = time.perf_counter()
        plan = controller.plan(observation, state)
        whole.append(time.perf_counter() - began)
        if plan.status is not PlanStatus.SOLVED:
            raise DataError(f"bench interventions, efficiency: the MPC did not solve: {plan.why}")
        solve.append(plan.seconds["solve"])
        state = plan.state
    return {
        "solve (48 h at 15 min)": 1e3 * float(np.median(solve[1:])),
        "control step (estimate, forecast, solve)": 1e3 * float(np.median(whole[1:])),
    }


def _observation(probe: Probe, climate: Climate, band_K: float) -> Observation:
    """The last 48 h before the probe days as the horizon, everything before as history."""
    past = probe.history
    n = round(_HORIZON_H * HOUR_S / past.step_s)
    history, ahead = past.slice(0, past.n_steps - n), past.slice(past.n_steps - n, past.n_steps)
    day = base_setpoint(climate, 1)
    machine = day[np.round(np.mod(ahead.time_s, DAY_S) / past.step_s).astype(int) % day.size]
    other = np.full(n + 1, climate.comfort_C + climate.sign * band_K)
    lower, upper = (machine, other) if climate.sign > 0 else (other, machine)
    price = tariffs.by_name()["highly_dynamic"](ahead.time_s)
    emission = np.full(n + 1, tariffs.EMISSION_KG_PER_KWH)
    boundary = Boundary(ahead.time_s, ahead.T_out_C, ahead.solar_W_m2, np.zeros(n + 1), lower, upper, price, emission)
    return Observation(history, boundary)


def _milliseconds(action: Callable[[], Any], repeats: int) -> float:
    """Median time of `repeats` calls after a first one, ms."""
    action()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))
