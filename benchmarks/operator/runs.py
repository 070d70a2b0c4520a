"""Parts of `tf-mpc bench operator`: identification from K days of one run, with excitation and under feedback.

Each window of each run is used alone for an identification, which is scored on all pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.operator.data import FLOOR_AREA_M2, ReferencePair, cut
from benchmarks.operator.score import PairScores, score_pairs
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.zones.two_stage import fit_two_stage

# Targets, K unless stated otherwise.
_FEW_SHOT_GOALS_K = {1: 0.12, 3: 0.08}
NEURAL_PENALTY = 1.02
INPUT_NAMES = {"auto": "auto", "identity": "u"}

_DAYS = (1, 3, 7, 27)
# Number of days from which the neural gain shall be better than the linear one, and the required ratio.
_MANY_DAYS, _BETTER = 7, 0.995

Row = dict[str, Any]


def few_shot(
    runs: dict[str, Record],
    pairs: Sequence[ReferencePair],
    quick: bool,
    options: dict[str, Any],
    say: Callable[[str], None],
) -> tuple[list[Row], list[Target]]:
    """Rows and targets for K days of one run: every window, tested on all pairs."""
    rows: list[Row] = []
    targets: list[Target] = []
    for days in _DAYS:
        # The input of the default always; input u (as in the paper) only with enough days to train a network.
        inputs = ("auto", "identity") if days >= _MANY_DAYS else ("auto",)
        found: dict[tuple[str, str], list[PairScores]] = {(i, g): [] for i in inputs for g in ("linear", "auto")}
        found["identity", "two-stage, order 1"] = []
        refused = 0
        for record in _windows(runs, days, quick, say):
            try:
                models = {
                    (given, gain): identify(
                        [record],
                        config=IdentificationConfig(modulation=gain, heat_input=given, **options),
                        floor_area_m2=FLOOR_AREA_M2,
                    )
                    for given, gain in found
                    if gain in ("linear", "auto")
                }
            except DataError:
                refused += 1
                continue
            for key, model in models.items():
                found[key].append(score_pairs(model.only.operator, pairs))
            paper = _paper_estimate(record, pairs)
            if paper is not None:
                found["identity", "two-stage, order 1"].append(paper)
        rows += [_summary(days, given, gain, scores, refused) for (given, gain), scores in found.items() if scores]
        if not found["auto", "auto"]:
            continue
        if days in _FEW_SHOT_GOALS_K:
            errors = np.array([s.rmse_K for s in found["auto", "auto"]])
            goal = _FEW_SHOT_GOALS_K[days]
            targets += [
                Target(f"{days} days of one run: median effect RMSE, K", float(np.median(errors)), goal),
                Target(f"{days} days of one run: 90th percentile, K", float(np.percentile(errors, 90)), goal),
                Target(f"{days} days of one run: worst window, K", float(errors.max()), goal),
            ]
        for given in inputs:
            linear, neural = (np.mean([s.rmse_K for s in found[given, g]]) for g in ("linear", "auto"))
            name = f"{days} days of one run, {INPUT_NAMES[given]}: neural against linear gain, mean RMSE"
            targets.append(Target(name, float(neural / linear), NEURAL_PENALTY))
            if days >= _MANY_DAYS:
                targets.append(Target(f"{name}, better", float(neural / linear), _BETTER))
    return rows, targets


def under_feedback(
    runs: dict[str, Record], pairs: Sequence[ReferencePair], quick: bool, say: Callable[[str], None]
) -> tuple[list[Row], list[Target]]:
    """Rows and targets for K days of a run under the native controller (feedback); linear gain."""
    rows: list[Row] = []
    for days in _DAYS:
        scores, refused = [], 0
        for record in _windows(runs, days, quick, say):
            try:
                model = identify(
                    [record],
                    config=IdentificationConfig(modulation="linear"),
                    floor_area_m2=FLOOR_AREA_M2,
                )
            except DataError:
                refused += 1
                continue
            scores.append(score_pairs(model.only.operator, pairs))
        if scores:
            rows.append(_summary(days, "auto", "linear", scores, refused) | {"part": "under feedback"})
    return rows, []


def _windows(runs: dict[str, Record], days: int, quick: bool, say: Callable[[str], None]) -> Iterator[Record]:
    """Iterate over all windows of `days` days."""
    for name, run in runs.items():
        total = run.n_steps * run.step_s / DAY_S
        for first in np.arange(0.0, total - days + 1e-9, _stride(days, quick)):
            say(f"{days} days of {name} from day {first:g}")
            yield cut(run, float(first), days)


def _stride(days: int, quick: bool) -> float:
    """Days between the starts of windows."""
    if quick:
        return 9.0
    return {7: 3.0}.get(days, 1.0)


def _paper_estimate(record: Record, pairs: Sequence[ReferencePair]) -> PairScores | None:
    """The paper's two-stage estimator on hourly means of the same days; None if there are too few off or on steps."""
    try:
        fit = fit_two_stage([record.resample(round(HOUR_S / record.step_s))])
    except DataError:
        return None
    return score_pairs(fit.operator(), pairs) if fit.g > 0 else None


def _summary(days: int, given: str, gain: str, scores: Sequence[PairScores], refused: int) -> Row:
    errors = np.array([s.rmse_K for s in scores])
    return {
        "part": "one run",
        "data": f"{days} days, {len(scores)} windows, {refused} refused",
        "input": INPUT_NAMES[given],
        "gain": gain,
        "rmse_K": float(np.median(errors)),
        "p90_K": float(np.percentile(errors, 90)),
        "worst_K": float(errors.max()),
        "sign": float(np.mean([s.sign_accuracy for s in scores])),
        "effect_K": scores[0].effect_K,
        "own_factor_rmse_K": float(np.median([s.own_factor_rmse_K for s in scores])),
        "own_factor_sd": float(np.median([s.own_factor_sd for s in scores])),
    }
