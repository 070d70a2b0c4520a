"""Scores of one method on one cell, and the test over cells (paper, sections 'Metrics' and 'Results I')."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import wilcoxon

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Predictor, plans, signs_right, true_effect
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError

LEVELS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
# Tolerance of the monotonicity check for rounding, K.
_ROUNDING_K = 1e-9


@dataclass(frozen=True)
class CellScore:
    """One method on the test pairs of one cell.

    Attributes:
        factual_rmse_K: RMSE of the temperature under the applied control, K.
        effect_rmse_K: RMSE of the effect (paper eq:effect) over all steps of all pairs, K.
        up_rmse_K, down_rmse_K: effect RMSE on shifts to more (DR-up) and less effort (DR-down), K; NaN if a cell has
            none.
        sign_accuracy: share of the steps with a true effect beyond 0.05 K whose predicted effect has its sign.
        violations: number of predictions for two neighbouring levels of u in the wrong order, out of `comparisons`.
        note: fitted or chosen settings of the method.
    """

    method: str
    climate: str
    window: str
    days: int
    pairs: int
    factual_rmse_K: float
    effect_rmse_K: float
    up_rmse_K: float
    down_rmse_K: float
    sign_accuracy: float
    violations: int
    comparisons: int
    note: str

    @property
    def cell(self) -> tuple[str, str]:
        """Climate and window."""
        return self.climate, self.window


def score_cell(name: str, predictor: Predictor, windows: Sequence[Window], days: int, sign: int) -> CellScore:
    """Score one method on the windows of one cell, with one prediction call per window for all plans and levels.

    Raises:
        DataError: there are no windows, or they belong to several cells.
    """
    cells = {(w.climate, w.name) for w in windows}
    if len(cells) != 1:
        raise DataError(f"scoring needs the windows of one cell, got {sorted(cells)}")
    ((climate, window_name),) = cells
    factual, errors, up, signs = [], [], [], []
    violations = comparisons = 0
    for window in windows:
        both = plans(window)
        held = np.broadcast_to(LEVELS[:, None], (LEVELS.size, both.shape[1]))
        answer = predictor.respond(window, np.concatenate([both, held]))
        effect, truth = answer[1] - answer[0], true_effect(window)
        factual.append(answer[0] - window.factual.T_zone_C[0, 1:])
        errors.append(effect - truth)
        up.append(sign * window.shift_K > 0)
        signs.append(signs_right(effect, truth))
        rises = sign * np.diff(answer[2:], axis=0)
        violations += int((rises < -_ROUNDING_K).sum())
        comparisons += rises.size
    mask = np.array(up)
    stacked = np.array(errors)
    return CellScore(
        method=name,
        climate=climate,
        window=window_name,
        days=days,
        pairs=len(windows),
        factual_rmse_K=rms(np.array(factual)),
        effect_rmse_K=rms(stacked),
        up_rmse_K=rms(stacked[mask]),
        down_rmse_K=rms(stacked[~mask]),
        sign_accuracy=float(np.mean(np.concatenate(signs))),
        violations=violations,
        comparisons=comparisons,
        note=predictor.note,
    )


def one_sided_wilcoxon(ours: Sequence[CellScore], other: Sequence[CellScore]) -> tuple[float, int]:
    """Exact one-sided Wilcoxon signed-rank test over cells: p and number of cells with lower effect RMSE of `ours`.

    With six cells the smallest possible p is 1/64.

    Raises:
        DataError: the two methods were not scored on the same cells.
    """
    theirs = {score.cell: score.effect_rmse_K for score in other}
    if len(ours) != len(theirs) or {s.cell for s in ours} != set(theirs):
        raise DataError("the test over cells needs both methods on the same cells")
    a = np.array([score.effect_rmse_K for score in ours])
    b = np.array([theirs[score.cell] for score in ours])
    if np.array_equal(a, b):
        return 1.0, 0
    return float(wilcoxon(a, b, alternative="less").pvalue), int((a < b).sum())
