"""`tf-mpc run`, `resume` and `report`: a controller over a scored window, in a run folder."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from thermoforce_mpc.cli.options import (
    PATH,
    base_options,
    equal_comfort_option,
    learned_options,
    mpc_options,
    scenario_from,
    window_options,
)


@click.command()
@base_options
@window_options
@click.option("--controller", metavar="NAME", help="Controller (see `tf-mpc controllers`).")
@learned_options
@mpc_options
@click.option("--baselines", metavar="A,B", help="Baselines to run; '' for none.  [default: native,thermostat]")
@equal_comfort_option
@click.option("--out", type=PATH, help="Run folder; must not exist.  [default: runs/...]")
@click.option("--quiet", is_flag=True, help="Print only the final table.")
def run(**options: Any) -> None:
    """Run a controller over a scored window and report KPIs.

    Builds the plant, probes it for a few days and identifies a model (or loads --model, or identifies from the probing
    of an earlier run of the same test case, --probing), runs the controller over the
    window after seven days of warm-up under native control, runs the baselines on the same plant, weather and window,
    and the thermostat at the set-point at which it is as comfortable as the controller. Prints the KPIs of all
    controllers and writes a run folder with an HTML report.

    \b
    Examples:
      tf-mpc run --testcase bestest_hydronic_heat_pump
      tf-mpc run --testcase bestest_hydronic_heat_pump --period typical_heat_day --weather Brussels.mos
      tf-mpc run --testcase bestest_hydronic_heat_pump --url http://127.0.0.1:8000
      tf-mpc run --testcase bestest_hydronic_heat_pump --fmu wrapped.fmu
      tf-mpc run --config peak_heat_day --start 2026-01-17 --horizon 36h
      tf-mpc run --config peak_heat_day --probing runs/my_run --set identification.options.order=2
    """
    from thermoforce_mpc.experiment.run import run_scenario
    from thermoforce_mpc.report.display import RunDisplay

    scenario = scenario_from(options)
    display = RunDisplay(options["quiet"])
    folder = run_scenario(scenario, display, options["out"], command=["tf-mpc", *sys.argv[1:]])
    display.console.print(f"Report: {shlex.quote(str(folder / 'report.html'))}", soft_wrap=True)


@click.command()
@click.argument("run", type=PATH)
@click.option(
    "--from",
    "since",
    metavar="LINE|TIME",
    help="Drop the journal from this line on, or from the step at '16 06:30' or '9000s'.",
)
@click.option("--url", metavar="URL", help="Address of the BOPTEST service of the run, given again.")
@click.option("--fmu", metavar="FILE", help="FMU of the run, given again.")
@click.option("--code", metavar="FILE", multiple=True, help="File of Python that the run names, given again.")
@click.option("--plant", metavar="NAME", help="Plugin's plant of the run, given again.")
@click.option("--forecaster", metavar="NAME", help="A hub's forecaster of the run, given again.")
@click.option("--stop", is_flag=True, help="Stop the run's test at the service instead; the run cannot go on then.")
@click.option("--quiet", is_flag=True, help="Print only the final table.")
def resume(
    run: Path,
    since: str | None,
    url: str | None,
    fmu: str | None,
    code: tuple[str, ...],
    plant: str | None,
    forecaster: str | None,
    stop: bool,
    quiet: bool,
) -> None:
    """Go on with the run in folder RUN, which was killed, interrupted, or ended by a full disk or a plant that failed.

    The journal in the folder (journal.jsonl) says what the plant was asked and what it answered. A simulated plant is
    advanced again as it was then, and its answers are compared with the journal; the controller plans again what it
    planned. From there on the run goes on, and its result is that of a run that was never ended. The model is that in
    the folder. A probing that was ended before its time goes on in the same way (probing/*.jsonl); one that was whole
    is not made again.

    At a BOPTEST service the test is taken up where it stands, if it still exists; a step that was on its way is neither
    lost nor repeated. A run that failed or was killed leaves its test there (--stop gives it back); Ctrl-C and SIGTERM
    stop the test.

    A journal that is damaged in the middle is refused with the line and the command that goes on from the last good
    one (--from); what comes after is kept in journal.jsonl.lost. A simulated plant repeats what is lost; a service goes
    on from where it stands, and what happened meanwhile is read from its record.

    The folder may come from anybody: it may hold plain files only, and an address, an FMU, Python, a plugin's plant or
    a hub's forecaster that its journal names has to be given again unless you gave it here before.

    \b
    Exit codes: 0 done (also where the run was complete already), 2 no journal,
    a damaged one or one that does not repeat itself, something outside that has to be given again, 3 the plant failed,
    5 the service no longer has the test, 6 the folder cannot be written.

    \b
    Example:
      tf-mpc resume runs/bestest_hydronic_heat_pump-peak_heat_day-constant-thermoforce_mpc-001
    """
    from thermoforce_mpc.experiment.outside import HUB
    from thermoforce_mpc.experiment.run import resume_run, stop_test
    from thermoforce_mpc.report.display import RunDisplay

    again = {"plant.url": url, "plant.path": fmu, "plant.kind": plant, HUB: forecaster}
    given = {key: value for key, value in again.items() if value is not None}
    if stop:
        stop_test(run, given, code)
        click.echo("The test was stopped.")
        return
    display = RunDisplay(quiet)
    folder = resume_run(run, display, since, given, code)
    display.console.print(f"Report: {shlex.quote(str(folder / 'report.html'))}", soft_wrap=True)


@click.command()
@click.argument("run", type=PATH)
@click.option("--out", type=PATH, help="File to write.  [default: report.html in RUN]")
def report(run: Path, out: Path | None) -> None:
    """Make the interactive report of the run in folder RUN again, from its journal and files.

    Nothing is simulated or planned again. A run that was cut off, or is under way, is shown as far as it came, and the
    page says so; `tf-mpc resume` goes on with it. A report made by an older release becomes one of this release.

    \b
    Exit codes: 0 done, 2 no journal or a damaged one, 6 it cannot be written.

    \b
    Example:
      tf-mpc report runs/my-run --out /tmp/so_far.html
    """
    from thermoforce_mpc.report.html import report_again

    path, notes = report_again(run, out)
    for line in notes:
        click.echo(line)
    click.echo(f"Report: {shlex.quote(str(path))}")
