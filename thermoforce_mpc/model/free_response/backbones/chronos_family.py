"""Chronos-Bolt and Chronos-2 by `chronos-forecasting`."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import BackboneError
from thermoforce_mpc.model.free_response.backbones.base import Backbone
from thermoforce_mpc.model.free_response.backbones.checkpoint import check_weights, damaged, quiet
from thermoforce_mpc.model.free_response.backbones.graph import GRAPH, Graph


def load(name: str, folder: Path, label: str = "") -> Backbone:
    """Load a checkpoint of the Chronos family from a folder: its graph, where it has one, else its weights by torch.

    Raises:
        BackboneError: it is another Chronos, its quantiles do not span 0.1 to 0.9, or its graph is not of its weights.
    """
    graph, pipeline = None, functools.cache(functools.partial(torch_pipeline, name, folder))
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    if (folder / GRAPH).is_file():
        family, settings, graph = config["chronos_pipeline_class"], config["chronos_config"], Graph(folder)
    else:
        family, settings = type(pipeline()).__name__, vars(pipeline().model.chronos_config)
    levels = settings.get("quantiles", [])
    # The library clamps quantiles outside its trained levels, which would give too narrow an interval.
    if family in {"ChronosBoltPipeline", "Chronos2Pipeline"} and not (min(levels) <= 0.1 and max(levels) >= 0.9):
        raise BackboneError(f"backbone '{name}': trained for the quantiles {levels}; 0.1 to 0.9 are needed")
    if family == "ChronosBoltPipeline":
        from thermoforce_mpc.model.free_response.backbones.bolt import BoltBackbone

        return BoltBackbone(settings, label or f"Chronos-Bolt '{name}'", pipeline, graph)
    if family == "Chronos2Pipeline":
        from thermoforce_mpc.model.free_response.backbones.chronos2 import Chronos2Backbone

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
