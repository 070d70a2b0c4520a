"""`tf-mpc counterfactual`: what another schedule would have done on a past day."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.console import Console

from thermoforce_mpc.cli.building.output import finish_axes, on_clock, write_picture, write_table
from thermoforce_mpc.cli.building.schedule_file import levels_of
from thermoforce_mpc.cli.options import FiniteRange, course_options, measured_model_options
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.data.dataframes import seconds_at, stamps
from thermoforce_mpc.simulation.views.whole_tables import plain_table, print_whole
from thermoforce_mpc.whatif.counterfactual import Counterfactual, counterfactual

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS = 25


@click.command()
@measured_model_options
@click.option("--start", required=True, metavar="TIME", help="First step of the stretch, such as '2026-01-20 00:00'.")
@click.option("--hours", type=FiniteRange(1.0), default=24.0, show_default=True, help="Length of the stretch.")
@course_options("One level in [0, 1] for all of it.")
def command(
    model: Path,
    files: tuple[str, ...],
    map_file: Path,
    start: str,
    hours: float,
    level: float | None,
    schedule: Path | None,
    out: Path | None,
    plot: Path | None,
) -> None:
    """Show what other levels would have changed from --start on: temperature, effect and energy.

    The day's weather, sun and people stay as they were: their part of the temperature is known once the forced part is
    taken off. The band is the uncertainty of the identified effect (90 %); the certified bounds are what the model can
    answer at most and at least in any weather and state.

    \b
    Example:
      tf-mpc counterfactual --model my_house --data 2026.csv --map map.yaml --start 2026-01-20 --level 0.3
    """
    from thermoforce_mpc.measurements.load import read_measurements
    from thermoforce_mpc.model.thermal_model import load_model

    if (level is None) == (schedule is None):
        raise click.UsageError("give the other levels, either --level or --schedule")
    thermal = load_model(model)
    record = read_measurements(list(files), map_file).served().record
    first_s = seconds_at(record.origin, start, "--start")
    time_s = first_s + record.step_s * np.arange(round(hours * HOUR_S / record.step_s), dtype=np.float64)
    u = levels_of(schedule, level, record.names, time_s, record.origin)
    result = counterfactual(thermal, record, u, start=start)
    console = Console(highlight=False, markup=False)
    _show(result, console)
    if out is not None:
        kWh = [
            (_known(was), _known(other)) for was, other in zip(result.energy_kWh, result.energy_other_kWh, strict=True)
        ]
        energy = {
            name: {"applied": was, "other": other}
            for name, (was, other) in zip(result.names.machines, kWh, strict=True)
        }
        write_table(out, result.to_dataframe(), console, "Course", energy_kWh=energy)
    if plot is not None:
        write_picture(plot, _drawn(result, record.step_s), console)


def _known(kWh: float) -> float | None:
    return round(float(kWh), 4) if np.isfinite(kWh) else None


def _show(result: Counterfactual, console: Console) -> None:
    frame = result.to_dataframe()
    names = result.names
    headings = ["from"]
    for name in names.actuators:
        headings += [f"{name}\nwas", "\nother"]
    for name in names.zones:
        headings += [f"{name}, °C\nwas", "\nother (90 %)", "effect, K\n(certified)"]
    table = plain_table(headings, "As it was, and under the other levels (temperature at the end of the step)")
    every = max(1, -(-len(frame) // _ROWS))
    for k in range(0, len(frame), every):
        cells = [f"{frame.index[k]:%d %b %H:%M}"]
        for a in range(len(names.actuators)):
            cells += [f"{result.u[a, k]:.2f}", f"{result.u_other[a, k]:.2f}"]
        for z in range(len(names.zones)):
            half = result.half_K[z, k]
            band = f" ± {half:.1f}" if np.isfinite(half) else ""
            proven = f"{result.certified_low_K[z, k]:+.1f} to {result.certified_high_K[z, k]:+.1f}"
            cells += [f"{result.measured_C[z, k]:.1f}", f"{result.other_C[z, k]:.1f}{band}"]
            cells.append(f"{result.effect_K[z, k]:+.1f} ({proven})")
        table.add_row(*cells)
    print_whole(table, console)
    for name, was, other in zip(names.machines, result.energy_kWh, result.energy_other_kWh, strict=True):
        if np.isfinite(was):
            console.print(
                f"Energy of {name} by the model: {was:.1f} kWh as it was, {other:.1f} kWh under the other levels",
                soft_wrap=True,
            )
    if np.isnan(result.sd_K).any():
        console.print("The model's card has no uncertainty of the effect: there is no band.")


def _drawn(result: Counterfactual, step_s: float) -> Figure:
    """A picture of steps of `step_s`, s: measured and other temperatures with their band, and both schedules."""
    from matplotlib.figure import Figure

    edges = on_clock(stamps(np.append(result.time_s, result.time_s[-1] + step_s), result.origin))
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    for z, zone in enumerate(result.names.zones):
        colour, half = f"C{z % 10}", result.half_K[z]
        axes.plot(edges[1:], result.measured_C[z], color=colour, label=f"{zone}, measured")
        axes.plot(edges[1:], result.other_C[z], color=colour, linestyle="--", label=f"{zone}, other levels")
        low, high = result.other_C[z] - half, result.other_C[z] + half
        axes.fill_between(edges[1:], low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set_ylabel("temperature, °C")
    for a in range(len(result.names.actuators)):
        below.stairs(result.u[a], edges, color=f"C{a % 10}", baseline=None, label="as it was" if a == 0 else None)
        below.stairs(result.u_other[a], edges, color=f"C{a % 10}", baseline=None, linestyle="--")
    below.set_ylabel("level")
    below.set_ylim(min(0.0, float(result.u_other.min())) - 0.05, 1.05)
    finish_axes(figure)
    return figure
