"""The step response of an actuator at full level in a zone: as a model has it, and as its identification knows it."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel


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
