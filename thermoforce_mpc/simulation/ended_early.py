"""What is kept of a run that ends before its time: tables, and where it was a fault, figures and report until there."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress

from thermoforce_mpc.errors import PlantError, StorageError, ThermoForceError, out_of_memory
from thermoforce_mpc.simulation.closed_loop import StepRecord
from thermoforce_mpc.simulation.folder.run_book import RunBook, is_real
from thermoforce_mpc.simulation.folder.run_folder import write_partial
from thermoforce_mpc.simulation.journal.journal import JournalError
from thermoforce_mpc.simulation.views.report_again import report_again


def ended_early(book: RunBook, records: Mapping[str, Sequence[StepRecord]], error: BaseException) -> BaseException:
    """Keep what there is of a run that `error` ended, or remove a folder that says nothing; the error to raise."""
    lacks_memory = out_of_memory(error)
    if not (book.has_begun or lacks_memory):
        with suppress(StorageError, OSError):  # the error that ended the run is the one to tell
            book.discard()
        return error
    kept = _keep(
        book, records, "out of memory" if lacks_memory else _in_words(error), fault=isinstance(error, Exception)
    )
    again = f"tf-mpc resume {shlex.quote(str(book.folder))}"
    there = f"{kept}; `{again}` goes on from there"
    if is_real(book.scenario):
        there += f", `{again} --stop` gives its test back to the service"
    if lacks_memory:
        return StorageError(f"out of memory: close other programs, or give the machine more\n{there}")
    return PlantError(f"{error}\n{there}") if isinstance(error, PlantError) else error


def _keep(book: RunBook, records: Mapping[str, Sequence[StepRecord]], reason: str, *, fault: bool) -> str:
    """Write it, as far as that can be; where it is, in words."""
    kept = f"What was recorded until then is in {book.folder}"
    with suppress(StorageError, OSError, MemoryError, JournalError):
        write_partial(book.folder, records, reason)
        if fault:
            report_again(book.folder)
            kept += ", with a report: report.html"
    return kept


def _in_words(error: BaseException) -> str:
    if not isinstance(error, Exception):
        return "interrupted"
    return str(error) if isinstance(error, ThermoForceError) else f"{type(error).__name__}: {error}"
