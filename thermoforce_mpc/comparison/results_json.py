"""JSON of comparisons and benchmarks: rows of figures, and targets with whether they are met."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from thermoforce_mpc.records.run_folder import environment


@dataclass(frozen=True)
class Target:
    """Target of a figure: `value` must be at most (or at least) `goal`. NaN does not meet it."""

    name: str
    value: float
    goal: float
    sense: Literal["at most", "at least"] = "at most"

    @property
    def holds(self) -> bool:
        """Whether the goal is met."""
        if math.isnan(self.value):
            return False
        return self.value <= self.goal if self.sense == "at most" else self.value >= self.goal


def results_json(name: str, rows: Iterable[Mapping[str, Any]], targets: Iterable[Target]) -> dict[str, Any]:
    """Rows and targets of a comparison or benchmark as a JSON object, with command and environment."""
    return {
        "bench": name,
        "command": " ".join(["tf-mpc", *sys.argv[1:]]),
        "environment": environment(),
        "rows": [dict(row) for row in rows],
        "targets": [asdict(target) | {"holds": target.holds} for target in targets],
    }
