"""Command line `tf-mpc`. A command's module is imported when it is called, so that `--help` is fast."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from thermoforce_mpc.cli.benchmarks import benchmark_command
from thermoforce_mpc.errors import EngineError, InputError, NoSuchTest, PlantError, StorageError, ThermoForceError
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.version import VERSION

# name: (module below this one, with a function where several commands stand in it; one line for the overview)
_COMMANDS = {
    "init": ("building.init", "Write a commented scenario to start from, and a test case or a map."),
    "run": ("running.run", "Run a controller over a scored window and report KPIs."),
    "resume": ("running.resume", "Go on with a run that was killed or interrupted."),
    "report": ("running.report", "Make the report of a run again, also of one that was cut off."),
    "compare": ("running.compare", "Compare controllers on several windows and tariffs."),
    "sweep": ("running.sweep", "Vary one controller option and plot cost against discomfort."),
    "fleet": ("running.fleet", "Run many buildings under many windows, tariffs and controllers."),
    "identify": ("building.identify", "Identify a model by probing a building, or from measurements."),
    "data": ("building.data", "Check measurements of your own building; plan a probing by hand."),
    "plan": ("building.plan", "Plan the next hours from recent measurements and a forecast in files."),
    "control": ("live.control", "Control a real building through a connection, in real time."),
    "forecast": ("building.forecast", "Forecast the temperature of your own building, with its band."),
    "counterfactual": ("building.counterfactual", "Show what another schedule would have done on a past day."),
    "saving": ("building.saving", "What a changed operation saved, with an interval, from records."),
    "explain": ("inside.explain", "Tell what a run decided at an instant, and why."),
    "watch": ("live.watch", "Watch a running controller, in the terminal or as a page."),
    "inspect": ("inside.inspect", "Show a saved model: parameters, certificate, identification data."),
    "migrate": ("inside.migrate", "Rewrite a saved model of an older release for this one."),
    "validate": ("inside.validate", "Check a scenario or test case file without running it."),
    "schema": ("inside.schema", "Write the JSON Schema of scenario, test case, comparison, fleet or map files."),
    "controllers": ("inside.listing:controllers", "List controllers and their options."),
    "train": ("inside.train", "Train the policy of the controller dpc through a saved model."),
    "plants": ("inside.listing:plants", "List plants and their options."),
    "connections": ("inside.listing:connections", "List connections to real buildings and their options."),
    "free-responses": ("inside.listing:free_responses", "List forecasters of the free response, and backbones."),
    "chaos": (
        "benchmarks.cli.chaos",
        "Run controllers with everything around them failing on purpose (in a checkout).",
    ),
    "doctor": ("inside.doctor", "Check installation, solvers, forecaster, plant, service, clock and disk."),
    "serve": ("live.serve", "Serve the embedded plant over BOPTEST's REST protocol."),
    "weather": ("inside.weather", "Download the weather file of the BOPTEST test case."),
    "bench": ("benchmarks.cli.bench", "Run benchmarks and compare the results with their targets (in a checkout)."),
    "testcases": ("inside.testcases", "List the shipped test cases, scenarios, comparisons and fleets."),
}

# Words before the message of an error, and exit code.
_ENDS: dict[type[ThermoForceError], tuple[str, int]] = {
    InputError: ("Error", 2),
    PlantError: ("Plant failed", 3),
    NoSuchTest: ("Cannot go on", 5),
    StorageError: ("Cannot be written", 6),
    EngineError: ("Tasks cannot be run", 7),
}
# A message of ours may name many keys; what it quotes is cut where it enters.
_MOST_SHOWN = 20_000


class _LazyGroup(click.Group):
    """Click group that imports only the command that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module, _, function = _COMMANDS[cmd_name][0].partition(":")
        command: click.Command
        if module.startswith("benchmarks."):
            command = benchmark_command(module)
        else:
            command = getattr(importlib.import_module(f"{__name__}.{module}"), function or "command")
        command.name = cmd_name  # all are functions of the same name; the command line reference shows this one
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, prog_name="tf-mpc")
def cli() -> None:
    """Model predictive control of buildings.

    The predicted zone temperature is the sum of a free response (no control action), forecast by a frozen
    time-series model, and a forced response, computed by an operator with few parameters that is identified from a
    few days of probing. To start:

    \b
      tf-mpc run --testcase bestest_hydronic_heat_pump

    \b
    Exit codes: 0 done, 1 a check failed (doctor, chaos) or there is no plan
    (plan), 2 bad input, 3 the plant or its service failed, or one of many runs
    (compare, sweep, fleet), 4 the model is below the bar (identify, plan),
    5 the service no longer has the test (resume only), 6 a file cannot be
    written (disk full, folder read-only or removed), 7 the Dask cluster of
    --scheduler is gone or does not fit, 129 the terminal was closed (control),
    130 interrupted by Ctrl-C, 143 ended by SIGTERM.
    """


class Terminated(BaseException):
    """A signal to end: ends as Ctrl-C does, with the plant released and the journal whole; exit code 128 + `number`."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _terminate(number: int, _: object) -> NoReturn:
    signal.signal(number, signal.SIG_IGN)  # a second one must not cut the plant's release short
    raise Terminated(number)


@contextmanager
def hangup_ends() -> Iterator[None]:
    """Within it a closed terminal (SIGHUP) ends the command as SIGTERM does, unless it is ignored, as under nohup."""
    hangup = getattr(signal, "SIGHUP", None)
    if hangup is None or signal.getsignal(hangup) is not signal.SIG_DFL:
        yield
        return
    signal.signal(hangup, _terminate)
    try:
        yield
    finally:
        signal.signal(hangup, signal.SIG_DFL)


_show_otherwise = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *place: Any, **further: Any) -> None:
    """Doubtful input in one line, without the place in our source; other warnings as usual."""
    if issubclass(category, DoubtfulInput):
        click.echo(f"Warning: {message}", err=True)
    else:
        _show_otherwise(message, category, *place, **further)


def main() -> None:
    """Entry point: prints an error of this package as one message and exits with its code."""
    # Read when numpy is loaded. Matrices here are small: more threads gain nothing, and wait for one another where the
    # machine is busy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.showwarning = _show_warning
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = cli.main(standalone_mode=False)
        if isinstance(code, int):  # a command that exits with a code of its own
            sys.exit(code)
    except click.ClickException as error:  # usage errors: exit code 2
        error.show()
        sys.exit(error.exit_code)
    except ThermoForceError as error:
        kind = next((kind for kind in _ENDS if isinstance(error, kind)), None)
        if kind is None:
            raise
        from boptest_client import safe_text  # it may quote a file, a service or a journal

        words, code = _ENDS[kind]
        click.echo(f"{words}: {safe_text(error, _MOST_SHOWN)}", err=True)
        sys.exit(code)
    except Terminated as error:
        click.echo("Terminated.", err=True)
        sys.exit(128 + error.number)
    except (KeyboardInterrupt, click.Abort):
        click.echo("Interrupted.", err=True)
        sys.exit(130)
