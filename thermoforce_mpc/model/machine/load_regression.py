"""What fits of heat and of electric power share: usable steps, levels to try, and a law affine in T_out by its ends.

Both are `MachineLoad`: a fixed part while on and a part that follows u, each affine in the outdoor temperature. Such a
law is nonnegative on an interval exactly when it is at both ends, so the unknowns are the values there, bounded below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad

# A level between these shares of full is an intermediate level; outside, off or full.
LEVEL_EDGE = 0.02
# Bound of the end values, a hair above zero so that rounding in the affine law cannot make a load negative.
LEAST_W = 1e-3
# Intermediate samples needed before the fixed and the proportional part can be told apart.
_MIN_LEVELS = 3
_MIN_STEPS, _MIN_RUNNING = 10, 5
# Share of full load that a step's measurement is off by (dynamics inside the step, what the law leaves out).
RESIDUAL_SCALE = 0.02
# How far beyond the outdoor temperatures seen the affine law is trusted, K; beyond, its value there is held.
_TRUST_K = 15.0


@dataclass(frozen=True)
class Steps:
    """Usable steps: `u`, `T_out_C` °C, `load_W` W and whether the machine ran, all (n,); `kept` of the steps given."""

    u: Array
    T_out_C: Array
    load_W: Array
    running: NDArray[np.bool_]
    kept: NDArray[np.bool_]


def usable_steps(u: Array, T_out_C: Array, load_W: Array, what: str) -> Steps:
    """Steps where all was measured; raises `DataError` where they are too few or the machine hardly ran."""
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, load_W))
    kept = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if kept.sum() < _MIN_STEPS:
        raise DataError(f"{what}: only {int(kept.sum())} of {u.size} steps were measured, need at least {_MIN_STEPS}")
    u, T, y = u[kept], T[kept], y[kept]
    running = u > LEVEL_EDGE
    if running.sum() < _MIN_RUNNING or np.mean(y[running]) <= 0:
        raise DataError(
            f"{what}: the actuator was on in {int(running.sum())} measured steps, need at least {_MIN_RUNNING}"
        )
    return Steps(u, T, y, running, kept)


def levels_to_try(steps: Steps, lowest_level: float | None) -> list[float]:
    """The lowest level given, or those of an on/off machine (1) and of one that runs at the lowest level seen."""
    if lowest_level is not None:
        return [lowest_level]
    between = steps.running & (steps.u < 1.0 - LEVEL_EDGE)
    return [1.0] + ([float(np.min(steps.u[between]))] if between.sum() >= _MIN_LEVELS else [])


@dataclass(frozen=True)
class EndValues:
    """Affine laws of T_out on [`low_C`, `high_C`] by their values at both ends; `middle_C` of what was seen."""

    low_C: float
    high_C: float
    middle_C: float

    @classmethod
    def around(cls, steps: Steps) -> EndValues:
        """The range of the outdoor temperatures while running, and what lies near it."""
        T = steps.T_out_C[steps.running]
        low, high = float(T.min()), float(T.max())
        return cls(low - _TRUST_K, high + _TRUST_K, 0.5 * (low + high))

    def weights(self, T_out_C: Array | float) -> Array:
        """Weights of the two end values at `T_out_C`, shape (…, 2); outside the range those of the nearer end."""
        share = (np.clip(T_out_C, self.low_C, self.high_C) - self.low_C) / (self.high_C - self.low_C)
        return np.stack([1.0 - share, share], axis=-1)

    def sloping(self, mean_per_K: float) -> Array:
        """Slope minus `mean_per_K` times the value in the middle, as weights of the end values, shape (2,)."""
        return np.array([-1.0, 1.0]) / (self.high_C - self.low_C) - mean_per_K * self.weights(self.middle_C)

    def load(self, ends_W: Array, lowest_level: float) -> MachineLoad:
        """The load whose parts have the end values `ends_W`: (fixed, per u), or per u alone for an on/off machine."""
        laws = []
        for at_low, at_high in np.reshape(ends_W, (-1, 2)):
            slope = (at_high - at_low) / (self.high_C - self.low_C)
            laws.append((float(at_low - slope * self.low_C), float(slope)))
        fixed, per_u = laws if len(laws) == 2 else [(0.0, 0.0), *laws]
        return MachineLoad(
            coefficients=(*fixed, *per_u),
            T_out_range_C=(self.low_C, self.high_C),
            lowest_level=lowest_level,
            levels_seen=len(laws) == 2,
        )


@dataclass(frozen=True)
class Quality:
    """How good a fit is: `rmse_W`, `bias_W` over `n_running` steps, `r2` over all `n_samples`."""

    rmse_W: float
    bias_W: float
    r2: float
    n_samples: int
    n_running: int

    @classmethod
    def of(cls, fitted_W: Array, steps: Steps) -> Quality:
        """Of `fitted_W` (n,) against what was measured."""
        error = fitted_W - steps.load_W
        variance = float(np.var(steps.load_W))
        return cls(
            rmse_W=float(np.sqrt(np.mean(error[steps.running] ** 2))),
            bias_W=float(np.mean(error[steps.running])),
            r2=1.0 - float(np.mean(error**2)) / variance if variance > 0 else float("nan"),
            n_samples=int(steps.u.size),
            n_running=int(steps.running.sum()),
        )
