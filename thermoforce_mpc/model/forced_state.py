"""The forced state F during a run, step by step.

The operator predicts F from the delivered heat (paper, below eq:arx); the rest of the temperature is the free response,
T = F + (T − F), so heat is counted once for any F. The whole one-step prediction error goes to the free part, an output
disturbance: a constant model error leaves no lasting offset, because the free forecast starts from the last T − F.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.model.forced_history import InitialForce, forced_history, heat_drive
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.features import feature_matrix


@dataclass(frozen=True)
class ForcedState:
    """Forced state of a run so far.

    `time_s` (n + 1,): boundaries of the processed history. `forced_K` (Z, A, n + 1, r): forced state of each pair.
    """

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

    Only steps since `state` are computed. A history that begins later than `state` did continues it.

    Args:
        operator: operator at any step length.
        state: that of the run so far; None begins a run.
        history: the record until now, without gaps in weather and levels.
        initial_force: initial value of F, see `Predictor`.

    Raises:
        DataError: see `forced_history`.
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
        rows.append(_advanced(operator, history, t, rows[-1]))
    forced_K = np.concatenate([state.forced_K, np.stack(rows[1:], axis=2)], axis=2)
    return ForcedState(history.time_s, forced_K)


def _advanced(operator: BuildingOperator, history: Record, t: int, before: Array) -> Array:
    """The forced state (Z, A, r) after step `t`, from that before it."""
    heat = heat_drive(operator, history, t, t + 1)[:, 0]
    free_C = _last_known_C(history.T_zone_C[:, : t + 1]) - before.sum(axis=(1, 2))
    features = feature_matrix(free_C, history.T_out_C[t], history.solar_W_m2[t], history.time_s[t])
    return np.asarray(operator.poles * before + operator.gains * operator.modulated(heat, features, before)[:, None])


def _last_known_C(T_zone_C: Array) -> Array:
    """The last finite temperature (Z,) of `T_zone_C` (Z, n); without one the mean of the other zones, or 0."""
    rows = [row[np.isfinite(row)] for row in T_zone_C]
    last = [float(row[-1]) for row in rows if row.size]
    mean = float(np.mean(last)) if last else 0.0
    return np.array([row[-1] if row.size else mean for row in rows])
