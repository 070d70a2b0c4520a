"""Smaller scales of the shipped forecaster, trained alike: baselines of the benches, beside it in their tables."""

from __future__ import annotations

from pathlib import Path

from thermoforce_mpc.model.free_response.backbones.loading import SHIPPED

_WEIGHTS = Path(__file__).parent / "weights"
SMALLER = {name: _WEIGHTS / folder for name, folder in (
    ("shipped_small", "bolt_thermal_small"), ("shipped_tiny", "bolt_thermal_tiny"),
)}  # fmt: skip
SCALES = (SHIPPED, *SMALLER)


def backbone_of(name: str) -> str:
    """What `load_backbone` takes for a forecaster of a bench: of a smaller scale its folder, else the name."""
    return str(SMALLER.get(name, name))
