"""Export of a checkpoint's operations as `model.onnx`, which ONNX Runtime runs in place of torch.

The file holds operations only: its weights are the tensors of `model.safetensors` beside it, by name and place, so that
they are stored once and in the precision in which they are stored there.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.chronos_family import torch_pipeline
from thermoforce_mpc.model.free_response.backbones.graph import GRAPH, WEIGHTS, WEIGHTS_KEY

# What the graph is recorded with: any number of series and of patches may be given to it afterwards.
_ROWS, _PATCHES, _PATCHES_AHEAD = 6, 5, 2


class _Bolt(nn.Module):
    """Chronos-Bolt: series (B, k) with NaN gaps to quantiles (B, quantiles, steps)."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, context: Tensor) -> Tensor:
        return self.model(context=context).quantile_preds


def export(folder: Path) -> Path:
    """Write `folder`/model.onnx for the checkpoint there and return it.

    Raises:
        BackboneError: no checkpoint, a damaged one, or a family that cannot be exported.
    """
    import onnx_ir as ir
    from onnxscript.optimizer import optimize

    pipeline = torch_pipeline(str(folder), folder)
    exported = _recorded(pipeline)
    weights = _as_inputs(exported.graph)
    optimize(exported)
    _from_file(exported.graph, weights, folder / WEIGHTS, pipeline.model)
    _strip(exported)
    exported.metadata_props[WEIGHTS_KEY] = hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest()
    ir.save(exported, folder / GRAPH)
    return folder / GRAPH


def _recorded(pipeline: Any) -> Any:
    """The operations of a pipeline's model, for any number and length of series."""
    model, example, axes = _of_family(pipeline)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deprecated functions that the exporter itself calls
        program = torch.onnx.export(
            model.eval(), example, dynamo=True, dynamic_shapes=axes, optimize=False, verbose=False
        )
    assert program is not None  # it is None only without `dynamo`
    return program.model


def _of_family(pipeline: Any) -> tuple[nn.Module, tuple[Tensor, ...], tuple[dict[int, Any], ...]]:
    """What is exported of a pipeline, with an example of its inputs and their axes of any length."""
    settings = pipeline.model.chronos_config
    patch = int(settings.input_patch_size)
    rows = torch.export.Dim("rows", min=1, max=4096)
    patches = torch.export.Dim("patches", min=1, max=int(settings.context_length) // patch)
    context = torch.zeros(_ROWS, _PATCHES * patch)
    if type(pipeline).__name__ == "ChronosBoltPipeline":
        return _Bolt(pipeline.model), (context,), ({0: rows, 1: patch * patches},)
    raise BackboneError(f"a {type(pipeline).__name__} is not exported; Chronos-Bolt is")


def _as_inputs(graph: Any) -> dict[str, Any]:
    """The weights of a graph by name, turned into its inputs so that nothing is computed from them beforehand."""
    weights = {name: value for name, value in graph.initializers.items() if name.startswith("model.")}
    for name, value in weights.items():
        graph.initializers.pop(name)
        value.const_value = None
        graph.inputs.append(value)
    return weights


def _from_file(graph: Any, weights: dict[str, Any], file: Path, model: nn.Module) -> None:
    """Make each weight a tensor of `file` instead, cast to single precision where it is stored in less."""
    import onnx_ir as ir

    stored, begin = _header(file)
    state = model.state_dict()
    place = {state[name].data_ptr(): name for name in stored if name in state}
    for name, value in weights.items():
        graph.inputs.remove(value)
        if not value.uses():
            continue
        tensor = stored[place[state[name.removeprefix("model.")].data_ptr()]]
        first, last = tensor["data_offsets"]
        dtype = {"F16": ir.DataType.FLOAT16, "F32": ir.DataType.FLOAT}[tensor["dtype"]]
        shape = ir.Shape(tensor["shape"])
        content = ir.ExternalTensor(
            file.name, begin + first, last - first, dtype, shape=shape, name=name, base_dir=file.parent
        )
        constant = ir.Value(name=name, shape=shape, type=ir.TensorType(dtype), const_value=content)
        graph.initializers[name] = constant
        cast = ir.node("Cast", [constant], {"to": ir.DataType.FLOAT})
        ir.convenience.replace_all_uses_with(value, cast.outputs[0])
        cast.outputs[0].name = f"{name}_single"
        graph.insert_before(graph[0], cast)


def _header(file: Path) -> tuple[dict[str, Any], int]:
    """The tensors of a safetensors file by name, and where its data begin, bytes."""
    with file.open("rb") as content:
        length = int.from_bytes(content.read(8), "little")
        tensors = json.loads(content.read(length))
    tensors.pop("__metadata__", None)
    return tensors, 8 + length


def _strip(model: Any) -> None:
    """Remove what the exporter notes on each operation: paths of its sources, and stack traces."""
    for node in model.graph:
        node.metadata_props.clear()
        node.doc_string = None
        for value in node.outputs:
            value.metadata_props.clear()
    for value in (*model.graph.inputs, *model.graph.initializers.values()):
        value.metadata_props.clear()
    model.metadata_props.clear()
    model.graph.metadata_props.clear()
