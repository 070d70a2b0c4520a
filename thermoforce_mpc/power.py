"""Total electric power as a function of the action: a fixed part while on, a part that follows u, both with T_out.

P(u, T_out) = on·(c0 + c1·T_out) + u·(c2 + c3·T_out). A model without the fixed part believes that running slowly is
cheap; on a machine with losses that do not scale with speed that costs a controller a quarter of the energy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.operator.actuator import OnLoad
from thermoforce_mpc.types import Array, History

# A level between these shares of full is an intermediate level; outside, off or full.
_LEVEL_EDGE = 0.02
# Intermediate samples needed before the fixed and the proportional part count as known apart.
_MIN_LEVELS = 8
# Bound below, a hair above zero so that rounding in the affine law cannot make a load negative.
_LEAST_W = 1e-3
# An outdoor range narrower than this cannot tell a slope from a constant.
_MIN_RANGE_K = 2.0


@dataclass(frozen=True)
class LoadFit:
    """A fitted load and how good it is: `rmse_W`, `bias_W` over `n_samples` steps while on, `r2` over all steps."""

    load: OnLoad
    rmse_W: float
    bias_W: float
    r2: float
    n_samples: int


@dataclass(frozen=True)
class PowerModel:
    """P(u, T_out) in W with the quality of its fit; `load.coefficients` (c0 … c3) are what a controller needs."""

    load: OnLoad
    rmse_W: float = float("nan")
    r2: float = float("nan")
    source: str = "given"

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """Mean electric power over a step for `u` in [0, 1] at `T_out_C` °C (shapes broadcast), W."""
        return self.load(u, T_out_C)

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """(c0, c1, c2, c3) in W, W/K, W, W/K."""
        return self.load.coefficients


def fit_power(history: History, *, lowest_level: float | None = None) -> PowerModel:
    """Fit the power model to the measured power of a probe; see `fit_load` for arguments and errors."""
    fit = fit_load(history.u, history.T_out_C[:-1], history.power_W, what="electric power", lowest_level=lowest_level)
    return PowerModel(load=fit.load, rmse_W=fit.rmse_W, r2=fit.r2, source=f"fitted to {fit.n_samples} steps")


def fit_load(u: Array, T_out_C: Array, load_W: Array, *, what: str, lowest_level: float | None = None) -> LoadFit:
    """Least squares for `OnLoad`, with both parts kept nonnegative over the outdoor range seen.

    Args:
        u: mean control over each step, shape (n,), in [0, 1].
        T_out_C: outdoor temperature at the start of each step, shape (n,), °C.
        load_W: measured mean load over each step, shape (n,), W; NaN where silent.
        what: name of the load for messages.
        lowest_level: level below which the machine switches; by default the lowest level above 2 % in the data when
            there are intermediate ones, else 1 (an on/off machine, whose fixed and proportional parts are one).

    Raises:
        DataError: fewer than ten usable steps, or the load was never on.
    """
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, load_W))
    usable = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if usable.sum() < 10:
        raise DataError(f"{what}: only {int(usable.sum())} of {u.size} steps were measured, need at least 10")
    u, T, y = u[usable], T[usable], y[usable]
    running = u > _LEVEL_EDGE
    if running.sum() < 5 or np.mean(y[running]) <= 0:
        raise DataError(f"{what}: the actuator was on in {int(running.sum())} measured steps, need at least 5")
    levels = running & (u < 1.0 - _LEVEL_EDGE)
    if lowest_level is None:
        lowest_level = float(np.min(u[levels])) if levels.sum() >= _MIN_LEVELS else 1.0
    levels_seen = lowest_level < 1.0
    on = np.minimum(u / lowest_level, 1.0)
    T_low, T_high = float(T.min()), float(T.max())
    with_slope = T_high - T_low >= _MIN_RANGE_K

    # An affine law is nonnegative on an interval exactly when it is at both ends: fit the end values, bounded below.
    share = (T - T_low) / (T_high - T_low) if with_slope else np.zeros_like(T)
    carriers = [on, u] if levels_seen else [u]
    columns = [c * w for c in carriers for w in ((1.0 - share, share) if with_slope else (np.ones_like(T),))]
    design = np.stack(columns, axis=1)
    solution = lsq_linear(design, y, bounds=(_LEAST_W, np.inf))
    ends = iter(solution.x)
    parts: list[tuple[float, float]] = []
    for _ in carriers:
        at_low = float(next(ends))
        at_high = float(next(ends)) if with_slope else at_low
        slope = (at_high - at_low) / (T_high - T_low) if with_slope else 0.0
        parts.append((at_low - slope * T_low, slope))
    fixed = parts[0] if levels_seen else (0.0, 0.0)
    proportional = parts[-1]
    residual = design @ solution.x - y
    variance = float(np.var(y))
    return LoadFit(
        load=OnLoad(
            coefficients=(*fixed, *proportional),
            T_out_range_C=(T_low, T_high),
            lowest_level=lowest_level,
            levels_seen=levels_seen,
        ),
        rmse_W=float(np.sqrt(np.mean(residual[running] ** 2))),
        bias_W=float(np.mean(residual[running])),
        r2=1.0 - float(np.mean(residual**2)) / variance if variance > 0 else float("nan"),
        n_samples=int(u.size),
    )
