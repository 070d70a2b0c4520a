"""`tf-mpc forecast` and `counterfactual`: temperatures ahead or of a past day, and under other levels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.console import Console

from thermoforce_mpc.cli.building.courses import finish_axes, levels_of, on_clock, write_picture, write_table
from thermoforce_mpc.cli.options import FiniteRange, course_options, measured_options, model_option
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Record
from thermoforce_mpc.data.dataframes import seconds_at, stamps
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.predictor import Prediction
from thermoforce_mpc.report.whole_tables import plain_table, print_whole
from thermoforce_mpc.whatif.counterfactual import TOLD, Counterfactual, counterfactual

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS, _BACK_DAYS = 25, 28.0
# The band promises 80 %: less than this held over a day or longer is said as a warning, where errors matter, K. Hours
# after hours are alike, so that a shorter time says little.
_HELD, _JUDGED_H, _MATTERS_K = 0.5, 24.0, 0.25
# Longest stretch that is asked about, h: a year.
_MOST_H = 8784.0


@click.command()
@model_option
@measured_options
@click.option("--forecast", "forecast_file", metavar="FILE", help="Weather from the end of the measurements on.")
@click.option("--start", metavar="TIME", help="Instead: a past time, whose weather and levels were measured.")
@click.option("--hours", type=FiniteRange(1.0, 96.0), default=24.0, help="Length.")
@course_options("One level in [0, 1] for all of it.  [default with --start: as applied]")
def forecast(
    model: Path,
    files: tuple[str, ...],
    map_file: Path,
    forecast_file: str | None,
    start: str | None,
    hours: float,
    level: float | None,
    schedule: Path | None,
    out: Path | None,
    plot: Path | None,
) -> None:
    """Forecast the zones' temperatures with an 80 % band, the free and the forced part apart.

    With --forecast it goes on from the end of the measurements, under --level or --schedule. With --start it goes back
    to a past time, knows nothing measured later but the weather and the levels, and is shown beside what was measured:
    the way to see how far to trust it.

    \b
    Examples:
      tf-mpc forecast --model my_house --data 2026.csv --map map.yaml --forecast tomorrow.csv --level 0.3
      tf-mpc forecast --model my_house --data 2026.csv --map map.yaml --start 2026-01-20
    """
    from thermoforce_mpc.measurements.load import read_measurements
    from thermoforce_mpc.model.forecast_gaps import completed
    from thermoforce_mpc.model.thermal_model import load_model

    if (forecast_file is None) == (start is None):
        raise click.UsageError("give --forecast FILE (from now on) or --start TIME (a past time)")
    if level is not None and schedule is not None:
        raise click.UsageError("give --level or --schedule, not both")
    if forecast_file and level is None and schedule is None:
        raise click.UsageError("give the levels ahead: --level or --schedule")
    thermal = load_model(model)
    measured = read_measurements(list(files), map_file, at="begin" if start else "end").served()
    record = measured.record
    check_same_layout(f"--model {model}:", thermal.layout, f"the map {map_file}", measured.layout)
    n = round(hours * HOUR_S / record.step_s)
    truth = np.full((len(record.names.zones), n), np.nan)
    applied: Array | None = None
    if start is not None:
        past, stretch = _split_at(record, start, n)
        ahead, truth, applied = Boundary.measured(stretch), stretch.T_zone_C[:, 1:], stretch.u
    else:
        from thermoforce_mpc.measurements.forecast import read_forecast

        # Bounds and prices say nothing about the temperature: none need be in the file.
        neutral = measured.map.forecast.model_copy(update={"lower": 0.0, "upper": 50.0, "price": 0.0})
        neutral_measured = replace(measured, map=measured.map.model_copy(update={"forecast": neutral}))
        past, ahead = record, read_forecast(str(forecast_file), neutral_measured)
        if ahead.n_steps < n:
            raise DataError(f"--forecast {forecast_file}: covers {ahead.n_steps} steps, {hours:g} h need {n}")
        ahead, filled = completed(ahead.head(n), past, None)
        if filled:
            click.echo(filled[0].upper() + filled[1:])
    if level is not None or schedule is not None:
        applied = levels_of(schedule, level, record.names, ahead.time_s[:-1], record.origin)
    elif applied is None or not np.isfinite(applied).all():
        raise DataError(f"the levels from {start} on were not all measured: give --level or --schedule")
    prediction = thermal.predict(past.last(round(_BACK_DAYS * DAY_S / record.step_s)), ahead, applied)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    _show(prediction, truth, record.step_s, console)
    table = prediction.to_dataframe()
    for name, values in record.names.columns(T_zone_C=truth).items():
        table[name.replace("T_zone_C", "measured_C")] = values
    if out is not None:
        write_table(out, table, console, "Forecast")
    if plot is not None:
        write_picture(plot, _drawn(prediction, truth), console)


def _split_at(record: Record, start: str, n: int) -> tuple[Record, Record]:
    first = record.nearest(seconds_at(record.origin, start, "--start"))
    if not 0 < first <= record.n_steps - n:
        stamps = record.stamps()
        raise DataError(f"--start {start}: {n} steps from there are not in the record ({stamps[0]} to {stamps[-1]})")
    return record.slice(0, first), record.slice(first, first + n)


def _show(prediction: Prediction, truth: Array, step_s: float, console: Console) -> None:
    stamps = prediction.to_dataframe().index
    has_truth = np.isfinite(truth).any()
    of_zone = ("band", "of it forced, K", *(["measured"] if has_truth else []))
    headings = ["at", *(heading for zone in prediction.names.zones for heading in (zone, *of_zone))]
    table = plain_table(headings, "Temperature at each time, °C (80 % band of the free response)")
    n, (low_C, high_C) = truth.shape[1], prediction.band_C
    for k in range(0, n, max(1, -(-n // _ROWS))):
        cells = [f"{stamps[k]:%d %b %H:%M}"]
        for z in range(truth.shape[0]):
            cells += [
                f"{prediction.total_C[z, k]:.1f}",
                f"{low_C[z, k]:.1f} to {high_C[z, k]:.1f}",
                f"{prediction.forced_K[z, k]:+.1f}",
            ]
            if has_truth:
                cells.append(f"{truth[z, k]:.1f}" if np.isfinite(truth[z, k]) else "–")
        table.add_row(*cells)
    print_whole(table, console)
    for z, zone in enumerate(prediction.names.zones):
        measured = np.isfinite(truth[z])
        if measured.any():
            rmse_K = float(np.sqrt(np.nanmean((prediction.total_C[z] - truth[z]) ** 2)))
            inside = ((low_C[z] <= truth[z]) & (truth[z] <= high_C[z]))[measured].mean()
            console.print(
                f"{zone}: RMSE {rmse_K:.2f} K, {100 * inside:.0f} % of what was measured inside the 80 % band"
            )
            if measured.sum() * step_s / HOUR_S >= _JUDGED_H and inside < _HELD and rmse_K > _MATTERS_K:
                console.print(
                    f"warning: the band of {zone} promises 80 % and held far less: do not rely on it; identify again "
                    "from more days, and look for heat that the record does not hold"
                )


def _drawn(prediction: Prediction, truth: Array) -> Figure:
    from matplotlib.figure import Figure

    at = on_clock(prediction.to_dataframe().index)
    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    (axes, below), (low_C, high_C) = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1]), prediction.band_C
    for z, zone in enumerate(prediction.names.zones):
        colour = f"C{z % 10}"
        axes.fill_between(at, low_C[z], high_C[z], color=colour, alpha=0.2, linewidth=0)
        axes.plot(at, prediction.total_C[z], color=colour, label=f"{zone}, forecast")
        below.plot(at, prediction.free_C[z], color=colour)
        measured = "measured" if z == 0 and np.isfinite(truth).any() else None
        axes.plot(at, truth[z], color="#1b1f24", linewidth=1.0, label=measured)
    axes.set_ylabel("temperature, °C")
    below.set_ylabel("without\ncontrol, °C")
    finish_axes(figure)
    return figure


@click.command()
@model_option
@measured_options
@click.option("--start", required=True, metavar="TIME", help="First step of the stretch, such as '2026-01-20 00:00'.")
@click.option("--hours", type=FiniteRange(1.0, _MOST_H), default=24.0, help="Length of the stretch.")
@course_options("One level in [0, 1] for all of it.")
def other_levels(
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
    measured = read_measurements(list(files), map_file).served()
    record = measured.record
    check_same_layout(f"--model {model}:", thermal.layout, f"the map {map_file}", measured.layout)
    first_s = seconds_at(record.origin, start, "--start")
    time_s = first_s + record.step_s * np.arange(round(hours * HOUR_S / record.step_s), dtype=np.float64)
    u = levels_of(schedule, level, record.names, time_s, record.origin)
    result = counterfactual(thermal, record, u, start=start)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    _show_other(result, console)
    if out is not None:
        energies = (result.energy_kWh, result.energy_other_kWh, result.energy_low_kWh, result.energy_high_kWh)
        energy = {
            name: {
                "applied": _known(was),
                "other": _known(other) if _is_told(other, low, high) else None,
                "other_low": _known(low),
                "other_high": _known(high),
                "beside": _known(beside),
            }
            for name, was, other, low, high, beside in zip(
                result.names.machines, *energies, result.beside_kWh, strict=True
            )
        }
        write_table(out, result.to_dataframe(), console, "Course", energy_kWh=energy)
    if plot is not None:
        write_picture(plot, _draw_other(result, record.step_s), console)


def _is_told(kWh: float, low: float, high: float) -> bool:
    """Whether an energy is known well enough for a figure."""
    return bool(low <= kWh <= high and high - low <= TOLD * max(kWh, 1e-9))


def _known(kWh: float) -> float | None:
    return round(float(kWh), 4) if np.isfinite(kWh) else None


def _show_other(result: Counterfactual, console: Console) -> None:
    frame, names, headings = result.to_dataframe(), result.names, ["from"]
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
    energies = (result.energy_kWh, result.energy_other_kWh, result.energy_low_kWh, result.energy_high_kWh)
    for name, was, other, low, high, beside in zip(names.machines, *energies, result.beside_kWh, strict=True):
        if not np.isfinite(was):
            continue
        told = (
            f"{other:.1f} kWh ({low:.1f} to {high:.1f})"
            if _is_told(other, low, high)
            else f"{low:.1f} to {high:.1f} kWh"
        )
        more = f", both without {beside:.1f} kWh of other loads on its meter, as hot water" if beside >= 0.05 else ""
        console.print(f"Energy of {name}: {was:.1f} kWh as it was, {told} under the other levels (90 % band){more}")
        if not _is_told(other, low, high):
            console.print(
                "  The record does not tell what these levels do to power: levels went with what the rooms asked for, "
                "or valves were never held like this. Try levels at other times (tf-mpc data probe-plan) to know more"
            )
    if np.isnan(result.sd_K).any():
        console.print("The model's card has no uncertainty of the effect: there is no band.")


def _draw_other(result: Counterfactual, step_s: float) -> Figure:
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
