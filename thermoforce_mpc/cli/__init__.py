"""Command line `tf-mpc`: entry point, signals and exit codes; the commands are in `commands`."""

from __future__ import annotations

import errno
import io
import os
import sys
import warnings
from typing import Any, TextIO

import click

from thermoforce_mpc.cli.commands import CommandGroups
from thermoforce_mpc.dependencies import keep_in_place
from thermoforce_mpc.errors import (
    ControllerRaised,
    EngineError,
    InputError,
    NoSuchTest,
    PlantError,
    StorageError,
    Terminated,
    ThermoForceError,
    interruption,
    out_of_memory,
    terminated_by,
)
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.version import VERSION

# Words before the message of an error, and exit code.
_ENDS: dict[type[ThermoForceError], tuple[str, int]] = {
    InputError: ("Error", 2),
    ControllerRaised: ("Controller failed", 1),
    PlantError: ("Plant failed", 3),
    NoSuchTest: ("Cannot go on", 5),
    StorageError: ("Cannot be written", 6),
    EngineError: ("Tasks cannot be run", 7),
}
# A disk or quota is full, or a file as large as it may be.
_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG)
# A message of ours may name many keys; what it quotes is cut where it enters.
_MOST_SHOWN = 20_000


_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True}


@click.group(cls=CommandGroups, context_settings=_SETTINGS)
@click.version_option(VERSION, prog_name="tf-mpc")
def cli() -> None:
    """Model predictive control of buildings. To start:

    \b
      tf-mpc run --testcase bestest_hydronic_heat_pump
      tf-mpc help COMMAND      or COMMAND --help; also exit-codes, completion
    """


_show_otherwise = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *place: Any, **further: Any) -> None:
    """Doubtful input in one line, without the place in our source.

    Warnings of libraries are for developers: they are shown where Python is asked for them (-W, PYTHONWARNINGS).
    """
    if issubclass(category, DoubtfulInput):
        click.echo(f"Warning: {message}", err=True)
    elif sys.warnoptions:
        _show_otherwise(message, category, *place, **further)


def _say_end(words: str, error: BaseException) -> None:
    """Print `words` and the notes of `error`, such as where what was recorded is; click puts its Abort around some."""
    from boptest_client import safe_text  # it may quote a file, a service or a journal

    notes = [*getattr(error.__cause__, "__notes__", ()), *getattr(error, "__notes__", ())]
    try:
        click.echo(safe_text("\n".join((words, *notes)), _MOST_SHOWN), err=True)
    except OSError:  # a terminal that was closed
        _to_nowhere(sys.stderr)


def _to_nowhere(stream: TextIO) -> None:
    """What could not be written to `stream` is not tried again at the end, where Python would exit with 120 for it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _run() -> Any:
    """Run the command; what cannot be imported since something of the user's hides it says so."""
    try:
        # SIGHUP: the terminal was closed, or the connection to it lost.
        with terminated_by("SIGTERM"), terminated_by("SIGHUP"), terminated_by("SIGINT"):
            return cli.main(standalone_mode=False)
    except Exception as error:
        # A building that was not given back, or a record that could not be kept, is to be told all the same.
        tells = isinstance(error, ThermoForceError) and not isinstance(error, InputError)
        if not tells and (end := interruption(error)) is not None:
            raise end from error
        if isinstance(error, ImportError):
            from thermoforce_mpc.registry import check_nothing_hides_us

            check_nothing_hides_us()
        raise


def main() -> None:
    """Entry point: prints an error of this package as one message and exits with its code."""
    # Read when numpy is loaded. Matrices here are small: more threads gain nothing, and wait for one another where the
    # machine is busy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    keep_in_place()
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of files may be of any bytes
        sys.stdout.reconfigure(errors="backslashreplace")
    warnings.showwarning = _show_warning
    try:
        code = _run()
        if isinstance(code, int):  # a command that exits with a code of its own
            sys.exit(code)
    except click.ClickException as error:  # usage errors: exit code 2
        error.show()
        sys.exit(error.exit_code)
    except ThermoForceError as error:
        kind = next((kind for kind in _ENDS if isinstance(error, kind)), None)
        if kind is None:
            raise
        words, code = _ENDS[kind]
        _say_end(f"{words}: {error}", error)
        sys.exit(code)
    except PermissionError as error:  # also of a folder on the way, in which nobody may look
        if error.filename is None:
            raise
        from boptest_client import safe_text

        where = safe_text(os.fsdecode(error.filename), _MOST_SHOWN)
        click.echo(f"Error: {where}: {error.strerror}: ask its owner for the right to it, or name another", err=True)
        sys.exit(2)
    except OSError as error:  # what is printed goes to a file on a full disk: `tf-mpc data map ... > map.yaml`
        if error.errno not in _FULL:
            raise
        _to_nowhere(sys.stdout)
        where = f"{error.filename}: " if isinstance(error.filename, str) else ""
        click.echo(f"Cannot be written: {where}{error.strerror}; make room or write elsewhere", err=True)
        sys.exit(6)
    except Terminated as error:
        _say_end("Terminated.", error)
        sys.exit(128 + error.number)
    except (KeyboardInterrupt, click.Abort) as error:
        _say_end("Interrupted.", error)
        sys.exit(130)
    except (MemoryError, RuntimeError) as error:
        if not out_of_memory(error):
            raise
        click.echo("Out of memory: close other programs, give less data, or give the machine more.", err=True)
        sys.exit(6)
