"""Chronos-Bolt (Ansari et al. 2024) and Chronos-2 (Ansari et al. 2025) by `chronos-forecasting` or a graph.

A graph, `model.onnx`, holds the model's operations for ONNX Runtime, for any number and length of series: several times
as fast for one building, and without torch. Its weights are the tensors of `model.safetensors` beside it, whose hash it
names. `python -m benchmarks.pretraining export FOLDER` writes it.
"""

from __future__ import annotations

import functools
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.model.free_response.backbones.base import (
    COVARIATES,
    LINEAR_MODEL,
    Backbone,
    Context,
    frozen_pass,
    padded_series,
)
from thermoforce_mpc.model.free_response.backbones.checkpoint import WEIGHTS, check_weights, damaged, quiet
from thermoforce_mpc.model.free_response.checks import LEVELS, level_places

if TYPE_CHECKING:
    from torch import nn

GRAPH = "model.onnx"
WEIGHTS_KEY = "weights_sha256"
# What a graph of each family is given.
_INPUTS = {"ChronosBoltPipeline": ("context",), "Chronos2Pipeline": ("context", "future_covariates")}
# Largest batch: beyond, the activations leave the cache of a core and the pass becomes slower.
_AT_ONCE = 48
# Contexts of one length below which they join a batch of longer ones: a pass of their own would cost more than the
# padding.
_FEW = 16


