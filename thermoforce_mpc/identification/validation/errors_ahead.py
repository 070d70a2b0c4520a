"""Errors of predictions of held-out rows from every row some hours before them, with known weather.

The free part is predicted as in `likelihood`: given the temperatures until the start, its gains and initial state are
conditioned on them. The same is done without the actuator, with disturbances chosen anew on the training rows, so that
the comparison is fair. All innovations of all starts come from one Cholesky factor: with
C = L Lᵀ and w = L⁻¹ r, the part of r_j that the rows before i do not predict is Σ_{k=i…j} L_jk w_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.columns import forced_columns
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.likelihood import residuals
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.records import LEAD_REACH
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.validation.blocks import PER_REGRESSION
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Sizes of the disturbances tried, as a share of the assumed ones.
_SCALES = tuple(np.geomspace(0.03, 2.0, 6).tolist())


@dataclass(frozen=True)
class Fold:
    """A linear fit, the priors that it began from, and what it has not seen: the held-out rows of `regressions`.

    `heat_input`: what its actuator delivers, by the rows that it has seen.
    """

    regressions: Sequence[RegressionData]
    fit: ModeFit
    priors: ModePriors
    heat_input: HeatInput

    @property
    def judged(self) -> list[int]:
        """Which regressions are judged: the runs with held-out rows; where there are none, the pairs."""
        held = [i for i, e in enumerate(self.regressions) if e.held]
        return [i for i in held if not self.regressions[i].is_pair] or held

    def linear_effects(self, sign: int) -> list[Array]:
        """What the actions did by the linear fit, K, at the rows of each regression."""
        return [forced_columns(e, self.fit.log_tau, sign) @ self.fit.gains for e in self.regressions]

    @property
    def held_out_h(self) -> float:
        """The held-out hours that are judged."""
        judged = [self.regressions[i] for i in self.judged]
        return sum(float(e.rows[-1] - e.rows[e.seen]) * e.step_s / HOUR_S for e in judged)


@dataclass(frozen=True)
class HeldOutErrors:
    """Held-out errors of one lead time, run by run: of model, weather alone and persistence, (n,) each, K.

    `blocks` (n,): block numbers; `solar` (n,): mean irradiance over the lead time, W/m².
    """

    model: Array
    weather: Array
    persistence: Array
    blocks: NDArray[np.intp]
    solar: Array

    @classmethod
    def joined(cls, parts: Sequence[HeldOutErrors]) -> HeldOutErrors:
        """Errors of several parts, one after another."""
        return cls(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls)))


def errors_of(
    fold: Fold, effects: Sequence[Array], leads_h: Sequence[float], block_h: float, number: int = 0
) -> dict[float, HeldOutErrors]:
    """Held-out errors by lead time of predictions with these `effects` of the actions, K, at the rows of each run.

    Blocks of the regressions are numbered from `number` on.
    """
    judged = [fold.regressions[i] for i in fold.judged]
    none = [np.zeros(e.rows.size) for e in judged]
    model = _innovations(judged, [effects[i] for i in fold.judged], fold.fit.log_tau, leads_h)
    weather = _innovations(judged, none, fold.fit.log_tau, leads_h)
    return {
        hours: HeldOutErrors.joined(
            [_errors(number + i, e, model[i], weather[i], hours, block_h) for i, e in enumerate(judged)]
        )
        for hours in leads_h
    }


@dataclass(frozen=True)
class _Innovations:
    """w (m,) and L (m, m) of the rows from `begin` on, in standard deviations and K."""

    begin: int
    white: Array
    factor: Array

    def ahead(self, starts: NDArray[np.intp], targets: NDArray[np.intp]) -> Array:
        """Errors (n,) of the predictions from `starts`, `begin` - 1 or later, to `targets`, K."""
        rows = zip(starts + 1 - self.begin, targets - self.begin, strict=True)
        return np.array([self.factor[j, i : j + 1] @ self.white[i : j + 1] for i, j in rows])


def _innovations(
    regressions: Sequence[RegressionData], effects: Sequence[Array], log_tau: Array, leads_h: Sequence[float]
) -> list[_Innovations]:
    """Return what predictions of these lead times need of each regression, with the likeliest size of disturbances.

    Likeliest on the rows before the held-out ones; `effects` (rows,) K are what the actions did.
    """
    rests = [residuals(e, log_tau) for e in regressions]
    left = [e.target - effect - rest.mean for e, effect, rest in zip(regressions, effects, rests, strict=True)]
    scale, each = 1.0, list(zip(regressions, rests, left, strict=True))
    if all(e.seen and not e.is_pair for e in regressions):  # that of pairs is the error of a model, which is known
        likelihoods = [rest.log_likelihoods(values, e.seen, _SCALES) for e, rest, values in each]
        scale = _SCALES[int(np.argmax(np.sum(likelihoods, axis=0)))]
    innovations = []
    for e, rest, values in each:
        begin = 1 + min(int(np.min(_held_out(e, hours)[0], initial=max(e.seen - 1, 0))) for hours in leads_h)
        innovations.append(_Innovations(begin, *rest.scaled(scale).later(values, begin)))
    return innovations


def _errors(
    number: int, e: RegressionData, model: _Innovations, weather: _Innovations, hours: float, block_h: float
) -> HeldOutErrors:
    """Errors at held-out rows, each predicted from the last row `hours` or more before it."""
    solar, rows = e.histories[0].solar_W_m2, e.rows
    starts, targets = _held_out(e, hours)
    at = rows * e.step_s / HOUR_S
    sun = np.array([solar[rows[i] : rows[j] + 1].mean() for i, j in zip(starts, targets, strict=True)])
    blocks = number * PER_REGRESSION + ((at[targets] - at[e.seen]) // block_h).astype(np.intp)
    persistence = e.target[targets] - e.target[starts]
    predicted, alone = model.ahead(starts, targets), weather.ahead(starts, targets)
    return HeldOutErrors(predicted, alone, persistence, np.asarray(blocks, dtype=np.intp), sun)


def _held_out(e: RegressionData, hours: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Starts and targets (n,) of the predictions `hours` ahead of the held-out rows."""
    at = e.rows * e.step_s / HOUR_S
    starts = np.searchsorted(at, at[e.seen :] - hours + 1e-9, side="right") - 1
    targets = np.arange(e.seen, at.size)
    # Where the sensor was silent there may be no row that far before: such a target is left out.
    near = (starts >= 0) & (at[targets] - at[np.maximum(starts, 0)] <= LEAD_REACH * hours + 1e-9)
    return starts[near], targets[near]
