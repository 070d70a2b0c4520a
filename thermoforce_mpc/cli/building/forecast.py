"""`tf-mpc forecast`: temperatures ahead with their band, or of a past day beside what was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.console import Console

from thermoforce_mpc.cli.building.output import finish_axes, on_clock, write_picture, write_table
from thermoforce_mpc.cli.building.schedule_file import levels_of
from thermoforce_mpc.cli.options import FiniteRange, course_options, measured_model_options
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Record
from thermoforce_mpc.data.dataframes import seconds_at
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.predictor import Prediction
from thermoforce_mpc.simulation.views.whole_tables import plain_table, print_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROWS, _BACK_DAYS = 25, 28.0
# The band promises 80 %: less than this held over a day or longer is said as a warning, where errors matter, K. Hours
# after hours are alike, so that a shorter time says little.
_HELD, _JUDGED_H, _MATTERS_K = 0.5, 24.0, 0.25


@click.command()
@measured_model_options
@click.option("--forecast", "forecast_file", metavar="FILE", help="Weather from the end of the measurements on.")
@click.option("--start", metavar="TIME", help="Instead: a past time, whose weather and levels were measured.")
@click.option("--hours", type=FiniteRange(1.0, 96.0), default=24.0, show_default=True, help="Length.")
@course_options("One level in [0, 1] for all of it.  [default with --start: as applied]")
def command(
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
    from thermoforce_mpc.model.thermal_model import load_model

    if (forecast_file is None) == (start is None):
        raise click.UsageError("give --forecast FILE (from now on) or --start TIME (a past time)")
    if level is not None and schedule is not None:
        raise click.UsageError("give --level or --schedule, not both")
    if forecast_file and level is None and schedule is None:
        raise click.UsageError("give the levels ahead: --level or --schedule")
    thermal = load_model(model)
    measured = read_measurements(list(files), map_file).served()
    record = measured.record
    check_same_building(f"--model {model}:", thermal.names, f"the map {map_file}", record.names)
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
        ahead = ahead.head(n)
    if level is not None or schedule is not None:
        applied = levels_of(schedule, level, record.names, ahead.time_s[:-1], record.origin)
    elif applied is None or not np.isfinite(applied).all():
        raise DataError(f"the levels from {start} on were not all measured: give --level or --schedule")
    prediction = thermal.predict(past.last(round(_BACK_DAYS * DAY_S / record.step_s)), ahead, applied)
    console = Console(highlight=False, markup=False)
    _show(prediction, truth, record.step_s, console)
    table = prediction.to_dataframe()
    for name, values in record.names.columns(T_zone_C=truth).items():
        table[name.replace("T_zone_C", "measured_C")] = values
    if out is not None:
        write_table(out, table, console, "Forecast")
    if plot is not None:
        write_picture(plot, _drawn(prediction, truth), console)


def _split_at(record: Record, start: str, n: int) -> tuple[Record, Record]:
    """The record until `start`, and the `n` steps from it on."""
    first = round((seconds_at(record.origin, start, "--start") - record.time_s[0]) / record.step_s)
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
        if np.isfinite(truth[z]).any():
            error = prediction.total_C[z] - truth[z]
            measured = np.isfinite(truth[z])
            inside = (low_C[z] <= truth[z]) & (truth[z] <= high_C[z])
            console.print(
                f"{zone}: RMSE {np.sqrt(np.nanmean(error**2)):.2f} K, {100 * inside[measured].mean():.0f} % of what "
                "was measured inside the 80 % band"
            )
            judged_h = measured.sum() * step_s / HOUR_S
            rmse_K = float(np.sqrt(np.nanmean(error**2)))
            if judged_h >= _JUDGED_H and inside[measured].mean() < _HELD and rmse_K > _MATTERS_K:
                console.print(
                    f"warning: the band of {zone} promises 80 % and held far less: do not rely on it; identify again "
                    "from more days, and look for heat that the record does not hold",
                    soft_wrap=True,
                )


def _drawn(prediction: Prediction, truth: Array) -> Figure:
    from matplotlib.figure import Figure

    at = on_clock(prediction.to_dataframe().index)
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    axes, (low_C, high_C) = figure.subplots(), prediction.band_C
    for z, zone in enumerate(prediction.names.zones):
        colour = f"C{z % 10}"
        axes.fill_between(at, low_C[z], high_C[z], color=colour, alpha=0.2, linewidth=0)
        axes.plot(at, prediction.total_C[z], color=colour, label=f"{zone}, forecast")
        axes.plot(at, prediction.free_C[z], color=colour, linestyle=":", label=f"{zone}, without control")
        measured = "measured" if z == 0 and np.isfinite(truth).any() else None
        axes.plot(at, truth[z], color="#1b1f24", linewidth=1.0, label=measured)
    axes.set_ylabel("temperature, °C")
    finish_axes(figure)
    return figure
