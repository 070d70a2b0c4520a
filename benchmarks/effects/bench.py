"""`tf-mpc bench effects`: what models say of six hours at full level, beside what these do.

From probing on generated houses, the embedded plant and a zone on EnergyPlus; from ordinary operation on houses of
several rooms (`operated`). The truth is the difference of two runs of the same
building, one with the block and one without (paper eq:paired).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.effects.asking import GENERATED, Answer, Case, ask, probed_days
from benchmarks.effects.operated import (
    DAYS,
    ROOMS,
    HouseAnswer,
    OperatedCase,
    ask_operated,
    operated_rows,
    operated_targets,
)
from benchmarks.effects.plot import plot_answers
from benchmarks.effects.windows import LONGEST, WINDOWS
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.plants.energyplus import engine as energyplus

EMBEDDED, ENERGYPLUS = "bestest_hydronic_heat_pump", "energyplus:heating_chicago"
# Goals: size of the median bias and mean size of the bias over a draw, share of bands that hold the truth, size of the
# embedded plant's bias.
_MEDIAN, _MEAN_SIZE, _COVERED, _EMBEDDED = 0.05, 0.12, (0.85, 0.95), 0.05
_QUICK_HOUSES = 2
# Days of operation, least and most.
_LEAST_DAYS, _MOST_DAYS = 7.0, 35.0

Row = dict[str, Any]


def run_effects_bench(
    *,
    seed: int = 1,
    houses: int = 12,
    days: Sequence[float] = (3.0, 7.0),
    engine: Engine,
    quick: bool = False,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run the houses 0 to `houses` − 1 of population `seed`, the embedded plant, and EnergyPlus where it is installed.

    Args:
        days: numbers of days of probing, from 1 to 10.
        engine: where the buildings are run.
        quick: two houses and the embedded plant, the fewest days.
        out: folder for the plot `effects.png`; no plot if None.
        progress: callback for progress lines.

    Raises:
        InputError: no houses, or a number of days out of range.
        PlantError: a plant failed.
    """
    probed = probed_days(houses, days, quick=quick)
    draw = f"seed {seed}"
    cases = [
        Case(f"generated:{seed}:{n}", draw, probed) for n in range(min(houses, _QUICK_HOUSES) if quick else houses)
    ]
    cases.append(Case(EMBEDDED, "embedded plant", probed))
    if not quick and energyplus.is_available():
        cases.append(Case(ENERGYPLUS, "EnergyPlus", probed))
    elif not quick:
        progress("EnergyPlus left out: not installed (pip install -e '.[energyplus]')")

    def told(done: int, answers: list[Answer]) -> None:
        biases = [f"{a.score(LONGEST.name).bias:+.2f}" if a.scores else a.verdict for a in answers]
        progress(f"{done} of {len(cases)}: {answers[0].building}, bias of {LONGEST.name} {', '.join(biases)}")

    answers = [answer for found in run_all(ask, cases, engine, told) for answer in found]
    result = results_json("effects", [*map(row, answers), *summary(answers)], targets(answers))
    result["answers"] = [asdict(answer) for answer in answers]
    if out is not None:
        progress(f"plot: {plot_answers(answers, out)}")
    return result


