"""Fitting the heat a machine gives (or takes) as a function of the action and the outdoor temperature.

A day shows few levels and a few kelvin outdoors, while plans go to full and into the cold. So the fit leans on what
machines of a kind have in common (`MachinePrior`). Which kind it is, and whether levels between off and full are run
or made by switching, the data decide by their evidence: the probability of the data under each, with all coefficients
integrated out (MacKay 1992; the bounds that keep loads positive are left out of it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.operator.actuator import OnLoad
from thermoforce_mpc.types import HOUR_S, Array

# A level between these shares of full is an intermediate level; outside, off or full.
_LEVEL_EDGE = 0.02
# Intermediate samples needed before the fixed and the proportional part can be told apart.
_MIN_LEVELS = 3
# Bound below, a hair above zero so that rounding in the affine law cannot make a load negative.
_LEAST_W = 1e-3
# How far beyond the outdoor temperatures seen the affine law is trusted, K; beyond, its value there is held.
_TRUST_K = 15.0
# Share of full heat that a step's measurement is off by (dynamics inside the step, return temperature), and how long
# such a deviation lasts, h: what the machine warms takes hours to cool again, so steps are not independent.
_MISFIT, _MISFIT_H = 0.02, 3.0
# Odds before anything is measured: of the first of several kinds against each other one, and of levels between off and
# full that are run against levels made by switching.
_FIRST_KIND, _LEVELS_ARE_RUN = 20.0, 10.0


@dataclass(frozen=True)
class MachinePrior:
    """What machines of a kind have in common, each as mean and standard deviation.

    Attributes:
        name: what a person calls this kind.
        slope: (1/load) · d load/d T_out at full, 1/K.
        fixed: share of the full heat that is there as soon as the machine runs and does not follow u.
        sag: how far full heat falls short of what the lowest levels promise, as a share of full heat; the returned
            law is straight all the same, and true at the lowest level and at full.
    """

    name: str
    slope: tuple[float, float]
    fixed: tuple[float, float]
    sag: tuple[float, float]


HEAT_PUMP = MachinePrior("heat pump", slope=(0.025, 0.0075), fixed=(0.1, 0.1), sag=(0.12, 0.06))
"""Heat of air-source heat pumps. Capacity at A−7/W35 is some 65 to 80 % of that at A7/W35 in EN 14511 data sheets. At
full, water leaves 5 K and air 3 K further from where they came (rating conditions of EN 14511), at some 1 and 2.5 %
of capacity per kelvin."""

AIR_CONDITIONER = MachinePrior("air conditioner", slope=(-0.009, 0.005), fixed=(0.1, 0.1), sag=(0.12, 0.06))
"""Cooling capacity falls by about a tenth from 35 to 46 °C outdoors (conditions T1 and T3 of ISO 5151)."""

DIRECT = MachinePrior("direct", slope=(0.0, 0.002), fixed=(0.0, 0.05), sag=(0.0, 0.02))
"""Electric heaters, boilers, coils: what they give follows u, whatever the weather."""

OTHER = MachinePrior("other", slope=(0.0, 0.03), fixed=(0.2, 0.2), sag=(0.0, 0.1))
"""Whatever is none of these: next to nothing is known beforehand."""

Machine = Literal["heat pump", "air conditioner", "direct", "other"]
KINDS: dict[str, MachinePrior] = {kind.name: kind for kind in (HEAT_PUMP, AIR_CONDITIONER, DIRECT, OTHER)}


def kinds_for(sign: int) -> tuple[MachinePrior, ...]:
    """What a machine that heats (+1) or cools (−1) may be, the likeliest first."""
    return (HEAT_PUMP if sign > 0 else AIR_CONDITIONER, DIRECT, OTHER)


@dataclass(frozen=True)
class HeatFit:
    """A fitted heat map and how good it is.

    `rmse_W` and `bias_W` over the steps while on, `r2` over all `n_samples` steps; `full_sd` the standard deviation of
    the heat at full in the middle of the outdoor temperatures seen, as a share of it; `kind` is what the machine was
    taken for, and `evidence` the logarithm of the probability of the data under it, up to a constant.
    """

    load: OnLoad
    rmse_W: float
    bias_W: float
    r2: float
    n_samples: int
    full_sd: float
    kind: str
    evidence: float


def fit_heat(
    u: Array,
    T_out_C: Array,
    heat_W: Array,
    *,
    kinds: Sequence[MachinePrior],
    step_s: float,
    lowest_level: float | None = None,
) -> HeatFit:
    """Least squares for `OnLoad`, with both parts kept nonnegative over the outdoor range it is valid for.

    Args:
        u: mean control over each step, shape (n,), in [0, 1].
        T_out_C: outdoor temperature at the start of each step, shape (n,), °C.
        heat_W: mean heat over each step, shape (n,), W, positive in the direction of the machine; NaN where silent.
        kinds: what machine it may be, the likeliest first, see `kinds_for`.
        step_s: length of a step, s.
        lowest_level: level below which the machine switches. By default both an on/off machine (1, where fixed and
            proportional part are one) and one with the lowest level in the data are tried.

    Raises:
        DataError: fewer than ten usable steps, or heat was given in fewer than five.
    """
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, heat_W))
    usable = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if usable.sum() < 10:
        raise DataError(f"delivered heat: only {int(usable.sum())} of {u.size} steps were measured, need at least 10")
    u, T, y = u[usable], T[usable], y[usable]
    running = u > _LEVEL_EDGE
    if running.sum() < 5 or np.mean(y[running]) <= 0:
        raise DataError(f"delivered heat: the actuator was on in {int(running.sum())} measured steps, need at least 5")
    levels = running & (u < 1.0 - _LEVEL_EDGE)
    if lowest_level is not None:
        candidates = [lowest_level]
    else:
        candidates = [1.0] + ([float(np.min(u[levels]))] if levels.sum() >= _MIN_LEVELS else [])
    counted_once = max(1.0, 2.0 * _MISFIT_H * HOUR_S / step_s)
    data = _Samples(u, T, y, running, _MISFIT * float(np.sqrt(counted_once)))
    fits = [_fit_at(data, lowest, kind) for kind in kinds for lowest in candidates]

    def posterior(fit: HeatFit) -> float:
        odds = (_FIRST_KIND if fit.kind == kinds[0].name else 1.0) * (_LEVELS_ARE_RUN if fit.load.levels_seen else 1.0)
        return fit.evidence + float(np.log(odds))

    return max(fits, key=posterior)


@dataclass(frozen=True)
class _Samples:
    """Usable steps: u (n,), T °C (n,), y W (n,), where the machine runs (n,); error of a step as a share of full."""

    u: Array
    T: Array
    y: Array
    running: NDArray[np.bool_]
    misfit: float


def _fit_at(data: _Samples, lowest_level: float, kind: MachinePrior) -> HeatFit:
    u, T, y = data.u, data.T, data.y
    levels_seen = lowest_level < 1.0
    seen_low, seen_high = float(T[data.running].min()), float(T[data.running].max())
    low, high = seen_low - _TRUST_K, seen_high + _TRUST_K
    span = high - low

    # An affine law is nonnegative on an interval exactly when it is at both ends: fit the end values, bounded below.
    share = (np.clip(T, low, high) - low) / span
    carriers = [np.minimum(u / lowest_level, 1.0), u] if levels_seen else [u]
    straight = np.stack([c * w for c in carriers for w in (1.0 - share, share)], axis=1)

    # A law that bends lies above its chord from the lowest level to full; only the chord is returned.
    above = np.maximum(u - lowest_level, 0.0) * (1.0 - u)
    design = np.column_stack([straight, above]) if levels_seen else straight

    at = (0.5 * (seen_low + seen_high) - low) / span
    middle = np.array([1.0 - at, at])
    full = _full_load(u, y, lowest_level, kind)
    relations, sds = _prior_rows(kind, lowest_level, middle, span, design.shape[1])
    # In shares of full heat, so that the evidence does not depend on the unit.
    rows = np.concatenate([design / data.misfit, relations / sds[:, None]])
    values = np.concatenate([y / full / data.misfit, np.zeros(sds.size)])
    least = np.full(design.shape[1], _LEAST_W / full)
    least[straight.shape[1] :] = -np.inf
    solution = np.asarray(lsq_linear(rows, values, bounds=(least, np.inf)).x)
    residual = rows @ solution - values

    at_full = np.zeros(design.shape[1])
    at_full[: straight.shape[1]] = np.tile(middle, len(carriers))
    precision = rows.T @ rows
    variance = float(at_full @ np.linalg.solve(precision, at_full))
    full_sd = float(np.sqrt(max(variance, 0.0))) / float(at_full @ solution)
    # Densities are of the relations and of the heat at full, which nothing is known of: hence the determinant.
    jacobian = np.linalg.slogdet(np.vstack([relations, at_full]))[1]
    evidence = -0.5 * (residual @ residual + np.linalg.slogdet(precision)[1]) - np.log(sds).sum() + jacobian

    ends = np.maximum(solution[: straight.shape[1]] * full, _LEAST_W)
    laws = [(a - (b - a) / span * low, (b - a) / span) for a, b in ends.reshape(-1, 2)]
    fixed = laws[0] if levels_seen else (0.0, 0.0)
    error = straight @ ends - y
    spread = float(np.var(y))
    return HeatFit(
        load=OnLoad(
            coefficients=(float(fixed[0]), float(fixed[1]), float(laws[-1][0]), float(laws[-1][1])),
            T_out_range_C=(low, high),
            lowest_level=lowest_level,
            levels_seen=levels_seen,
        ),
        rmse_W=float(np.sqrt(np.mean(error[data.running] ** 2))),
        bias_W=float(np.mean(error[data.running])),
        r2=1.0 - float(np.mean(error**2)) / spread if spread > 0 else float("nan"),
        n_samples=int(u.size),
        full_sd=full_sd,
        kind=kind.name,
        evidence=float(evidence),
    )


def _full_load(u: Array, y: Array, lowest_level: float, kind: MachinePrior) -> float:
    """Rough size of the heat at full, W: the largest step, scaled up where it was not one at full."""
    top = int(np.argmax(y))
    fixed = kind.fixed[0] if lowest_level < 1.0 else 0.0
    return float(y[top] / (fixed + (1.0 - fixed) * max(float(u[top]), _LEVEL_EDGE)))


def _prior_rows(kind: MachinePrior, lowest_level: float, middle: Array, span: float, n: int) -> tuple[Array, Array]:
    """What is known beforehand as relations that are zero, give or take: rows (m, n) and deviations (m,).

    Columns are the end values of each part, then the height above the chord; all in shares of full heat.
    """
    slope, slope_sd = kind.slope
    # Slope minus its mean times the value in the middle.
    sloping = np.array([-1.0, 1.0]) / span - slope * middle
    if lowest_level == 1.0:
        return sloping[None, :], np.array([slope_sd])
    rows = np.zeros((4, n))
    rows[0, :4] = np.tile(sloping, 2)
    rows[1, :2] = sloping
    rows[2, :4] = np.concatenate([(1.0 - kind.fixed[0]) * middle, -kind.fixed[0] * middle])
    rows[3, -1] = 1.0
    rows[3, :4] = -kind.sag[0] * np.tile(middle, 2)
    return rows, np.array([slope_sd, 0.5 * slope_sd, kind.fixed[1], kind.sag[1]])
