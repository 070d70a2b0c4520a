"""Picture of measurements: temperatures, weather, what acts; gaps shaded, flagged readings marked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.series import stretches
from thermoforce_mpc.measurements.load import Measurements

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More zones or actuators than this share one panel without a legend.
_MOST_LABELS = 10
# More steps than this are drawn as a line: bars would be thinner than a pixel.
_MOST_BARS = 3000


def draw_measurements(path: Path, measured: Measurements, title: str = "") -> None:
    """Write the picture (PNG, SVG or PDF by suffix) of `measured`."""
    figure = measurements_figure(measured, title)
    figure.savefig(path, dpi=150, metadata={"Software": None} if path.suffix == ".png" else None)


def measurements_figure(measured: Measurements, title: str = "") -> Figure:
    """The picture of `measured` at the width of a page, 7.2 inches."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    record, conditions, names = measured.record, measured.conditions, measured.record.names
    at = _clock(measured, record.time_s)
    with_power = bool(np.isfinite(record.power_W).any())
    figure = Figure(figsize=(7.2, 7.6 if with_power else 6.4), layout="constrained")
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize="small", wrap=True)
    panels = figure.subplots(4 if with_power else 3, 1, sharex=True, height_ratios=[3, 2, 1.5, 1.5][: 3 + with_power])
    for z, zone in enumerate(names.zones):
        panels[0].plot(at, record.T_zone_C[z], **_look(z), linewidth=0.9, label=zone)
        for bound in (conditions.lower_C[z], conditions.upper_C[z]):
            panels[0].plot(at, bound, color=f"C{z % 10}", linewidth=0.6, linestyle=":")
        _flags(panels[0], measured, f"zones.{zone}.temperature")
        _gaps(panels[0], at, record.T_zone_C[z], f"C{z % 10}")
    panels[0].set_ylabel("zone temperature, °C")
    _legend(panels[0], len(names.zones))
    panels[1].plot(at, record.T_out_C, color="tab:blue", linewidth=0.9)
    panels[1].set_ylabel("outdoors, °C", color="tab:blue")
    _flags(panels[1], measured, "outdoor")
    _gaps(panels[1], at, record.T_out_C, "tab:blue")
    sun = panels[1].twinx()
    sun.fill_between(at, record.solar_W_m2, color="tab:orange", alpha=0.35, linewidth=0)
    sun.set_ylabel("sun, W/m²", color="tab:orange")
    for a, actuator in enumerate(names.actuators):
        alone = len(names.actuators) == 1 and record.n_steps <= _MOST_BARS
        panels[2].stairs(record.u[a], at, **_look(a), fill=alone, alpha=0.6, label=actuator, baseline=0.0)
        _gaps(panels[2], at, record.u[a], f"C{a % 10}")
    panels[2].set_ylabel("level u")
    panels[2].set_ylim(min(0.0, *measured.layout.u_min) * 1.05, 1.05)
    _legend(panels[2], len(names.actuators))
    if with_power:
        for m, machine in enumerate(names.machines):
            panels[3].stairs(record.power_W[m] / 1000.0, at, **_look(m), label=machine, baseline=None)
        panels[3].set_ylabel("power, kW")
        _legend(panels[3], len(names.machines))
    panels[-1].set_xlim(at[0], at[-1])
    first, last = np.datetime_as_string(at[[0, -1]], unit="D")
    panels[-1].set_xlabel(
        f"{first} to {last}{_zone(measured)}; shaded: gaps; crosses: flagged readings", fontsize="small", wrap=True
    )
    dates = AutoDateLocator(minticks=3, maxticks=8)
    panels[-1].xaxis.set_major_locator(dates)
    panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(dates, show_offset=False))
    for panel in panels:
        panel.grid(visible=True, linewidth=0.3)
        panel.yaxis.set_major_locator(MaxNLocator(5, min_n_ticks=2))
        panel.tick_params(labelbottom=True)
    return figure


def _clock(measured: Measurements, time_s: Array) -> Any:
    """Wall-clock instants of `time_s`, for an axis of dates, in standard time all year."""
    origin = measured.record.origin.tz_localize(None)
    return (origin + pd.to_timedelta(time_s, unit="s")).to_numpy()


def _zone(measured: Measurements) -> str:
    return f"; standard time of {measured.understood.zone}" if measured.understood.zone else ""


def _look(place: int) -> dict[str, Any]:
    """Colour and dashes of one of several; dots are for bounds."""
    return {"color": f"C{place % 10}", "linestyle": ("-", "--", "-.")[place % 3]}


def _legend(axes: Axes, n: int) -> None:
    if 1 < n <= _MOST_LABELS:
        axes.legend(loc="upper left", ncols=5, frameon=False, fontsize="small")


def _flags(axes: Axes, measured: Measurements, key: str) -> None:
    """Crosses where readings were refused, at the edge of the panel where they lie far outside it."""
    points = [p for s in measured.understood.signals if s.key == key for flag in s.flags for p in flag.points]
    if not points:
        return
    low, high = axes.get_ylim()
    time_s, values = np.array(points).T
    axes.plot(_clock(measured, time_s), np.clip(values, low, high), "x", color="tab:red", markersize=5, clip_on=False)
    axes.set_ylim(low, high)


def _gaps(axes: Axes, at: Any, values: Array, colour: str) -> None:
    """Shade the stretches in which `values` are not known."""
    for start, stop in stretches(~np.isfinite(values)):
        axes.axvspan(at[max(start - 1, 0)], at[min(stop, at.size - 1)], color=colour, alpha=0.08, linewidth=0)
