"""`tf-mpc bench operator`: predicted effects of actions against interventions of a reference building.

Four parts: operator trained on pairs and tested on pairs of other start days; identified from K days of a single run
with excitation, and of one under feedback, and tested on all pairs (`operator.runs`); speed. Training and test
data are disjoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from benchmarks.operator.data import FLOOR_AREA_M2, ReferencePair, read_hourly_pairs, read_run
from benchmarks.operator.runs import INPUT_NAMES, NEURAL_PENALTY, few_shot, under_feedback
from benchmarks.operator.score import PairScores, score_pairs
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify

# Targets of this bench, K unless stated otherwise.
_PAIRS_GOAL_K, _SIGN_GOAL, _AGAINST_FIRST_ORDER = 0.035, 0.995, 0.5
_SPEED_GOAL = 20.0

_MANY_BUILDINGS, _FEW_BUILDINGS, _MANY_GOAL = 100, 10, 5.0

Row = dict[str, Any]


def run_operator_bench(
    reference: Path,
    *,
    quick: bool = False,
    epochs: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run the bench on the records in `reference` (layout in `operator.data`).

    Args:
        reference: folder with hourly pairs, their weather, excite_*.csv.gz runs, and optionally native_*.csv.gz.
        quick: one split of the pairs and fewer windows.
        epochs: epochs of training; by default as in identification.
        progress: callback for progress lines.

    Raises:
        DataError: files are missing or unusable.
    """
    say = progress or (lambda text: None)
    say("reading the reference records")
    pairs = read_hourly_pairs(reference)
    runs, feedback = (
        {path.name.removesuffix(".csv.gz"): read_run(path) for path in sorted(reference.glob(f"{kind}_*.csv.gz"))}
        for kind in ("excite", "native")
    )
    if not runs:
        raise DataError(f"{reference}: no excite_*.csv.gz found")
    rows: list[Row] = []
    targets: list[Target] = []
    options: dict[str, Any] = {} if epochs is None else {"epochs": epochs}
    parts = (
        _trained_on_pairs(pairs, quick, options, say),
        few_shot(runs, pairs, quick, options, say),
        under_feedback(feedback, pairs, quick, say),
        _speed(*((20, _FEW_BUILDINGS) if quick else (300, _MANY_BUILDINGS)), say),
    )
    for part_rows, part_targets in parts:
        rows += part_rows
        targets += part_targets
    return results_json("operator", rows, targets)


def _trained_on_pairs(
    pairs: Sequence[ReferencePair], quick: bool, options: dict[str, Any], say: Callable[[str], None]
) -> tuple[list[Row], list[Target]]:
    """Two folds: train on every other start day and test on the others, then the reverse."""
    days = sorted({p.start_day for p in pairs})
    rows: list[Row] = []
    worst: dict[tuple[str, str, str], PairScores] = {}
    for fold in (0,) if quick else (0, 1):
        training = [p.pair for p in pairs if days.index(p.start_day) % 2 == fold]
        testing = [p for p in pairs if days.index(p.start_day) % 2 != fold]
        for heat_input, order, modulation in _variants():
            say(f"pairs, fold {fold + 1}: {heat_input}, order {order}, {modulation}")
            config = IdentificationConfig(heat_input=heat_input, order=order, modulation=modulation, **options)
            start = perf_counter()
            model = identify(pairs=training, config=config, floor_area_m2=FLOOR_AREA_M2)
            seconds = perf_counter() - start
            scores = score_pairs(model.only.operator, testing)
            key = (heat_input, str(order), modulation)
            if key not in worst or scores.rmse_K > worst[key].rmse_K:
                worst[key] = scores
            rows.append(
                {
                    "part": "trained on pairs",
                    "data": f"fold {fold + 1}, {len(training)} pairs",
                    "input": heat_input,
                    "gain": modulation,
                    "order": model.only.operator.order,
                    "rmse_K": scores.rmse_K,
                    "sign": scores.sign_accuracy,
                    "effect_K": scores.effect_K,
                    "own_factor_rmse_K": scores.own_factor_rmse_K,
                    "own_factor_sd": scores.own_factor_sd,
                    "seconds": seconds,
                }
            )
    chosen, first = worst["auto", "auto", "auto"], worst["auto", "1", "auto"]
    targets = [
        Target("pairs: effect RMSE of the selected operator, K", chosen.rmse_K, _PAIRS_GOAL_K),
        Target("pairs: sign accuracy of the selected operator", chosen.sign_accuracy, _SIGN_GOAL, "at least"),
        Target("pairs: RMSE against first order on the same input", chosen.rmse_K / first.rmse_K, _AGAINST_FIRST_ORDER),
    ]
    for heat_input in ("auto", "identity"):
        neural, linear = (worst[heat_input, "auto", gain].rmse_K for gain in ("auto", "linear"))
        name = f"pairs: neural against linear gain on {INPUT_NAMES[heat_input]}"
        targets.append(Target(name, neural / linear, NEURAL_PENALTY))
    return rows, targets


