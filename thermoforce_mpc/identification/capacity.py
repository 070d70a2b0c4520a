"""What each actuator takes of a shared machine's capacity, from metered heat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record
from thermoforce_mpc.model.operator.heat_input import HeatInput


def with_metered_shares(layout: Layout, heat_inputs: Sequence[HeatInput], histories: Sequence[Record]) -> Layout:
    """`layout` with the shares of machines whose actuators are all metered.

    The capacity is the largest heat that all took together over an hour: more was not seen. A share is the heat of
    full level over it. Circuits that are cold take more than they were sized for, so the shares may sum to more than 1.
    """
    shares = list(layout.shares)
    for m in range(len(layout.names.machines)):
        fed = layout.fed_by(m)
        if len(fed) < 2 or any(heat_inputs[a].heat is None or layout.signs[a] != layout.signs[fed[0]] for a in fed):
            continue
        most_W = max(largest_W(np.abs(h.heat_W[fed].sum(axis=0)), h.step_s) for h in histories)
        if not most_W > 0.0:
            continue
        T_out_C = float(np.nanmean(np.concatenate([h.T_out_C for h in histories])))
        for a in fed:
            full = float(heat_inputs[a](np.asarray(1.0), np.asarray(T_out_C))) * heat_inputs[a].reference_W
            shares[a] = min(full / most_W, 1.0)
    return replace(layout, shares=tuple(shares))


def largest_W(heat_W: Array, step_s: float) -> float:
    """Largest mean of an hour, W; steps that were not metered do not count."""
    n = max(1, min(heat_W.size, round(HOUR_S / step_s)))
    mean = np.convolve(heat_W, np.ones(n) / n, "valid")
    return float(np.nanmax(mean)) if np.isfinite(mean).any() else float("nan")
