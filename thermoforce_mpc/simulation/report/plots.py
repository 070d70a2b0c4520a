"""Plots of a run as SVG text. Uses matplotlib figure objects directly, without display or global state."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thermoforce_mpc.data import DAY_S, SINGLE, Layout, Names

INK, FREE, FORCED, BAND, QUIET = "#1b1f24", "#228b22", "#b22222", "#dfeaf5", "#8a939c"
LEVEL_COLOURS = (INK, "#1f5a99", FORCED, FREE)
BASELINE_COLOURS = ("#8a6d3b", "#6b5b95", "#3b7a8a", "#a05a7a", "#5a7d3b", "#c47f2c", "#4a5568")


def temperature_plot(
    trajectory: pd.DataFrame, steps: pd.DataFrame, baselines: Mapping[str, pd.DataFrame], layout: Layout
) -> str:
    """Zone temperature and comfort band, °C; below, predicted free response, °C, and forced response, K.

    With several zones a row for each: its temperature with what was predicted a step before, the responses, and the
    levels of the actuators that serve it.
    """
    names = layout.names
    if len(names.zones) == 1:
        figure = Figure(figsize=(11, 6.2), layout="constrained")
        top, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
        _temperature(top, trajectory, baselines)
        top.set_ylabel("zone temperature, °C")
        top.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=5, frameon=False)
        _responses(below, trajectory, steps)
        below.set_xlabel("day of the scored window")
        return svg_text(figure)
    figure = Figure(figsize=(11, 0.6 + 2.3 * len(names.zones)), layout="constrained")
    axes = figure.subplots(len(names.zones), 3, sharex=True, squeeze=False, width_ratios=[3, 2, 2])
    for z, ((left, middle, right), zone) in enumerate(zip(axes, names.zones, strict=True)):
        of_zone, planned = _of(trajectory, zone), _of(steps, zone).dropna(subset=["T_free_next_C"])
        _temperature(left, of_zone, {name: _of(frame, zone) for name, frame in baselines.items()})
        if len(planned):
            predicted = (planned.T_free_next_C + planned.T_forced_next_K).astype(float)
            at = _relative_days(planned.time_s + steps.time_s.diff().median(), of_zone)  # it holds at the step's end
            left.plot(at, predicted, color=FORCED, linewidth=0.9, linestyle=":", label="predicted a step before")
        left.set_title(zone, loc="left", fontsize=10)
        left.set_ylabel("°C")
        _responses(middle, of_zone, _of(steps, zone))
        _levels(right, trajectory, [names.actuators[a] for a in layout.actuators_of(z)])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=5, frameon=False)
    for axis in axes[-1]:
        axis.set_xlabel("day of the scored window")
    return svg_text(figure)


def _temperature(axis: Axes, trajectory: pd.DataFrame, baselines: Mapping[str, pd.DataFrame]) -> None:
    """Temperature of one zone, its comfort band and the temperatures of the baselines."""
    day = _days(trajectory)
    axis.fill_between(
        day, trajectory.lower_C, trajectory.upper_C, step="post", color=BAND, linewidth=0, label="comfort band"
    )
    for (name, frame), colour in zip(baselines.items(), BASELINE_COLOURS, strict=False):
        axis.plot(_days(frame, end=True), frame.T_zone_C, color=colour, linewidth=0.8, alpha=0.8, label=name)
    axis.plot(_days(trajectory, end=True), trajectory.T_zone_C, color=INK, linewidth=1.3, label="zone temperature")
    T = trajectory.T_zone_C
    axis.set_ylim(min(T.min(), 20) - 0.7, max(T.max(), 24) + 0.7)


def _responses(axis: Axes, trajectory: pd.DataFrame, steps: pd.DataFrame) -> None:
    """Predicted free and forced response of one zone; where nothing was planned, the outdoor temperature."""
    planned = steps.dropna(subset=["T_free_next_C"])
    if not len(planned):
        axis.plot(_days(trajectory, end=True), trajectory.T_out_C, color=QUIET, linewidth=1.0)
        axis.set_ylabel("outdoor, °C")
        return
    # The first predicted values hold at the end of the plan's step.
    planned_day = _relative_days(planned.time_s, trajectory)
    axis.plot(planned_day, planned.T_free_next_C, color=FREE, linewidth=1.1, label="free, °C")
    axis.fill_between(
        planned_day,
        planned.T_free_low_next_C.astype(float),
        planned.T_free_high_next_C.astype(float),
        color=FREE,
        alpha=0.15,
        linewidth=0,
    )
    axis.set_ylabel("free response, °C", color=FREE)
    forced = axis.twinx()
    forced.plot(planned_day, planned.T_forced_next_K, color=FORCED, linewidth=1.1, label="forced, K")
    forced.set_ylabel("forced response, K", color=FORCED)


def _levels(axis: Axes, trajectory: pd.DataFrame, actuators: Sequence[str]) -> None:
    """Levels of the actuators of one zone."""
    least = 0.0
    for a, name in enumerate(actuators):
        u = _of(trajectory, name).u_measured.astype(float)
        axis.step(
            _days(trajectory), u, where="post", color=LEVEL_COLOURS[a % len(LEVEL_COLOURS)], linewidth=0.9, label=name
        )
        least = min(least, float(u.min()) if u.notna().any() else 0.0)
    axis.set_ylabel("level u" if least >= 0 else "level u\n(< 0: cooling)")
    axis.set_ylim(least - 0.05, 1.05)
    if actuators:
        legend = axis.legend(loc="lower left", bbox_to_anchor=(0.0, 0.97), ncols=2, frameon=False, fontsize=8)
        legend.set_in_layout(False)  # it stands in the space of the zone's title


def actuation_plot(trajectory: pd.DataFrame, currency: str, names: Names = SINGLE) -> str:
    """Actuator level (below 0: cooling), power, kW, outdoor temperature, °C, irradiance, W/m², and price.

    With several actuators or machines a panel for each, by name, and one per price. With several zones the levels stand
    in their rows.
    """
    actuators = names.actuators if len(names.zones) == 1 else ()
    prices = _different_prices(trajectory, names)
    if names.single:
        figure = Figure(figsize=(11, 6.2), layout="constrained")
        panels = figure.subplots(4, 1, sharex=True)
        below = panels[-1:]
    else:
        n = len(actuators) + len(names.machines) + len(prices) + 1
        rows = -(-n // 2)
        figure = Figure(figsize=(11, 0.4 + 1.6 * rows), layout="constrained")
        grid = figure.subplots(rows, 2, sharex=True, squeeze=False)
        panels, below = grid.ravel()[:n], grid[-1]
        for unused in grid.ravel()[n:]:
            unused.axis("off")
    waiting = iter(panels)
    for name in actuators:
        _level(next(waiting), _of(trajectory, name), _titled("level u", name, names.actuators))
    for name in names.machines:
        _power(next(waiting), _of(trajectory, name), _titled("power, kW", name, names.machines))
    _weather(next(waiting), trajectory)
    for name in prices:
        _price(next(waiting), _of(trajectory, name), _titled("price", name, prices), currency)
    for axis in below:
        axis.set_xlabel("day of the scored window")
    return svg_text(figure)


def _different_prices(trajectory: pd.DataFrame, names: Names) -> list[str]:
    """The first machine of each price: machines that pay the same share a panel."""
    found: list[str] = []
    for name in names.machines:
        own = _of(trajectory, name).price_per_kWh
        if not any(own.equals(_of(trajectory, other).price_per_kWh) for other in found):
            found.append(name)
    return found


def _titled(label: str, name: str, names: Sequence[str]) -> str:
    return label if len(names) == 1 else f"{label}\n{name}"


def _level(axis: Axes, trajectory: pd.DataFrame, label: str) -> None:
    least = float(np.nanmin(trajectory.u_measured)) if trajectory.u_measured.notna().any() else 0.0
    text = label if least >= 0 else f"{label}\n(< 0: cooling)"
    _steps(axis, _days(trajectory), trajectory.u_measured, INK, text)
    axis.set_ylim(min(least, 0.0) - 0.05, 1.05)


def _power(axis: Axes, trajectory: pd.DataFrame, label: str) -> None:
    hourly = _hourly_means(trajectory)
    axis.fill_between(_days(trajectory), trajectory.power_W / 1e3, step="post", color=FORCED, alpha=0.25, linewidth=0)
    axis.plot(hourly.index, hourly.power_W / 1e3, color=FORCED, linewidth=1.1)
    axis.set_ylabel(f"{label}\n(line: hourly mean)")


def _weather(axis: Axes, trajectory: pd.DataFrame) -> None:
    axis.plot(_days(trajectory, end=True), trajectory.T_out_C, color=QUIET, linewidth=1.1)
    axis.set_ylabel("outdoor, °C")
    sun = axis.twinx()
    sun.fill_between(_days(trajectory, end=True), trajectory.solar_W_m2, color="#e6b800", alpha=0.4, linewidth=0)
    sun.set_ylabel("sun, W/m²")


def _price(axis: Axes, trajectory: pd.DataFrame, label: str, currency: str) -> None:
    _steps(axis, _days(trajectory), trajectory.price_per_kWh, INK, f"{label},\n{currency}/kWh")
    low, high = trajectory.price_per_kWh.min(), trajectory.price_per_kWh.max()
    room = max(0.1 * (high - low), 0.01)
    axis.set_ylim(min(low, 0) - room if low < 0 else low - room, high + room)


def _of(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    """The frame with the columns of a zone, actuator or machine, `signal[name]`, under the signals' names."""
    return frame.rename(columns=lambda column: str(column).removesuffix(f"[{name}]"))


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
