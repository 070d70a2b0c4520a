"""`tf-mpc resume`: go on with a run that was ended before its time."""

from __future__ import annotations

import shlex
from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
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
@click.option("--stop", is_flag=True, help="Stop the run's test at the service instead; the run cannot go on then.")
@click.option("--quiet", is_flag=True, help="Print only the final table.")
def command(
    run: Path,
    since: str | None,
    url: str | None,
    fmu: str | None,
    code: tuple[str, ...],
    plant: str | None,
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

    The folder may come from anybody: it may hold plain files only, and an address, an FMU, Python or a plugin's plant
    that its journal names has to be given again unless you gave it here before.

    \b
    Exit codes: 0 done (also where the run was complete already), 2 no journal,
    a damaged one or one that does not repeat itself, something outside that has to be given again, 3 the plant failed,
    5 the service no longer has the test, 6 the folder cannot be written.

    \b
    Example:
      tf-mpc resume runs/bestest_hydronic_heat_pump-peak_heat_day-constant-thermoforce_mpc-001
    """
    from thermoforce_mpc.simulation.run import resume_run, stop_test
    from thermoforce_mpc.simulation.views.display import RunDisplay

    again = {"plant.url": url, "plant.path": fmu, "plant.kind": plant}
    given = {key: value for key, value in again.items() if value is not None}
    if stop:
        stop_test(run, given, code)
        click.echo("The test was stopped.")
        return
    display = RunDisplay(quiet)
    folder = resume_run(run, display, since, given, code)
    display.console.print(f"Report: {shlex.quote(str(folder / 'report.html'))}", soft_wrap=True, markup=False)
