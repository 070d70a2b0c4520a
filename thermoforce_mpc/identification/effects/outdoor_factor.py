"""Heat of a level over the outdoor temperature where heat is not measured, from the zone temperatures.

A heat pump gives less heat at full level when it is cold, a circuit on a heating curve gives more. Operation acts most
when it is cold, so a fit that takes every level for the same heat is wrong in one direction, the more certainly so the
longer the record: that of a heat pump finds an effect that is too small.

The drive is u·(1 + k·(T_out − mean)). For each k of a grid the linear part of the joint fit is solved at the prior time
constants, and the evidence weighed with the priors of the machine types.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import other_actuators, others_of
from thermoforce_mpc.identification.estimation.modes import ModePriors, wide_priors
from thermoforce_mpc.identification.estimation.optimisers import BoundedLeastSquares
from thermoforce_mpc.identification.estimation.regression import RegressionData, calibrated, run_regression
from thermoforce_mpc.identification.estimation.system import System
from thermoforce_mpc.model.machine.heat_capacity import KINDS, kinds_for
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

# Grid of k, 1/K: beyond two standard deviations of the weakest prior, and points solved and weighed on it.
_MOST_PER_K, _SOLVED, _FINE = 0.08, 9, 401
# Least heat of a level anywhere in the record, as a share of that at the mean.
_LEAST_FACTOR = 0.2
# Modes of the fit.
_ORDER = 3


@dataclass(frozen=True)
class OutdoorFactor:
    """k of an actuator: `per_K` and its standard deviation `sd`, 1/K, from `reference_C`; `level_sd`: relative standard
    deviation that it leaves on the heat of a level in the weather of the record.
    """

    per_K: float
    sd: float
    reference_C: float
    T_out_range_C: tuple[float, float]
    level_sd: float

    @property
    def heat_input(self) -> HeatInput:
        """The heat input with this factor."""
        return HeatInput(reference_C=self.reference_C, per_K=self.per_K, T_out_range_C=self.T_out_range_C)

    def in_words(self) -> str:
        """A note for the model card."""
        return (
            f"heat was not measured: from the temperatures that of a level changes by {100 * self.per_K:+.1f} "
            f"± {100 * self.sd:.1f} % per K outdoors, effects are those at {self.reference_C:.1f} °C"
        )


def levels_only(heat_input: HeatInput, layout: Layout, a: int, config: IdentificationConfig) -> bool:
    """Whether nothing but its level says what actuator `a` gives.

    Not so where heat was measured or is the level itself: signed levels, `heat_input: identity`, the map of a radiator.
    """
    may_be_fitted = config.method == "joint" and config.heat_input == "auto" and config.radiator_exponent is None
    return may_be_fitted and heat_input.heat is None and layout.lowest[a] == 0.0


def outdoor_factor(
    runs: Sequence[Record], layout: Layout, a: int, config: IdentificationConfig
) -> OutdoorFactor | None:
    """Estimate k of actuator `a`, of which only the level is known.

    None without runs, if it never acted, and where its machine is shared: what a machine gives to one of
    several depends on the others too, so that their temperatures say little of it.
    """
    if not runs or len(layout.fed_by(layout.machine_of[a])) > 1:
        return None
    level = np.concatenate([run.u[a] for run in runs])
    if not level.sum() > 0.0:
        return None
    T_out_C = np.concatenate([run.T_out_C[:-1] for run in runs])
    mean_C, low, high = float(level @ T_out_C / level.sum()), float(T_out_C.min()), float(T_out_C.max())
    most = min(_MOST_PER_K, (1.0 - _LEAST_FACTOR) / max(high - mean_C, mean_C - low, 1.0))
    grid = np.linspace(-most, most, _SOLVED)
    inputs = [HeatInput(reference_C=mean_C, per_K=float(k), T_out_range_C=(low, high)) for k in grid]
    logs = _log_evidence(runs, layout, a, inputs, config)
    fine = np.linspace(-most, most, _FINE)
    kinds = kinds_for(layout.signs[a]) if config.machine == "auto" else (KINDS[config.machine],)
    prior = np.sum([norm.pdf(fine, *kind.slope) for kind in kinds], axis=0)
    at = CubicSpline(grid, logs)(fine) + np.log(prior)
    weights = np.exp(at - at.max())
    weights /= weights.sum()
    per_K = float(weights @ fine)
    sd = float(np.sqrt(weights @ (fine - per_K) ** 2))
    spread_K = float(np.sqrt(np.mean((T_out_C - mean_C) ** 2)))
    return OutdoorFactor(per_K, sd, mean_C, (low, high), sd * spread_K)


def _log_evidence(
    runs: Sequence[Record], layout: Layout, a: int, inputs: Sequence[HeatInput], config: IdentificationConfig
) -> Array:
    """Log evidence (k,) of the temperatures of the home zone of actuator `a`, up to a constant."""
    home = layout.home[a]
    order = [a, *others_of(layout, a, config)]
    parts = [run.part(home, order, [layout.machine_of[a]]) for run in runs]
    sign, priors = layout.signs[a], wide_priors(_ORDER)
    others = other_actuators(layout, [IDENTITY] * len(layout.home), a, config)

    def regressions(heat_input: HeatInput) -> list[RegressionData]:
        return [run_regression(part, heat_input, config, others) for part in parts]

    _, rms = _evidence_and_rms(regressions(IDENTITY), priors, sign)
    return np.array([_evidence_and_rms(calibrated(regressions(i), rms), priors, sign)[0] for i in inputs])


def _evidence_and_rms(regressions: Sequence[RegressionData], priors: ModePriors, sign: int) -> tuple[float, float]:
    """Log evidence of the linear part at the prior time constants (Laplace), and RMS of its whitened residual."""
    system = System(regressions, priors.order, sign)
    rows = system.rows(priors.log_tau, priors)
    solution = BoundedLeastSquares(rows, system.variables)
    log_evidence = -0.5 * (solution.squares + solution.log_determinant)
    log_evidence -= float(np.log(priors.gains_at(priors.log_tau)[1]).sum())
    residual = (rows[:, :-1] @ solution.values - rows[:, -1])[: system.n_data]
    return log_evidence, float(np.sqrt(np.mean(residual**2)))
