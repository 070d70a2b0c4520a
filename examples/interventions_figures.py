"""Plot a prediction of one day: its free and forced parts, and its course under five constant actuator levels.

    python interventions_figures.py                    on the embedded plant
    python interventions_figures.py FOLDER             on a recorded run: the first excite_*.csv.gz of FOLDER
                                                       (columns as in the reference of `tf-mpc bench operator`)

Writes decomposition.png and counterfactuals.png into the current folder, or into --out. The dashed line in both is the
forecast from the measured temperature by the same forecaster, without the operator; it does not depend on the action.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.operator.data import FLOOR_AREA_M2, cut, read_run
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Observation
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.identification import identify
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant

FREE, FORCED, TRUTH, RAW = "#228b22", "#b22222", "#1b1f24", "#6b7280"
LEVELS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
SHOWN_H = 48


@dataclass(frozen=True)
class Situation:
    """Model, observation at one instant, and actions `u` (24,) and temperatures `truth_C` (24,) of the next day."""

    model: ThermalModel
    observation: Observation
    u: np.ndarray
    truth_C: np.ndarray
    name: str


def on_the_emulator() -> Situation:
    """Identify from three days of probing on the embedded plant, then simulate a day of random levels (3 h each)."""
    plant = EmbeddedPlant(synthetic_weather())
    window = plant.period("peak_heat_day")
    model = identify_on(plant, before=window, days=3)
    plant.reset(window.start_s, window.warmup_s)
    observation = Observation(plant.past(HOUR_S), plant.forecast(DAY_S, HOUR_S))
    u = np.repeat(np.random.default_rng(3).choice(LEVELS, 8), 3)
    truth = np.array([plant.advance(float(level), HOUR_S).T_zone_C[0] for level in u])
    return Situation(model, observation, u, truth, f"embedded plant, {plant.info.weather}")


def on_a_record(folder: Path) -> Situation:
    """Identify from the first three days of a recorded run; the predicted day is its eleventh."""
    found = sorted(folder.glob("excite_*.csv.gz"))
    if not found:
        raise SystemExit(f"{folder}: no excite_*.csv.gz found")
    record = read_run(found[0])
    run = record.resample(round(HOUR_S / record.step_s))
    model = identify([cut(record, 0.0, 3.0)], floor_area_m2=FLOOR_AREA_M2, step_s=HOUR_S, source=found[0].name)
    now = 10 * 24
    ahead = run.slice(now, now + 24)
    observation = Observation(run.slice(0, now), Boundary.measured(ahead))
    return Situation(model, observation, ahead.u[0], ahead.T_zone_C[0, 1:], found[0].name)


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the free/forced decomposition and a fan of counterfactuals.")
    parser.add_argument("folder", type=Path, nargs="?", help="records of a building; by default the embedded plant")
    parser.add_argument("--out", type=Path, default=Path("."), help="folder for the two figures")
    options = parser.parse_args()
    situation = on_a_record(options.folder) if options.folder else on_the_emulator()
    history, boundary = situation.observation.history, situation.observation.boundary
    forecaster = build_free_response("chronos")
    predictor = Predictor(situation.model.operator, forecaster)
    context = predictor.context(situation.observation)
    raw_C = forecaster.forecast(history.T_zone_C[0], history, boundary).median_C
    predicted = context.predict(situation.u)
    fan = context.counterfactuals(LEVELS)

    free_C = predictor.free_history(history)[0, -SHOWN_H - 1 :]
    past_h = (history.time_s - history.time_s[-1])[-SHOWN_H - 1 :] / HOUR_S
    ahead_h = np.arange(1, boundary.n_steps + 1)
    options.out.mkdir(parents=True, exist_ok=True)

    figure = Figure(figsize=(9, 6), layout="constrained")
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    top.plot(past_h, history.T_zone_C[0, -SHOWN_H - 1 :], color=TRUTH, label="measured")
    top.plot(past_h, free_C, color=FREE, label="free: measured minus forced")
    top.plot(ahead_h, situation.truth_C, color=TRUTH)
    top.plot(ahead_h, predicted.free_C[0], color=FREE, linestyle=":", label="free, forecast")
    top.plot(ahead_h, predicted.total_C[0], color=FORCED, label="free + forced, forecast")
    top.plot(ahead_h, raw_C, color=RAW, linestyle="--", label="forecaster alone")
    top.axvline(0, color=RAW, linewidth=0.8)
    top.set_ylabel("°C")
    top.legend(frameon=False, ncols=2)
    below.stairs(history.u[0, -SHOWN_H:], past_h, fill=True, color=RAW, alpha=0.5)
    below.stairs(situation.u, np.append(0, ahead_h), fill=True, color=FORCED, alpha=0.5)
    below.set(ylabel="u", ylim=(0, 1.05), xlabel="hours from now")
    top.set_title(situation.name)
    figure.savefig(options.out / "decomposition.png", dpi=120)

    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for level, T, tone in zip(LEVELS, fan.total_C[:, 0], np.linspace(0.25, 1.0, LEVELS.size), strict=True):
        axes.plot(ahead_h, T, color=(0.7 * tone, 0.13, 0.5 * (1 - tone) + 0.1), label=f"u = {level:g}")
    axes.plot(ahead_h, raw_C, color=RAW, linestyle="--", label="forecaster alone")
    axes.set(xlabel="hours from now", ylabel="°C", title=situation.name)
    axes.legend(frameon=False, ncols=3)
    figure.savefig(options.out / "counterfactuals.png", dpi=120)

    def rmse(forecast: np.ndarray) -> float:
        return float(np.sqrt(np.mean((forecast - situation.truth_C) ** 2)))

    print(f"{situation.name}: forecast of one day with known actions and weather")
    print(f"RMSE over 24 h: free + forced {rmse(predicted.total_C[0]):.2f} K, forecaster alone {rmse(raw_C):.2f} K")
    spread = fan.total_C[-1, 0] - fan.total_C[0, 0]
    print(f"effect of u = 1 against u = 0: {spread[5]:.1f} K after 6 h, {spread[23]:.1f} K after 24 h")
    print(f"figures: {options.out / 'decomposition.png'}, {options.out / 'counterfactuals.png'}")


if __name__ == "__main__":
    main()
