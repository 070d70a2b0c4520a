"""`tf-mpc watch`: what a running controller does now, in the terminal or as a page on this machine."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path

import click
from rich import box
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.simulation.explaining import words_of
from thermoforce_mpc.simulation.live_view import LiveRun, Point, View

_BARS = "▁▂▃▄▅▆▇█"
_WIDTH = 32
_COLOURS = {"solved": "green", "rule": "green", "bridged": "yellow", "acceptable": "yellow", "shifted": "yellow"}


@click.command(short_help="Watch a running controller, in the terminal or as a page.")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--controller", metavar="NAME", help="Which of the run.  [default: the latest; of a finished run the first]"
)
@click.option("--hours", type=click.FloatRange(0.1), default=8.0, show_default=True, help="Hours of the plan to show.")
@click.option(
    "--every", type=click.FloatRange(0.2, 3600), default=2.0, show_default=True, help="Seconds between looks."
)
@click.option("--once", is_flag=True, help="Print once and end.")
@click.option("--web", is_flag=True, help="Serve a page on this machine instead (needs the extra 'serve').")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8010, show_default=True, help="Port of --web; 0 picks a free one."
)
def command(run: Path, controller: str | None, hours: float, every: float, once: bool, web: bool, port: int) -> None:
    """Watch the run in folder RUN: temperatures and bounds, the plan's next hours, levels, what acts and why, cost and
    discomfort so far.

    Only the journal is read and nothing is written, so that it may be watched from several places, under way or later.
    It ends when the run does, or with Ctrl-C. The page of --web is for this machine alone; from elsewhere it is reached
    by a tunnel (ssh -L).

    Cost counts metered energy at the prices in force; where power is not metered there is none.

    \b
    Examples:
      tf-mpc watch runs/my-run
      tf-mpc watch runs/my-run --once
      tf-mpc watch runs/my-run --web
    """
    live = LiveRun(run, controller)
    view = live.now()
    if web:
        _serve(live, port)
        return
    console = Console(highlight=False, markup=False)
    if once or not console.is_terminal:
        console.print(shown(view, hours))
        return
    with Live(shown(view, hours), console=console, auto_refresh=False, screen=False) as screen:
        for later in _looks(live, view, every):
            screen.update(shown(later, hours), refresh=True)


def _looks(live: LiveRun, view: View, every: float) -> Iterator[View]:
    while view.state == "running":
        time.sleep(every)
        view = live.now()
        yield view


def _serve(live: LiveRun, port: int) -> None:
    from thermoforce_mpc.service.live_page import serve_page

    serve_page(lambda: live.now().to_json(), port, lambda url: click.echo(f"Watching at {url} (Ctrl-C ends)"))


def shown(view: View, hours: float) -> RenderableType:
    """The view as tables and lines."""
    days = f"day {view.days:.2f}" + (f" of {view.days_in_all:g}" if math.isfinite(view.days_in_all) else "")
    head = Text(f"{view.testcase} · {view.controller} · {words_of(view.time_s)} ({days}) · ", style="bold")
    head.append(view.state, style="green" if view.state != "ended early" else "red")
    lines: list[RenderableType] = [head]
    if view.said:
        lines.append(Text(view.said))
    lines.append(_zones(view))
    acts = Text("acts: ")
    acts.append(view.status, style=_COLOURS.get(view.status, "red"))
    acts.append(f" – {view.why}")
    lines.append(acts)
    lines += [Text(f"in doubt: {note}", style="yellow") for note in view.notes]
    if view.plan:
        lines.append(_plan(view, hours))
    counts = ", ".join(f"{n} {status}" for status, n in sorted(view.counts.items(), key=lambda item: -item[1]))
    lines.append(
        Text(
            f"so far: cost {view.cost:.2f}, energy {view.energy_kWh:.1f} kWh, discomfort {view.discomfort_Kh:.2f} K·h; "
            f"steps: {counts or 'none'}"
        )
    )
    return Group(*lines)


def _zones(view: View) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for column in ("", "now", "bounds", f"last {_hours(view.past):g} h"):
        table.add_column(column, justify="right" if column in ("now", "bounds") else "left", no_wrap=True)
    for z, zone in enumerate(view.zones):
        now = Text("no reading" if math.isnan(zone.T_C) else f"{zone.T_C:.2f} °C")
        if zone.outside_K > 0.05:
            now.stylize("red")
        bounds = "" if math.isnan(zone.lower_C + zone.upper_C) else f"{zone.lower_C:g}–{zone.upper_C:g}"
        table.add_row(zone.name, now, bounds, _bars([point.T_C[z] for point in view.past]))
    table.add_row("outdoors", f"{view.outdoor_C:.1f} °C", "", "")
    for a, name in enumerate(view.actuators):
        level = view.levels[a]
        now = Text("own control" if math.isnan(level) else f"{level:.2f}")
        past = [point.u[a] for point in view.past]
        # Where it cools too, off is in the middle.
        lowest = -1.0 if any(u < 0.0 for u in past) else 0.0
        table.add_row(name, now, view.acting[a], _bars(past, lowest, 1.0))
    return table


def _plan(view: View, hours: float) -> Table:
    step_s = view.plan[1].time_s - view.plan[0].time_s if len(view.plan) > 1 else HOUR_S
    every = max(1, round(HOUR_S / step_s))
    table = Table(title="Plan", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
    columns = ["until", *(f"u {name}" for name in view.actuators)]
    columns += [text for zone in view.zones for text in (f"T {zone.name}", "bounds")]
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    for end in range(every, min(len(view.plan), round(hours * HOUR_S / step_s)) + 1, every):
        last, part = view.plan[end - 1], view.plan[end - every : end]
        cells = [words_of(last.time_s)]
        cells += [f"{sum(point.u[a] for point in part) / every:.2f}" for a in range(len(view.actuators))]
        for z in range(len(view.zones)):
            cells += [f"{last.T_C[z]:.2f}", f"{last.lower_C[z]:g}–{last.upper_C[z]:g}"]
        table.add_row(*cells)
    return table


def _bars(values: list[float], low: float | None = None, high: float | None = None) -> str:
    """A course as a line of bars, the mean of a few values each."""
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return ""
    low, high = min(known) if low is None else low, max(known) if high is None else high
    every = max(1, math.ceil(len(values) / _WIDTH))
    text = ""
    for start in range(0, len(values), every):
        part = [value for value in values[start : start + every] if math.isfinite(value)]
        share = (sum(part) / len(part) - low) / max(high - low, 1e-9) if part else 0.0
        text += _BARS[min(max(int(share * len(_BARS)), 0), len(_BARS) - 1)] if part else " "
    return text


def _hours(points: tuple[Point, ...]) -> float:
    return round((points[-1].time_s - points[0].time_s) / HOUR_S, 1) if points else 0.0
