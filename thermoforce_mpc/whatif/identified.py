"""What a model says of its own record: rollouts over it, the step response to full actuation, and their picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Observation, Record
from thermoforce_mpc.data.series import bridged
from thermoforce_mpc.identification.estimation.regression import BAND, STEP_RESPONSE_H
from thermoforce_mpc.model.free_response.rc import RcFreeResponse
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLOT_NAME = "identification.png"
# Start of the first rollout and length of each, h.
_ROLLOUT_H = 12.0


@dataclass(frozen=True)
class Rollouts:
    """Predictions of a record: `predicted_C` (Z, n + 1) °C, NaN before the first rollout, and their RMSE (Z,), K."""

    predicted_C: Array
    rmse_K: Array


def rollouts(model: ThermalModel, record: Record) -> Rollouts | None:
    """Predict a record by consecutive rollouts of 12 h, each from the record before it with the measured weather.

    Sun that the model found on a sensor is taken off the record. Gaps in the record's weather and levels are bridged.
    Returns None if a zone has no linear free part (identified from pairs only) or the record is too short.
    """
    n = max(1, round(_ROLLOUT_H * HOUR_S / record.step_s))
    free_models = [free for free in model.free if free is not None]
    if len(free_models) < len(model.free) or record.n_steps < 2 * n:
        return None
    record, _ = bridged(model.in_rooms(record))
    predictor = Predictor(model.operator, [RcFreeResponse(free) for free in free_models])
    predicted = np.full(record.T_zone_C.shape, np.nan)
    for start in range(n, record.n_steps, n):
        stop = min(start + n, record.n_steps)
        context = predictor.context(Observation(record.slice(0, start), Boundary.measured(record.slice(start, stop))))
        predicted[:, start + 1 : stop + 1] = context.predict(record.u[:, start:stop]).total_C
    error = predicted - record.T_zone_C
    return Rollouts(predicted, np.sqrt(np.nanmean(error**2, axis=1)))


def plot_identification(path: Path, model: ThermalModel, record: Record) -> None:
    """Write the figure: record and rollouts of each zone, levels, and the step responses with their 90 % bands.

    The step responses are a matrix, zones by actuators; an empty cell is a pair without an effect.
    """
    from matplotlib.figure import Figure

    zones, actuators, _ = model.operator.shape
    figure = Figure(figsize=(max(9.0, 3.0 * actuators), 5.0 + 3.0 * zones), layout="constrained")
    upper, lower = list(figure.subfigures(2, 1, squeeze=False, height_ratios=[3 * zones + 1, 3 * zones])[:, 0])
    courses = upper.subplots(zones + 1, 1, height_ratios=[3] * zones + [1], squeeze=False, sharex=True)[:, 0]
    days = record.time_s / DAY_S
    predictions, rooms = rollouts(model, record), model.in_rooms(record)
    measured = "measured" if rooms is record else "measured, without the sun on the sensor"
    for z, axes in enumerate(courses[:-1]):
        title = "Measured and predicted zone temperature" if zones == 1 else model.operator.zones[z]
        axes.set_title(title, loc="left", pad=22.0)  # above the legend
        axes.plot(days, rooms.T_zone_C[z], color="black", linewidth=1.2, label=measured)
        if predictions is not None:
            label = f"rollouts of {_ROLLOUT_H:g} h, measured weather; RMSE {predictions.rmse_K[z]:.2f} K"
            axes.plot(days, predictions.predicted_C[z], color="tab:red", linewidth=1.2, label=label)
        axes.set_ylabel("zone temperature, °C" if zones == 1 else "°C")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, frameon=False, borderaxespad=0.2)
    for a, name in enumerate(model.operator.actuators):
        courses[-1].stairs(record.u[a], days, color=f"C{a}", fill=actuators == 1, alpha=0.5, label=name)
    if actuators > 1:
        courses[-1].legend(loc="upper left", ncols=actuators, frameon=False, fontsize="small")
    courses[-1].set_ylabel("level u")
    courses[-1].set_ylim(1.05 * float(np.nanmin(record.u, initial=0.0)), 1.05)
    courses[-1].set_xlabel("days since 1 January")
    cells = lower.subplots(zones, actuators, squeeze=False, sharex=True)
    for z, a, pair in model.operator.each():
        _plot_answer(cells[z, a], model, z, a, pair)
    for z in range(zones):
        for a in range(actuators):
            if model.operator.pairs[z][a] is None:
                cells[z, a].set_title(f"{model.operator.actuators[a]} on {model.operator.zones[z]}", loc="left")
                cells[z, a].text(0.5, 0.5, "no effect", ha="center", transform=cells[z, a].transAxes)
        cells[z, 0].set_ylabel("change of the zone temperature, K" if zones == 1 else "change, K")
    for axes in cells[-1]:
        axes.set_xlabel("hours since the step")
    figure.savefig(path, dpi=120, metadata={"Software": None})


def _plot_answer(axes: Axes, model: ThermalModel, z: int, a: int, pair: OperatorParameters) -> None:
    """Step response of a pair to full level."""
    operator = model.operator
    hours, answer = step_answer(pair)
    full = f" ({text})" if (text := full_level_of(pair)) else ""
    if model.names.single:
        axes.set_title(f"Step response to full level{full}", loc="left")
    else:
        axes.set_title(f"{operator.actuators[a]} on {operator.zones[z]}{full}", loc="left")
    axes.axhline(0.0, color="black", linewidth=0.5)
    axes.plot(hours, answer, color="tab:red", label="expected")
    mean, sd = step_response_of(model, z, a)
    if mean.size:
        at = np.array([0.0, *STEP_RESPONSE_H])
        low, high = mean - BAND * sd, mean + BAND * sd
        axes.fill_between(at, low, high, color="tab:red", alpha=0.2, linewidth=0, label="90 % band")
        axes.plot(at, mean, "o", color="tab:red", markersize=3)
    if model.names.single:
        axes.legend(loc="best", frameon=False)


def step_answer(pair: OperatorParameters) -> tuple[Array, Array]:
    """Return hours since a step to full level and the expected answer of a pair, K, from 0 to the last of
    `STEP_RESPONSE_H`.
    """
    steps = round(STEP_RESPONSE_H[-1] * HOUR_S / pair.step_s)
    hours = np.arange(steps + 1) * pair.step_s / HOUR_S
    return np.asarray(hours, dtype=np.float64), np.concatenate([[0.0], np.cumsum(pair.impulse(steps))])


def full_level_of(pair: OperatorParameters) -> str:
    """Return the heat of full level in words; empty where it is not known."""
    return "" if pair.heat_input.law is None else f"{pair.heat_input.reference_W / 1000:.1f} kW"


def step_response_of(model: ThermalModel, z: int, a: int) -> tuple[Array, Array]:
    """Return the step response of a pair at 0 h and `STEP_RESPONSE_H` and its standard deviation, K; empty: unknown."""
    card, suffix = model.card_of(z, a)
    means = [card.uncertainty.get(f"step_response_{h}h_K{suffix}") for h in STEP_RESPONSE_H]
    sds = [card.uncertainty.get(f"step_response_{h}h_sd_K{suffix}") for h in STEP_RESPONSE_H]
    if any(value is None for value in (*means, *sds)):
        return np.empty(0), np.empty(0)
    sign = model.operator.of_actuator(a).sign if model.operator.home[a] == z else 1
    return sign * np.array([0.0, *means], dtype=np.float64), np.array([0.0, *sds], dtype=np.float64)
