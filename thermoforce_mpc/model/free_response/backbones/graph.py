"""A frozen model as operations that ONNX Runtime runs: several times as fast for one building, and without torch.

`model.onnx` holds the operations, for any number and length of series; its weights are the tensors of
`model.safetensors` beside it, whose hash it names. `python -m benchmarks.pretraining export FOLDER` writes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.model.free_response.backbones.checkpoint import WEIGHTS
from thermoforce_mpc.model.free_response.checks import level_places

if TYPE_CHECKING:
    from torch import nn

GRAPH = "model.onnx"
WEIGHTS_KEY = "weights_sha256"


class Graph:
    """The graph in `folder`, run on one thread, so that results are the same bits.

    Raises `BackboneError` for one that cannot be read, or was exported from other weights.
    """

    def __init__(self, folder: Path) -> None:
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
