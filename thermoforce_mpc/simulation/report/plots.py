"""Plots of a run as SVG text. Uses matplotlib figure objects directly, without display or global state."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thermoforce_mpc.data import DAY_S

INK, FREE, FORCED, BAND, QUIET = "#1b1f24", "#228b22", "#b22222", "#dfeaf5", "#8a939c"
BASELINE_COLOURS = ("#8a6d3b", "#6b5b95", "#3b7a8a", "#a05a7a", "#5a7d3b", "#c47f2c", "#4a5568")


def temperature_plot(trajectory: pd.DataFrame, steps: pd.DataFrame, baselines: Mapping[str, pd.DataFrame]) -> str:
    """Zone temperature and comfort band, °C; below, predicted free response, °C, and forced response, K."""
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    day = _days(trajectory)
    top.fill_between(
        day, trajectory.lower_C, trajectory.upper_C, step="post", color=BAND, linewidth=0, label="comfort band"
    )
    for (name, frame), colour in zip(baselines.items(), BASELINE_COLOURS, strict=False):
        top.plot(_days(frame, end=True), frame.T_zone_C, color=colour, linewidth=0.8, alpha=0.8, label=name)
    top.plot(_days(trajectory, end=True), trajectory.T_zone_C, color=INK, linewidth=1.3, label="zone temperature")
    T = trajectory.T_zone_C
    top.set_ylim(min(T.min(), 20) - 0.7, max(T.max(), 24) + 0.7)
    top.set_ylabel("zone temperature, °C")
    top.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=5, frameon=False)
    planned = steps.dropna(subset=["T_free_next_C"])
    if len(planned):
        # The first predicted values hold at the end of the plan's step.
        planned_day = _relative_days(planned.time_s, trajectory)
        below.plot(planned_day, planned.T_free_next_C, color=FREE, linewidth=1.1, label="free, °C")
        below.fill_between(
            planned_day,
            planned.T_free_low_next_C.astype(float),
            planned.T_free_high_next_C.astype(float),
            color=FREE,
            alpha=0.15,
            linewidth=0,
        )
        below.set_ylabel("free response, °C", color=FREE)
        forced = below.twinx()
        forced.plot(planned_day, planned.T_forced_next_K, color=FORCED, linewidth=1.1, label="forced, K")
        forced.set_ylabel("forced response, K", color=FORCED)
    else:
        below.plot(_days(trajectory, end=True), trajectory.T_out_C, color=QUIET, linewidth=1.0)
        below.set_ylabel("outdoor, °C")
    below.set_xlabel("day of the scored window")
    return svg_text(figure)


def actuation_plot(trajectory: pd.DataFrame, currency: str) -> str:
    """Actuator level (below 0: cooling), power, kW, outdoor temperature, °C, irradiance, W/m², and price."""
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    day = _days(trajectory)
    hourly = _hourly_means(trajectory)
    least = float(np.nanmin(trajectory.u_measured)) if trajectory.u_measured.notna().any() else 0.0
    _steps(axes[0], day, trajectory.u_measured, INK, "level u" if least >= 0 else "level u\n(< 0: cooling)")
    axes[0].set_ylim(min(least, 0.0) - 0.05, 1.05)
    axes[1].fill_between(day, trajectory.power_W / 1e3, step="post", color=FORCED, alpha=0.25, linewidth=0)
    axes[1].plot(hourly.index, hourly.power_W / 1e3, color=FORCED, linewidth=1.1)
    axes[1].set_ylabel("power, kW\n(line: hourly mean)")
    axes[2].plot(_days(trajectory, end=True), trajectory.T_out_C, color=QUIET, linewidth=1.1)
    axes[2].set_ylabel("outdoor, °C")
    sun = axes[2].twinx()
    sun.fill_between(_days(trajectory, end=True), trajectory.solar_W_m2, color="#e6b800", alpha=0.4, linewidth=0)
    sun.set_ylabel("sun, W/m²")
    _steps(axes[3], day, trajectory.price_per_kWh, INK, f"price,\n{currency}/kWh")
    low, high = trajectory.price_per_kWh.min(), trajectory.price_per_kWh.max()
    room = max(0.1 * (high - low), 0.01)
    axes[3].set_ylim(min(low, 0) - room if low < 0 else low - room, high + room)
    axes[3].set_xlabel("day of the scored window")
    return svg_text(figure)


def kpi_plot(kpis: Mapping[str, Mapping[str, float]], currency: str) -> str:
    """Cost, energy and discomfort of every controller side by side."""
    wanted = {
        "cost_tot": f"cost, {currency}/m²",
        "ener_tot": "energy, kWh/m²",
        "tdis_tot": "discomfort, K·h",
    }
    figure = Figure(figsize=(11, 0.9 + 0.5 * len(kpis)), layout="constrained")
    axes = figure.subplots(1, len(wanted), sharey=True)
    names = list(kpis)
    colours = [FORCED, *BASELINE_COLOURS][: len(names)]
    for axis, (key, label) in zip(axes, wanted.items(), strict=True):
        values = [kpis[name].get(key, np.nan) for name in names]
        bars = axis.barh(names, values, color=colours, alpha=0.85)
        axis.bar_label(bars, fmt="%.3f", padding=3, fontsize=9)
        axis.set_xlabel(label)
        axis.margins(x=0.25)
    axes[0].set_ylim(len(names) - 0.5, -0.5)  # first controller on top
    return svg_text(figure)


def _steps(axis: Axes, day: pd.Series, values: pd.Series, colour: str, label: str) -> None:
    axis.step(day, values, where="post", color=colour, linewidth=0.9)
    axis.set_ylabel(label)


def _days(trajectory: pd.DataFrame, end: bool = False) -> pd.Series:
    """Start (or end) of each block in days since the first block."""
    time_s = trajectory.start_s + (trajectory.duration_s if end else 0.0)
    return _relative_days(time_s, trajectory)


def _relative_days(time_s: pd.Series, trajectory: pd.DataFrame) -> pd.Series:
    return (time_s - trajectory.start_s.iloc[0]) / DAY_S


def _hourly_means(trajectory: pd.DataFrame) -> pd.DataFrame:
    """Hourly means of the power, W, weighted by block duration, indexed by day at the middle of the hour."""
    hour = ((trajectory.start_s - trajectory.start_s.iloc[0]) // 3600).rename("hour")
    joules = (trajectory.power_W * trajectory.duration_s).groupby(hour).sum()
    seconds = trajectory.duration_s.groupby(hour).sum()
    return pd.DataFrame({"power_W": joules / seconds}).set_axis((joules.index + 0.5) / 24.0)


def svg_text(figure: Figure) -> str:
    """The figure as an SVG element with reproducible bytes (no creation date) and text as text."""
    for axis in figure.axes:
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": "thermoforce-mpc", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    # Remove the XML prologue, which is not allowed inside an HTML body.
    return re.sub(r"^.*?(?=<svg)", "", buffer.getvalue(), flags=re.DOTALL)
