"""The matrix of step responses of a run's model, for its page."""

from __future__ import annotations

from collections.abc import Sequence

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.modes import STEP_RESPONSE_H
from thermoforce_mpc.identification.validation.report import BAND, full_level_of, step_answer, step_response_of
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.simulation.report.packing import Json


def answers_json(model: ThermalModel | None) -> list[list[Json | None]] | None:
    """Of each zone and actuator the answer to full level, K, and its 90 % band; None where there is no effect."""
    if model is None:
        return None
    zones, actuators, _ = model.operator.shape
    matrix: list[list[Json | None]] = [[None] * actuators for _ in range(zones)]
    for z, a, pair in model.operator.each():
        hours, answer = step_answer(pair)
        every = max(1, hours.size // 200)
        cell: Json = {
            "hours": _rounded(hours[::every]), "K": _rounded(answer[::every]), "full": full_level_of(pair),
        }  # fmt: skip
        mean, sd = step_response_of(model, z, a)
        if mean.size:
            cell |= {
                "at": [0, *STEP_RESPONSE_H],
                "mean": _rounded(mean),
                "low": _rounded(mean - BAND * sd),
                "high": _rounded(mean + BAND * sd),
            }
        matrix[z][a] = cell
    return matrix


def _rounded(values: Array) -> Sequence[float]:
    return [round(float(value), 4) for value in values]
