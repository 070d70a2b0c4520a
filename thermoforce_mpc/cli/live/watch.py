"""`tf-mpc watch`: what a running controller does now, in the terminal or as a page on this machine."""

from __future__ import annotations

import math
import time
from pathlib import Path

import click
from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from thermoforce_mpc.cli.options import PATH, FiniteRange
from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.experiment.explaining import hour_ends
from thermoforce_mpc.report.live_view import LiveRun, RunView
from thermoforce_mpc.report.whole_tables import plain_table, width_of

_BARS = "▁▂▃▄▅▆▇█"
# Bars of a course at most, and as many as its heading is long.
_WIDTH, _HEAD = 32, 11
_COLOURS = {"solved": "green", "rule": "green", "bridged": "yellow", "acceptable": "yellow", "shifted": "yellow"}


@click.command()
@click.argument("run", type=PATH)
@click.option(
    "--controller", metavar="NAME", help="Which of the run.  [default: the latest; of a finished run the first]"
)
@click.option("--hours", type=FiniteRange(0.1), default=8.0, help="Hours of the plan to show.")
@click.option("--every", type=FiniteRange(0.2, 3600), default=2.0, help="Seconds between looks.")
@click.option("--once", is_flag=True, help="Print once and end.")
@click.option("--web", is_flag=True, help="Serve a page on this machine instead (needs the extra 'serve').")
@click.option("--port", type=click.IntRange(0, 65535), default=8010, help="Port of --web; 0 picks a free one.")
def watch(run: Path, controller: str | None, hours: float, every: float, once: bool, web: bool, port: int) -> None:
    """Watch the run in folder RUN: temperatures and bounds, the plan's next hours, levels, what acts and why, cost and
    discomfort so far.

    Only the journal is read and nothing is written, so that it may be watched from several places, under way or later.
    It ends when the run does, or with Ctrl-C. The page of --web is for this machine alone; from elsewhere it is reached
    by a tunnel (ssh -L).

    Cost counts metered energy at the prices in force, of a machine that heats with gas at that of gas (the electricity
    of its fan too, where one meter has both); where power is not metered there is none.

    \b
    Examples:
      tf-mpc watch runs/my-run
      tf-mpc watch runs/my-run --once
      tf-mpc watch runs/my-run --web
    """
    live = LiveRun(run, controller)
    view = live.now()
    if web:
        from thermoforce_mpc.service.live_page import serve_page

        serve_page(lambda: live.now().to_json(), port, lambda url: click.echo(f"Watching at {url} (Ctrl-C ends)"))
        return
    console = Console(highlight=False, markup=False)
    if once or not console.is_terminal:
        console.print(shown(view, hours, console))
        return
    with Live(shown(view, hours, console), console=console, auto_refresh=False, screen=False) as screen:
        while view.state == "running":
            time.sleep(every)
            view = live.now()
            screen.update(shown(view, hours, console), refresh=True)


def shown(view: RunView, hours: float, console: Console) -> RenderableType:
    """The view as tables and lines, no wider than the console as long as figures fit."""
    days = f"day {view.days:.2f}" + (f" of {view.days_in_all:g}" if math.isfinite(view.days_in_all) else "")
    head = Text(f"{view.testcase} · {view.controller} · {view.at} ({days}) · ", style="bold")
    head.append(view.state, style="green" if view.state in ("running", "finished") else "red")
    lines: list[RenderableType] = [head, *([Text(view.said)] if view.said else [])]
    least = _zones(view, 1)
    lines.append(_zones(view, min(max(console.width - width_of(least, console) + _HEAD, _HEAD), _WIDTH)))
    lines.append(Text.assemble("acts: ", (view.status, _COLOURS.get(view.status, "red")), f" – {view.why}"))
    lines += [Text(f"in doubt: {note}", style="yellow") for note in view.notes]
    if (tank := view.hot_water) is not None:
        set_to = "left to its device" if math.isnan(tank.told) else f"set to {tank.told:g}"
        lines.append(Text(f"tank: {set_to}. {tank.said}"))
    if view.plan:
        lines += _plan(view, hours, console)
    counts = ", ".join(f"{n} {status}" for status, n in sorted(view.counts.items(), key=lambda item: -item[1]))
    so_far = (
        f"so far: cost {_figure(view.cost, '.2f')}, energy {_figure(view.energy_kWh, '.1f', ' kWh')}, "
        f"discomfort {_figure(view.discomfort_Kh, '.2f', ' K·h')}; steps: {counts or 'none'}"
    )
    return Group(*lines, Text(so_far))