class Graph:
    """The graph in `folder`, run on one thread, so that results are the same bits.

    Raises `BackboneError` for one that cannot be read, has other `inputs`, or was exported from other weights.
    """

    def __init__(self, folder: Path, inputs: tuple[str, ...]) -> None:
        import onnxruntime

        self._weights = folder / WEIGHTS
        self.weights_sha256 = file_sha256(self._weights)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3  # errors, which are raised as well
        try:
            self._session = onnxruntime.InferenceSession(folder / GRAPH, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the library raises many types
            reason = " ".join(str(error).split())[:300]
            raise BackboneError(f"{folder / GRAPH} cannot be loaded ({reason}); {_again(folder)}") from error
        if (found := {one.name for one in self._session.get_inputs()}) != set(inputs):
            raise BackboneError(
                f"{folder / GRAPH} takes {', '.join(sorted(found))}, expected {', '.join(inputs)}; {_again(folder)}"
            )
        exported_from = self._session.get_modelmeta().custom_metadata_map.get(WEIGHTS_KEY)
        if exported_from != self.weights_sha256:
            raise BackboneError(f"{folder / GRAPH} was exported from other weights than {WEIGHTS}; {_again(folder)}")

    @property
    def parameters(self) -> int:
        """Number of weights."""
        from safetensors import safe_open

        with safe_open(str(self._weights), framework="numpy") as content:
            return sum(math.prod(content.get_slice(name).get_shape()) for name in content.keys())  # noqa: SIM118

    def __call__(self, **inputs: NDArray[np.generic]) -> NDArray[np.float32]:
        """The output for inputs by name."""
        (values,) = self._session.run(None, inputs)
        return np.asarray(values, dtype=np.float32)


class ByGraph:
    """What backbones have in common that a graph may run in place of the library.

    `settings`: `chronos_config` of the checkpoint. `load`: the library's pipeline, frozen; of a checkpoint with a graph
    called only for horizons to be unrolled.
    """

    def __init__(
        self, settings: Mapping[str, Any], label: str, load: Callable[[], Any], graph: Graph | None = None
    ) -> None:
        self.label, self._load, self.graph = label, load, graph
        self._patch, self._longest = int(settings["input_patch_size"]), int(settings["context_length"])
        self._at_once = self._steps_at_once(settings)
        self._levels = level_places(settings["quantiles"])

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """Modules with weights."""
        return () if self.graph else (self._pipeline.model,)

    @cached_property
    def _pipeline(self) -> Any:
        return self._load()

    def _steps_at_once(self, settings: Mapping[str, Any]) -> int:
        """Number of steps that the model forecasts without being unrolled."""
        return int(settings["prediction_length"])


def _again(folder: Path) -> str:
    return (
        f"export it again where the sources of this package are (`python -m benchmarks.pretraining export {folder}`), "
        f"or delete it to run the weights by torch"
    )


class BoltBackbone(ByGraph):
    """`Backbone` of a `ChronosBoltPipeline`; uses the series only."""

    @cached_property
    def _pipeline(self) -> Any:
        pipeline = self._load()
        # The decoder runs once per call, so its cache is never read but takes 20 % of the time.
        pipeline.model.decoder.config.use_cache = False
        return pipeline

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`; the library unrolls horizons beyond the trained one.

        Contexts of one number of patches form a batch, since padding to the longest costs as much as the longest; few
        of them join longer ones, since each batch costs as much as several contexts.
        """
        answers: list[Array] = [np.empty(0)] * len(contexts)
        of_size: dict[tuple[bool, int], list[int]] = {}
        for i, context in enumerate(contexts):
            unrolled = len(context.ahead_weather) > self._at_once
            of_size.setdefault((unrolled, -(-context.free_C.size // self._patch)), []).append(i)
        batches: list[list[int]] = []
        for _, same in sorted(of_size.items(), reverse=True):
            if batches and min(len(batches[-1]), len(same)) < _FEW:
                batches[-1] += same
            else:
                batches.append(same)
        for batch in batches:
            for first in range(0, len(batch), _AT_ONCE):
                some = batch[first : first + _AT_ONCE]
                for i, values in zip(some, self._predict([contexts[i] for i in some]), strict=True):
                    answers[i] = values
        return answers

    def _predict(self, contexts: Sequence[Context]) -> list[Array]:
        steps = [len(context.ahead_weather) for context in contexts]
        series = padded_series(contexts, self._patch)
        if self._levels is not None and max(steps) <= self._at_once:
            values = self._at_once_of(series[:, -self._longest :])[:, self._levels]
        else:
            values = self._unrolled(series, max(steps))
        return [value[:, :n] for value, n in zip(values.astype(np.float64), steps, strict=True)]

    def _unrolled(self, series: NDArray[np.float32], steps: int) -> NDArray[np.float32]:
        """Quantiles (B, 9, steps) by the library, which unrolls what it does not forecast at once."""
        pipeline = self._pipeline
        import torch

        with frozen_pass(), warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = pipeline.predict_quantiles(torch.from_numpy(series), steps, LEVELS.round(1).tolist())
        return np.asarray(values.transpose(1, 2))

    def _at_once_of(self, series: NDArray[np.float32]) -> NDArray[np.float32]:
        """All trained quantiles (B, quantiles, steps) of series (B, k), k a multiple of the patch."""
        if self.graph is not None:
            return self.graph(context=series)
        import torch

        return np.asarray(self._pipeline.model(context=torch.from_numpy(series)).quantile_preds)


class Chronos2Backbone(ByGraph):
    """`Backbone` of a `Chronos2Pipeline` with outdoor temperature, irradiance and clock, past and ahead.

    One that was trained on what linear weather models leave over reads their course, too (`after_linear_weather`).
    """

    def __init__(self, *args: Any, after_linear_weather: bool = False) -> None:
        super().__init__(*args)
        self.after_linear_weather = after_linear_weather
        self._names = (*COVARIATES, LINEAR_MODEL) if after_linear_weather else COVARIATES

    def _steps_at_once(self, settings: Mapping[str, Any]) -> int:
        return int(settings["output_patch_size"]) * int(settings["max_output_patches"])

    def quantiles_C(self, contexts: Sequence[Context]) -> list[Array]:
        """See `Backbone.quantiles_C`; contexts with equal N form one batch."""
        answers: list[Array] = [np.empty(0)] * len(contexts)
        for steps in {len(context.ahead_weather) for context in contexts}:
            same = [i for i, context in enumerate(contexts) if len(context.ahead_weather) == steps]
            by_graph = self.graph is not None and self._levels is not None and steps <= self._at_once
            predict = self._by_graph if by_graph else self._by_library
            for i, values in zip(same, predict([contexts[i] for i in same], steps), strict=True):
                answers[i] = values
        return answers

    def _by_graph(self, contexts: Sequence[Context], steps: int) -> list[Array]:
        assert self.graph is not None
        k = -(-max(context.free_C.size for context in contexts) // self._patch) * self._patch
        rows = 1 + len(self._names)  # of a context: the series, then its covariates
        past = np.full((len(contexts), rows, k), np.nan, dtype=np.float32)
        past[:, 0] = padded_series(contexts, self._patch)
        ahead = np.full((len(contexts), rows, -(-steps // self._patch) * self._patch), np.nan, dtype=np.float32)
        for i, context in enumerate(contexts):
            past[i, 1:, k - context.free_C.size :] = context.past_weather.T[: rows - 1]
            ahead[i, 1:, :steps] = context.ahead_weather.T[: rows - 1]
        values = self.graph(context=past[:, :, -self._longest :], future_covariates=ahead)
        return list(values[:, self._levels, :steps].astype(np.float64))

    def _by_library(self, contexts: Sequence[Context], steps: int) -> list[Array]:
        tasks = [
            {
                "target": context.free_C.astype(np.float32),
                "past_covariates": self._columns(context.past_weather),
                "future_covariates": self._columns(context.ahead_weather),
            }
            for context in contexts
        ]
        pipeline = self._pipeline
        with frozen_pass(), warnings.catch_warnings():
            # Unrolling is intended here; the library warns at every call.
            warnings.filterwarnings("ignore", message="We recommend keeping prediction length")
            values, _ = pipeline.predict_quantiles(
                tasks, prediction_length=steps, quantile_levels=LEVELS.round(1).tolist()
            )
        # One list entry per task, shape (variates, N, levels); the target is the only variate forecast.
        return [np.asarray(value[0].T.double().numpy()) for value in values]

    def _columns(self, weather: Array) -> dict[str, Any]:
        return {name: weather[:, i].astype(np.float32) for i, name in enumerate(self._names)}


def load(name: str, folder: Path, label: str = "") -> Backbone:
    """A checkpoint of the Chronos family in a folder: its graph, where it has one, else its weights by torch.

    Raises `BackboneError` for another Chronos, quantiles that do not span 0.1 to 0.9, or a graph of other weights.
    """
    graph, pipeline = None, functools.cache(functools.partial(torch_pipeline, name, folder))
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    if (folder / GRAPH).is_file():
        family, settings = config["chronos_pipeline_class"], config["chronos_config"]
        graph = Graph(folder, _INPUTS.get(family, ()))
    else:
        family, settings = type(pipeline()).__name__, vars(pipeline().model.chronos_config)
    levels = settings.get("quantiles", [])
    # The library clamps quantiles outside its trained levels, which would give too narrow an interval.
    if family in {"ChronosBoltPipeline", "Chronos2Pipeline"} and not (min(levels) <= 0.1 and max(levels) >= 0.9):
        raise BackboneError(f"backbone '{name}': trained for the quantiles {levels}; 0.1 to 0.9 are needed")
    if family == "ChronosBoltPipeline":
        return BoltBackbone(settings, label or f"Chronos-Bolt '{name}'", pipeline, graph)
    if family == "Chronos2Pipeline":
        after = config.get("after_linear_weather", False) is True
        label = label or f"Chronos-2 '{name}' with weather"
        return Chronos2Backbone(settings, label, pipeline, graph, after_linear_weather=after)
    raise BackboneError(f"backbone '{name}' is a {family}; of this library Chronos-Bolt and Chronos-2 are supported")


def torch_pipeline(name: str, folder: Path) -> Any:
    """The library's pipeline of a local checkpoint, its weights checked and frozen; raises `BackboneError`."""
    import torch
    from chronos import BaseChronosPipeline

    try:
        with quiet():
            pipeline = BaseChronosPipeline.from_pretrained(
                str(folder), device_map="cpu", dtype=torch.float32, local_files_only=True, use_safetensors=True
            )
    except Exception as error:  # the libraries raise many types
        raise damaged(name, folder, error) from error
    check_weights(name, pipeline.model.state_dict(), folder)
    pipeline.model.eval().requires_grad_(False)
    return pipeline
