"""`tf-mpc worth` and `saving`: what plans would have saved in an own building, and what a changed operation did save.

The first is by the building's model and its record, the second, with an interval, from records before and after.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import pandas as pd
from rich.console import Console

from thermoforce_mpc.cli.building.courses import finish_axes, on_clock, write_json_file, write_picture, write_table
from thermoforce_mpc.cli.building.data import show_doubts
from thermoforce_mpc.cli.options import (
    FiniteRange,
    currency_of_prices,
    measured_options,
    model_option,
    out_option,
    own_prices_option,
    plot_option,
    said_tank,
)
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Record, energy_kWh
from thermoforce_mpc.data.dataframes import seconds_at
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.scenario.settings import parse_overrides, validate
from thermoforce_mpc.whatif.days import Days
from thermoforce_mpc.whatif.saving import Saving, verified_saving

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from thermoforce_mpc.experiment.worth import Worth
    from thermoforce_mpc.measurements.load import Measurements


_ERRORS = ("none", "low", "medium", "high")


@click.command()
@model_option
@measured_options
@own_prices_option
@click.option("--start", metavar="TIME", help="Begin of what is lived through.  [default: --days before the end]")
@click.option("--days", type=FiniteRange(1.0, 60.0), default=7.0, help="Length.")
@click.option("--commands", is_flag=True, help="Set the commands of the map instead of levels.")
@click.option("--keep-bounds", is_flag=True, help="Ask plans for the map's comfort also where it was not kept.")
@click.option("--hours", type=FiniteRange(6.0, 48.0), default=24.0, help="Horizon of the plans, made each hour.")
@click.option("--forecasts", type=click.Choice(_ERRORS), default="medium", help="Errors of the weather forecasts.")
@click.option("--houses", type=click.IntRange(2, 40), default=6, help="Houses drawn from what the model does not know.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of houses and forecasts.")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any option of the controller.")
@out_option("what was and what would have been")
@plot_option(of="both")
def worth(
    model: Path,
    files: tuple[str, ...],
    map_file: Path,
    prices: Path | None,
    start: str | None,
    days: float,
    commands: bool,
    keep_bounds: bool,
    hours: float,
    forecasts: str,
    houses: int,
    seed: int,
    assignments: tuple[str, ...],
    out: Path | None,
    plot: Path | None,
) -> None:
    """Say what plans would have saved in the days of a record, with a 90 % band, and what that rests on.

    The identified house is lived through the record's weather again: as it was, and with plans made each hour with
    forecasts as of then (the measured weather with errors of a usual size). Comfort is equal: no room is asked to be
    warmer than it was, and lower bounds of plans are raised or lowered, by 0.5 K at most, where K·h outside the bounds
    differ. With --keep-bounds the comfort that plans add is paid for. The band holds what the model does not know of
    the house, and what the record does not tell of power. Heat that is stored at the end counts.

    Such bands held the truth of 17 of 20 simulated houses known without probing; half their width was 8 % of the cost
    in the median. A tank of hot water of the map is lived through too, by its model and what was drawn then.

    Prices are those of --prices, else of the map; of a bill what a kWh costs, not its peaks and export. With --commands
    plans set what the map names (set-points, offsets).

    \b
    Example:
      tf-mpc worth --model my_house --data 2026.csv --map map.yaml --prices dynamic.csv --plot worth.png
    """
    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from thermoforce_mpc.boundary.forecast_error import ForecastError
    from thermoforce_mpc.experiment.worth import LoggedTank
    from thermoforce_mpc.experiment.worth import worth as worth_of
    from thermoforce_mpc.measurements.load import learned_commands, learned_tank, read_measurements
    from thermoforce_mpc.model.thermal_model import load_model

    console = Console(highlight=False, markup=False, soft_wrap=True)
    thermal = load_model(model)
    measured = read_measurements(list(files), map_file, step_s=HOUR_S).served()
    record = measured.record
    check_same_layout(f"--model {model}:", thermal.layout, str(map_file), measured.layout)
    if commands and not measured.commands:
        raise ConfigError(f"--commands: --map {map_file} names no command of an actuator")
    learned = learned_commands(measured) if commands else {}
    conditions = _conditions(measured, prices, console)
    chosen = {"step_s": HOUR_S, "horizon_h": hours} | parse_overrides(assignments)
    tank = said_tank(lambda: learned_tank(measured), console.print)
    controller = ThermoForceMPC(thermal, validate(MPCConfig, chosen, "--set"), commands=learned, hot_water=tank)
    start_s = float(record.time_s[-1]) - round(days * DAY_S / HOUR_S) * HOUR_S
    if start is not None:
        start_s = float(record.time_s[0]) + record.nearest(seconds_at(record.origin, start, "--start")) * HOUR_S
    error = None if forecasts == "none" else ForecastError(forecasts, forecasts, seed)  # type: ignore[arg-type]
    with RunDisplay().phase("the record is made ready") as line:

        def begins(house: str) -> None:
            click.echo(house, err=True)
            line.then(house)

        found = worth_of(
            thermal,
            record,
            conditions,
            controller,
            start_s=start_s,
            days=days,
            draws=houses,
            commands=learned,
            hot_water=measured.map.tank_machine
            if tank is None or measured.tank is None
            else LoggedTank(tank, measured.tank),
            bounds_kept=keep_bounds,
            error=error,
            seed=seed,
            progress=begins,
        )
    found = replace(found, currency=currency_of_prices(prices, measured.map))
    _show(found, console)
    if out is not None:
        write_table(out, found.to_dataframe(), console, "Course", worth=_as_json(found))
    if plot is not None:
        write_picture(plot, _drawn(found), console)


def _conditions(measured: Measurements, prices: Path | None, console: Console) -> Boundary:
    """Bounds and prices of the record's times."""
    if prices is None:
        return measured.conditions
    from thermoforce_mpc.measurements.forecast import billed_over_steps, prices_over_steps
    from thermoforce_mpc.scenario.bill import SUFFIXES, read_bill

    record, clock = measured.record, measured.map.time
    over = clock, record.origin, record.time_s, record.step_s
    if prices.suffix in SUFFIXES:
        bill = read_bill(prices)
        price, _, read = billed_over_steps(prices, bill, measured.conditions.price_per_kWh, *over)
        if bill.of_whole_house:
            console.print(f"{prices}: {', '.join(bill.of_whole_house)}: not counted, neither in what was nor in plans")
    else:
        of_file, read = prices_over_steps(prices, *over)
        price = np.tile(of_file, (len(record.names.machines), 1))
    console.print(f"Prices: {read}")
    return measured.conditions.at_prices(price)


