"""`tf-mpc data`: check a table of measurements, write a map to start from, plan a probing by hand.

Its picture has temperatures, weather and what acts; gaps are shaded, flagged readings marked.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.console import Console

from thermoforce_mpc.cli.options import PATH, plot_option
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.data.dataframes import time_told
from thermoforce_mpc.data.series import stretches
from thermoforce_mpc.errors import DataError, counted
from thermoforce_mpc.execution.progress import figure
from thermoforce_mpc.files import write_json, written
from thermoforce_mpc.measurements.load import Measurements
from thermoforce_mpc.measurements.signals import Understood
from thermoforce_mpc.report.display import RunDisplay
from thermoforce_mpc.report.whole_tables import in_lines, plain_table, print_whole
from thermoforce_mpc.whatif.dates import label_dates, on_dates

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from thermoforce_mpc.identification.probing.by_hand import ProbeSchedule


@click.group()
def data() -> None:
    """Measurements of your own building: CSV or Parquet files and a map that says which column is what.

    \b
    Example:
      tf-mpc data map house.csv > map.yaml        (then check every line of it)
      tf-mpc data check house.csv --map map.yaml
      tf-mpc identify --data house.csv --map map.yaml --out my_house
    """


_MOST_FILES = 5
# Share of a signal that is known from which its gaps are no matter, and how many with less are named.
_WHOLE, _MOST_HOLED = 0.97, 4
FILES = click.argument("files", nargs=-1, required=True, metavar="FILE...")
MAP = click.option("--map", "map_file", required=True, type=PATH, help="Map of the table (YAML).")


@data.command("map")
@FILES
@click.option("--zone", help="The building's time zone, as Europe/Brussels.  [default: as FILE tells]")
def map_of(files: tuple[str, ...], zone: str | None) -> None:
    """Print a map for FILE (several of one building, or a pattern in quotes), to be checked line by line.

    Recognises one column per signal, one row per reading (Home Assistant, InfluxDB and the like), one file per signal
    or room; how the file is written and stamped; and by names and values what each signal is. What is not certain is
    marked by CHECK. Comfort by the hour is of the building's clock: exports in UTC need --zone.

    \b
    Example:
      tf-mpc data map history.csv --zone Europe/Brussels > map.yaml
    """
    from thermoforce_mpc.measurements.map.starting_map import doubt_of_zone, starting_map

    text = starting_map(files, zone)
    click.echo(text, nl=False)
    if doubt := doubt_of_zone(text):
        click.echo(doubt, err=True)


@data.command("check")
@FILES
@MAP
@plot_option(Path("data_check.png"), "the measurements")
@click.option("--fit/--no-fit", default=True, help="Fit a linear model to see what the data tell.")
@click.option("--json", "json_file", type=PATH, help="Write what was understood as JSON.")
def check(files: tuple[str, ...], map_file: Path, plot: Path, fit: bool, json_file: Path | None) -> None:
    """Say what was understood of FILE (several, or a pattern in quotes) by the map, and draw it.

    Prints period, step, gaps, ranges and flagged readings of every signal, what was assumed, what is missing and what
    is doubtful: stamps that are late or early, units, set-points taken for levels, other loads on a meter, rooms left
    out. Then what a linear model of the data tells about the effect of acting.
    """
    from thermoforce_mpc.measurements.load import read_measurements

    display = RunDisplay()
    with display.phase("the measurements are read"):
        measured = read_measurements(files, map_file)
    show_measurements(measured, display.console)
    with display.phase("the measurements are looked at for what does not fit"):
        doubts = show_remarks(measured, display.console)
    tells = show_findings(measured, display, doubts) if fit else {}
    with written(plot) as aside:
        names = ", ".join(Path(name).name for name in measured.understood.files[:3])
        draw_measurements(aside, measured, ": ".join([names, *([tells["headline"]] if tells else [])]))
    display.say(f"Picture: {plot}")
    if json_file is not None:
        content = {"understood": measured.understood.to_json(), "remarks": doubts, "tells": tells}
        write_json(json_file, content, follow=True)


def _hours(context: click.Context, parameter: click.Parameter, value: str) -> tuple[int, int]:
    try:
        first, last = (int(part) for part in value.split("-"))
    except ValueError as error:
        raise click.BadParameter("write two hours, such as 7-22") from error
    return first, last


def _levels(context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in value.split(","))
    except ValueError as error:
        raise click.BadParameter("write levels, such as 0,1 or 0,0.5,1") from error


@data.command("probe-plan")
@FILES
@MAP
@click.option("--out", type=PATH, default=Path("probe.csv"), help="Schedule (CSV).")
@click.option("--days", type=int, default=1, help="Days to probe, 1 to 7.")
@click.option("--levels", default="0,1", callback=_levels, help="Levels to set, off first.")
@click.option("--awake", default="7-22", callback=_hours, help="Hours between which levels are set.")
@click.option("--start", metavar="DATE", help="First day.  [default: the first morning after the data]")
@click.option("--fit/--no-fit", default=True, help="Fit a linear model to see what is known.")
@click.option("--seed", type=int, default=1, help="Seed of the draws.")
def probe_plan(
    files: tuple[str, ...],
    map_file: Path,
    out: Path,
    days: int,
    levels: tuple[float, ...],
    awake: tuple[int, int],
    start: str | None,
    fit: bool,
    seed: int,
) -> None:
    """Write a probing after which FILE and it together tell the effect of acting, to run by hand.

    The schedule has one line per change: the time, and the level of every actuator from then on; an empty cell leaves
    the actuator to the building's own control, as at night and at the end. Actuators whose effect a linear model of
    FILE tells already are left alone; where it tells all, nothing is written.

    Keep measuring while you run it, append the rows to your file, and identify again; where a day was not enough, add
    another.
    """
    from thermoforce_mpc.identification.probing.by_hand import probe_schedule
    from thermoforce_mpc.identification.probing.operation import MOST_DAYS, findings, telling_part
    from thermoforce_mpc.measurements.load import read_measurements

    display = RunDisplay()
    measured = read_measurements(files, map_file).served()
    begin_s, hours = _start(measured.record, awake, start)
    record, note = telling_part(measured.record, measured.layout)
    if note:
        display.say(note)
    fitted = findings(record, measured.layout) if fit else []
    for words, of in _by_text((finding.words, finding.actuator) for finding in fitted).items():
        display.say(f"Found for {', '.join(of)} by a linear model: {words}")
    lower, upper = (_last_known(getattr(measured.conditions, name)) for name in ("lower_C", "upper_C"))
    recent = measured.record.last(round(MOST_DAYS * DAY_S / measured.record.step_s))
    plan = probe_schedule(
        recent,
        measured.layout,
        days=days,
        lower_C=lower,
        upper_C=upper,
        levels=levels,
        awake=hours,
        start_s=begin_s,
        competent=[finding.competent for finding in fitted] if fitted else None,
        seed=seed,
    )
    if not plan.probed:
        display.say("Nothing needs to be probed.")
        return
    _write(out, plan, display)


def _write(out: Path, plan: ProbeSchedule, display: RunDisplay) -> None:
    from thermoforce_mpc.data.dataframes import table
    from thermoforce_mpc.identification.probing.by_hand import as_changes

    display.say(f"{plan.by_hand_h} h by hand at {', '.join(plan.probed)}, expected:")
    for z, zone in enumerate(plan.record.names.zones):
        low, high = plan.lower_C[z], plan.upper_C[z]
        display.say(
            f"  {zone}: {plan.discomfort_Kh[z]:.1f} K·h outside {low:.1f} to {high:.1f} °C, up to "
            f"{plan.excursion_K[z]:.1f} K from its usual temperature, for a building as the priors expect it. Leave "
            f"the schedule where it gets below {low - 1:.0f} or above {high + 1:.0f} °C, and note when"
        )
    time_s, u = as_changes(plan)
    names = plan.record.names.actuators
    changes = table(time_s, plan.record.origin, **dict(zip(names, u, strict=True)))
    with written(out) as aside:
        changes.to_csv(aside)
    for at, row in changes.iterrows():
        cells = ", ".join(f"{name} {'own control' if np.isnan(u) else f'{100 * u:.0f} %'}" for name, u in row.items())
        display.say(f"  {at}  {cells}")
    display.say(f"Schedule: {out}")


def _last_known(rows: Array) -> Array:
    """The last known value of each row (Z, n), NaN where it has none."""
    return np.array([row[np.isfinite(row)][-1] if np.isfinite(row).any() else np.nan for row in rows])


def _start(record: Record, awake: tuple[int, int], start: str | None) -> tuple[float, tuple[int, int]]:
    """The first awake hour of the first day, s since the record's new year, and the awake hours in its standard time.

    Raises:
        DataError: `start` is no date, or lies before the end of the record.
    """
    origin, end = record.origin, record.stamps()[-1]
    summer = (end.utcoffset() - origin.utcoffset()).total_seconds() if origin.tzinfo else 0.0
    hours = (max(0, awake[0] - round(summer / HOUR_S)), awake[1] - round(summer / HOUR_S))
    if start is None:
        now_s = float(record.time_s[-1])
        return np.ceil((now_s - hours[0] * HOUR_S) / DAY_S) * DAY_S + hours[0] * HOUR_S, hours
    day = time_told(start, "--start")
    at = (day.normalize().tz_localize(None) - origin.tz_localize(None)).total_seconds() + HOUR_S * hours[0]
    if at < record.time_s[-1]:
        raise DataError(f"--start {start}: lies before the end of the data, {end}; name a later day")
    return float(at), hours


def show_measurements(measured: Measurements, console: Console) -> None:
    """Print period, step, signals, flags, assumptions and what is missing."""
    understood, say = measured.understood, console.print
    files = ", ".join(understood.files[:_MOST_FILES])
    if len(understood.files) > _MOST_FILES:
        files += f" and {len(understood.files) - _MOST_FILES} more"
    say(f"{files}: {understood.rows} rows, every {_time(understood.rows_every_s)}", soft_wrap=True)
    say(
        f"{understood.begins} to {understood.ends} ({understood.days:.1f} days, {understood.zone or 'no time zone'}); "
        f"step {_time(understood.step_s)}, {measured.record.n_steps} steps",
        soft_wrap=True,
    )
    table = plain_table((), "Signals")
    for heading in ("signal", "column", "every", "known", "longest gap", "least", "median", "most", ""):
        words = heading in ("signal", "column", "")
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    for signal in understood.signals:
        numbers = map(figure, (signal.least, signal.median, signal.most))
        gap = f"{signal.longest_gap_h:.3g} h" if signal.longest_gap_h else "none"
        name = signal.key.removeprefix("zones.").removeprefix("actuators.").removeprefix("machines.")
        every, known = _time(signal.usual_s), f"{100 * signal.measured:.1f} %"
        table.add_row(in_lines(name), in_lines(signal.source), every, known, gap, *numbers, signal.unit)
    print_whole(table, console)
    show_doubts(understood, console)
    told = {"doubtful": understood.beside, "assumed": understood.assumed, "missing": understood.missing}
    for what, texts in told.items():
        for text in texts:
            say(f"  {what}: {text}", soft_wrap=True)


def show_doubts(understood: Understood, console: Console) -> None:
    """Print which readings count as not measured, and what is doubtful of a signal."""
    for text in understood.doubts_in_words():
        console.print(f"  {text}", soft_wrap=True)


def show_remarks(measured: Measurements, console: Console) -> list[str]:
    """Print what the record says against itself (`measurements.checks`); returns it for a file."""
    from thermoforce_mpc.measurements.checks import remarks

    found = [remark.in_words() for remark in remarks(measured.record, measured.layout)]
    for text in found:
        console.print(f"  doubtful: {text}", soft_wrap=True)
    return found


def show_findings(measured: Measurements, display: RunDisplay, doubts: Sequence[str]) -> dict[str, Any]:
    """Print what a linear model of the data tells about the effect of acting; returns it for a file, and a headline.

    `doubts`: what was said to be doubtful in them.
    """
    from thermoforce_mpc.identification.probing.operation import findings, telling_part

    try:
        served = measured.served()
        record, note = telling_part(served.record, served.layout)
    except DataError as error:
        display.say(f"Effect of acting: cannot be told: {error}")
        return {"headline": "the effect of acting cannot be told", "refused": str(error)}
    display.say("Effect of acting, found by a linear model:")
    if note:
        display.say(f"  {note}")
    with display.phase(f"  fitted to {counted(len(served.layout.home), 'actuator')}"):
        found = findings(record, served.layout)
    gaps = gaps_in_words(measured) if not all(finding.competent for finding in found) else ""
    for words, of in _by_text((finding.words, finding.actuator) for finding in found).items():
        display.say(f"  {', '.join(of)}: {words}")
    advised = _by_text((advice, finding.actuator) for finding in found for advice in finding.advice)
    for advice, of in advised.items():
        display.say(f"    advice{'' if len(of) == len(found) else ' for ' + ', '.join(of)}: {advice}")
    if gaps:
        display.say(f"  {gaps}")
    if doubts and any(finding.competent for finding in found):
        display.say("  first mend what is doubtful above: the model takes the record as it is")
    if not all(finding.competent for finding in found):
        display.say("  `tf-mpc data probe-plan` writes a probing by hand that would tell")
    headline = "; ".join(f"{f.actuator} {f.words if f.competent else 'cannot be told'}" for f in found)
    return {"headline": headline, "part": note, "found": [asdict(finding) for finding in found]}


def _by_text(told: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Each text once, with the names of which it was told."""
    found: dict[str, list[str]] = {}
    for text, name in told:
        found.setdefault(text, []).append(name)
    return found


