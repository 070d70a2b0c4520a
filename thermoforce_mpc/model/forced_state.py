"""The forced state F over a past record and during a run (paper, below eq:arx).

The operator predicts F from the delivered heat; the rest of the temperature is the free response, T = F + (T − F), so
heat is counted once for any F. The whole one-step prediction error goes to the free part, an output disturbance: a
constant model error leaves no lasting offset, because the free forecast starts from the last T − F.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.data.limits import ROUNDING
from thermoforce_mpc.data.series import held
from thermoforce_mpc.data.superposition import control_free
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import ZONE, feature_matrix

InitialForce = Literal["steady", "zero"]

# Fixed-point iterations for the initial forced state; the modulation changes it by a few percent only.
_START_ROUNDS = 5


def forced_history(operator: BuildingOperator, history: Record, *, initial_force: InitialForce = "steady") -> Array:
    """Return the forced state of each pair at each boundary of `history` (paper, below eq:arx), (Z, A, n + 1, r), K.

    The modulation uses T − F of the rollout; a missing temperature is held at its last value. Where heat was measured
    in identification, measured heat is used instead of the level, under native control too. Raises as `heat_drive`.
    """
    n = history.n_steps
    Z, A, r = operator.shape
    if n == 0:
        return np.zeros((Z, A, 1, r))
    operator = operator.resampled(history.step_s)
    heat = heat_drive(operator, history, 0, n)
    T_zone = held_C(history.T_zone_C)
    features = feature_matrix(T_zone[:, :-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])
    forced = np.empty((Z, A, n + 1, r))
    forced[:, :, 0] = _steady_start(operator, heat, features) if initial_force == "steady" else 0.0
    if operator.constant_modulation:  # all steps at once
        drive = heat * operator.modulated(np.ones(A), features[:, 0], forced[:, :, 0])[:, None]
        forced[:, :, 1:] = operator.driven(forced[:, :, 0], drive)
        return forced
    for t in range(n):
        features[:, t, ZONE] = control_free(T_zone[:, t], forced[:, :, t].sum(axis=(1, 2)))
        forced[:, :, t + 1] = operator.advance(
            forced[:, :, t], operator.modulated(heat[:, t], features[:, t], forced[:, :, t])
        )
    return forced


def heat_drive(operator: BuildingOperator, history: Record, start: int, stop: int) -> Array:
    """Return v of each actuator over the steps `start` … `stop` − 1, (A, stop − start), from measured heat if any.

    Identification is driven by v(u) instead; `identification.estimation.regression` says why. Raises
    `DataError`, with the step, where the weather or u without measured heat has gaps, or u leaves [0, 1].
    """
    T_out, solar = history.T_out_C[start : stop + 1], history.solar_W_m2[start : stop + 1]
    rows = []
    for a, head in enumerate(operator.of_actuators):
        heat_W, u = history.heat_W[a, start:stop], history.u[a, start:stop]
        measured = np.isfinite(heat_W) & (head.heat_input.law is not None)
        u = np.where(measured & ~np.isfinite(u), 0.0, u)  # u is not used there
        label = history.names.label("u", a)
        for name, values in ((label, u), ("T_out_C", T_out), ("solar_W_m2", solar)):
            if not np.isfinite(values).all():
                gaps = np.flatnonzero(~np.isfinite(values))
                raise DataError(
                    f"history: {name} is not finite at step {start + gaps[0]} of {history.n_steps} ({gaps.size} such): "
                    "bridge it first (thermoforce_mpc.data.series)"
                )
        # Means over a step can exceed 1 by rounding.
        u_min = head.heat_input.u_min
        outside = np.flatnonzero((u < u_min - ROUNDING) | (u > 1 + ROUNDING))
        if outside.size:
            at = start + outside[0]
            raise DataError(f"history: {label} is {u[outside[0]]:.10g} at step {at}, expected values in [{u_min:g}, 1]")
        heat = head.heat_input(np.clip(u, u_min, 1.0), T_out[:-1])
        rows.append(np.where(measured, head.heat_input.of_meter(head.sign * heat_W, T_out[:-1]), heat))
    return np.stack(rows)


def _steady_start(operator: BuildingOperator, heat: Array, features: Array) -> Array:
    """Return the steady forced state under the first day's mean drive, shape (Z, A, r), K."""
    day = max(1, min(heat.shape[-1], round(DAY_S / operator.step_s)))
    heat, features = heat[:, :day], features[:, :day].copy()
    T_zone = features[..., ZONE].copy()
    forced = operator.steady_gains_K * heat.mean(axis=1)[:, None]
    for _ in range(_START_ROUNDS):
        features[..., ZONE] = control_free(T_zone, forced.sum(axis=(1, 2))[:, None])
        drive = [
            float(np.mean(head.modulation(head.seen(features[z], forced[z, a])) * heat[a]))
            for a, (z, head) in enumerate(zip(operator.home, operator.of_actuators, strict=True))
        ]
        forced = operator.steady_gains_K * np.array(drive)[:, None]
    return np.asarray(forced)


