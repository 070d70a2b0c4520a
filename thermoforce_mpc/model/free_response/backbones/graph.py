"""A frozen model as operations that ONNX Runtime runs: several times as fast for one building, and without torch.

`model.onnx` holds the operations, for any number and length of series; its weights are the tensors of
`model.safetensors` beside it, whose hash it names. `python -m benchmarks.pretraining export FOLDER` writes it.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.checkpoint import WEIGHTS

GRAPH = "model.onnx"
WEIGHTS_KEY = "weights_sha256"


class Graph:
    """The graph in `folder`, loaded with its weights and run on one thread, so that results are the same bits.

    Raises:
        BackboneError: it cannot be read, or was exported from other weights.
    """

    def __init__(self, folder: Path) -> None:
        import onnxruntime

        self._weights = folder / WEIGHTS
        self.weights_sha256 = hashlib.sha256(self._weights.read_bytes()).hexdigest()
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


def _again(folder: Path) -> str:
    return (
        f"export it again where the sources of this package are (`python -m benchmarks.pretraining export {folder}`), "
        f"or delete it to run the weights by torch"
    )
