"""The picture of an identification: what a model says of its record, and its step responses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import NORMAL_95, Record
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.dates import label_dates, on_dates
from thermoforce_mpc.whatif.rollouts import ROLLOUT_H, rollouts
from thermoforce_mpc.whatif.step_response import full_level_of, step_answer, step_response_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLOT_NAME = "identification.png"


def plot_identification(path: Path, model: ThermalModel, record: Record) -> None:
    """Write the figure: record and rollouts of each zone, levels, and the step responses with their 90 % bands.

    The step responses are a matrix, zones by actuators; an empty cell is a pair without an effect.
    """
    from matplotlib.figure import Figure

    zones, actuators, _ = model.operator.shape
    figure = Figure(figsize=(max(9.0, 3.0 * actuators), 5.0 + 3.0 * zones), layout="constrained")
    upper, lower = list(figure.subfigures(2, 1, squeeze=False, height_ratios=[3 * zones + 1, 3 * zones])[:, 0])
    courses = upper.subplots(zones + 1, 1, height_ratios=[3] * zones + [1], squeeze=False, sharex=True)[:, 0]
    at = on_dates(record.time_s, record.origin)
    predictions, rooms = rollouts(model, record), model.in_rooms(record)
    measured = "measured" if rooms is record else "measured, without the sun on the sensor"
    for z, axes in enumerate(courses[:-1]):
        title = "Measured and predicted zone temperature" if zones == 1 else model.operator.zones[z]
        axes.set_title(title, loc="left", pad=22.0)  # above the legend
        axes.plot(at, rooms.T_zone_C[z], color="black", linewidth=1.2, label=measured)
        if predictions is not None:
            label = f"rollouts of {ROLLOUT_H:g} h, measured weather; RMSE {predictions.rmse_K[z]:.2f} K"
            axes.plot(at, predictions.predicted_C[z], color="tab:red", linewidth=1.2, label=label)
        axes.set_ylabel("zone temperature, °C" if zones == 1 else "°C")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, frameon=False, borderaxespad=0.2)
    for a, name in enumerate(model.operator.actuators):
        courses[-1].stairs(record.u[a], at, color=f"C{a}", fill=actuators == 1, alpha=0.5, label=name)
    if actuators > 1:
        courses[-1].legend(loc="upper left", ncols=actuators, frameon=False, fontsize="small")
    courses[-1].set_ylabel("level u")
    courses[-1].set_ylim(1.05 * float(np.nanmin(record.u, initial=0.0)), 1.05)
    label_dates(courses[-1], at, record.origin)
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
        low, high = mean - NORMAL_95 * sd, mean + NORMAL_95 * sd
        axes.fill_between(at, low, high, color="tab:red", alpha=0.2, linewidth=0, label="90 % band")
        axes.plot(at, mean, "o", color="tab:red", markersize=3)
    if model.names.single:
        axes.legend(loc="best", frameon=False)
