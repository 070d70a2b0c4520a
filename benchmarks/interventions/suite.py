"""Fit every method on the probe days of each climate and score it on the test pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.cases import run_all
from benchmarks.interventions.dataset import ClimateData, Dataset, Window
from benchmarks.interventions.methods.base import Predictor, Training
from benchmarks.interventions.methods.registry import METHODS, find_method
from benchmarks.interventions.methods.remembering import tsfm
from benchmarks.interventions.protocol import WINDOW_START_H
from benchmarks.interventions.scores import LEVELS, CellScore, score_cell
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.plants.energyplus.zone import ClimateName


@dataclass(frozen=True)
class Fan:
    """Predictions of one window at five constant levels of u; `answers_C` maps a method to shape (5, N), °C."""

    climate: ClimateName
    window: Window
    answers_C: dict[str, Array]


@dataclass(frozen=True)
class SuiteResult:
    """Scores of every method on every cell, and one fan per climate."""

    scores: tuple[CellScore, ...]
    fans: tuple[Fan, ...]

    def of(self, method: str, climate: str | None = None, days: int | None = None) -> list[CellScore]:
        """Scores of one method, in the order of the cells."""
        return [
            s
            for s in self.scores
            if s.method == method and climate in (None, s.climate) and (days is None or s.days == days)
        ]


def run_suite(
    data: Dataset,
    days: Sequence[int],
    *,
    methods: Sequence[str] = tuple(METHODS),
    backbone: str = "shipped",
    seed: int = 1,
    engine: Engine,
    say: Callable[[str], None] = lambda line: None,
) -> SuiteResult:
    """Fit and score every method on every cell, for each number of probe days.

    Args:
        data: paired data of all climates.
        days: numbers of probe days K; each must have been simulated.
        methods: names in `METHODS`.
        backbone: weights of the forecaster, shared by all methods that use one.
        seed: seed of the networks.
        engine: where methods are fitted and scored; results do not depend on it.
        say: callback for progress lines.

    Raises:
        ConfigError: unknown method.
        DataError: the probe days were not simulated, or identification from them failed.
        BackboneError: the forecaster's weights cannot be loaded.
    """
    for name in methods:
        find_method(name)
    tasks = [(climate, k, name, backbone, seed) for climate in data.climates.values() for k in days for name in methods]

    labels: dict[str, str] = {name: of.climate.label for name, of in data.climates.items()}

    def told(n: int, outcome: tuple[list[CellScore], Array]) -> None:
        cells, _ = outcome
        effect = np.mean([cell.effect_rmse_K for cell in cells])  # as in the table
        which = f"{labels[cells[0].climate]}, {cells[0].days} probe days, {METHODS[cells[0].method].label}"
        say(f"{which}: effect RMSE {effect:.3f} K")

    outcomes = run_all(_evaluate, tasks, engine, told)
    scores = [score for cells, _ in outcomes for score in cells]
    fans: dict[ClimateName, dict[str, Array]] = {name: {} for name in data.climates}
    for (climate, k, name, _, _), (_, fan) in zip(tasks, outcomes, strict=True):
        if k == days[0]:
            fans[climate.climate.name][name] = fan
    return SuiteResult(
        tuple(scores),
        tuple(Fan(name, fan_window(data.climates[name]), answers) for name, answers in fans.items()),
    )


def fan_window(data: ClimateData) -> Window:
    """Window of the counterfactual figure: the first afternoon of the test part."""
    return next(w for w in data.part("test") if w.name == "afternoon")


def training_of(data: ClimateData, days: int, seed: int = 1) -> Training:
    """Training data for `days` probe days; raises `DataError` if these were not simulated."""
    if days not in data.probes:
        raise DataError(f"{days} probe days were not simulated; there are {', '.join(map(str, data.probes))}")
    return Training(data.climate, days, data.probes[days], data.part("validation"), seed)


def score_cells(name: str, predictor: Predictor, data: ClimateData, days: int) -> list[CellScore]:
    """Score a fitted method on the three test cells of a climate."""
    cells = [[w for w in data.part("test") if w.name == window] for window in WINDOW_START_H]
    return [score_cell(name, predictor, windows, days, data.climate.sign) for windows in cells]


def _evaluate(task: tuple[ClimateData, int, str, str, int]) -> tuple[list[CellScore], Array]:
    import torch

    torch.set_num_threads(1)  # fixed order of summation: reproducible results
    data, days, name, backbone, seed = task
    predictor = METHODS[name].build(training_of(data, days, seed), tsfm(backbone))
    window = fan_window(data)
    held = np.broadcast_to(LEVELS[:, None], (LEVELS.size, window.factual.n_steps))
    return score_cells(name, predictor, data, days), predictor.respond(window, held)