def _show(found: Worth, console: Console) -> None:
    stamps = found.as_was.stamps()
    console.print(f"{stamps[0]} to {stamps[-1]}: {found.sentence}.")
    console.print(
        f"  Energy {found.energy_kWh:.1f} instead of {found.energy_was_kWh:.1f} kWh, cost {found.cost:.2f} instead of "
        f"{found.cost_was:.2f}, outside the bounds {found.outside_Kh:.1f} instead of {found.outside_was_Kh:.1f} K·h"
    )
    console.print(f"  {_stored(found)}")
    for zone, warmer in zip(found.as_was.names.zones, found.warmer_K, strict=True):
        console.print(f"  {zone}: {warmer:+.1f} K on average")
    if found.raised_K:
        way = "raised" if found.raised_K > 0.0 else "lowered"
        console.print(f"  Bounds of plans were {way} by {abs(found.raised_K):g} K, to be as comfortable as it was")
    if found.tank is not None:
        console.print(f"  {found.tank.in_words}")
    if found.tank_raised_K:
        console.print(f"  Plans kept the tank {found.tank_raised_K:g} K warmer than is wanted, to be as warm as it was")
    for line in found.acted_in_words:
        console.print(f"  {line}")
    console.print(f"  {found.rests_on}")


def _stored(found: Worth) -> str:
    """Why the saving is not the difference of the costs."""
    less = "less" if found.stored < 0.0 else "more"
    return f"Warmth of {abs(found.stored):.2f} {less} is left at the end than it was; it is in what is saved"


