"""Scoring an operator on paired interventions it was not trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.operator.data import ReferencePair
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.model.forced_state import forced_history
from thermoforce_mpc.model.operator.building import forced_rollout, single
from thermoforce_mpc.model.operator.parameters import OperatorParameters, feature_matrix

# Smallest effect whose sign is scored, K.
SIGN_FROM_K = 0.05


@dataclass(frozen=True)
class PairScores:
    """Effect error over all pairs and lags.

    `rmse_K`: RMSE, K; `sign_accuracy`: where |effect| > 0.05 K (NaN if nowhere); `effect_K`: RMS of the effect, K; `n`:
    number of lags. `own_factor_rmse_K` is the RMSE, K, after scaling the prediction of each pair by its least-squares
    factor, and `own_factor_sd` the standard deviation of these factors. A gain m(x) that hardly changes within a day
    can reduce `rmse_K` to `own_factor_rmse_K` at best.
    """

    rmse_K: float
    sign_accuracy: float
    effect_K: float
    n: int
    own_factor_rmse_K: float
    own_factor_sd: float


def predicted_effect(operator: OperatorParameters, reference: ReferencePair) -> Array:
    """Effect of the first run's actions instead of the second's, shape (n,), K (paper eq:effect).

    Both are rolled out with the features of the second run; measurements of the first run are not used.
    """
    acted, baseline = reference.pair.a, reference.pair.b
    operator = operator.resampled(baseline.step_s)
    free = baseline.T_zone_C[0] - forced_history(single(operator), baseline)[0, 0].sum(axis=1)
    features = feature_matrix(free[:-1], baseline.T_out_C[:-1], baseline.solar_W_m2[:-1], baseline.time_s[:-1])
    start = np.zeros(operator.order)
    first, second = (forced_rollout(operator, start, run.u[0], features).sum(axis=-1) for run in (acted, baseline))
    return np.asarray(first - second)


def score_pairs(
    operator: OperatorParameters, references: Sequence[ReferencePair], horizon_h: float = 24.0
) -> PairScores:
    """Score rollouts over `horizon_h` from the start of each intervention."""
    predicted, measured = [], []
    for reference in references:
        run = reference.pair.a
        steps = round(horizon_h * HOUR_S / run.step_s)
        window = slice(reference.window_start, reference.window_start + steps)
        predicted.append(predicted_effect(operator, reference)[window])
        measured.append((run.T_zone_C[0] - reference.pair.b.T_zone_C[0])[1:][window])
    p, m = np.concatenate(predicted), np.concatenate(measured)
    # A pair without effect in the window (late action) keeps the factor 1.
    seen = [(x, y) for x, y in zip(predicted, measured, strict=True) if np.abs(x).max() > SIGN_FROM_K]
    factors = np.array([float(x @ y) / float(x @ x) for x, y in seen])
    left = [f * x - y for f, (x, y) in zip(factors, seen, strict=True)]
    left += [x - y for x, y in zip(predicted, measured, strict=True) if np.abs(x).max() <= SIGN_FROM_K]
    strong = np.abs(m) > SIGN_FROM_K
    return PairScores(
        rmse_K=rms(p - m),
        sign_accuracy=float(np.mean(np.sign(p[strong]) == np.sign(m[strong]))) if strong.any() else float("nan"),
        effect_K=rms(m),
        n=int(p.size),
        own_factor_rmse_K=rms(np.concatenate(left)),
        own_factor_sd=float(np.std(factors)) if factors.size else float("nan"),
    )
