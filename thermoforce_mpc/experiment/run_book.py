"""Folder and journal of one run: what is written as it goes on, what a resumed run finds, what an ended one leaves."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from thermoforce_mpc.errors import PlantError, StorageError, ThermoForceError, out_of_memory
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.files import plain_json
from thermoforce_mpc.loop.closed_loop import StepRecord
from thermoforce_mpc.records.journal import (
    FORMAT,
    NAME,
    DamagedJournal,
    Journal,
    JournalEntry,
    JournalError,
    JournalText,
    lines_of,
    making_sense,
    read_run,
    set_aside,
)
from thermoforce_mpc.records.recorded_plant import JournaledPlant
from thermoforce_mpc.records.run_folder import write_partial
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.version import VERSION

# It becomes a part of addresses.
_TESTID = re.compile(r"[\w-]{1,200}")


@dataclass(frozen=True)
class RunBook:
    """A run in its folder; `told` are the records of a run that is resumed, after the first.

    `resumed`: whether the folder was there before; `cut`: whether records are lost, so that a plant that outlived the
    process may stand anywhere after them.
    """

    folder: Path
    experiment: Experiment
    command: tuple[str, ...]
    journal: Journal
    told: tuple[JournalEntry, ...] = ()
    resumed: bool = False
    cut: bool = False

    @classmethod
    def begin(cls, folder: Path, experiment: Experiment, command: Sequence[str]) -> RunBook:
        """Begin the journal of a run; raises `StorageError`, and then leaves no folder behind."""
        try:
            journal = Journal(folder / NAME, durable=experiment.plant.outlives_us)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)  # what went wrong is the reason, not that it may be gone
            raise
        book = cls(folder, experiment, tuple(command), journal)
        head = {"format": FORMAT, "version": VERSION, "command": list(command)}
        try:
            journal.write("run", head | {"scenario": experiment.written.model_dump(mode="json")})
        except BaseException:
            book.discard()
            raise
        return book

    @classmethod
    def reopen(
        cls,
        folder: Path,
        since: float | None = None,
        resolved: Callable[[Scenario], Experiment] = Experiment.of,
    ) -> RunBook:
        """Go on with the journal of a run, at its end, or before `since`, a line (int) or time (s, float).

        What comes after is set aside. `resolved`: the experiment of the scenario; called before anything is
        written, and may refuse it.

        Raises:
            JournalError: there is none, it is damaged (names the line), of another format, or has nothing at `since`.
            StorageError: it cannot be written.
        """
        path = folder / NAME
        text = read_run(path) if since is None else _until(path, since)
        head = text.entries[0]
        if "building" in head.content:
            raise JournalError(f"{path}: is of a real building: start `tf-mpc control` again with the same --out")
        with making_sense(head.where):
            scenario = validate(Scenario, dict(head.content["scenario"]), head.where)
            command = tuple(str(word) for word in head.content["command"])
        experiment = resolved(scenario)
        goes_on = experiment.plant.outlives_us
        if since is not None:
            text = _with_its_loop(path, text) if goes_on else text
            set_aside(path, text)
        # A plant that goes on while we are down needs a journal that outlasts a power failure.
        journal = Journal(path, text, durable=goes_on)
        return cls(folder, experiment, command, journal, text.entries[1:], resumed=True, cut=since is not None)

    def connect(self) -> JournaledPlant:
        """The plant of the run: made, or the test of a service that it had taken up again; raises as it is built."""
        build = self.experiment.plant.build
        if self.told:
            entry = self.told[0]
            if entry.kind != "plant":
                raise JournalError(f"{entry.where}: '{entry.kind}' before the plant")
            with making_sense(entry.where):
                testid = entry.content["info"]["details"].get("testid")
                if testid is not None and not _TESTID.fullmatch(testid):
                    raise ValueError(f"{testid:.100} is not the name of a test")
            return JournaledPlant(build(testid), self.journal, self.told[1:], cut=self.cut)
        plant = build()
        try:
            self.journal.write("plant", {"info": plain_json(asdict(plant.info))})
        except BaseException:
            plant.close()
            raise
        return JournaledPlant(plant, self.journal)

    @contextmanager
    def released(self, plant: JournaledPlant) -> Iterator[JournaledPlant]:
        """Close `plant` at the end; one that outlives us is left where a run that failed can go on from there."""
        try:
            yield plant
        except Exception as error:
            if self.has_begun or isinstance(error, PlantError):
                plant.leave()
            raise
        finally:
            plant.close()

    @property
    def has_begun(self) -> bool:
        """Whether more is known than the plant, such as the models: a run that goes on from here is further."""
        return self.resumed or self.journal.records > 2

    def discard(self) -> None:
        """Remove the folder, which the run made: nothing was done yet, and an empty run says nothing."""
        self.journal.close()
        shutil.rmtree(self.folder)


def _until(path: Path, since: float) -> JournalText:
    """The journal before a line, or before the step at a time of the loop that was the last."""
    try:
        entries = read_run(path).entries
    except DamagedJournal as damage:
        entries = damage.good.entries
    n = since - 1 if isinstance(since, int) else _step_at(path, entries, since)
    if not 1 <= n <= len(entries):
        raise JournalError(f"{path}: --from {since}: give a line from 2 to {len(entries) + 1}, or a time")
    return read_run(path, int(n))


def _step_at(path: Path, entries: Sequence[JournalEntry], time_s: float) -> int:
    """Number of records before the step at `time_s`."""
    with making_sense(path):
        begin = _last(entries, "loop")
        steps = [n for n, entry in enumerate(entries) if entry.kind == "step" and n > begin]
        before = [n for n in steps if float(entries[n].content["time_s"]) <= time_s]
    if not before:
        raise JournalError(f"{path}: --from: the last loop has no step at {time_s:.0f} s that can be read; give a line")
    return before[-1]


def _last(entries: Sequence[JournalEntry], kind: str) -> int:
    return max((n for n, entry in enumerate(entries) if entry.kind == kind), default=-1)


def _with_its_loop(path: Path, text: JournalText) -> JournalText:
    """What is kept of the journal of a service, which stands where it stands.

    It goes on in the loop that it is in. A loop that is over there, or of which no step is left, begins again.
    """
    begin = _last(text.entries, "loop")
    over = any(b'"kind":"reset"' in line for line in lines_of(path, text.size))
    if begin >= 0 and (over or _last(text.entries, "step") < begin):
        return read_run(path, begin)
    return text


def ended_early(book: RunBook, records: Mapping[str, Sequence[StepRecord]], error: BaseException) -> BaseException:
    """Keep what there is of a run that `error` ended, or remove a folder that says nothing; the error to raise."""
    lacks_memory = out_of_memory(error)
    if not (book.has_begun or lacks_memory):
        with suppress(StorageError, OSError):  # the error that ended the run is the one to tell
            book.discard()
        return error
    fault = isinstance(error, Exception)
    reason = "interrupted"
    if lacks_memory:
        reason = f"out of memory{f': {error}' if str(error) else ''}"
    elif fault:
        reason = str(error) if isinstance(error, ThermoForceError) else f"{type(error).__name__}: {error}"
    there = f"What was recorded until then is in {book.folder}"
    with suppress(StorageError, OSError, MemoryError, JournalError):  # as far as that can be
        write_partial(book.folder, records, reason)
        if fault:
            from thermoforce_mpc.report.html import report_again

            report_again(book.folder)
            there += ", with a report: report.html"
    again = f"tf-mpc resume {shlex.quote(str(book.folder))}"
    there += f"; `{again}` goes on from there"
    if book.experiment.plant.outlives_us:
        there += f", `{again} --stop` gives its test back to the service"
    if lacks_memory:
        how = f" ({error})" if isinstance(error, MemoryError) and str(error) else ""
        return StorageError(f"out of memory: close other programs, or give the machine more{how}\n{there}")
    if isinstance(error, PlantError):
        return PlantError(f"{error}\n{there}")
    error.add_note(there)
    return error
