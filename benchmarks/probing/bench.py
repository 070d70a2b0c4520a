"""`tf-mpc bench probing`: informative against random probing on the embedded plant.

It identifies from days of either and scores the effect on pairs of probed runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from benchmarks.operator.data import FLOOR_AREA_M2, ReferencePair
from benchmarks.operator.score import score_pairs
from benchmarks.probing.pair_probing import probe_pair
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, Pair, identify
from thermoforce_mpc.identification.probing.design import information
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant

_LEVELS = (0.0, 0.4, 0.7, 1.0)
_PAIR_DAYS, _START_DAYS = (12, 25, 40, 60, 75, 90, 300, 330), (18, 33, 50, 68, 83, 310)
_LINEAR = IdentificationConfig(modulation="linear")

Row = dict[str, Any]


def run_probing_bench(*, quick: bool = False, progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Run it on the embedded plant with the synthetic year.

    Args:
        quick: fewer days and one seed.
        progress: callback for progress lines.
    """
    say = progress or (lambda text: None)
    plant = EmbeddedPlant(synthetic_weather())
    pairs = _pairs(plant, quick, say)
    rows, targets = _designs(plant, pairs, quick, say)
    return results_json("probing", rows, targets)


def _pairs(plant: EmbeddedPlant, quick: bool, say: Callable[[str], None]) -> list[ReferencePair]:
    say("simulating pairs for scoring")
    config = ProbingConfig(design="random", warmup_days=2.0)
    pairs = []
    for day in _PAIR_DAYS[:1] if quick else _PAIR_DAYS:
        pair = probe_pair(plant, day * DAY_S, 1.25, seeds=(day, day + 1000), config=config)
        pairs.append(ReferencePair(day, "probed", 0, Pair(_hourly(pair.a), _hourly(pair.b))))
    return pairs


def _designs(
    plant: EmbeddedPlant, pairs: list[ReferencePair], quick: bool, say: Callable[[str], None]
) -> tuple[list[Row], list[Target]]:
    rows: list[Row] = []
    found: dict[tuple[int, str], list[float]] = {}
    designs: tuple[Literal["random", "informative"], ...] = ("random", "informative")
    for days in (1, 3):
        for design in designs:
            say(f"{days} days, {design}")
            errors, worth, extremes, refused = [], [], [], 0
            for day in _START_DAYS[:1] if quick else _START_DAYS:
                for seed in (1,) if quick else (1, 2):
                    probing = ProbingConfig(design=design, levels=_LEVELS, warmup_days=3.0)
                    record = probe(plant, day * DAY_S, days, seed=seed, config=probing)
                    extremes += [float(record.T_zone_C.min()), float(record.T_zone_C.max())]
                    worth.append(information(record))
                    try:
                        model = identify([record], config=_LINEAR, floor_area_m2=FLOOR_AREA_M2)
                    except DataError:
                        refused += 1
                        continue
                    errors.append(score_pairs(model.only.operator, pairs).rmse_K)
            found[days, design] = errors
            rows.append(
                {
                    "data": f"{days} days, {len(worth)} records",
                    "draws": design,
                    "information_nats": float(np.mean(worth)),
                    "mean_rmse_K": float(np.mean(errors)),
                    "worst_rmse_K": float(np.max(errors)),
                    "refused": refused,
                    "coldest_C": min(extremes),
                    "warmest_C": max(extremes),
                }
            )
    targets = [
        Target(
            f"{days} days: effect RMSE of chosen draws against random ones",
            float(np.mean(found[days, "informative"]) / np.mean(found[days, "random"])),
            1.0,
        )
        for days in (1, 3)
    ]
    return rows, targets


def _hourly(run: Record) -> Record:
    return run.resample(round(HOUR_S / run.step_s))
