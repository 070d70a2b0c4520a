"""Regression common to heat and electric power: usable steps, lowest levels to try, and affine laws of T_out.

An affine law is nonnegative on an interval exactly if it is at both ends, so the unknowns are the end values, bounded
below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import MachineLoad

# A level in (LEVEL_EDGE, 1 − LEVEL_EDGE) is intermediate; outside it is off or full.
LEVEL_EDGE = 0.02
# Lower bound of the end values, W, above zero so that rounding cannot make a load negative.
LEAST_W = 1e-3
# Least number of intermediate samples to separate the fixed and the proportional part.
_MIN_LEVELS = 3
_MIN_STEPS, LEAST_RUNNING = 10, 5
# Standard deviation of a step's error as a share of full load (dynamics inside the step, model error).
RESIDUAL_SCALE = 0.02
# Extrapolation of the affine law beyond the outdoor temperatures of the data, K; beyond, its value is held.
TRUST_K = 15.0


@dataclass(frozen=True)
class Steps:
    """Usable steps: `u`, `T_out_C` °C, `load_W` W and whether the machine ran, all (n,); `kept`: mask on the input."""

    u: Array
    T_out_C: Array
    load_W: Array
    running: NDArray[np.bool_]
    kept: NDArray[np.bool_]


def usable_steps(u: Array, T_out_C: Array, load_W: Array, what: str) -> Steps:
    """The fully measured steps; raises `DataError` for fewer than 10, fewer than 5 that run, or no load in these."""
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, load_W))
    kept = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if kept.sum() < _MIN_STEPS:
        raise DataError(f"{what}: only {int(kept.sum())} of {u.size} steps were measured, need at least {_MIN_STEPS}")
    u, T, y = u[kept], T[kept], y[kept]
    running = u > LEVEL_EDGE
    if running.sum() < LEAST_RUNNING:
        raise DataError(
            f"{what}: the actuator was on in {int(running.sum())} measured steps, need at least {LEAST_RUNNING}"
        )
    mean_W = float(np.mean(y[running]))
    if mean_W <= 0.0:
        raise DataError(f"{what}: its mean while the actuator was on is {mean_W:.4g} W: check the meter and its sign")
    return Steps(u, T, y, running, kept)


def levels_to_try(steps: Steps, lowest_level: float | None) -> list[float]:
    """Return the given lowest level, or 1 (on/off machine) and the lowest intermediate level in the data."""
    if lowest_level is not None:
        return [lowest_level]
    between = steps.running & (steps.u < 1.0 - LEVEL_EDGE)
    return [1.0] + ([float(np.min(steps.u[between]))] if between.sum() >= _MIN_LEVELS else [])


@dataclass(frozen=True)
class EndValues:
    """Affine laws of T_out on [`low_C`, `high_C`] by their end values; `middle_C` is the middle of the data."""

    low_C: float
    high_C: float
    middle_C: float

    @classmethod
    def around(cls, steps: Steps) -> EndValues:
        """Return the range of outdoor temperatures while running, extended by 15 K on both sides."""
        T = steps.T_out_C[steps.running]
        low, high = float(T.min()), float(T.max())
        return cls(low - TRUST_K, high + TRUST_K, 0.5 * (low + high))

    def weights(self, T_out_C: Array | float) -> Array:
        """Return the weights of the two end values at `T_out_C`, shape (…, 2); outside the range, of the nearer end."""
        share = (np.clip(T_out_C, self.low_C, self.high_C) - self.low_C) / (self.high_C - self.low_C)
        return np.stack([1.0 - share, share], axis=-1)

    def sloping(self, mean_per_K: float) -> Array:
        """Return slope − `mean_per_K` times the value in the middle, as weights of the end values, shape (2,)."""
        return np.array([-1.0, 1.0]) / (self.high_C - self.low_C) - mean_per_K * self.weights(self.middle_C)

    def load(self, ends_W: Array, lowest_level: float, curve_W: float = 0.0) -> MachineLoad:
        """Return the load with end values `ends_W` of its parts: (fixed, per u), or per u only for on/off machines."""
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
            curve_W=curve_W,
        )


@dataclass(frozen=True)
class Quality:
    """Quality of a fit: `rmse_W` over `n_running` steps, `r2` over all `n_samples`."""

    rmse_W: float
    r2: float
    n_samples: int
    n_running: int

    @classmethod
    def of(cls, fitted_W: Array, steps: Steps) -> Quality:
        """Return the quality of `fitted_W` (n,) against the measured load."""
        error = fitted_W - steps.load_W
        variance = float(np.var(steps.load_W))
        return cls(
            rmse_W=float(np.sqrt(np.mean(error[steps.running] ** 2))),
            r2=1.0 - float(np.mean(error**2)) / variance if variance > 0 else float("nan"),
            n_samples=int(steps.u.size),
            n_running=int(steps.running.sum()),
        )
