"""Proof for a run's manifest that the run left its forecaster as it was: hashes of its weights before and after."""

from __future__ import annotations

from typing import Any

from thermoforce_mpc.protocols import Controller


def weight_hash(controller: Controller) -> str | None:
    """Hash of the forecasters' weights, where the controller has any with weights; each different one once."""
    methods = getattr(getattr(controller, "predictor", None), "free_responses", ())
    different = {id(method): method for method in methods}.values()
    hashes = [method.weight_hash() for method in different if hasattr(method, "weight_hash")]
    return " ".join(dict.fromkeys(hashes)) or None


def frozen_proof(controller: Controller, before: str | None) -> dict[str, Any]:
    """What the manifest says of the weights after a run; empty where there are none. `before`: their hash before it."""
    if before is None:
        return {}
    after = weight_hash(controller)
    return {"weights_before": before, "weights_after": after, "frozen": before == after}
