"""`tf-mpc saving`: what a changed operation saved, with an interval, from records before and after."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
import pandas as pd
from rich.console import Console

from thermoforce_mpc.cli.building.courses import finish_axes, write_json_file, write_picture
from thermoforce_mpc.cli.building.data import show_doubts
from thermoforce_mpc.cli.options import FiniteRange, measured_options, plot_option
from thermoforce_mpc.data import Record
from thermoforce_mpc.data.dataframes import seconds_at
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.whatif.counterfactual import Days
from thermoforce_mpc.whatif.saving import Saving, verified_saving

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@click.command()
@measured_options
@click.option("--changed", required=True, metavar="TIME", help="When the operation changed, such as '2026-02-01'.")
@click.option("--from", "first", metavar="TIME", help="Leave out what was recorded before.")
@click.option("--until", "last", metavar="TIME", help="Leave out what was recorded later.")
@click.option("--interval", type=FiniteRange(0.5, 0.999), default=0.95, help="Its level.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the result as JSON.")
@plot_option()
def saving(
    files: tuple[str, ...],
    map_file: Path,
    changed: str,
    first: str | None,
    last: str | None,
    interval: float,
    out: Path | None,
    plot: Path | None,
) -> None:
    """Print what was saved after --changed against what the old operation would have used in the same weather.

    The map needs an outdoor temperature and the power of a machine (or heat); sun narrows the interval. Ten whole days
    before and seven after are the least; a month each, in the same season, is better. A saving is claimed only where
    the whole interval lies above 0. What else changed on that day (people, machines, rooms in use) is in the number.

    \b
    Example:
      tf-mpc saving --data 2026.csv --map map.yaml --changed 2026-02-01
    """
    from thermoforce_mpc.measurements.load import read_measurements

    measured = read_measurements(list(files), map_file)
    record = measured.record
    begin = _index(record, first, "--from") if first else 0
    end = _index(record, last, "--until") if last else record.n_steps
    split = _index(record, changed, "--changed")
    if not begin < split < end:
        stamps = record.stamps()
        raise DataError(f"--changed {changed} is not inside the measurements ({stamps[begin]} to {stamps[end]})")
    saving = verified_saving(record.slice(begin, split), record.slice(split, end), level=interval)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    _show(saving, record, console)
    show_doubts(measured.understood, console)
    if out is not None:
        write_json_file(out, saving.to_json(), console, "Result")
    if plot is not None:
        write_picture(plot, _drawn(saving, record.origin), console)


def _index(record: Record, text: str, option: str) -> int:
    """The boundary of the record nearest to the time `text`, or its nearer end."""
    steps = (seconds_at(record.origin, text, option) - record.time_s[0]) / record.step_s
    return int(np.clip(round(steps), 0, record.n_steps))


def _show(saving: Saving, record: Record, console: Console) -> None:
    say = console.print
    say(saving.in_words())
    say(
        f"  {saving.before.n} days before and {saving.after.n} after; baseline {saving.baseline_kWh:.0f} kWh, measured "
        f"{saving.measured_kWh:.0f} kWh"
    )
    say(
        f"  baseline by {saving.regressors}; a day scatters by {saving.rmse_kWh:.1f} kWh around it (R² {saving.r2:.2f})"
    )
    for zone, warmer in zip(record.names.zones, saving.warmer_K, strict=True):
        if np.isfinite(warmer):
            say(f"  {zone}: {warmer:+.1f} K after against before")
    for note in saving.notes:
        say(f"  note: {note}")


def _drawn(saving: Saving, origin: pd.Timestamp) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    axes = figure.subplots()

    def days(of: Days) -> pd.DatetimeIndex:
        noons = [origin + pd.Timedelta(days=int(k), hours=12) for k in of.number]
        return pd.DatetimeIndex([noon.tz_localize(None).normalize() for noon in noons])

    before, after = days(saving.before), days(saving.after)
    axes.plot(before, saving.before.energy_kWh, "o", color="#1b1f24", markersize=4, label="measured before")
    axes.plot(before, saving.fitted_of_day_kWh, color="#3b7a8a", label="old operation by the fit")
    axes.plot(after, saving.after.energy_kWh, "o", color="#b22222", markersize=4, label="measured after")
    axes.plot(after, saving.baseline_of_day_kWh, color="#3b7a8a", linestyle="--", label="old operation, baseline")
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("energy, kWh per day")
    axes.set_title(saving.in_words(), fontsize=9, loc="left", wrap=True)
    finish_axes(figure)
    return figure
