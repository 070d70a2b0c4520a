"""A zone as if only its own actuator acted: record and prediction with the effect of all others taken out.

Adaptation and watch take one actuator on its home zone. What the others did to it is known from their measured levels
and the model, so it is subtracted from the temperature; for one actuator nothing is. The power of a machine that feeds
others too says nothing of one of them and is left out, and so does the level of an actuator while they all need more
than the machine has: what it got is in its heat meter, if anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.limits import ROUNDING
from thermoforce_mpc.data.superposition import control_free
from thermoforce_mpc.identification.effects.couplings import largest_W
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel


@dataclass(frozen=True)
class SingleActuatorContext:
    """Prediction of a zone by its own actuator: `forced_K` (r,), `free` (Q, N) and `features` (N, 4)."""

    forced_K: Array
    free: FreeForecast
    features: Array
    boundary: Boundary


def single_actuator_context(context: PredictionContext, a: int) -> SingleActuatorContext:
    """The prediction of actuator `a` on its home zone."""
    z = context.operator.home[a]
    free = FreeForecast(context.free.levels, context.free.quantiles_C[:, z], context.free.note)
    forced_K = context.forced_K[z, a, : context.operator.of_actuator(a).order]
    return SingleActuatorContext(forced_K, free, context.features[z], context.boundary)


def single_actuator_records(model: ThermalModel, history: Record, forced_K: Array | None) -> tuple[Record, ...]:
    """The record of each actuator on its home zone (A,).

    Args:
        model: the building.
        history: its record, n steps.
        forced_K: forced states (Z, A, k + 1, r) at its first k + 1 boundaries; beyond, the temperature is left out.
    """
    shared = {m for m in model.machine_of if model.machine_of.count(m) > 1}
    beyond = {m: _beyond_capacity(model, history, m) for m in shared}
    return tuple(_zone_record(model, history, forced_K, a, beyond) for a in range(len(model.operator.actuators)))


def _zone_record(
    model: ThermalModel, history: Record, forced_K: Array | None, a: int, beyond: Mapping[int, NDArray[np.bool_]]
) -> Record:
    """See `single_actuator_records`; `beyond`: steps (n,) beyond the capacity of each machine that feeds several."""
    z = model.operator.home[a]
    m = model.machine_of[a]
    record = history.part(z, [a], [] if m in beyond else [m])
    if m in beyond:
        record = replace(record, u=np.where(beyond[m], np.nan, record.u))
    others = [b for b in range(len(model.operator.actuators)) if b != a and model.operator.pairs[z][b] is not None]
    if not others:
        return record
    T = np.full(history.n_steps + 1, np.nan)
    if forced_K is not None:
        n_known = min(forced_K.shape[2], T.size)
        T[:n_known] = control_free(record.T_zone_C[0, :n_known], forced_K[z, others, :n_known].sum(axis=(0, 2)))
    return replace(record, T_zone_C=T)


def _beyond_capacity(model: ThermalModel, history: Record, m: int) -> NDArray[np.bool_]:
    """Steps (n,) in which the actuators of machine `m` may together have needed more than it has.

    A level may be the share of a step in which an actuator is on, so all that act count in full. Where all are metered,
    what they take when it is cold is in the maps of their heat, and what the machine has is the most of an hour so far.
    """
    if not history.n_steps:  # the length of a step is unknown
        return np.zeros(0, dtype=bool)
    fed = [b for b, machine in enumerate(model.machine_of) if machine == m]
    acting = history.u[fed] > ROUNDING
    maps = [model.operator.of_actuator(b).heat_input.law for b in fed]
    shares = np.array([model.shares[b] for b in fed])
    if any(heat_map is None for heat_map in maps):
        return np.asarray(shares @ acting > 1.0 + ROUNDING)
    full_W = np.abs(
        [heat_map(np.ones(history.n_steps), history.T_out_C[:-1]) for heat_map in maps if heat_map is not None]
    )
    most_W = largest_W(np.abs(history.heat_W[fed].sum(axis=0)), history.step_s)
    return np.asarray((full_W * acting).sum(axis=0) > most_W)