def _figure(value: float, digits: str, unit: str = "") -> str:
    return "–" if math.isnan(value) else f"{value:{digits}}{unit}"


def _zones(view: RunView, bars: int) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    past_h = round((view.past[-1].time_s - view.past[0].time_s) / HOUR_S, 1) if view.past else 0.0
    for column in ("", "now", "bounds", f"last {past_h:g} h"):
        table.add_column(column, justify="right" if column in ("now", "bounds") else "left", no_wrap=True)
    for z, zone in enumerate(view.zones):
        now = Text("no reading" if math.isnan(zone.T_C) else f"{zone.T_C:.2f} °C")
        if zone.outside_K > 0.05:
            now.stylize("red")
        bounds = "" if math.isnan(zone.lower_C + zone.upper_C) else f"{zone.lower_C:g}–{zone.upper_C:g}"
        table.add_row(zone.name, now, bounds, _bars([point.T_C[z] for point in view.past], bars))
    table.add_row("outdoors", _figure(view.outdoor_C, ".1f", " °C"), "", "")
    for a, name in enumerate(view.actuators):
        level = view.levels[a]
        now = Text("own control" if math.isnan(level) else f"{level:.2f}")
        past = [point.u[a] for point in view.past]
        # Where it cools too, off is in the middle.
        u_min = -1.0 if any(u < 0.0 for u in past) else 0.0
        table.add_row(name, now, view.acting[a], _bars(past, bars, u_min, 1.0))
    return table


def _plan(view: RunView, hours: float, console: Console) -> list[Table]:
    """The plan as a table, or as several below one another where the console is too narrow for all columns."""
    parts = [[f"u {name}"] for name in view.actuators] + [[f"T {zone.name}", "bounds"] for zone in view.zones]
    tables: list[Table] = []
    first = 0
    while first < len(parts):
        for end in range(len(parts), first, -1):
            table = _plan_table(view, hours, parts, range(first, end))
            if width_of(table, console) <= console.width:
                break
        tables.append(table)
        first = end
    return tables


def _plan_table(view: RunView, hours: float, parts: list[list[str]], which: range) -> Table:
    step_s = view.plan[1].time_s - view.plan[0].time_s if len(view.plan) > 1 else HOUR_S
    ends = hour_ends(len(view.plan), step_s, hours)
    every = ends.step
    table = plain_table(["until", *(text for i in which for text in parts[i])], None if which.start else "Plan")
    for end in ends:
        last, part = view.plan[end - 1], view.plan[end - every : end]
        cells = [[f"{sum(point.u[a] for point in part) / every:.2f}"] for a in range(len(view.actuators))]
        cells += [[f"{last.T_C[z]:.2f}", f"{last.lower_C[z]:g}–{last.upper_C[z]:g}"] for z in range(len(view.zones))]
        table.add_row(view.until[end - 1], *(text for i in which for text in cells[i]))
    return table


def _bars(values: list[float], most: int, low: float | None = None, high: float | None = None) -> str:
    """A course as a line of `most` bars at most, the mean of a few values each."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return ""
    low, high = min(finite) if low is None else low, max(finite) if high is None else high
    every = max(1, math.ceil(len(values) / most))
    text = ""
    for start in range(0, len(values), every):
        part = [value for value in values[start : start + every] if math.isfinite(value)]
        share = (sum(part) / len(part) - low) / max(high - low, 1e-9) if part else 0.0
        text += _BARS[min(max(int(share * len(_BARS)), 0), len(_BARS) - 1)] if part else " "
    return text
