"""Size of a forecaster."""

from __future__ import annotations

from thermoforce_mpc.model.free_response.backbones.base import Backbone


def parameter_count(backbone: Backbone) -> int:
    """Number of weights of a backbone; shared tensors count once."""
    graph = getattr(backbone, "graph", None)
    if graph is not None:
        return int(graph.parameters)
    tensors = {p.data_ptr(): p.numel() for module in backbone.modules for p in module.parameters()}
    return sum(tensors.values())
