"""Folder and journal of one run: what is written as it goes on, and what a resumed run finds there."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.simulation.folder.run_folder import plain_json
from thermoforce_mpc.simulation.journal.journal import (
    FORMAT,
    NAME,
    Entry,
    Journal,
    JournalError,
    making_sense,
    read_run,
)
from thermoforce_mpc.simulation.journal.journaled_plant import JournaledPlant
from thermoforce_mpc.version import VERSION


@dataclass(frozen=True)
class RunBook:
    """A run in its folder; `told` are the records of a run that is resumed, after the first."""

    folder: Path
    scenario: Scenario
    command: tuple[str, ...]
    journal: Journal
    told: tuple[Entry, ...] = ()

    @classmethod
    def begin(cls, folder: Path, scenario: Scenario, command: Sequence[str]) -> RunBook:
        """Begin the journal of a run; raises `StorageError`, and then leaves no folder behind."""
        try:
            journal = Journal(folder / NAME, durable=is_real(scenario))
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)  # what went wrong is the reason, not that it may be gone
            raise
        book = cls(folder, scenario, tuple(command), journal)
        head = {"format": FORMAT, "version": VERSION, "command": list(command)}
        try:
            journal.write("run", head | {"scenario": scenario.model_dump(mode="json")})
        except BaseException:
            book.discard()
            raise
        return book

    @classmethod
    def reopen(cls, folder: Path) -> RunBook:
        """Go on with the journal of a run.

        Raises:
            JournalError: there is none, it is damaged (names the line), or of another format.
            StorageError: it cannot be written.
        """
        path = folder / NAME
        text = read_run(path)
        head = text.entries[0]
        with making_sense(head.where):
            scenario = validate(Scenario, dict(head.content["scenario"]), head.where)
            command = tuple(str(word) for word in head.content["command"])
        journal = Journal(path, text, durable=is_real(scenario))
        return cls(folder, scenario, command, journal, text.entries[1:])

    def connect(self, build: Callable[[str | None], Plant]) -> JournaledPlant:
        """The plant of the run; `build` makes it, or takes up the test of a service by its name."""
        if self.told:
            entry = self.told[0]
            if entry.kind != "plant":
                raise JournalError(f"{entry.where}: '{entry.kind}' before the plant")
            with making_sense(entry.where):
                testid = entry.content["info"]["details"].get("testid")
            return JournaledPlant(build(testid), self.journal, self.told[1:])
        plant = build(None)
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
    def holds_nothing(self) -> bool:
        """Whether not even the plant was there: a run that goes on from here would begin anew."""
        return self.journal.records <= 1

    @property
    def has_begun(self) -> bool:
        """Whether more is known than the plant, such as the models: a run that goes on from here is further."""
        return bool(self.told) or self.journal.records > 2

    def discard(self) -> None:
        """Remove the folder, which the run made: nothing was done yet, and an empty run says nothing."""
        self.journal.close()
        shutil.rmtree(self.folder)


def is_real(scenario: Scenario) -> bool:
    """Whether the plant goes on while we are down, so that the journal must outlast a power failure."""
    return scenario.plant.kind == "boptest"
