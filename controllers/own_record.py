"""A zone as if only its own actuator acted: record and prediction with the effect of all others taken out.

Adaptation and watch judge one actuator on its home zone. What the others did to it is known from their measured levels
and the model, so it is subtracted from the temperature; for one actuator nothing is. The power of a machine that feeds
others too says nothing of one of them and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class OwnContext:
    """Prediction of a zone by its own actuator: `forced_K` (r,), `free` (Q, N) and `features` (N, 4)."""

    forced_K: Array
    free: FreeForecast
    features: Array
    boundary: Boundary


def own_context(context: PredictionContext, a: int) -> OwnContext:
    """The prediction of actuator `a` on its home zone."""
    z = context.operator.home[a]
    free = FreeForecast(context.free.levels, context.free.quantiles_C[:, z], context.free.note)
    return OwnContext(context.forced_K[z, a], free, context.features[z], context.boundary)


def own_record(model: ThermalModel, history: Record, forced_K: Array | None, a: int) -> Record:
    """The record of actuator `a` on its home zone.

    Args:
        model: the building.
        history: its record, n steps.
        forced_K: forced states (Z, A, k + 1, r) at its first k + 1 boundaries; beyond, the temperature is left out.
        a: the actuator.
    """
    z = model.operator.home[a]
    m = model.machine_of[a]
    part = history.part(z, [a], [m] if model.machine_of.count(m) == 1 else [])
    others = [b for b in range(len(model.operator.actuators)) if b != a and model.operator.pairs[z][b] is not None]
    if not others:
        return part
    T = np.full(history.n_steps + 1, np.nan)
    if forced_K is not None:
        known = min(forced_K.shape[2], T.size)
        T[:known] = part.T_zone_C[0, :known] - forced_K[z, others, :known].sum(axis=(0, 2))
    return replace(part, T_zone_C=T)
