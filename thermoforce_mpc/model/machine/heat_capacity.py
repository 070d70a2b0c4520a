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
from scipy.optimize import lsq_linear

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.load_regression import (
    LEAST_W,
    LEVEL_EDGE,
    RESIDUAL_SCALE,
    EndValues,
    Quality,
    Steps,
    levels_to_try,
    usable_steps,
)

# How long a step's deviation lasts, h: what the machine warms takes hours to cool again, so steps are not independent.
_RESIDUAL_CORRELATION_H = 3.0
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
    """A fitted heat capacity and how good it is.

    `full_sd` is the standard deviation of the heat at full in the middle of the outdoor temperatures seen, as a share
    of it; `kind` is what the machine was taken for, and `evidence` the logarithm of the probability of the data under
    it, up to a constant.
    """

    load: MachineLoad
    quality: Quality
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
    """Least squares for `MachineLoad`, with both parts kept nonnegative over the outdoor range it is valid for.

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
    steps = usable_steps(u, T_out_C, heat_W, "delivered heat")
    residual_scale = RESIDUAL_SCALE * float(np.sqrt(max(1.0, 2.0 * _RESIDUAL_CORRELATION_H * HOUR_S / step_s)))
    fits = [
        _fit_at(steps, residual_scale, lowest, kind) for kind in kinds for lowest in levels_to_try(steps, lowest_level)
    ]

    def posterior(fit: HeatFit) -> float:
        odds = (_FIRST_KIND if fit.kind == kinds[0].name else 1.0) * (_LEVELS_ARE_RUN if fit.load.levels_seen else 1.0)
        return fit.evidence + float(np.log(odds))

    return max(fits, key=posterior)


def _fit_at(steps: Steps, residual_scale: float, lowest_level: float, kind: MachinePrior) -> HeatFit:
    """`residual_scale` is the error of a step as a share of full heat."""
    u, y, ends = steps.u, steps.load_W, EndValues.around(steps)
    levels_seen = lowest_level < 1.0
    carriers = [np.minimum(u / lowest_level, 1.0), u] if levels_seen else [u]
    straight = np.concatenate([c[:, None] * ends.weights(steps.T_out_C) for c in carriers], axis=1)

    # A law that bends lies above its chord from the lowest level to full; only the chord is returned.
    above = np.maximum(u - lowest_level, 0.0) * (1.0 - u)
    design = np.column_stack([straight, above]) if levels_seen else straight

    full = _full_load(u, y, lowest_level, kind)
    relations, sds = _prior_rows(kind, lowest_level, ends, design.shape[1])
    # In shares of full heat, so that the evidence does not depend on the unit.
    rows = np.concatenate([design / residual_scale, relations / sds[:, None]])
    values = np.concatenate([y / full / residual_scale, np.zeros(sds.size)])
    least = np.full(design.shape[1], LEAST_W / full)
    least[straight.shape[1] :] = -np.inf
    solution = np.asarray(lsq_linear(rows, values, bounds=(least, np.inf)).x)
    residual = rows @ solution - values

    at_full = np.zeros(design.shape[1])
    at_full[: straight.shape[1]] = np.tile(ends.weights(ends.middle_C), len(carriers))
    precision = rows.T @ rows
    variance = float(at_full @ np.linalg.solve(precision, at_full))
    full_sd = float(np.sqrt(max(variance, 0.0))) / float(at_full @ solution)
    # Densities are of the relations and of the heat at full, which nothing is known of: hence the determinant.
    jacobian = np.linalg.slogdet(np.vstack([relations, at_full]))[1]
    evidence = -0.5 * (residual @ residual + np.linalg.slogdet(precision)[1]) - np.log(sds).sum() + jacobian

    values_W = np.maximum(solution[: straight.shape[1]] * full, LEAST_W)
    return HeatFit(
        load=ends.load(values_W, lowest_level),
        quality=Quality.of(straight @ values_W, steps),
        full_sd=full_sd,
        kind=kind.name,
        evidence=float(evidence),
    )


def _full_load(u: Array, y: Array, lowest_level: float, kind: MachinePrior) -> float:
    """Rough size of the heat at full, W: the largest step, scaled up where it was not one at full."""
    top = int(np.argmax(y))
    fixed = kind.fixed[0] if lowest_level < 1.0 else 0.0
    return float(y[top] / (fixed + (1.0 - fixed) * max(float(u[top]), LEVEL_EDGE)))


def _prior_rows(kind: MachinePrior, lowest_level: float, ends: EndValues, n: int) -> tuple[Array, Array]:
    """What is known beforehand as relations that are zero, give or take: rows (m, n) and deviations (m,).

    Columns are the end values of each part, then the height above the chord; all in shares of full heat.
    """
    slope, slope_sd = kind.slope
    sloping, middle = ends.sloping(slope), ends.weights(ends.middle_C)
    if lowest_level == 1.0:
        return sloping[None, :], np.array([slope_sd])
    rows = np.zeros((4, n))
    rows[0, :4] = np.tile(sloping, 2)
    rows[1, :2] = sloping
    rows[2, :4] = np.concatenate([(1.0 - kind.fixed[0]) * middle, -kind.fixed[0] * middle])
    rows[3, -1] = 1.0
    rows[3, :4] = -kind.sag[0] * np.tile(middle, 2)
    return rows, np.array([slope_sd, 0.5 * slope_sd, kind.fixed[1], kind.sag[1]])