def gaps_in_words(measured: Measurements) -> str:
    """Which signals split the record by their gaps, and the remedy; '' where none does."""
    holed = sorted((s for s in measured.understood.signals if s.longest_gap_h > 0.0), key=lambda s: s.measured)
    split = [s for s in holed if s.measured < _WHOLE][:_MOST_HOLED]
    if not split:
        return ""
    told = ", ".join(f"{s.key} (known {100 * s.measured:.0f} %, longest gap {s.longest_gap_h:.3g} h)" for s in split)
    return (
        f"gaps split the record: {told}. Where readings are stored only when they change set hold_h of the signal, the "
        "longest time that one holds; else give a part without gaps"
    )


# Units of times between readings, from the length on at which each is told, s.
_UNITS = ((2.0 * HOUR_S, HOUR_S, "h"), (60.0, 60.0, "min"), (0.0, 1.0, "s"))


def _time(seconds: float) -> str:
    if not seconds > 0:
        return "?"
    size, unit = next((size, unit) for least, size, unit in _UNITS if seconds >= least)
    return f"{seconds / size:.3g} {unit}"


# More zones or actuators than this share one panel without a legend.
_MOST_LABELS = 10
# More steps than this are drawn as a line: bars would be thinner than a pixel.
_MOST_BARS = 3000


