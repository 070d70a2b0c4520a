"""What a plant recorded, turned into means over control steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from thermoforce_mpc.types import Array


def interval_means(record: Mapping[str, Array], points: Sequence[str], edges: Array) -> Array:
    """Time means of the sum of `points` between `edges` (n + 1,), shape (n,); NaN where there are no points.

    Each sample stands for the time since the one before it: at a switch, the sample at the start of an interval still
    belongs to the action before.
    """
    if not points or edges.size < 2:
        return np.full(edges.size - 1, math.nan)
    time_s = record["time"]
    total = np.sum([record[name] for name in points], axis=0)
    integral = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * total[1:])])
    return np.asarray(np.diff(np.interp(edges, time_s, integral)) / np.diff(edges))