def held_C(T_zone_C: Array) -> Array:
    """`T_zone_C` (Z, n) with each gap filled by the last finite value (at the start, by the first).

    A zone that was never measured has the mean of the others, 0 where none was.
    """
    measured = np.isfinite(T_zone_C).any(axis=1)
    filled = np.zeros_like(T_zone_C)
    if measured.any():
        filled[measured] = [held(row) for row in T_zone_C[measured]]
        filled[~measured] = filled[measured].mean(axis=0)
    return filled


@dataclass(frozen=True)
class ForcedState:
    """Forced state of each pair, `forced_K` (Z, A, n + 1, r), at the boundaries `time_s` (n + 1,) of a run so far."""

    time_s: Array
    forced_K: Array

    def __post_init__(self) -> None:
        for array in (self.time_s, self.forced_K):
            array.setflags(write=False)

    def since(self, time_s: float) -> ForcedState:
        """Without what was before `time_s`, s; itself where nothing was, or nothing would be left."""
        first = int(np.searchsorted(self.time_s, time_s - 0.5))
        if first == 0 or first >= self.time_s.size:
            return self
        return replace(self, time_s=self.time_s[first:], forced_K=self.forced_K[:, :, first:])


def followed(
    operator: BuildingOperator, state: ForcedState | None, history: Record, initial_force: InitialForce = "steady"
) -> ForcedState:
    """The forced state after all of `history`; a history that does not continue `state` is rolled out anew.

    Only steps since `state` (None begins a run) are computed. A history that begins later than `state` did continues
    it. `history` has no gaps in weather and levels; `initial_force` as in `Predictor`; raises as `forced_history`.
    """
    state = state.since(float(history.time_s[0])) if state else None
    n_known = state.time_s.size if state else 0
    if (
        state is None
        or n_known > history.time_s.size
        or not np.array_equal(history.time_s[:n_known], state.time_s)
        or (n_known == 1 and history.n_steps)  # F starts from the first day, not yet known
    ):
        return ForcedState(history.time_s, forced_history(operator, history, initial_force=initial_force))
    if n_known == history.time_s.size:
        return state
    operator = operator.resampled(history.step_s)
    rows = [state.forced_K[:, :, -1]]
    for t in range(n_known - 1, history.n_steps):
        before, heat = rows[-1], heat_drive(operator, history, t, t + 1)[:, 0]
        T_C = history.T_zone_C[:, t]
        T_C = T_C if np.isfinite(T_C).all() else held_C(history.T_zone_C[:, : t + 1])[:, -1]
        free_C = control_free(T_C, before.sum(axis=(1, 2)))
        features = feature_matrix(free_C, history.T_out_C[t], history.solar_W_m2[t], history.time_s[t])
        rows.append(operator.advance(before, operator.modulated(heat, features, before)))
    forced_K = np.concatenate([state.forced_K, np.stack(rows[1:], axis=2)], axis=2)
    return ForcedState(history.time_s, forced_K)
