"""Shape of heat over the level where heat is not measured, from the temperature: part load, exponent of a radiator.

One parameter k of the drive v(u; k) is estimated beside all others of the joint fit. The regression is linear in the
gains and in the free part, so k and the time constants are linearised (Gauss-Newton), and the inverse of the Hessian
gives the uncertainty of k with everything else marginalised (Laplace).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.columns import forced_columns
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.optimisers import BoundedLeastSquares
from thermoforce_mpc.identification.estimation.regression import RegressionData, calibrated
from thermoforce_mpc.identification.estimation.system import System
from thermoforce_mpc.model.machine.load_regression import LEVEL_EDGE
from thermoforce_mpc.model.machine.part_load import COST, COST_SD, HEAT, HEAT_SD, LEVEL
from thermoforce_mpc.model.machine.power import PowerModel

EXPONENT, EXPONENT_SD = "radiator_exponent", "radiator_exponent_sd"
# Heat per level at part load over that at full level. A machine whose heat is the level has 1; heat pumps sag by some
# 12 % at full level (`machine.heat_capacity`), and one at the limit of its water temperature by up to a half.
_HEAT_PRIOR = (1.1, 0.25)
# Exponent of panel radiators, convectors and sectional radiators in data sheets by EN 442: 1.2 to 1.4.
_EXPONENT_SD = 0.1
# Estimates are held inside these. Heat is a concave law of the level: per level, part load gives no less than full
# level. Below 1 an estimate is noise, and would switch an electric heater for a loss that it cannot have.
_HEAT_RANGE, _EXPONENT_RANGE = (1.0, 2.0), (1.0, 2.0)
# The data determine an exponent where they leave less than this share of its prior's standard deviation.
_INFORMATIVE = 0.7
# Steps at part load from which their heat is estimated.
_LEAST_STEPS = 4
_ROUNDS = 8


@dataclass(frozen=True)
class Shape:
    """A family of drives: `drive` and `slope`, its derivative by k, of levels (n,); prior and range of k."""

    drive: Callable[[Array, float], Array]
    slope: Callable[[Array, float], Array]
    mean: float
    sd: float
    range: tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """Estimate of k and its standard deviation."""

    value: float
    sd: float


def _part(u: Array) -> NDArray[np.bool_]:
    return np.asarray((u > LEVEL_EDGE) & (u < 1.0 - LEVEL_EDGE))


PART_LOAD = Shape(
    lambda u, k: np.where(_part(u), np.minimum(k * u, 1.0), u),
    lambda u, k: np.where(_part(u) & (k * u < 1.0), u, 0.0),
    *_HEAT_PRIOR,
    _HEAT_RANGE,
)
"""Heat at part load is k times the level, of a machine whose heat at full level is 1."""


def radiator(assumed: float) -> Shape:
    """Heat of a radiator of exponent k whose levels were recorded with the exponent `assumed`."""
    return Shape(
        lambda u, k: np.asarray(u ** (k / assumed)),
        lambda u, k: np.asarray(u ** (k / assumed) * np.log(np.maximum(u, 1e-12)) / assumed),
        assumed,
        _EXPONENT_SD,
        _EXPONENT_RANGE,
    )


def estimate(
    shape: Shape,
    regressions: Sequence[RegressionData],
    fit: ModeFit,
    priors: ModePriors,
    sign: int,
) -> Estimate:
    """Estimate k of `shape` from regressions whose drives are levels; `fit` is their joint fit, at v = u."""
    used = calibrated(regressions, fit.residual_scale)
    r = fit.log_tau.size
    k, log_tau = shape.mean, fit.log_tau
    for _ in range(_ROUNDS):
        driven, slopes = ([_driven(e, f, k) for e in used] for f in (shape.drive, shape.slope))
        system = System(driven, r, sign)
        rows = system.rows(log_tau, priors)
        design, target = rows[:, :-1], rows[:, -1]
        values = BoundedLeastSquares(rows, system.variables).values
        by_k = np.zeros(target.size)
        by_k[: system.n_data] = np.concatenate(
            [e.disturbance.whitened(forced_columns(e, log_tau, sign) @ values[:r]) for e in slopes]
        )
        jacobian = np.column_stack([by_k, system.slopes(log_tau, priors, values), design])
        prior = np.zeros(jacobian.shape[1])
        prior[0], prior[1 : 1 + r] = shape.sd**-2, priors.log_tau_sd**-2
        hessian = jacobian.T @ jacobian + np.diag(prior)
        # Time constants stay those of the fit; that they are uncertain counts in the step and in the uncertainty.
        downhill = jacobian.T @ (target - design @ values)
        downhill[0] += (shape.mean - k) * prior[0]
        step = float(np.linalg.solve(hessian, downhill)[0])
        k = float(np.clip(k + step, *shape.range))
        if abs(step) < 1e-3:
            break
    return Estimate(k, float(np.sqrt(np.linalg.inv(hessian)[0, 0])))


def _driven(regression: RegressionData, by: Callable[[Array, float], Array], k: float) -> RegressionData:
    return replace(regression, drives=tuple((sign, by(u, k)) for sign, u in regression.drives))


def level_shape(
    histories: Sequence[Record],
    regressions: Sequence[RegressionData],
    fit: ModeFit,
    priors: ModePriors,
    config: IdentificationConfig,
    power: PowerModel | None,
    sign: int,
) -> tuple[dict[str, float], list[str]]:
    """What the temperature says of the heat over the level, as numbers for the card and notes in words.

    The drives of `regressions` are levels. `config.part_load` turns on the cost of heat at part load,
    `config.radiator_exponent` for the exponent; both empty where neither is on, or the data hold nothing of it.
    """
    if config.radiator_exponent is not None:
        return _exponent(estimate(radiator(config.radiator_exponent), regressions, fit, priors, sign), config)
    u = np.concatenate([h.u[0] for h in histories])
    if not config.part_load or power is None or np.count_nonzero(_part(u)) < _LEAST_STEPS:
        return {}, []
    return _cost(estimate(PART_LOAD, regressions, fit, priors, sign), histories, power)


def _exponent(exponent: Estimate, config: IdentificationConfig) -> tuple[dict[str, float], list[str]]:
    assumed = config.radiator_exponent
    numbers = {EXPONENT: exponent.value, EXPONENT_SD: exponent.sd}
    summary = f"exponent of the radiator from the temperature: {exponent.value:.2f} ± {exponent.sd:.2f}"
    if exponent.sd > _INFORMATIVE * _EXPONENT_SD:
        return numbers, [f"{summary}; the data hardly tell it, the {assumed:g} of the data sheet is kept"]
    if abs(exponent.value - (assumed or 0.0)) <= 2.0 * exponent.sd:
        return numbers, [f"{summary}, in agreement with the {assumed:g} in use"]
    return numbers, [
        f"{summary}, not the {assumed:g} in use: write actuator.exponent: {exponent.value:.2f} and probe again"
    ]


def _cost(heat: Estimate, histories: Sequence[Record], power: PowerModel) -> tuple[dict[str, float], list[str]]:
    """Cost of heat at the level of part load that is nearest to what held the zone, over that at full level."""
    u, T_out, power_W = (
        np.concatenate([values(h) for h in histories])
        for values in (lambda h: h.u[0], lambda h: h.T_out_C[:-1], lambda h: h.power_W[0])
    )
    kept = np.isfinite(u) & np.isfinite(T_out) & np.isfinite(power_W)
    u, T_out, power_W = u[kept], T_out[kept], power_W[kept]
    # Trial levels are few; in light zones any level may have been held, so neighbours count with it.
    levels = u[_part(u)]
    if not levels.size:
        return {}, []
    level = float(levels[np.argmin(np.abs(levels - u.mean()))])
    near = _part(u) & (np.abs(u - level) <= 0.2 * level)
    full_W = power(np.ones(u.size), T_out)
    per_level = power_W[near] / (u[near] * full_W[near])
    spread = (heat.sd / heat.value) ** 2
    # E[1/k] to second order: not knowing the heat makes what it costs dearer in expectation.
    cost = float(per_level.mean()) / heat.value * (1.0 + spread)
    noise = float(per_level.std() / np.sqrt(near.sum()) / per_level.mean())
    cost_sd = cost * float(np.hypot(heat.sd / heat.value, noise))
    return {LEVEL: level, HEAT: heat.value, HEAT_SD: heat.sd, COST: cost, COST_SD: cost_sd}, []
