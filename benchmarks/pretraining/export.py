"""Export of a checkpoint's operations as `model.onnx`, which ONNX Runtime runs in place of torch.

The file holds operations only: its weights are the tensors of `model.safetensors` beside it, by name and place, so that
they are stored once and in the precision in which they are stored there.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import json
import warnings
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.checkpoint import WEIGHTS
from thermoforce_mpc.model.free_response.backbones.chronos_family import GRAPH, WEIGHTS_KEY
from thermoforce_mpc.model.free_response.backbones.loading import load_backbone

# What the graph is recorded with: any number of series and of patches may be given to it afterwards.
_ROWS, _PATCHES, _PATCHES_AHEAD = 6, 5, 2
# The first version of ONNX with attention and root mean square normalisation as operations.
_OPSET = 23
# ONNX Runtime's attention takes no mask that is to be broadcast, as Chronos-2's is.
_PLAIN_ATTENTION = ("_attn_implementation", "eager")
_NORMS = ("T5LayerNorm", "Chronos2LayerNorm")


class _Bolt(nn.Module):
    """Chronos-Bolt: series (B, k) with NaN gaps to quantiles (B, quantiles, steps)."""

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, context: Tensor) -> Tensor:
        return cast("Tensor", self.model(context=context).quantile_preds)


class _Chronos2(nn.Module):
    """Chronos-2: rows (B, k), their groups (B,) and what of them is known ahead (B, N), to quantiles (B, quantiles, N).

    Two of its steps are put otherwise: a check that raises by values, and an `einsum` of truth values.
    """

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model
        for layer in model.modules():
            if hasattr(layer, "config"):
                setattr(layer.config, *_PLAIN_ATTENTION)
        for owner, step, in_place in (
            (model, "_prepare_patched_future", self._known_ahead),
            (model.encoder, "_construct_and_invert_group_time_mask", _apart),
        ):
            if not hasattr(owner, step):
                raise BackboneError(f"Chronos-2 has no {step} any more: adapt {__name__} to the installed version")
            setattr(owner, step, in_place)

    def forward(self, context: Tensor, group_ids: Tensor, future_covariates: Tensor) -> Tensor:
        patches = future_covariates.shape[1] // self.model.chronos_config.output_patch_size
        given = {"group_ids": group_ids, "future_covariates": future_covariates}
        return cast("Tensor", self.model(context=context, num_output_patches=patches, **given).quantile_preds)

    def _known_ahead(
        self, future_covariates: Tensor, loc_scale: tuple[Tensor, Tensor], num_output_patches: int, **_: Any
    ) -> tuple[Tensor, Tensor]:
        settings = self.model.chronos_config
        ahead, _ = self.model.instance_norm(future_covariates, loc_scale)
        known = torch.isnan(ahead).logical_not()
        patches = (ahead.shape[0], num_output_patches, settings.output_patch_size)
        time = torch.arange(ahead.shape[1], dtype=torch.float32) / settings.time_encoding_scale
        parts = (time.reshape(1, *patches[1:]).expand(patches), torch.where(known, ahead, 0.0).reshape(patches))
        known = known.to(ahead.dtype).reshape(patches)
        return torch.cat([*parts, known], dim=-1), known


def _apart(group_ids: Tensor, attention_mask: Tensor, floating_type: torch.dtype) -> Tensor:
    """What keeps groups apart, and gaps out, of the attention between rows, (patches, 1, B, B)."""
    same = (group_ids[:, None] == group_ids[None, :]).to(floating_type)
    together = same[None] * attention_mask.to(floating_type).T[:, None, :]
    return (1.0 - together[:, None]) * torch.finfo(floating_type).min


def export(folder: Path) -> Path:
    """Write `folder`/model.onnx for the checkpoint there, in place of one that is there, and return it.

    Raises:
        BackboneError: no checkpoint, a damaged one, or a family that cannot be exported.
    """
    import onnx_ir as ir
    from onnxscript.optimizer import optimize

    (folder / GRAPH).unlink(missing_ok=True)
    (model,) = load_backbone(str(folder)).modules
    exported = _recorded(model)
    weights = _as_inputs(exported.graph, model)
    optimize(exported)
    _from_file(exported.graph, weights, folder / WEIGHTS, model)
    _strip(exported)
    exported.metadata_props[WEIGHTS_KEY] = hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest()
    ir.save(exported, folder / GRAPH)
    return folder / GRAPH


def _recorded(model: Any) -> Any:
    """The operations of a model, for any number and length of series."""
    wrapped, example, axes = _of_family(copy.deepcopy(model))
    for module in wrapped.modules():
        if type(module).__name__ in _NORMS:  # one operation instead of six
            module.forward = functools.partial(_normed, module)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deprecated functions that the exporter itself calls
        program = torch.onnx.export(
            wrapped.eval(),
            example,
            dynamo=True,
            dynamic_shapes=axes,
            opset_version=_OPSET,
            optimize=False,
            verbose=False,
        )
    assert program is not None  # it is None only without `dynamo`
    return program.model


def _normed(norm: Any, x: Tensor) -> Tensor:
    return nn.functional.rms_norm(x, norm.weight.shape, norm.weight, norm.variance_epsilon)


def _of_family(model: Any) -> tuple[nn.Module, tuple[Tensor, ...], tuple[dict[int, Any], ...]]:
    """What is exported of a model, with an example of its inputs and their axes of any length."""
    settings, family = model.chronos_config, type(model).__name__
    patch = int(settings.input_patch_size)
    rows = torch.export.Dim("rows", min=1, max=4096)
    patches = torch.export.Dim("patches", min=1, max=int(settings.context_length) // patch)
    context = torch.zeros(_ROWS, _PATCHES * patch)
    if family == "ChronosBoltModelForForecasting":
        return _Bolt(model), (context,), ({0: rows, 1: patch * patches},)
    if family == "Chronos2Model":
        ahead = torch.export.Dim("patches_ahead", min=1, max=int(settings.max_output_patches))
        groups, known = torch.arange(_ROWS) // 3, torch.zeros(_ROWS, _PATCHES_AHEAD * patch)
        axes: tuple[dict[int, Any], ...] = ({0: rows, 1: patch * patches}, {0: rows}, {0: rows, 1: patch * ahead})
        return _Chronos2(model), (context, groups, known), axes
    raise BackboneError(f"a {family} is not exported; Chronos-Bolt and Chronos-2 are")


def _as_inputs(graph: Any, model: nn.Module) -> dict[str, Any]:
    """The weights of a graph by name, turned into its inputs so that nothing is computed from them beforehand."""
    names = {f"model.{name}" for name in model.state_dict()}
    weights = {name: value for name, value in graph.initializers.items() if name in names}
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
