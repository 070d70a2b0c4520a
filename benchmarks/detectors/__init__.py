"""`tf-mpc bench detectors`: what detectors do where there is nothing to detect, and where there is."""

from pathlib import Path

KEPT = Path(__file__).with_name("weeks.json")
"""The panel as this repository keeps it, a result of its --json: what `--against` without a file compares with."""
