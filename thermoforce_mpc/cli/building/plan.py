"""`tf-mpc plan`: a plan of the next hours from recent measurements and a forecast in files, to follow by hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.cli.building.courses import on_clock, write_json_file, write_picture, write_table
from thermoforce_mpc.cli.building.identify import NOT_COMPETENT
from thermoforce_mpc.cli.options import (
    PATH,
    FiniteRange,
    billed_objective,
    currency_of_prices,
    map_option,
    model_option,
    out_option,
    own_prices_option,
    plot_option,
    said_tank,
)
from thermoforce_mpc.commands.loop import USUAL_COMMANDS, command_rows, saving_in_words
from thermoforce_mpc.commands.tank import tank_in_words, tank_rows
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Layout, Observation, Plan, PlannedSaving, energy_kWh
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.map.mapping import MOST_STEP_S
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.whole_tables import plain_table, print_whole
from thermoforce_mpc.scenario.settings import merge, parse_overrides, validate
from thermoforce_mpc.whatif.dates import date_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from controllers.mpc.config import MPCConfig
    from controllers.mpc.controller import ThermoForceMPC
    from thermoforce_mpc.commands.loop import LearnedCommand
    from thermoforce_mpc.commands.tank import LearnedTank
    from thermoforce_mpc.measurements.load import Measurements
    from thermoforce_mpc.model.thermal_model import ThermalModel


# Least and usual length of a plan, h, and how much of the measurements it looks back at, days: a month with its peaks.
_LEAST_H, _USUAL_H, _BACK_DAYS = 6.0, 48.0, 31.0
# Least step of a plan, s: that of the controller.
_LEAST_STEP_S = 300.0


@click.command()
@model_option
@click.option("--data", "files", required=True, multiple=True, metavar="FILE", help="Recent measurements; repeatable.")
@map_option
@click.option("--forecast", required=True, metavar="FILE", help="Weather, prices and bounds from their end on.")
@own_prices_option
@click.option("--step", default="60min", help="Step of the plan, 5min to 1h.")
@click.option("--hours", type=FiniteRange(_LEAST_H, 96.0), help="Length.  [default: the forecast's, up to 48]")
@click.option("--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any option of the controller.")
@click.option("--commands", "commands_file", type=PATH, help="Write the commands as .csv or .json.")
@out_option("the plan")
@plot_option(of="the plan")
def plan(
    model: Path,
    files: tuple[str, ...],
    map_file: Path,
    forecast: str,
    prices: Path | None,
    step: str,
    hours: float | None,
    assignments: tuple[str, ...],
    commands_file: Path | None,
    out: Path | None,
    plot: Path | None,
) -> None:
    """Plan the next hours, print what to set as a table of times, and write it as CSV or JSON.

    Measurements reach back a week or more and end now; the forecast begins there or before. Its columns are those of
    the map, or of the map's key forecast: outdoor temperature, sun, and prices and comfort bounds unless the map has
    numbers. Nothing is connected: set the levels yourself, and plan again when new measurements are there.

    Where the map names a command of an actuator (docs/how-it-works/commands.md), that is what to set, with what it
    saves against leaving the building alone. Of others the level is, with what these save against rooms kept as they
    usually were, where days of the record are alike.
    With hot_water in the map the tank is planned too.

    A level between 0 and 1 of a machine that is only on or off means that share of the step. Where a step does not hold
    its minimum on and off times (actuation.min_on_s, min_off_s) or its share of the starts an hour
    (actuation.starts_per_hour), levels are those of runs that keep them, also towards the last levels of the record: of
    a machine with several valves, whichever is open. A line says of which machines no runs are planned. An actuator
    whose model may not act has no level ("own control", null in JSON, empty in CSV), nor have rooms that it alone
    serves a temperature, or its machine a power.

    Exit code 4 where the model is not competent, 1 where readings, forecast or solver give no plan: leave the building
    to its own control then.

    \b
    Example:
      tf-mpc plan --model my_house --data recent.csv --map map.yaml --forecast tomorrow.csv --out plan.csv
    """
    from controllers.mpc.config import MPCConfig
    from thermoforce_mpc.experiment.left_alone import saving_of_levels
    from thermoforce_mpc.measurements.forecast import read_forecast
    from thermoforce_mpc.measurements.load import learned_commands, learned_tank, read_measurements
    from thermoforce_mpc.model.thermal_model import load_model

    step_s = _seconds(step)
    display = RunDisplay()
    thermal = load_model(model)
    measured = read_measurements(files, map_file, step_s=step_s, at="end").served()
    record = measured.record
    check_same_layout(f"--model {model}:", thermal.layout, str(map_file), measured.layout)
    notes: list[str] = []
    ahead = read_forecast(forecast, measured, prices=prices, left_out=notes)
    there_h = ahead.n_steps * step_s / HOUR_S
    horizon_h = min(_USUAL_H, there_h) if hours is None else hours
    if there_h < (hours or _LEAST_H):
        raise DataError(
            f"--forecast {forecast}: covers {there_h:g} h from {record.stamps()[-1]} on, need {hours or _LEAST_H:g}"
        )
    history = record.last(round(_BACK_DAYS * DAY_S / step_s))
    chosen: dict[str, Any] = {"step_s": step_s, "horizon_h": horizon_h, "whole_runs": True}
    chosen["objective"] = billed_objective(prices, measured.map)
    config = validate(MPCConfig, merge(chosen, parse_overrides(assignments)), "--set")
    if commands_file is not None:
        _check_commands_file(commands_file, measured, map_file)
    commands = learned_commands(measured)
    tank = said_tank(lambda: learned_tank(measured), display.say)
    controller = _controller(thermal, config, commands, tank, step)
    ahead = ahead.head(round(controller.horizon_s / step_s))
    plan = controller.plan(Observation(history, ahead, *(measured.tank.now() if measured.tank else ())))
    _say_why(display, plan, f"Plan from {record.stamps()[-1]} for {horizon_h:.4g} h", controller, thermal, notes)
    if not plan.u.size:
        display.say("There is no plan: leave the building to its own control.")
        click.get_current_context().exit(NOT_COMPETENT if plan.status == "gate" else 1)
    table = plan_table(plan, ahead.head(plan.u.shape[1]), measured.layout)
    sums = _show(plan, table, measured.layout, display, by_commands=bool(commands))
    by_commands = [a for a, name in enumerate(plan.names.actuators) if name in commands]

    def of_levels() -> PlannedSaving:
        return saving_of_levels(thermal, history, ahead, plan, by_commands, "" if tank is None else tank.machine)

    currency = currency_of_prices(prices, measured.map)
    saving, said = _saving_of(plan, of_levels, config, by_commands, currency)
    found = [*command_rows(plan, commands), *tank_rows(plan, None if tank is None else tank.command)]
    if found:
        _show_commands(found, display)
    # What a plan saves counts what is not known of its levels too: other sums than those of the table.
    display.say(sums if saving is None else f"{sums}, if the model were exact. On average over what it may err:")
    display.say(said)
    if plan.hot_water is not None:
        display.say(tank_in_words(plan.hot_water))
    of_saving = _saving_json(saving, currency)
    if commands_file is not None:
        _write_commands(commands_file, plan, found, of_saving, display)
    if out is not None:
        write_table(out, table, display.console, "Plan", **_beside_table(plan, of_saving, said, found))
    if plot is not None:
        write_picture(plot, drawn_plan(plan, table, ahead.head(plan.u.shape[1]), found), display.console)


def _check_commands_file(path: Path, measured: Measurements, map_file: Path) -> None:
    """Raise `ConfigError` where a file of commands has none to hold, or is of no form that is written."""
    if not measured.commands and (measured.map.hot_water is None or measured.map.hot_water.command is None):
        raise ConfigError(f"--commands {path}: --map {map_file} names no command of an actuator")
    if path.suffix not in (".csv", ".json"):
        raise ConfigError(f"--commands {path}: a .csv or .json file")


def _controller(
    thermal: ThermalModel,
    config: MPCConfig,
    commands: Mapping[str, LearnedCommand],
    tank: LearnedTank | None,
    step: str,
) -> ThermoForceMPC:
    """The controller that plans; raises `ControllerConfigError`, of `step` where that is too short for blocks."""
    from controllers.checks import ControllerConfigError
    from controllers.mpc.controller import ThermoForceMPC

    try:
        return ThermoForceMPC(thermal, config, commands=commands, hot_water=tank)
    except ControllerConfigError as error:
        if "block_s" not in str(error):
            raise
        least = 2.0 * max(config.actuation_of(name).block_s for name in thermal.names.actuators) / 60.0
        raise ControllerConfigError(
            f"--step {step}: a plan of on/off blocks has {least:g}min to 1h; {error}"
        ) from error


def _say_why(
    display: RunDisplay,
    plan: Plan,
    of_what: str,
    controller: ThermoForceMPC,
    thermal: ThermalModel,
    notes: Sequence[str],
) -> None:
    """Say why the plan is as it is, how it acts, and what it does not count with; `notes`: of prices."""
    display.say(_listed(of_what, plan.why))
    display.say(_listed("Actuation", controller.actuation_in_words))
    thermal.say_claims(display.say, plan.why)
    for limits in controller.limits_not_planned:
        display.say(limits)
    for note in notes:
        display.say(f"Prices: {note}")


def _beside_table(
    plan: Plan, saving: dict[str, float | str] | None, said: str, commands: list[dict[str, Any]]
) -> dict[str, Any]:
    """What a JSON file has beside the table; `said`: why there is no saving."""
    beside: dict[str, Any] = {"status": str(plan.status), "why": plan.why, "solver": plan.solver_status}
    beside["acting"] = dict(zip(plan.names.actuators, map(str, plan.acting), strict=True))
    beside["saving"] = saving
    if saving is None:
        beside["no_saving"] = said
    if commands:
        beside["commands"] = commands
    if (tank := plan.hot_water) is not None:
        told = ("cost", "cost_alone", "below_Kh", "below_alone_Kh", "gap")
        beside["hot_water"] = {name: round(getattr(tank, name), 4) for name in told}
    return beside


def _seconds(step: str) -> float:
    """The step of a plan, s; raises `ConfigError` for what is none."""
    possible = f"write one from {_LEAST_STEP_S / 60.0:g}min to {MOST_STEP_S / HOUR_S:g}h, such as 15min"
    try:
        seconds = pd.Timedelta(step).total_seconds()
    except ValueError as error:
        raise ConfigError(f"--step {step}: is no duration; {possible}") from error
    if re.fullmatch(r"[\d\s.+-]+", step):  # pandas takes it for nanoseconds
        raise ConfigError(f"--step {step}: has no unit; {possible}")
    if not _LEAST_STEP_S <= seconds <= MOST_STEP_S:
        raise ConfigError(f"--step {step}: is no step of a plan; {possible}")
    return seconds


def plan_table(plan: Plan, ahead: Boundary, layout: Layout | None = None) -> pd.DataFrame:
    """The plan, one row per step at its start: `Plan.to_dataframe` with weather, bounds, price and cost of the step.

    With the `layout` of the building, temperatures of zones that no planned actuator serves are NaN, and power of
    machines that feed others.
    """
    names = plan.names
    zones, machines = _told(plan, layout)
    table = plan.to_dataframe()
    for names_of, told, signals in (
        (names.zones, zones, ("T_zone_C", "T_low_C", "T_high_C", "T_free_C", "T_forced_K", "slack_K")),
        (names.machines, machines, ("power_W",)),
    ):
        for row in range(len(names_of)):
            if not told[row]:
                table[[names.label(signal, row) for signal in signals]] = np.nan
    table["T_out_C"], table["solar_W_m2"] = ahead.T_out_C[:-1], ahead.solar_W_m2[:-1]
    bounds = names.columns(lower_C=ahead.lower_C[:, 1:], upper_C=ahead.upper_C[:, 1:])
    price = ahead.price_per_kWh[:, :-1]
    prices = names.columns(price_per_kWh=price)
    for name, values in (bounds | prices).items():
        table[name] = values
    cost = energy_kWh(plan.power_W, ahead.step_s) * price
    if ahead.others_W.size:  # what others leave over costs what it would have earned
        power_W, spare_W = plan.power_W.sum(axis=0), np.maximum(-np.nan_to_num(ahead.others_W[:-1]), 0.0)
        earns = ahead.export_per_kWh[:-1] if ahead.export_per_kWh.size else np.zeros(power_W.size)
        dearer = np.maximum(price.max(axis=0) - earns, 0.0)
        table["others_W"] = ahead.others_W[:-1]
        own_W = plan.power_W / np.maximum(power_W, 1e-9) * np.minimum(power_W, spare_W)
        cost = cost - energy_kWh(own_W, ahead.step_s) * dearer
    table["cost"] = cost[machines].sum(axis=0) if machines.any() else np.nan
    if (tank := plan.hot_water) is not None:
        table["T_tank_C"], table["T_tank_low_C"] = tank.T_C, tank.low_C
        table["tank_power_W"], table["tank_share"] = tank.power_W, tank.share
    return table


def _saving_of(
    plan: Plan, of_levels: Callable[[], PlannedSaving], config: MPCConfig, by_commands: Sequence[int], currency: str
) -> tuple[PlannedSaving | None, str]:
    """What a plan saves, None where it is not told, and that or why in words; `by_commands`: its actuators that are."""
    from thermoforce_mpc.experiment.left_alone import LEFT_ALONE, of_both

    commands, usual, of = plan.saving, "", "" if plan.hot_water is None else "In the rooms: "
    if commands is not None and len(by_commands) == len(plan.names.actuators):
        return commands, f"{of}{saving_in_words(commands, currency=currency)}"
    try:
        if len(by_commands) == len(plan.names.actuators):
            raise DataError("none of its commands is set")
        if config.objective.prices_peaks or config.objective.at_the_meter:
            raise DataError("what it changes at the meter, as a peak, is not counted")
        saving = of_levels()
        if commands is not None and commands.gain > 0.0:  # else none of them is set
            saving, usual = of_both(commands, saving), f"{USUAL_COMMANDS}, and "
        words = saving_in_words(saving, f"{usual}with {LEFT_ALONE}", currency)
        return saving, f"{of}{words}"
    except DataError as error:
        told = "tf-mpc worth tells what plans would have saved in the days of a record"
        alone = "" if commands is None else saving_in_words(commands, currency=currency)
        of_commands = alone and f"Of its commands alone: {alone} "
        return None, f"{of_commands}What the plan saves is not told: {error}. {told}"


def _saving_json(saving: PlannedSaving | None, currency: str) -> dict[str, float | str] | None:
    if saving is None:
        return None
    numbers = asdict(saving) | {"stored": saving.stored}
    return {name: round(value, 4) for name, value in numbers.items()} | {"currency": currency}


def _show_commands(rows: list[dict[str, Any]], display: RunDisplay) -> None:
    shown = plain_table(["actuator", "from", "until", "set"], "Commands to set")
    for row in rows:
        begin, end = pd.Timestamp(row["from"]), pd.Timestamp(row["until"])
        shown.add_row(row["actuator"], f"{begin:%a %d %b %H:%M}", f"{end:%a %H:%M}", row["text"])
    print_whole(shown, display.console)


def _write_commands(
    path: Path, plan: Plan, rows: list[dict[str, Any]], saving: dict[str, float | str] | None, display: RunDisplay
) -> None:
    if path.suffix == ".json":
        content = {"status": str(plan.status), "why": plan.why, "saving": saving, "commands": rows}
        write_json_file(path, content, display.console, "Commands")
        return
    from thermoforce_mpc.files import write_whole

    write_whole(path, pd.DataFrame(rows).to_csv(index=False, lineterminator="\n"))
    display.say(f"Commands: {path}")


def _told(plan: Plan, layout: Layout | None) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Zones (Z,) of whose temperature a plan tells, and machines (M,) of whose power: those that follow it."""
    followed = plan.followed
    if layout is None:
        return np.ones(len(plan.names.zones), dtype=bool), np.ones(len(plan.names.machines), dtype=bool)
    zones = [not own or bool(followed[own].any()) for own in layout.actuators_of_zones]
    machines = [bool(followed[fed].all()) for fed in layout.actuators_of_machines]
    return np.array(zones), np.array(machines)


