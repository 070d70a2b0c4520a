"""The command line. Commands are imported when they are called, so that help answers at once."""

from __future__ import annotations

import importlib
import sys

import click

from thermoforce_mpc.errors import InputError, PlantError
from thermoforce_mpc.version import VERSION

# name: (module, one line for the overview)
_COMMANDS = {
    "run": ("thermoforce_mpc.cli.run", "Control a building over a scored window and report how it went."),
    "compare": ("thermoforce_mpc.cli.compare", "Run controllers side by side, on several windows and tariffs."),
    "sweep": ("thermoforce_mpc.cli.sweep", "Trace cost against discomfort over an option of a controller."),
    "identify": ("thermoforce_mpc.cli.identify", "Probe a building for a few days and save what was learned."),
    "inspect": ("thermoforce_mpc.cli.inspect", "Show a saved model: parameters, certificate, data it has seen."),
    "validate": ("thermoforce_mpc.cli.validate", "Check a scenario or test case file without running it."),
    "controllers": ("thermoforce_mpc.cli.controllers", "List controllers and their options."),
    "serve": ("thermoforce_mpc.cli.serve", "Offer the embedded plant to clients written for BOPTEST."),
    "weather": ("thermoforce_mpc.cli.weather", "Get the weather of the real test case."),
    "bench": ("thermoforce_mpc.cli.bench", "Measure parts of the package against their targets."),
    "testcases": ("thermoforce_mpc.cli.testcases", "List the test cases and scenarios that ship."),
}


class _LazyGroup(click.Group):
    """A group that knows its commands by name and imports only the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = importlib.import_module(_COMMANDS[cmd_name][0]).command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(VERSION, prog_name="tf-mpc")
def cli() -> None:
    """Model predictive control of buildings.

    The future temperature of a zone is its free response, forecast by a frozen time-series model, plus what our
    actions add, a small operator identified from a few days of probing. Start here:

    \b
      tf-mpc run --testcase bestest_hydronic_heat_pump

    \b
    Exit codes: 0 done, 2 bad input, 3 the plant or its service failed, 130 interrupted.
    """


def main() -> None:
    """Entry point: turns this package's errors into one message and an exit code."""
    try:
        cli.main(standalone_mode=False)
    except click.ClickException as error:  # usage errors: exit code 2
        error.show()
        sys.exit(error.exit_code)
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(2)
    except PlantError as error:
        click.echo(f"Plant failed: {error}", err=True)
        sys.exit(3)
    except (KeyboardInterrupt, click.Abort):
        click.echo("Interrupted.", err=True)
        sys.exit(130)
