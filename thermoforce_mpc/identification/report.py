"""Figure of an identification: rollouts over its record, and the step response to full actuation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Observation, Record
from thermoforce_mpc.identification.uncertainty import STEP_RESPONSE_H
from thermoforce_mpc.model.free_response.rc import RcFreeResponse
from thermoforce_mpc.model.gaps import bridged
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLOT_NAME = "identification.png"
# Start of the first rollout and length of each, h.
_ROLLOUT_H = 12.0
# Half width of a 90 % band of a normal distribution, standard deviations.
_BAND = 1.645


@dataclass(frozen=True)
class Rollouts:
    """Predictions of a record: `predicted_C` (n + 1,) °C, NaN before the first rollout, and their RMSE, K."""

    predicted_C: Array
    rmse_K: float


def rollouts(model: ThermalModel, record: Record, hours: float = _ROLLOUT_H) -> Rollouts | None:
    """Predict a record by consecutive rollouts of `hours`, each from the record before it with the measured weather.

    Gaps in the record's weather and levels are bridged. Returns None if the model has no linear free part (identified
    from pairs only) or the record is too short.
    """
    n = max(1, round(hours * HOUR_S / record.step_s))
    if model.free is None or record.n_steps < 2 * n:
        return None
    record, _ = bridged(record)
    predictor = Predictor(model.operator, RcFreeResponse(model.free))
    predicted = np.full(record.n_steps + 1, np.nan)
    for start in range(n, record.n_steps, n):
        stop = min(start + n, record.n_steps)
        context = predictor.context(Observation(record.slice(0, start), record.slice(start, stop).weather()))
        predicted[start + 1 : stop + 1] = context.predict(record.u[start:stop]).total_C
    error = predicted - record.T_zone_C
    return Rollouts(predicted, float(np.sqrt(np.nanmean(error**2))))


def plot_identification(path: Path, model: ThermalModel, record: Record) -> None:
    """Write the figure: record and rollouts, actions, and the step response of the linear fit with its 90 % band."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, height_ratios=[3, 1, 3])
    days = record.time_s / DAY_S
    top.set_title("Measured and predicted zone temperature", loc="left")
    top.plot(days, record.T_zone_C, color="black", linewidth=1.2, label="measured")
    found = rollouts(model, record)
    if found is not None:
        label = f"rollouts of {_ROLLOUT_H:g} h, measured weather; RMSE {found.rmse_K:.2f} K"
        top.plot(days, found.predicted_C, color="tab:red", linewidth=1.2, label=label)
    top.set_ylabel("zone temperature, °C")
    top.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, frameon=False)
    middle.stairs(record.u, days, color="tab:blue", fill=True, alpha=0.5)
    middle.set_ylabel("level u")
    middle.set_ylim(0, 1.05)
    middle.set_xlabel("days since 1 January")
    _plot_answer(bottom, model)
    figure.savefig(path, dpi=120, metadata={"Software": None})


def _plot_answer(axes: Axes, model: ThermalModel) -> None:
    operator, known = model.operator, model.card.uncertainty
    steps = round(STEP_RESPONSE_H[-1] * HOUR_S / operator.step_s)
    hours = np.arange(steps + 1) * operator.step_s / HOUR_S
    answer = np.concatenate([[0.0], np.cumsum(operator.impulse(steps))])
    heat = operator.heat_input.heat
    full = "" if heat is None else f" ({operator.heat_input.reference_W / 1000:.1f} kW)"
    axes.set_title(f"Step response to full level{full}", loc="left")
    axes.axhline(0.0, color="black", linewidth=0.5)
    axes.plot(hours, answer, color="tab:red", label="expected")
    names = [f"step_response_{h}h" for h in STEP_RESPONSE_H]
    if all(f"{name}_sd_K" in known for name in names):
        mean = operator.sign * np.array([0.0, *(known[f"{name}_K"] for name in names)])
        sd = np.array([0.0, *(known[f"{name}_sd_K"] for name in names)])
        at = np.array([0.0, *STEP_RESPONSE_H])
        axes.fill_between(
            at,
            mean - _BAND * sd,
            mean + _BAND * sd,
            color="tab:red",
            alpha=0.2,
            linewidth=0,
            label="90 % band",
        )
        axes.plot(at, mean, "o", color="tab:red", markersize=3)
    axes.set_xlabel("hours since the step")
    axes.set_ylabel("change of the zone temperature, K")
    axes.legend(loc="best", frameon=False)
