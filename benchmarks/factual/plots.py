"""Figures of the suite: few-shot curve, decomposition window, counterfactual fan; each also as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.factual.evaluate import BEST, COVARIATES, OURS, RAW, RC_FULL, RESIDUAL, Scores
from benchmarks.factual.protocol import Protocol
from benchmarks.factual.tables import errors_of

_COLOURS = {
    RAW: "#1b1f24", RC_FULL: "#c47f2c", COVARIATES: "#6b5b95", OURS: "#228b22", RESIDUAL: "#3b7a8a", BEST: "#b22222",
}  # fmt: skip


def few_shot_figure(scores: Sequence[Scores], protocol: Protocol) -> Figure:
    """Median RMSE over the homes against the budget, one panel per horizon."""
    figure = Figure(figsize=(4.6 * len(protocol.horizons_h), 3.9), layout="constrained")
    panels = figure.subplots(1, len(protocol.horizons_h), squeeze=False)[0]
    for axes, hours in zip(panels, protocol.horizons_h, strict=True):
        for method, colour in _COLOURS.items():
            y = [float(np.nanmedian(errors_of(scores, method, k, f"{hours:g}"))) for k in protocol.days]
            style = "--" if method == RAW else "-"
            marker = None if method == RAW else "o"
            axes.plot(protocol.days, y, style, color=colour, marker=marker, markersize=4, linewidth=1.4, label=method)
        axes.set_xscale("log")
        axes.set_xticks(protocol.days, [f"{k}" for k in protocol.days])
        axes.minorticks_off()
        # A grey box that diverges on one day of data would flatten all others.
        raw = float(np.nanmedian(errors_of(scores, RAW, 0, f"{hours:g}")))
        axes.set_ylim(0.0, 3.0 * raw)
        axes.set_title(f"{hours:g} h, median of {len(scores)} homes", fontsize=10)
        axes.set_xlabel("identification budget, days")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("RMSE, K")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def window_of(scores: Sequence[Scores]) -> Scores | None:
    """The home whose operator acts most in its window; None where no home has an operator."""
    acting = [s for s in scores if s.window.get("fan_C")]
    if not acting:
        return None
    return max(acting, key=lambda s: float(np.ptp(np.array(s.window["fan_C"])[:, -1])))


def decomposition_figure(scores: Scores) -> Figure:
    """One test window: measured, control-free part, ThermoForce and the raw forecaster, and the level applied."""
    w = scores.window
    hours, past = np.array(w["hours"]), np.array(w["hours"]) <= 0
    figure = Figure(figsize=(8.2, 4.6), layout="constrained")
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    axes.plot(hours, _numbers(w["measured_C"]), color="#1b1f24", label="measured")
    axes.plot(hours, _numbers(w["free_C"]), color="#228b22", linestyle=":", label="control-free part T − F")
    ahead = hours[~past]
    axes.plot(ahead, w["ours_C"], color="#b22222", label="ThermoForce")
    axes.plot(ahead, w["raw_C"], color="#3b7a8a", linestyle="--", label="raw TSFM")
    below.step(hours[:-1], w["level"], where="post", color="#c47f2c")
    below.set_ylim(-0.05, 1.05)
    below.set_ylabel("level")
    below.set_xlabel("hours since the forecast was made")
    for each in (axes, below):
        each.axvline(0.0, color="#8a939c", linewidth=0.8)
        each.grid(alpha=0.3)
    axes.set_ylabel("room, °C")
    axes.set_title(f"{scores.home}; {w['operator']}", fontsize=10)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def fan_figure(scores: Scores) -> Figure:
    """ThermoForce at constant levels, and the raw forecaster, which no level changes."""
    w = scores.window
    hours = np.array(w["hours"])
    past, ahead = hours[hours <= 0], hours[hours > 0]
    measured = _numbers(w["measured_C"])
    figure = Figure(figsize=(8.2, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(past, measured[: past.size], color="#1b1f24", label="measured")
    axes.plot(ahead, measured[past.size :], color="#1b1f24", linewidth=0.9, linestyle=":", label="measured later")
    for level, course in zip(w["levels"], w["fan_C"], strict=True):
        axes.plot(ahead, course, color=(0.85 * level + 0.1, 0.25, 0.95 - 0.85 * level), label=f"u = {level:g}")
    axes.plot(ahead, w["raw_C"], color="#3b7a8a", linestyle="--", label="raw TSFM, any u")
    axes.axvline(0.0, color="#8a939c", linewidth=0.8)
    axes.grid(alpha=0.3)
    axes.set_xlabel("hours since the forecast was made")
    axes.set_ylabel("room, °C")
    axes.set_title(f"{scores.home}; {w['operator']}", fontsize=10)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure


def write_tables(folder: Path, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write each table as `NAME.csv`."""
    for name, rows in tables.items():
        pd.DataFrame(list(rows)).to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")


def window_tables(scores: Scores) -> dict[str, list[dict[str, Any]]]:
    """The two window figures as tables by name."""
    w = scores.window
    hours, measured, free = w["hours"], w["measured_C"], w["free_C"]
    past = sum(h <= 0 for h in hours)

    def later(values: Sequence[float], k: int) -> float | None:
        return values[k - past] if k >= past else None

    return {
        "decomposition": [
            {
                "hours": h,
                "level": w["level"][k] if k < len(w["level"]) else None,
                "measured_C": measured[k],
                "free_C": free[k],
                "thermoforce_C": later(w["ours_C"], k),
                "raw_C": later(w["raw_C"], k),
            }
            for k, h in enumerate(hours)
        ],
        "fan": [
            {"hours": h, "measured_C": measured[k], "raw_C": later(w["raw_C"], k)}
            | {f"u={level:g}": later(row, k) for level, row in zip(w["levels"], w["fan_C"], strict=True)}
            for k, h in enumerate(hours)
        ],
    }


def _numbers(values: Sequence[float | None]) -> Any:
    """Values of a JSON file, in which gaps are null."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
