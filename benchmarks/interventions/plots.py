"""Figures of the suite as PNG and SVG, made with matplotlib figure objects (no display, no global state)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MultipleLocator, NullFormatter

from benchmarks.interventions.methods.registry import BEST, METHODS, MONOTONE
from benchmarks.interventions.scores import LEVELS
from benchmarks.interventions.suite import Fan, SuiteResult
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.plants.energyplus.zone import CLIMATES

_COLOURS = (
    "#8a939c", "#3b7a8a", "#6b5b95", "#c47f2c", "#8a6d3b", "#5a7d3b", "#a05a7a", "#b22222", "#1b1f24", "#228b22",
)  # fmt: skip
_MARKERS = {"heating_chicago": "o", "cooling_phoenix": "s"}


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Write `name`.png and `name`.svg reproducibly; returns the path of the SVG."""
    path = folder / f"{name}.svg"
    with rc_context({"svg.hashsalt": "interventions", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", dpi=150, metadata={"Software": None})
    return path


def scatter_figure(result: SuiteResult, days: int) -> Figure:
    """Factual against effect RMSE, one marker per method and climate."""
    figure = Figure(figsize=(8.5, 4.6), layout="constrained")
    axes = figure.subplots()
    shown = [name for name in METHODS if result.of(name, days=days)]
    for name, colour in zip(METHODS, _COLOURS, strict=True):
        for climate, marker in _MARKERS.items():
            cells = result.of(name, climate, days)
            if cells:
                x, y = (np.mean([getattr(c, key) for c in cells]) for key in ("factual_rmse_K", "effect_rmse_K"))
                label = METHODS[name].label if climate == _first_climate(result) else None
                axes.scatter(x, y, color=colour, marker=marker, s=60, alpha=0.8, label=label, zorder=3)
    axes.set_xlabel("factual RMSE, K (mean over the climate's cells)")
    axes.set_ylabel("intervention-effect RMSE, K")
    axes.set_xlim(left=0)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)
    axes.set_title(f"{len(shown)} methods, {days} probe days; circles: heating, squares: cooling", fontsize=10)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure


def fan_figure(fans: Sequence[Fan], methods: Sequence[str] = ("tsfm", "rc", MONOTONE, BEST)) -> Figure:
    """Counterfactual predictions of each method at u = 0, ¼, ½, ¾ and 1, with the measured temperatures."""
    shown = [name for name in methods if all(name in fan.answers_C for fan in fans)]
    figure = Figure(figsize=(3.1 * len(shown), 3.0 * len(fans)), layout="constrained")
    grid = np.atleast_2d(figure.subplots(len(fans), len(shown), sharex=True, sharey="row", squeeze=False))
    for row, fan in zip(grid, fans, strict=True):
        past, ahead = fan.window.history.last(24), fan.window.factual
        start = ahead.time_s[0]
        for axes, name in zip(row, shown, strict=True):
            axes.plot((past.time_s - start) / HOUR_S, past.T_zone_C[0], color="#1b1f24", linewidth=1.2)
            axes.plot(
                (ahead.time_s - start) / HOUR_S, ahead.T_zone_C[0], color="#1b1f24", linewidth=1.2, label="measured"
            )
            for level, course in zip(LEVELS, fan.answers_C[name], strict=True):
                colour = (0.85 * level + 0.1, 0.25, 0.95 - 0.85 * level)
                hours = (ahead.time_s[1:] - start) / HOUR_S
                axes.plot(hours, course, color=colour, linewidth=1.1, linestyle="--", label=f"u = {level:g}")
            axes.axvline(0.0, color="#8a939c", linewidth=0.7)
            axes.xaxis.set_major_locator(MultipleLocator(3.0))
            axes.grid(alpha=0.25)
            axes.set_title(f"{METHODS[name].label}\n{CLIMATES[fan.climate].label}", fontsize=8)
        row[0].set_ylabel("zone, °C")
    for axes in grid[-1]:
        axes.set_xlabel("hours since the shift began")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return figure


def curves_figure(curves: Mapping[str, tuple[Sequence[float], Sequence[float]]], xlabel: str, *, log: bool) -> Figure:
    """Effect RMSE against one setting; `curves` maps the name of each line to (x, y in K)."""
    figure = Figure(figsize=(7.5, 4.4), layout="constrained")
    axes = figure.subplots()
    for index, (name, (x, y)) in enumerate(curves.items()):
        axes.plot(x, y, marker="o", color=_COLOURS[index % len(_COLOURS)], label=name)
    if log:
        ticks = sorted({value for x, _ in curves.values() for value in x})
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    axes.set_ylim(0.0, 1.08 * max(value for _, y in curves.values() for value in y))
    axes.set_xlabel(xlabel)
    axes.set_ylabel("intervention-effect RMSE, K")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    return figure


def bars_figure(
    values: Mapping[str, tuple[float, float | None]],
    xlabel: str,
    labels: tuple[str, str] = ("here", "paper"),
    *,
    log: bool = True,
) -> Figure:
    """Two labelled horizontal bars per name, the first name on top.

    `values` maps a name to both values, by default measured here and in the paper; the second may be None.
    """
    figure = Figure(figsize=(7.5, 0.9 + 0.5 * len(values)), layout="constrained")
    axes = figure.subplots()
    for index, (label, colour) in enumerate(zip(labels, ("#228b22", "#8a939c"), strict=True)):
        drawn = [(at, value) for at, pair in enumerate(values.values()) if (value := pair[index]) is not None]
        at, lengths = zip(*drawn, strict=True) if drawn else ((), ())
        bars = axes.barh(np.array(at) + 0.4 * index - 0.2, lengths, 0.38, color=colour, label=label)
        axes.bar_label(bars, labels=[f"{float(f'{length:.3g}'):g}" for length in lengths], padding=3, fontsize=7)
    axes.set_yticks(range(len(values)), list(values), fontsize=8)
    axes.invert_yaxis()
    axes.set_xscale("log" if log else "linear")
    axes.margins(x=0.12)
    axes.set_xlabel(xlabel)
    figure.legend(loc="outside upper right", ncols=2, frameon=False, fontsize=8)
    return figure


def _first_climate(result: SuiteResult) -> str:
    return result.scores[0].climate
