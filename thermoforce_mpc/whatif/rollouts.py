"""Rollouts of a model over a record, as of the one that it was identified from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Observation, Record, steps_in
from thermoforce_mpc.data.series import bridged
from thermoforce_mpc.model.free_response.rc import RcFreeResponse
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.model.thermal_model import ThermalModel

ROLLOUT_H = 12.0
"""Start of the first rollout and length of each, h."""


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
    n = steps_in(ROLLOUT_H * HOUR_S, record.step_s)
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
