"""Evaluation of a checkpoint on held-out synthetic series: error against simple forecasts, and calibration.

It shows whether training worked and how much history the model needs. `tf-mpc bench free-response` evaluates the
forecaster on series of buildings.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pretraining.model import CONTEXT, HORIZON, QUANTILES
from benchmarks.pretraining.series import Batch, courses, draw_batch
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError, ConfigError
from thermoforce_mpc.model.free_response.backbones.base import COVARIATES, LINEAR_MODEL

CONTEXTS = (48, 96, 168, 336, 512)
_SEASON = 24
# Streams 1 and 2 of a seed are used for training and validation.
_STREAM = 3
# Errors are scaled by the standard deviation of the context, so nearly constant contexts are excluded.
_LEAST_SCALE = 1e-3


@dataclass(frozen=True)
class ContextScore:
    """Scores at one context length, pooled over series and the first `steps` steps ahead.

    Errors are mean absolute ones over the standard deviation of each series' context. `coverage` holds the share of
    values at or below each of the model's quantiles, which should be the quantile's level.
    """

    context: int
    series: int
    steps: int
    model: float
    persistence: float
    seasonal_naive: float
    inside_80: float
    coverage: tuple[float, ...]


def evaluate(folder: Path, *, series: int = 1024, seed: int = 0, steps: int = 24) -> dict[str, Any]:
    """Score the checkpoint in `folder` at several context lengths on the same held-out series.

    A Chronos-2 corrects the linear weather model, so its shortest context is a day.

    Args:
        folder: config.json and model.safetensors of a Chronos-Bolt, or of a Chronos-2, which gets the weather too.
        series: number of series.
        seed: seed of the series; it may equal the training seed, since another stream is used.
        steps: number of forecast steps that are scored, at most `HORIZON`.

    Returns:
        `contexts`: a list of `ContextScore` as dicts; `milliseconds`: median time of one forecast of `steps` steps.

    Raises:
        BackboneError: there is no checkpoint in `folder`, or it cannot be loaded.
        ConfigError: `series` or `steps` is out of range.
    """
    if not 1 <= steps <= HORIZON:
        raise ConfigError(f"steps is {steps}: the model forecasts 1 to {HORIZON} at once")
    if series < 1:
        raise ConfigError(f"series is {series}: draw at least one")
    pipeline = _load(folder)
    batch = _held_out(np.random.default_rng([seed, _STREAM]), series, steps)
    # All context lengths share one scale, that of the shortest context, which contains no future values.
    scale = batch.context[:, -min(CONTEXTS) :].std(axis=1, keepdims=True)
    # What corrects a linear model needs a day, 96 steps at 15 min.
    lengths = [length for length in CONTEXTS if length >= 96 or not _corrects(pipeline)]
    scores = [_score(pipeline, _cut(batch, length, steps), scale) for length in lengths]
    return {
        "seed": seed,
        "contexts": [asdict(score) for score in scores],
        "milliseconds": _milliseconds(pipeline, Batch(*(values[:1] for values in _fields(batch)))),
    }


def _load(folder: Path) -> Any:
    import torch
    from chronos import BaseChronosPipeline

    if not (folder / "config.json").is_file():
        raise BackboneError(f"{folder}: no config.json there; give the folder of a checkpoint")
    try:
        pipeline = BaseChronosPipeline.from_pretrained(str(folder), device_map="cpu", dtype=torch.float32)
    except Exception as error:  # the libraries below raise anything from KeyError to their own types
        raise BackboneError(f"{folder} cannot be loaded: {type(error).__name__}: {error}") from error
    pipeline.model.eval()
    return pipeline


def _held_out(rng: np.random.Generator, series: int, steps: int) -> Batch:
    """Series whose shortest context has no gaps, with `steps` values of their future.

    The same series serve all context lengths, so padded ones are drawn again.
    """
    found: list[Batch] = []
    while sum(len(batch.context) for batch in found) < series:
        batch = _cut(draw_batch(rng, 256, CONTEXT, HORIZON), CONTEXT, steps)
        usable = np.isfinite(batch.context).all(axis=1) & np.isfinite(batch.future).all(axis=1)
        usable &= batch.context[:, -min(CONTEXTS) :].std(axis=1) > _LEAST_SCALE
        found.append(Batch(*(values[usable] for values in _fields(batch))))
    return Batch(*(np.concatenate(values)[:series] for values in zip(*map(_fields, found), strict=True)))


def _cut(batch: Batch, length: int, steps: int) -> Batch:
    """The last `length` values of the contexts, and the first `steps` of their future."""
    context = batch.context.shape[1]
    seen = slice(context - length, context + steps)
    return Batch(batch.context[:, -length:], batch.future[:, :steps], batch.covariates[:, :, seen], batch.hour[:, seen])


def _fields(batch: Batch) -> tuple[NDArray[Any], ...]:
    return batch.context, batch.future, batch.covariates, batch.hour


def _score(pipeline: Any, batch: Batch, scale: Array) -> ContextScore:
    past, future = batch.context.astype(np.float64), batch.future.astype(np.float64)
    n, steps = future.shape
    quantiles = _quantiles(pipeline, batch)
    day = past[:, -_SEASON:]
    naive = np.tile(day, (1, -(-steps // _SEASON)))[:, :steps]
    below = future[:, None, :] <= quantiles

    def error(forecast: Array) -> float:
        return float((np.abs(future - forecast) / scale).mean())

    return ContextScore(
        context=int(past.shape[1]),
        series=int(n),
        steps=int(steps),
        model=error(quantiles[:, QUANTILES.index(0.5)]),
        persistence=error(np.repeat(past[:, -1:], steps, axis=1)),
        seasonal_naive=error(naive),
        inside_80=float(((future >= quantiles[:, 0]) & (future <= quantiles[:, -1])).mean()),
        coverage=tuple(float(share) for share in below.mean(axis=(0, 2))),
    )


def _quantiles(pipeline: Any, batch: Batch) -> Array:
    """The model's nine quantiles, sorted, shape (n, 9, steps)."""
    import torch

    steps, course_ahead = batch.future.shape[1], np.zeros((1, 1, 1), dtype=np.float32)
    with torch.no_grad():
        if _corrects(pipeline):
            course, k = courses(batch), batch.context.shape[1]
            course_ahead, known = course[:, None, k:], np.concatenate([batch.covariates, course[:, None]], axis=1)
            tasks = [_task(*pair, steps) for pair in zip(batch.context - course[:, :k], known, strict=True)]
            each, _ = pipeline.predict_quantiles(tasks, prediction_length=steps, quantile_levels=QUANTILES)
            found = torch.stack([values[0] for values in each])
        else:
            found, _ = pipeline.predict_quantiles(torch.from_numpy(batch.context), steps, QUANTILES)
    return np.asarray(np.sort(found.numpy().transpose(0, 2, 1), axis=1) + course_ahead, dtype=np.float64)


def _corrects(pipeline: Any) -> bool:
    from chronos import Chronos2Pipeline

    return isinstance(pipeline, Chronos2Pipeline)


def _task(past: NDArray[np.float32], covariates: NDArray[np.float32], steps: int) -> dict[str, Any]:
    """A series (k,) with its covariates (4, k + steps)."""
    names = (*COVARIATES, LINEAR_MODEL)
    return {
        "target": past,
        "past_covariates": dict(zip(names, covariates[:, :-steps], strict=True)),
        "future_covariates": dict(zip(names, covariates[:, -steps:], strict=True)),
    }


def _milliseconds(pipeline: Any, batch: Batch, repeats: int = 30) -> float:
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        _quantiles(pipeline, batch)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)) * 1e3