def draw_measurements(path: Path, measured: Measurements, title: str) -> None:
    """Write the picture (PNG, SVG or PDF by suffix) of `measured`."""
    figure = measurements_figure(measured, title)
    figure.savefig(path, dpi=150, metadata={"Software": None} if path.suffix == ".png" else None)


def measurements_figure(measured: Measurements, title: str) -> Figure:
    """The picture of `measured` at the width of a page, 7.2 inches."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    record, conditions, names = measured.record, measured.conditions, measured.record.names
    at = on_dates(record.time_s, record.origin)
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
    if measured.map.sun is not None:
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
    label_dates(panels[-1], at, record.origin)
    marks = f"{panels[-1].get_xlabel()}; shaded: gaps; crosses: flagged readings"
    panels[-1].set_xlabel(marks, fontsize="small", wrap=True)
    for panel in panels:
        panel.grid(visible=True, linewidth=0.3)
        panel.yaxis.set_major_locator(MaxNLocator(5, min_n_ticks=2))
        panel.tick_params(labelbottom=True)
    return figure


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
    axes.plot(
        on_dates(time_s, measured.record.origin),
        np.clip(values, low, high),
        "x",
        color="tab:red",
        markersize=5,
        clip_on=False,
    )
    axes.set_ylim(low, high)


def _gaps(axes: Axes, at: Any, values: Array, colour: str) -> None:
    """Shade the stretches in which `values` are not known."""
    for start, stop in stretches(~np.isfinite(values)):
        axes.axvspan(at[max(start - 1, 0)], at[min(stop, at.size - 1)], color=colour, alpha=0.08, linewidth=0)
