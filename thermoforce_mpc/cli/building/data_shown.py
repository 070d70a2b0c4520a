"""What `tf-mpc data check` prints: what was understood, and what the data tell about the effect of acting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.load import Measurements
from thermoforce_mpc.measurements.understood import SignalSummary, Understood
from thermoforce_mpc.simulation.views.display import RunDisplay

_MOST_FILES = 5


def show_measurements(measured: Measurements, console: Console) -> None:
    """Print period, step, signals, flags, assumptions and what is missing."""
    understood = measured.understood
    more = f" and {len(understood.files) - _MOST_FILES} more" if len(understood.files) > _MOST_FILES else ""
    say = console.print
    files = ", ".join(understood.files[:_MOST_FILES])
    say(f"{files}{more}: {understood.rows} rows, every {_time(understood.rows_every_s)}", soft_wrap=True)
    say(
        f"{understood.begins} to {understood.ends} ({understood.days:.1f} days, {understood.zone or 'no time zone'}); "
        f"step {_time(understood.step_s)}, {measured.record.n_steps} steps",
        soft_wrap=True,
    )
    table = Table(title="Signals", title_justify="left")
    for heading in ("signal", "column", "every", "known", "longest gap", "least", "median", "most", ""):
        table.add_column(heading, justify="left" if heading in ("signal", "column", "") else "right")
    for signal in understood.signals:
        table.add_row(*_cells(signal))
    say(table)
    show_doubts(understood, console)
    for text in understood.beside:
        say(f"  doubtful: {text}", soft_wrap=True)
    for text in understood.assumed:
        say(f"  assumed: {text}", soft_wrap=True)
    for text in understood.missing:
        say(f"  missing: {text}", soft_wrap=True)


def show_doubts(understood: Understood, console: Console) -> None:
    """Print which readings count as not measured, and what is doubtful of a signal."""
    for signal in understood.signals:
        for flag in signal.flags:
            console.print(
                f"  flagged in {signal.key}: {flag.count} by rule '{flag.rule}', first {flag.first}", soft_wrap=True
            )
        if signal.doubt:
            console.print(f"  doubtful: {signal.key}: {signal.doubt}", soft_wrap=True)


def show_remarks(measured: Measurements, console: Console) -> list[str]:
    """Print what the record says against itself (`measurements.checks`); returns it for a file."""
    from thermoforce_mpc.measurements.checks import remarks

    found = [remark.in_words() for remark in remarks(measured.record, measured.layout)]
    for text in found:
        console.print(f"  doubtful: {text}", soft_wrap=True)
    return found


def show_findings(measured: Measurements, display: RunDisplay, doubts: Sequence[str] = ()) -> dict[str, Any]:
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
    found = findings(record, served.layout)
    for finding in found:
        display.say(f"  {finding.actuator}: {finding.words}")
        for advice in finding.advice:
            display.say(f"    advice: {advice}")
    if doubts and any(finding.competent for finding in found):
        display.say("  first mend what is doubtful above: the model takes the record as it is")
    if not all(finding.competent for finding in found):
        display.say("  `tf-mpc data probe-plan` writes a probing by hand that would tell")
    headline = "; ".join(f"{f.actuator} {f.words if f.competent else 'cannot be told'}" for f in found)
    return {"headline": headline, "part": note, "found": [asdict(finding) for finding in found]}


def _cells(signal: SignalSummary) -> tuple[str, ...]:
    numbers = tuple(f"{value:.4g}" for value in (signal.least, signal.median, signal.most))
    gap = f"{signal.longest_gap_h:.3g} h" if signal.longest_gap_h else "none"
    name = signal.key.removeprefix("zones.").removeprefix("actuators.").removeprefix("machines.")
    every = _time(signal.usual_s)
    return (name, signal.source, every, f"{100 * signal.measured:.1f} %", gap, *numbers, signal.unit)


def _time(seconds: float) -> str:
    if not seconds > 0:
        return "?"
    return f"{seconds:.4g} s" if seconds < 60 else f"{seconds / 60:.4g} min"