def _listed(what: str, said: str) -> str:
    """What is said of something, several things on lines of their own; what stands in brackets stays in its line."""
    parts, depth = [""], 0
    for piece in re.split(r"(; |[()])", said):
        depth = max(depth + {"(": 1, ")": -1}.get(piece, 0), 0)
        if piece == "; " and not depth:
            parts.append("")
        else:
            parts[-1] += piece
    return f"{what}: {said}" if len(parts) == 1 else "\n".join([f"{what}:", *(f"  {part}" for part in parts)])


def _show(plan: Plan, table: pd.DataFrame, layout: Layout, display: RunDisplay, *, by_commands: bool) -> str:
    """Show the plan; returns the sums of its table in words."""
    names, one_zone = plan.names, len(plan.names.zones) == 1
    zones_told, machines_told = _told(plan, layout)
    of = "Levels that the commands below are to bring" if by_commands else "Levels to set"
    title = f"{of} (of a machine that is on or off: share of the step), and what they lead to by its end"
    zones = [f"{zone}, °C{' (80 % band)' if one_zone else ''}" for zone in names.zones]
    bounds = ["bounds, °C"] if one_zone else []
    shown = plain_table(["from", *names.actuators, *zones, *bounds, "power, kW", "price", "cost"], title)
    machines = names.columns(price_per_kWh=plan.power_W)
    day, power_W = "", plan.power_W[machines_told]
    for k, (at, row) in enumerate(table.iterrows()):
        cells = [f"{at:%a %d %b %H:%M}" if f"{at:%j}" != day else f"{at:%H:%M}"]
        day = f"{at:%j}"
        cells += ["own control" if np.isnan(level) else f"{100 * level:.0f} %" for level in plan.u_to_set[:, k]]
        if one_zone:
            cells.append(f"{row['T_zone_C']:.1f} ({row['T_low_C']:.1f} to {row['T_high_C']:.1f})")
            cells.append(f"{row['lower_C']:g} to {row['upper_C']:g}")
        else:
            cells += [f"{T:.1f}" if told else "–" for T, told in zip(plan.T_zone_C[:, k], zones_told, strict=True)]
        cells.append(f"{power_W[:, k].sum() / 1000:.2f}" if machines_told.any() else "–")
        cells.append(", ".join(f"{price:.3f}" for price in dict.fromkeys(row[name] for name in machines)))
        shown.add_row(*cells, f"{row['cost']:.2f}" if machines_told.any() else "–")
    print_whole(shown, display.console)
    step_s = (table.index[1] - table.index[0]).total_seconds() if len(table) > 1 else float("nan")
    slack = plan.slack_K[zones_told].sum() * step_s / HOUR_S
    outside = f"expected outside the bounds {slack:.1f} K·h"
    if not plan.followed.all():
        display.say(_left_out(plan, zones_told, machines_told))
    if not machines_told.any():
        return outside[0].upper() + outside[1:]
    energy = energy_kWh(float(power_W.sum()), step_s)
    return f"Energy {energy:.1f} kWh, cost {table['cost'].sum():.2f}, {outside}"


