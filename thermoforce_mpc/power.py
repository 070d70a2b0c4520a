"""Total electric power as a function of the action: a fixed part while on, a part that follows u, both with T_out.

P(u, T_out, T_return) = [on·(c0 + c1·T_out) + u·(c2 + c3·T_out)]·(1 + κ (T_return − reference)), the last factor where
the return water's temperature is measured (`return_water.py`). A model without the fixed part believes that running
slowly is cheap; on a machine with losses that do not scale with speed that costs a controller a quarter of the energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.operator.actuator import OnLoad
from thermoforce_mpc.return_water import ReturnWater, fit_return_water
from thermoforce_mpc.types import Array, History

# A level between these shares of full is an intermediate level; outside, off or full.
_LEVEL_EDGE = 0.02
# Intermediate samples needed before the fixed and the proportional part can be told apart.
_MIN_LEVELS = 3
# Bound below, a hair above zero so that rounding in the affine law cannot make a load negative.
_LEAST_W = 1e-3
# How far beyond the outdoor temperatures seen the affine law is trusted, K; beyond, its value there is held.
_TRUST_K = 15.0
# Share of full load that a step's measurement is off by (dynamics inside the step, return temperature).
_MISFIT = 0.02


@dataclass(frozen=True)
class SlopePrior:
    """What is believed about (1/load) · d load/d T_out before measuring: mean and standard deviation, 1/K.

    A few days of one season say little about it, and the days to be planned for are colder or warmer.
    """

    mean_per_K: float
    sd_per_K: float


POWER_SLOPE = SlopePrior(0.0, 0.015)
"""Electric power at a given speed hardly depends on the outdoor temperature."""


@dataclass(frozen=True)
class LoadFit:
    """A fitted load and how good it is: `rmse_W`, `bias_W` over `n_running` steps, `r2` over all `n_samples`."""

    load: OnLoad
    rmse_W: float
    bias_W: float
    r2: float
    n_samples: int
    n_running: int


@dataclass(frozen=True)
class PowerModel:
    """P(u, T_out, T_return) in W with the quality of its fit; `load.coefficients` are (c0 … c3).

    `water` says how the power follows the return water; None where that was not measured.
    """

    load: OnLoad
    rmse_W: float = float("nan")
    r2: float = float("nan")
    source: str = "given"
    water: ReturnWater | None = None

    def __call__(self, u: Array, T_out_C: Array, T_return_C: Array | float = float("nan")) -> Array:
        """Mean electric power over a step for `u` in [0, 1] at `T_out_C` and return water at `T_return_C` °C, W.

        Shapes broadcast. Where the return temperature is NaN it is taken to be the one of the fit.
        """
        return np.asarray(self.load(u, T_out_C) * self._factor(T_return_C))

    def parts(self, T_out_C: Array, T_return_C: Array | float = float("nan")) -> tuple[Array, Array]:
        """The part that is fixed while on and the part per unit of u, both W; see `OnLoad.parts`."""
        fixed, per_u = self.load.parts(T_out_C)
        factor = self._factor(T_return_C)
        return np.asarray(fixed * factor), np.asarray(per_u * factor)

    def at_lowest_level(self, lowest_level: float) -> PowerModel:
        """The same machine actuated with another lowest level, see `OnLoad.at_lowest_level`."""
        return replace(self, load=self.load.at_lowest_level(lowest_level))

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """(c0, c1, c2, c3) in W, W/K, W, W/K."""
        return self.load.coefficients

    def _factor(self, T_return_C: Array | float) -> Array:
        T_return = np.asarray(T_return_C, dtype=np.float64)
        return np.ones_like(T_return) if self.water is None else self.water.factor(T_return)


def fit_power(
    histories: Sequence[History], *, lowest_level: float | None = None, slope: SlopePrior = POWER_SLOPE
) -> PowerModel:
    """Fit the power model to the measured power of probes; see `fit_load` for arguments and errors."""
    u, T_out, power, T_return, T_zone = (
        np.concatenate([values(history) for history in histories])
        for values in (
            lambda h: h.u,
            lambda h: h.T_out_C[:-1],
            lambda h: h.power_W,
            lambda h: h.T_return_C,
            lambda h: h.T_zone_C[:-1],
        )
    )

    def fit(factor: Array) -> LoadFit:
        what = "electric power"
        return fit_load(u, T_out, power, what=what, lowest_level=lowest_level, slope=slope, factor=factor)

    plain = fit(np.ones_like(u))
    full_W = float(np.nanmax(power))
    water = fit_return_water(
        T_return, T_zone, u, lambda factor: fit(factor).rmse_W ** 2 * plain.n_running, full_W=full_W
    )
    found = plain if water is None else fit(water.factor(T_return))
    return PowerModel(found.load, found.rmse_W, found.r2, f"fitted to {found.n_samples} steps", water)


def fit_load(
    u: Array,
    T_out_C: Array,
    load_W: Array,
    *,
    what: str,
    lowest_level: float | None = None,
    slope: SlopePrior | None = None,
    factor: Array | None = None,
) -> LoadFit:
    """Least squares for `OnLoad`, with both parts kept nonnegative over the outdoor range it is valid for.

    Args:
        u: mean control over each step, shape (n,), in [0, 1].
        T_out_C: outdoor temperature at the start of each step, shape (n,), °C.
        load_W: measured mean load over each step, shape (n,), W; NaN where silent.
        what: name of the load for messages.
        lowest_level: level below which the machine switches. By default both an on/off machine (1, where fixed and
            proportional part are one) and one with the lowest level in the data are tried, and the better fit kept.
        slope: prior on the dependence on T_out; none by default.
        factor: what the load is known to be multiplied by in each step, shape (n,); 1 by default.

    Raises:
        DataError: fewer than ten usable steps, or the load was on in fewer than five.
    """
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, load_W))
    times = np.ones_like(y) if factor is None else np.asarray(factor, dtype=np.float64)
    usable = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if usable.sum() < 10:
        raise DataError(f"{what}: only {int(usable.sum())} of {u.size} steps were measured, need at least 10")
    u, T, y, times = u[usable], T[usable], y[usable], times[usable]
    running = u > _LEVEL_EDGE
    if running.sum() < 5 or np.mean(y[running]) <= 0:
        raise DataError(f"{what}: the actuator was on in {int(running.sum())} measured steps, need at least 5")
    levels = running & (u < 1.0 - _LEVEL_EDGE)
    if lowest_level is not None:
        candidates = [lowest_level]
    else:
        candidates = [1.0] + ([float(np.min(u[levels]))] if levels.sum() >= _MIN_LEVELS else [])
    fits = [_fit_at(u, T, y, times, lowest, running, slope) for lowest in candidates]
    return min(fits, key=lambda fit: fit.rmse_W)


def _fit_at(
    u: Array,
    T: Array,
    y: Array,
    times: Array,
    lowest_level: float,
    running: NDArray[np.bool_],
    slope: SlopePrior | None,
) -> LoadFit:
    levels_seen = lowest_level < 1.0
    on, level = times * np.minimum(u / lowest_level, 1.0), times * u
    seen_low, seen_high = float(T[running].min()), float(T[running].max())
    low, high = seen_low - _TRUST_K, seen_high + _TRUST_K
    middle = 0.5 * (seen_low + seen_high)

    # An affine law is nonnegative on an interval exactly when it is at both ends: fit the end values, bounded below.
    share = (np.clip(T, low, high) - low) / (high - low)
    carriers = [on, level] if levels_seen else [level]
    design = np.stack([c * w for c in carriers for w in (1.0 - share, share)], axis=1)
    full = float(np.max(y[running]))
    rows: list[Array] = [design / (_MISFIT * full)]
    values: list[Array] = [y / (_MISFIT * full)]
    if slope is not None:
        # Slope minus mean times the value in the middle is zero, give or take; the load's own size sets the scale.
        at_middle = (middle - low) / (high - low)
        relation = np.array([-1.0, 1.0]) / (high - low) - slope.mean_per_K * np.array([1.0 - at_middle, at_middle])
        per_part = slope.sd_per_K * full / len(carriers)
        rows.append(np.asarray(np.kron(np.eye(len(carriers)), relation) / per_part))
        values.append(np.zeros(len(carriers)))
    solution = lsq_linear(np.concatenate(rows), np.concatenate(values), bounds=(_LEAST_W, np.inf)).x
    parts = [
        (at_low - (at_high - at_low) / (high - low) * low, (at_high - at_low) / (high - low))
        for at_low, at_high in solution.reshape(-1, 2)
    ]
    fixed = parts[0] if levels_seen else (0.0, 0.0)
    residual = design @ solution - y
    variance = float(np.var(y))
    return LoadFit(
        load=OnLoad(
            coefficients=(float(fixed[0]), float(fixed[1]), float(parts[-1][0]), float(parts[-1][1])),
            T_out_range_C=(low, high),
            lowest_level=lowest_level,
            levels_seen=levels_seen,
        ),
        rmse_W=float(np.sqrt(np.mean(residual[running] ** 2))),
        bias_W=float(np.mean(residual[running])),
        r2=1.0 - float(np.mean(residual**2)) / variance if variance > 0 else float("nan"),
        n_samples=int(u.size),
        n_running=int(running.sum()),
    )