def _variants() -> Iterator[tuple[Literal["identity", "auto"], Literal["auto", 1], Literal["auto", "linear"]]]:
    for heat_input in ("identity", "auto"):
        for order in (1, "auto"):
            for modulation in ("linear", "auto"):
                yield heat_input, order, modulation


def _speed(epochs: int, buildings: int, say: Callable[[str], None]) -> tuple[list[Row], list[Target]]:
    from benchmarks.operator.speed import compare_module_call, compare_rollout  # loads torch, for this part only
    from benchmarks.operator.training_speed import compare_many_buildings, compare_training, compare_training_to_loss

    # Three days at 15 minutes are one run of 288 steps; the pairs of this bench are 120 runs of 40 hours.
    comparisons, targets = [], []
    for n_steps, rollouts in ((288, 1), (40, 120)):
        say(f"speed: training on {rollouts} x {n_steps} steps")
        comparisons.append(compare_training(n_steps, rollouts))
        training = compare_training_to_loss(n_steps, rollouts, epochs)
        comparisons.append(training)
        name = f"speed: training on {rollouts} x {n_steps} steps to the same loss, times faster than a loop"
        targets.append(Target(name, training.ratio, _SPEED_GOAL, "at least"))
    say(f"speed: {buildings} buildings")
    many = compare_many_buildings(buildings)
    comparisons.append(many)
    name = f"speed: two-stage identification of {buildings} buildings at once, times faster than one by one"
    targets.append(Target(name, many.ratio, _MANY_GOAL, "at least"))
    say("speed: rollouts")
    for n_steps in (24, 48):
        by_casadi, by_numpy = compare_rollout(n_steps)
        comparisons += [by_casadi, by_numpy, compare_module_call(n_steps)]
        name = f"speed: CasADi rollout of {n_steps} steps against the torch module step by step, times faster"
        targets.append(Target(name, by_casadi.ratio, _SPEED_GOAL, "at least"))
    rows = [
        {"part": "speed", "data": c.name, "plain_ms": 1e3 * c.plain_s, "fast_ms": 1e3 * c.fast_s, "ratio": c.ratio}
        for c in comparisons
    ]
    # Times printed in the paper (another machine), for orientation, with the nearest figure of this run.
    single, trained, rolled = many.plain_s / buildings, comparisons[1].fast_s, comparisons[5].fast_s
    paper = (
        ("RC identification (3 days)", 24.0, single),
        ("training, 300 epochs (ours: to the same loss)", 5600.0, trained),
        ("forced rollout, 24 steps", 2.1, rolled),
    )
    rows += [
        {"part": "paper's figures", "data": name, "paper_ms": theirs, "ours_ms": 1e3 * ours}
        for name, theirs, ours in paper
    ]
    return rows, targets
