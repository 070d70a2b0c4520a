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
_SERIES, _ROWS, _PATCHES, _PATCHES_AHEAD = 3, 5, 7, 2
# The first version of ONNX with attention and root mean square normalisation as operations.
_OPSET = 23
_NORMS = ("T5LayerNorm", "Chronos2LayerNorm")


class _Bolt(nn.Module):
    """Chronos-Bolt: series (B, k) with NaN gaps to quantiles (B, quantiles, steps)."""

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, context: Tensor) -> Tensor:
        return cast("Tensor", self.model(context=context).quantile_preds)


class _Chronos2(nn.Module):
    """Chronos-2: series with their covariates (n, rows, k), the series first, and what of them is known ahead (n, rows,
    N), to quantiles of the series (n, quantiles, N).

    It computes what the library does with less: rows attend to those of their own context instead of to all under a
    mask, attention and rotation are one operation each, and of the last block there is only what is read of it.
    """

    rotation: tuple[Tensor, Tensor]

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model, settings = model, model.chronos_config
        longest = settings.context_length // settings.input_patch_size + 1 + settings.max_output_patches
        frequencies = model.encoder.block[0].layer[0].self_attention.rope_embed.inv_freq
        angles = torch.arange(longest, dtype=torch.float32)[:, None] * frequencies
        self.rotation = (angles.cos(), angles.sin())

    def forward(self, context: Tensor, future_covariates: Tensor) -> Tensor:
        model, settings = self.model, self.model.chronos_config
        n, rows, _ = context.shape
        patches, measured, loc_scale = self._patched(context.flatten(0, 1))
        known = self._known_ahead(future_covariates.flatten(0, 1), loc_scale)
        between = model.shared(torch.full((n * rows, 1), model.config.reg_token_id))
        x = torch.cat([model.input_patch_embedding(patches), between, model.input_patch_embedding(known)], dim=1)
        ahead, length = known.shape[1], x.shape[1]
        read = torch.cat([measured.to(x.dtype), torch.ones(n * rows, 1 + ahead)], dim=1)
        hidden = (1.0 - read) * torch.finfo(x.dtype).min  # gaps
        in_time = hidden[:, None, None, :].expand(-1, -1, length, -1)
        in_rows = _rows_last(hidden[..., None], n)[:, None, None, :, 0].expand(-1, -1, rows, -1)
        for block in model.encoder.block[:-1]:
            over_time, over_rows, forward = block.layer
            x = _rows_last(self._attended(over_time, x, slice(None), in_time, rotated=True), n)
            x = forward(self._attended(over_rows, x, slice(None), in_rows))
            x = x.unflatten(0, (n, length)).transpose(1, 2).flatten(0, 1)
        over_time, over_rows, forward = model.encoder.block[-1].layer
        x = _rows_last(self._attended(over_time, x, slice(-ahead, None), in_time[:, :, -ahead:], rotated=True), n)
        x = forward(self._attended(over_rows, x, slice(0, 1), None))
        values = model.output_patch_embedding(model.encoder.final_layer_norm(x)).reshape(
            n, ahead, model.num_quantiles, settings.output_patch_size
        )
        loc, scale = (of_rows.reshape(n, rows)[:, :1] for of_rows in loc_scale)
        courses = values.transpose(1, 2).flatten(1)
        return cast("Tensor", model.instance_norm.inverse(courses, (loc, scale)).reshape(n, model.num_quantiles, -1))

    def _patched(self, context: Tensor) -> tuple[Tensor, Tensor, Any]:
        """Patches of series (n, k) with their times and gaps, which of them hold a reading, and their scale."""
        model, settings = self.model, self.model.chronos_config
        context = context[:, -settings.context_length :]
        known = model.patch(torch.isnan(context).logical_not().to(context.dtype)).nan_to_num(nan=0.0)
        scaled, loc_scale = model.instance_norm(context)
        values = torch.where(known > 0.0, model.patch(scaled), 0.0)
        of_patches = known.shape[1] * settings.input_patch_size
        times = torch.arange(-of_patches, 0, dtype=torch.float32).div(settings.time_encoding_scale)
        times = times.reshape(1, known.shape[1], -1).expand(context.shape[0], -1, -1)
        return torch.cat([times, values, known], dim=-1), known.sum(dim=-1) > 0, loc_scale

    def _attended(self, layer: Any, x: Tensor, asking: slice, mask: Tensor | None, *, rotated: bool = False) -> Tensor:
        """What tokens `asking` of `x` (sequences, tokens, width) are after they attended to all of their sequence."""
        attention, normed = layer.self_attention, layer.layer_norm(x)
        q, k, v = attention.q(normed[:, asking]), attention.k(normed), attention.v(normed)
        if rotated:
            places = torch.arange(x.shape[1]).expand(x.shape[0], -1)
            q, k = (
                torch.onnx.ops.rotary_embedding(of, *self.rotation, at, num_heads=attention.n_heads)
                for of, at in ((q, places[:, asking]), (k, places))
            )
        heads = {"q_num_heads": attention.n_heads, "kv_num_heads": attention.n_heads}
        found = torch.onnx.ops.attention(q, k, v, mask, scale=1.0, **heads)[0]
        return x[:, asking] + cast("Tensor", attention.o(found))

    def _known_ahead(self, future_covariates: Tensor, loc_scale: tuple[Tensor, Tensor]) -> Tensor:
        """Patches of time, values and what is known, as the library makes them; its check that raises is left out."""
        settings = self.model.chronos_config
        ahead, _ = self.model.instance_norm(future_covariates, loc_scale)
        known = torch.isnan(ahead).logical_not()
        patches = (ahead.shape[0], -1, settings.output_patch_size)
        time = torch.arange(ahead.shape[1], dtype=torch.float32) / settings.time_encoding_scale
        parts = (time.expand(ahead.shape[0], -1), torch.where(known, ahead, 0.0), known.to(ahead.dtype))
        return torch.cat([part.reshape(patches) for part in parts], dim=-1)


def _rows_last(x: Tensor, n: int) -> Tensor:
    """Tokens (n · rows, patches, width) with those of one patch of a context together, (n · patches, rows, width)."""
    return x.unflatten(0, (n, -1)).transpose(1, 2).flatten(0, 1)


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
    series = torch.export.Dim("series", min=1, max=4096)
    patches = torch.export.Dim("patches", min=1, max=int(settings.context_length) // patch)
    if family == "ChronosBoltModelForForecasting":
        return _Bolt(model), (torch.zeros(_SERIES, _PATCHES * patch),), ({0: series, 1: patch * patches},)
    if family == "Chronos2Model":
        rows = torch.export.Dim("rows", min=1, max=64)
        ahead = torch.export.Dim("patches_ahead", min=1, max=int(settings.max_output_patches))
        context = torch.zeros(_SERIES, _ROWS, _PATCHES * patch)
        known = torch.zeros(_SERIES, _ROWS, _PATCHES_AHEAD * patch)
        axes = {0: series, 1: rows, 2: patch * patches}, {0: series, 1: rows, 2: patch * ahead}
        return _Chronos2(model), (context, known), axes
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