def _as_json(found: Worth) -> dict[str, Any]:
    names = ("saved", "low", "high", "cost", "cost_was", "energy_kWh", "energy_was_kWh", "outside_Kh", "outside_was_Kh")
    numbers = {name: round(float(getattr(found, name)), 4) for name in names}
    warmer = zip(found.as_was.names.zones, np.round(found.warmer_K, 3).tolist(), strict=True)
    of_tank = found.tank and {
        "below_Kh": round(found.tank.below_Kh, 4),
        "below_was_Kh": round(found.tank.below_was_Kh, 4),
        "raised_K": found.tank_raised_K,
    }
    return numbers | {
        "hot_water": of_tank,
        "warmer_K": dict(warmer),
        "houses": [round(one, 4) for one in found.draws],
        "raised_K": found.raised_K,
        "acted": {name: {what: round(one, 4) for what, one in of.items()} for name, of in found.acted.items()},
        "currency": found.currency,
        "sentence": found.sentence,
        "rests_on": found.rests_on,
    }


def _drawn(found: Worth) -> Figure:
    from matplotlib.figure import Figure

    names, frame = found.as_was.names, found.to_dataframe()
    at = on_clock(frame.index)
    figure = Figure(figsize=(10.0, 8.0), layout="constrained")
    upper, middle, price, lower = figure.subplots(4, 1, sharex=True, height_ratios=[4, 2, 1, 2])
    courses = [
        (zone, f"C{z % 10}", found.as_was.T_zone_C[z, 1:], found.planned.T_zone_C[z, 1:])
        for z, zone in enumerate(names.zones)
    ]
    for label, colour, was_C, planned_C in courses:
        upper.plot(at, was_C, color=colour, linewidth=0.9, linestyle=":", label=f"{label}, as it was")
        upper.plot(at, planned_C, color=colour, label=f"{label}, with plans")
    bounds = np.unique(found.lower_C, axis=0)
    for k, row in enumerate(bounds):
        upper.step(at, row, where="post", color="0.6", linewidth=0.8, label="lower bound" if k == 0 else None)
    if found.tank is not None:
        beside = upper.twinx()
        beside.plot(at, found.tank.T_was_C, color="C3", linewidth=0.9, linestyle=":")
        beside.plot(at, found.tank.T_C, color="C3", linewidth=0.9)
        beside.set_ylabel("hot water, °C", color="C3")
    upper.set_ylabel("temperature, °C")
    upper.set_title(found.sentence, loc="left", fontsize=9, wrap=True)
    for label, record, colour in (("as it was", found.as_was, "0.4"), ("with plans", found.planned, "C0")):
        middle.step(at, record.power_W.sum(axis=0) / 1000.0, where="post", color=colour, label=label, linewidth=0.9)
        cost = (energy_kWh(record.power_W, record.step_s) * found.price_per_kWh).sum(axis=0)
        lower.plot(at, np.cumsum(cost), color=colour, label=label)
    middle.set_ylabel("power, kW")
    middle.legend(frameon=False, fontsize="small")
    for row in np.unique(found.price_per_kWh, axis=0):
        price.step(at, row, where="post", color="0.3", linewidth=0.9)
    price.set_ylabel("price of\na kWh")
    lower.set_ylabel(f"cost so far, {found.currency}" if found.currency else "cost so far")
    lower.set_title(f"By the law of power. {_stored(found)}", loc="left", fontsize=9)
    finish_axes(figure)
    return figure


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
    stamps = record.stamps()
    if begin >= end:
        only = " and ".join(f"{option} {at}" for option, at in (("--from", first), ("--until", last)) if at)
        raise DataError(f"{only}: leaves nothing of the measurements ({stamps[0]} to {stamps[-1]})")
    if not begin < split < end:
        raise DataError(f"--changed {changed} is not inside the measurements ({stamps[begin]} to {stamps[end]})")
    saving = verified_saving(record.slice(begin, split), record.slice(split, end), level=interval)
    console = Console(highlight=False, markup=False, soft_wrap=True)
    _show_saving(saving, record, console)
    show_doubts(measured.understood, console)
    if out is not None:
        write_json_file(out, saving.to_json(), console, "Result")
    if plot is not None:
        write_picture(plot, _drawn_saving(saving, record.origin), console)


def _index(record: Record, text: str, option: str) -> int:
    """The boundary of the record nearest to the time `text`, or its nearer end."""
    return int(np.clip(record.nearest(seconds_at(record.origin, text, option)), 0, record.n_steps))


def _show_saving(saving: Saving, record: Record, console: Console) -> None:
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


def _drawn_saving(saving: Saving, origin: pd.Timestamp) -> Figure:
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