def run_operated_bench(
    *,
    seed: int = 1,
    houses: int = 12,
    days: float = DAYS,
    engine: Engine,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run the houses of rooms 0 to `houses` − 1 of population `seed` in ordinary operation for `days`; `quick`: one.

    Raises `InputError` for no houses, or days out of range.
    """
    if not _LEAST_DAYS <= days <= _MOST_DAYS:
        raise InputError(f"{days:g} days of operation: expected {_LEAST_DAYS:g} to {_MOST_DAYS:g}")
    if houses < 1:
        raise InputError(f"{houses} houses: expected at least one")
    cases = [OperatedCase(seed, n, ROOMS[n % len(ROOMS)], days) for n in range(1 if quick else houses)]

    def told(done: int, answer: HouseAnswer) -> None:
        (cells, *_) = operated_rows([answer])
        held = "; ".join(f"{of}: {cells[f'{of} in_90_band']} in their bands" for of in ("own", "cross"))
        progress(f"{done} of {len(cases)}: {answer.building}, {answer.refused or held}, {cells['competent']} competent")

    answers = run_all(ask_operated, cases, engine, told)
    result = results_json("effects", operated_rows(answers), operated_targets(answers))
    result["answers"] = [asdict(answer) for answer in answers]
    return result


def row(answer: Answer) -> Row:
    """Table row of one building and number of days: the bias of each window; truth, answer and band of 48 h, K."""
    longest = answer.score(LONGEST.name)
    cells: Row = {"building": answer.building, "in words": answer.words, "days": answer.days}
    cells |= {f"bias {window.name}": _known(answer.score(window.name).bias) for window in WINDOWS}
    cells |= {"true_K": _known(longest.true_K), "said_K": _known(longest.said_K)}
    cells["90 % band"] = f"{longest.low_K:.2f} to {longest.high_K:.2f}" if answer.scores else "–"
    cells["truth outside"] = ", ".join(score.window for score in answer.scores if not score.in_band)
    return cells | {"verdict": answer.verdict}


def summary(answers: Sequence[Answer]) -> list[Row]:
    """Table rows by draw, days of probing and window, over all models, and over the competent where some are not."""
    rows = []
    for (draw, days), of in _drawn(answers).items():
        models = [answer for answer in of if not answer.refused]
        competent = [answer for answer in models if not answer.missed]
        counts = {"houses": len(of), "refused": len(of) - len(models), "not competent": len(models) - len(competent)}
        among = {"all": models} | ({"competent": competent} if len(competent) < len(models) else {})
        for over, some in among.items():
            for window in WINDOWS if some else ():
                scores = [answer.score(window.name) for answer in some]
                biases = np.array([score.bias for score in scores])
                rows.append(
                    {
                        "draw": draw,
                        "days": days,
                        **counts,
                        "models": over,
                        "window": window.name,
                        "median_bias": _known(float(np.median(biases))),
                        "mean_abs_bias": _known(float(np.abs(biases).mean())),
                        "in_90_band": _known(float(np.mean([score.in_band for score in scores]))),
                    }
                )
    return rows


def targets(answers: Sequence[Answer]) -> list[Target]:
    """Goals of each draw and of the embedded plant, for each number of days; the bands of all windows count."""
    found = []
    for (draw, days), of in _drawn(answers).items():
        longest = np.array([answer.score(LONGEST.name).bias for answer in of if answer.scores] or [np.nan])
        held = [score.in_band for answer in of for score in answer.scores]
        covered = float(np.mean(held)) if held else float("nan")
        name, least, most = f"{draw}, {days:g} days", *_COVERED
        found += [
            Target(f"{name}: size of the median bias of {LONGEST.name}", abs(float(np.median(longest))), _MEDIAN),
            Target(f"{name}: mean size of the bias of {LONGEST.name}", float(np.abs(longest).mean()), _MEAN_SIZE),
            Target(f"{name}: share of 90 % bands that hold the truth", covered, least, "at least"),
            Target(f"{name}: share of 90 % bands that hold the truth", covered, most),
        ]
    found += [
        Target(f"embedded plant, {a.days:g} days: size of the bias of {LONGEST.name}", _size(a), _EMBEDDED)
        for a in answers
        if a.building == EMBEDDED
    ]
    return found


def _drawn(answers: Sequence[Answer]) -> dict[tuple[str, float], list[Answer]]:
    """The answers of generated houses by draw and days."""
    groups: dict[tuple[str, float], list[Answer]] = {}
    for answer in sorted(answers, key=lambda a: a.days):
        if answer.building.startswith(GENERATED):
            groups.setdefault((answer.draw, answer.days), []).append(answer)
    return groups


def _size(answer: Answer) -> float:
    return abs(answer.score(LONGEST.name).bias)


def _known(value: float) -> float | None:
    return round(value, 3) if np.isfinite(value) else None
