"""Fit of a machine's heat (or cooling) capacity as a function of level and outdoor temperature.

A day of data covers few levels and a few K, while plans extrapolate to full level and colder weather. So the fit uses a
prior per machine type (`MachinePrior`). The type, and whether intermediate levels are modulated or made by cycling, are
chosen by the evidence of the data, with all coefficients marginalised (MacKay 1992; without the bounds).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.model.machine.load import (
    LEAST_W,
    LEVEL_EDGE,
    RESIDUAL_SCALE,
    EndValues,
    MachineLoad,
    Quality,
    Steps,
    levels_to_try,
    usable_steps,
)

# Correlation time of the residuals, h: heated components cool over hours, so steps are not independent. By judgement.
_RESIDUAL_CORRELATION_H = 3.0
# Prior odds: of the first type against each other type, and of modulated against cycled intermediate levels. By
# judgement: what machines of a kind share is wrong for one in twenty.
_FIRST_KIND, _LEVELS_ARE_RUN = 20.0, 10.0


@dataclass(frozen=True)
class MachinePrior:
    """Prior of a machine type, each parameter as (mean, standard deviation).

    `slope`: (1/load) · d load/d T_out at full level, 1/K. `fixed`: share of full heat that does not depend on u while
    the machine runs. `sag`: deficit of full heat against extrapolation from the lowest levels, as a share of full heat;
    the returned law is linear in u, exact at the lowest level and at full level.
    """

    name: str
    slope: tuple[float, float]
    fixed: tuple[float, float]
    sag: tuple[float, float]


HEAT_PUMP = MachinePrior("heat pump", slope=(0.025, 0.0075), fixed=(0.1, 0.1), sag=(0.12, 0.06))
"""Air-source heat pumps. Capacity at A−7/W35 is about 65 to 80 % of that at A7/W35 in EN 14511 data sheets. At full
level the temperature differences of water and air are 5 K and 3 K larger (rating conditions of EN 14511), at about 1
and 2.5 % of capacity per K."""

AIR_CONDITIONER = MachinePrior("air conditioner", slope=(-0.009, 0.005), fixed=(0.1, 0.1), sag=(0.12, 0.06))
"""Cooling capacity falls by about 10 % from 35 to 46 °C outdoors (conditions T1 and T3 of ISO 5151)."""

DIRECT = MachinePrior("direct", slope=(0.0, 0.002), fixed=(0.0, 0.05), sag=(0.0, 0.02))
"""Electric heaters, boilers, coils: heat is proportional to u, independent of the weather."""

OTHER = MachinePrior("other", slope=(0.0, 0.03), fixed=(0.2, 0.2), sag=(0.0, 0.1))
"""Any other machine: weak prior."""


def kinds_for(sign: int) -> tuple[MachinePrior, ...]:
    """Return the possible types of a heating (+1) or cooling (−1) machine, the likeliest first."""
    return (HEAT_PUMP if sign > 0 else AIR_CONDITIONER, DIRECT, OTHER)


@dataclass(frozen=True)
class HeatFit:
    """Fitted heat capacity and its quality.

    `full_sd`: relative standard deviation of the heat at full level in the middle of the outdoor range of the data;
    `kind`: chosen machine type; `evidence`: log probability of the data under it, up to a constant.
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
    """Fit a `MachineLoad` by least squares with priors, both parts nonnegative over its outdoor range.

    `u` (n,): mean level over each step, in [0, 1]; `T_out_C` (n,) at its start; `heat_W` (n,): mean over it, positive
    in the direction of the machine, NaN if missing. `kinds`: possible machine types, the likeliest first, see
    `kinds_for`. `lowest_level`: below it the machine cycles; by default both an on/off machine (1, where fixed and
    proportional part are one) and one with the lowest level in the data are tried. Raises `DataError` as
    `usable_steps`.
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
    """Fit one machine type and lowest level; `residual_scale` is the error of a step as a share of full heat."""
    from scipy.optimize import lsq_linear

    u, y, ends = steps.u, steps.load_W, EndValues.around(steps)
    levels_seen = lowest_level < 1.0
    carriers = [np.minimum(u / lowest_level, 1.0), u] if levels_seen else [u]
    straight = np.concatenate([c[:, None] * ends.weights(steps.T_out_C) for c in carriers], axis=1)

    # A concave law lies above its chord from the lowest to full level; only the chord is returned.
    above = np.maximum(u - lowest_level, 0.0) * (1.0 - u)
    design = np.column_stack([straight, above]) if levels_seen else straight

    full = _full_load(u, y, lowest_level, kind)
    relations, sds = _prior_rows(kind, lowest_level, ends, design.shape[1])
    # In units of full heat, so that the evidence does not depend on the unit.
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
    # The priors are densities of the relations and of the heat at full level (flat): hence the determinant.
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
    """Return an estimate of the heat at full level, W: the largest step, scaled to full level."""
    top = int(np.argmax(y))
    fixed = kind.fixed[0] if lowest_level < 1.0 else 0.0
    return float(y[top] / (fixed + (1.0 - fixed) * max(float(u[top]), LEVEL_EDGE)))


def _prior_rows(kind: MachinePrior, lowest_level: float, ends: EndValues, n: int) -> tuple[Array, Array]:
    """Return the priors as relations with mean zero: rows (m, n) and standard deviations (m,).

    Columns are the end values of each part, then the height above the chord; all in units of full heat.
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
