"""What plant and worker process say to each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from thermoforce_mpc.data import Array

# BOPTEST samples a simulation this often, s.
SAMPLE_S = 30.0


@dataclass(frozen=True)
class Job:
    """What to load and record. `inputs` and `outputs` are (value reference, FMI type) by name."""

    folder: str
    guid: str
    model_identifier: str
    tolerance: float | None
    inputs: Mapping[str, tuple[int, str]]
    outputs: Mapping[str, tuple[int, str]]
    recorded: tuple[str, ...]


@dataclass(frozen=True)
class Stretch:
    """What happened over one stretch: times (n,) s, recorded outputs (n, columns), and all outputs at its end."""

    time_s: Array
    rows: Array
    final: Mapping[str, float]
