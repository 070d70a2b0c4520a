"""`tf-mpc bench verdicts`: is a model that passes worth acting on, and how many good ones are held back?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.effects.asking import probed_days
from benchmarks.verdicts.house import EQUAL_KH, USEFUL, Case, Judged, judged
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.execution import Engine

# Goal: share of good models that are held back.
_HELD_BACK = 0.1
_QUICK_HOUSES = 2

Row = dict[str, Any]


def run_verdicts_bench(
    *,
    seed: int = 1,
    houses: int = 60,
    closed_loop: int = 60,
    days: Sequence[float] = (1.5, 3.0),
    engine: Engine,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Judge the models of the houses 0 to `houses` − 1 of population `seed`, beside what they are worth.

    Args:
        closed_loop: so many of the houses also run a week in closed loop.
        days: numbers of days of probing, from 1 to 10.
        engine: where the houses are run.
        quick: two houses, one in closed loop, the fewest days.
        progress: callback for progress lines.

    Raises:
        InputError: no houses, or a number of days out of range.
        PlantError: a plant failed.
    """
    probed = probed_days(houses, days, quick=quick)
    n, closed = (min(houses, _QUICK_HOUSES), min(closed_loop, 1)) if quick else (houses, closed_loop)
    cases = [Case(seed, index, probed, index < closed) for index in range(n)]

    def told(done: int, models: list[Judged]) -> None:
        progress(f"{done} of {n}: " + "; ".join(f"{one.days:g} days {_worth(one)}" for one in models))

    models = [one for found in run_all(judged, cases, engine, told) for one in found]
    return results_json("verdicts", [*map(row, models), *summary(models)], targets(models))


def row(one: Judged) -> Row:
    """Table row of a model: verdict, error of the effect, cost and discomfort beside the thermostat's."""
    weeks = {
        name: "–" if week is None else f"{week.cost:.3f} / {week.discomfort_Kh:.2f}"
        for name, week in (("ours", one.ours), ("thermostat", one.thermostat))
    }
    missed = one.refused or ("" if one.verdict is None else "; ".join(one.verdict.reasons))
    return {
        "house": one.house,
        "in words": one.words,
        "days": one.days,
        "verdict": "refused" if one.refused else "passes" if one.passes else "held back",
        "effect_error": round(one.error, 3) if np.isfinite(one.error) else None,
        **weeks,
        "costs more": one.costs_more,
        "missed": missed,
    }


def summary(models: Sequence[Judged]) -> list[Row]:
    """Counts by days of probing and verdict."""
    rows = []
    for days in dict.fromkeys(one.days for one in models):
        of = [one for one in models if one.days == days]
        for name, some in (
            ("passes", [one for one in of if one.passes]),
            ("held back", [one for one in of if not one.passes and not one.refused]),
            ("refused", [one for one in of if one.refused]),
        ):
            run = [one.costs_more for one in some if one.costs_more is not None]
            rows.append(
                {
                    "days": days,
                    "verdict": name,
                    "models": len(some),
                    "good": sum(one.is_good for one in some),
                    f"effect off by more than {USEFUL:.0%}": sum(one.error > USEFUL for one in some),
                    "weeks in closed loop": len(run),
                    "of these cost more": sum(run),
                }
            )
    return rows


def targets(models: Sequence[Judged]) -> list[Target]:
    """No model that passes costs more than the thermostat; few good ones are held back."""
    found = []
    for days in dict.fromkeys(one.days for one in models):
        of = [one for one in models if one.days == days and not one.refused]
        passing, good = [one for one in of if one.passes], [one for one in of if one.is_good]
        run = [one for one in passing if one.costs_more is not None]
        held = sum(not one.passes for one in good) / len(good) if good else float("nan")
        name = f"{days:g} days"
        found += [
            Target(
                f"{name}: of {len(run)} models that pass, cost more than the thermostat at equal comfort "
                f"(± {EQUAL_KH:g} K·h a week)",
                float(sum(bool(one.costs_more) for one in run)),
                0.0,
            ),
            Target(
                f"{name}: of {len(passing)} models that pass, effect off by more than {USEFUL:.0%}",
                float(sum(one.error > USEFUL for one in passing)),
                0.0,
            ),
            Target(f"{name}: share of {len(good)} good models that are held back", held, _HELD_BACK),
        ]
    return found


def _worth(one: Judged) -> str:
    """A model in short."""
    if one.refused:
        return "refused"
    verdict = "passes" if one.passes else "held back"
    cost = {None: "", True: ", costs more", False: ", costs no more"}[one.costs_more]
    return f"{verdict}, effect off by {100 * one.error:.0f} %{cost}"
