"""Messages between the FMU plant and its worker process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from thermoforce_mpc.data import Array

# BOPTEST's sampling interval, s.
SAMPLE_S = 30.0


@dataclass(frozen=True)
class Job:
    """FMU to load and outputs to record. `inputs` and `outputs` are (value reference, FMI type) by name."""

    folder: str
    guid: str
    model_identifier: str
    tolerance: float | None
    inputs: Mapping[str, tuple[int, str]]
    outputs: Mapping[str, tuple[int, str]]
    recorded: tuple[str, ...]


@dataclass(frozen=True)
class Stretch:
    """Result of one advance: times (n,) s, recorded outputs (n, columns), and all outputs at its end."""

    time_s: Array
    rows: Array
    final: Mapping[str, float]