def _left_out(plan: Plan, zones_told: NDArray[np.bool_], machines_told: NDArray[np.bool_]) -> str:
    """What a plan does not tell, because the building's own control acts, in words."""
    names = plan.names
    own = [name for name, followed in zip(names.actuators, plan.followed, strict=True) if not followed]
    told = (("bounds", names.zones, zones_told), ("energy and cost", names.machines, machines_told))
    what = [
        f"{of} of {', '.join(name for name, flag in zip(those, flags, strict=True) if not flag)}"
        for of, those, flags in told
        if not flags.all()
    ]
    left = f": {' and '.join(what)} left out" if what else ""
    return (
        f"{', '.join(own)}: own control, set nothing{left}. The plan of the others takes it that own control keeps the "
        "bounds of its rooms"
    )


def drawn_plan(plan: Plan, table: pd.DataFrame, ahead: Boundary, commands: Sequence[Mapping[str, Any]] = ()) -> Figure:
    """A picture: predicted temperatures with band and bounds, `commands` to set (`command_rows`), levels with the
    price, and temperatures without any action.
    """
    from matplotlib.figure import Figure

    names = plan.names
    at = on_clock(table.index)
    edges = np.append(at, at[-1] + (at[-1] - at[-2]))
    units = list(dict.fromkeys(row["unit"] for row in commands if row["value"] is not None))
    figure = Figure(figsize=(10.0, 7.5 + 1.5 * len(units)), layout="constrained")
    upper, *of_units, middle, lower = figure.subplots(
        3 + len(units), 1, sharex=True, height_ratios=[6, *[3 for _ in units], 4, 2]
    )
    for z, zone in enumerate(names.zones):
        if table[names.label("T_zone_C", z)].isna().all():  # its own control acts
            continue
        colour = f"C{z % 10}"
        label = {name: table[names.label(name, z)] for name in ("T_zone_C", "T_low_C", "T_high_C")}
        upper.fill_between(edges[1:], label["T_low_C"], label["T_high_C"], color=colour, alpha=0.2, linewidth=0)
        upper.plot(edges[1:], label["T_zone_C"], color=colour, label=zone)
        lower.plot(edges[1:], plan.T_free_C[z], color=colour, linewidth=0.9)
        for bound in (ahead.lower_C[z], ahead.upper_C[z]):
            upper.step(edges, bound, where="post", color=colour, linewidth=0.7, linestyle=":")
    upper.set_ylabel("temperature, °C")
    upper.set_title("Plan with its 80 % band; dotted: bounds", loc="left", fontsize="medium")
    for axes, unit in zip(of_units, units, strict=True):
        _draw_commands(axes, [row for row in commands if row["unit"] == unit], unit)
    for a, actuator in enumerate(names.actuators):
        if not plan.followed[a]:
            continue
        middle.stairs(plan.u[a], edges, color=f"C{a % 10}", fill=len(names.actuators) == 1, alpha=0.6, label=actuator)
    middle.set_ylabel("level u")
    middle.set_ylim(min(0.0, float(plan.u.min())) * 1.05, 1.05)
    price = middle.twinx()
    price.stairs(ahead.price_per_kWh[0, :-1], edges, color="0.4", linestyle="--", baseline=None)
    price.set_ylabel("price per kWh, dashed", color="0.4")
    lower.set_ylabel("without\naction, °C")
    for axes, several in ((upper, names.zones), (middle, names.actuators)):
        if len(several) > 1:
            _legend_above(axes)
    date_ticks(upper)
    return figure


def _draw_commands(axes: Axes, commands: Sequence[Mapping[str, Any]], unit: str) -> None:
    """What to set each actuator to, as it is held; nothing where it is left to itself."""
    names = list(dict.fromkeys(row["actuator"] for row in commands))
    for k, name in enumerate(names):
        rows = [row for row in commands if row["actuator"] == name]
        held = [np.nan if row["value"] is None else float(row["value"]) for row in rows]
        ends = [pd.Timestamp(row["from"]) for row in rows] + [pd.Timestamp(rows[-1]["until"])]
        axes.step(on_clock(pd.DatetimeIndex(ends)), [*held, held[-1]], where="post", color=f"C{k % 10}", label=name)
    axes.set_ylabel(f"set, {unit}" if unit else "set")
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    """A legend where it hides no course."""
    axes.legend(
        frameon=False, ncols=5, fontsize="small", loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0
    )
