"""A probing that is kept: what was asked of the plant and what it answered, in a journal of its own in a run folder.

`probing/NAME.jsonl` begins with what was probed and how (`probing`) and ends with why probing ended (`end`). With an
end it is a record that a model can be identified from again; without one, the probing can go on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from thermoforce_mpc.data import DAY_S, PlantInfo, Record
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import storage_errors
from thermoforce_mpc.loop.probing import Probed
from thermoforce_mpc.protocols import OutlivingPlant, Plant
from thermoforce_mpc.records.journal import (
    DamagedJournal,
    Journal,
    JournalEntry,
    JournalError,
    JournalText,
    making_sense,
    read_journal,
)
from thermoforce_mpc.records.journal_values import Json, block_of, measurement_of, names_of
from thermoforce_mpc.records.plain_files import check_plain
from thermoforce_mpc.records.recorded_plant import RecordedPlant
from thermoforce_mpc.records.run_folder import plain_json
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.version import VERSION

FOLDER = "probing"
_FORMAT = 2


@dataclass(frozen=True)
class ToldProbing:
    """A probing as its journal at `path` tells it, whole or as far as it came."""

    path: Path
    entries: Sequence[JournalEntry]

    @property
    def head(self) -> Mapping[str, Any]:
        """What was probed and how; raises `JournalError` where it is another journal."""
        head = self.entries[0] if self.entries else None
        if head is None or head.kind != "probing" or head.content.get("format") != _FORMAT:
            raise JournalError(f"{self.path}: holds no probing of format {_FORMAT}; probe again")
        return head.content

    @property
    def days(self) -> float:
        """Days that were probed."""
        with making_sense(self.path):
            return sum(advance["asked"]["duration_s"] for advance in self._advances) / DAY_S

    @property
    def _advances(self) -> Iterator[Mapping[str, Any]]:
        return (entry.content for entry in self.entries if entry.kind == "advance")

    @property
    def has_ended(self) -> bool:
        """Whether it need not go on."""
        return self.entries[-1].kind == "end"

    @property
    def probed(self) -> Probed:
        """The probing; raises `JournalError` where no step was probed."""
        if not self.days:
            raise JournalError(f"{self.path}: was ended before its first step; name another run")
        plant, end = self.head["plant"], self.entries[-1].content
        with making_sense(self.path):
            why = str(end["why"]) if self.has_ended else "its run was ended before its time"
            reset = next(entry.content["answer"] for entry in self.entries if entry.kind == "reset")
            names = names_of(reset["names"])
            record, blocks = Record.beginning(measurement_of(reset, names)), []
            for advance in self._advances:
                record = record.extended(measurement_of(advance["answer"], names))
                blocks.append(block_of(advance["asked"]))
            return Probed(record, tuple(blocks), PlantInfo(**plant), why)


def told_probing(path: Path) -> ToldProbing | None:
    """The probing whose journal is at `path`; None where none has begun. Raises `JournalError` for a damaged one."""
    told = ToldProbing(path, _read(path).entries) if path.exists() else None
    return told if told and told.entries else None


def _read(path: Path) -> JournalText:
    try:
        return read_journal(path)
    except DamagedJournal as damage:
        raise JournalError(f"{damage}; move the file away, and it is probed again") from damage


def find_probing(place: Path, testcase: TestCase, how: Json) -> Probed:
    """The probing of an earlier run, as far as it came: that which was probed as `how` says, or the only one.

    `place`: folder of the run, its folder `probing`, or one of the journals in that; `how`: as of `how_probed`.

    Raises:
        ConfigError: there is none, or several and none is as `how` says.
        JournalError: it is damaged, holds no step, or is of another test case; names the file.
    """
    where = place_of_journals(place)
    if where.is_dir():
        check_plain(where)
    journals = [where] if where.is_file() else sorted(where.glob("*.jsonl"))
    found = [told for path in journals if (told := told_probing(path))]
    alike = [told for told in found if told.head["how"] == how] or found
    if not found:
        raise ConfigError(f"{place}: holds no probing ({FOLDER}/*.jsonl): name the folder of a run that has probed")
    if len(alike) > 1:
        files = ", ".join(str(told.path) for told in alike)
        raise ConfigError(f"{place}: holds several probings, none with the settings of this run: name one of {files}")
    told = alike[0]
    of = {name: told.head.get(name) for name in ("testcase", "names")}
    if of != _building(testcase):
        raise JournalError(
            f"{told.path}: is a probing of {of['testcase']}, not of {testcase.name} as it is now; probe again"
        )
    return told.probed


def place_of_journals(place: Path) -> Path:
    """What is read of a place: the folder `probing` of a run folder; that folder or a journal in it as it is."""
    return place if place.is_file() or place.name == FOLDER else place / FOLDER


@contextmanager
def keeping_probing(plant: Plant, path: Path | None, testcase: TestCase, how: Json) -> Iterator[Plant]:
    """`plant`, whose answers are written to the journal at `path`, if any, as they come, after those that are there.

    Raises:
        JournalError: the journal is damaged (names the line), or another one.
        StorageError: it cannot be written.
    """
    if path is None:
        yield plant
        return
    text = _read(path) if path.exists() else None
    with storage_errors(path):
        path.parent.mkdir(exist_ok=True)
    # A service goes on where a power failure ends us.
    with closing(Journal(path, text, durable=isinstance(plant, OutlivingPlant))) as journal:
        kept = RecordedPlant(plant, journal, text.entries if text else ())
        head = {"format": _FORMAT, "version": VERSION, **_building(testcase), "how": how}
        kept.noted("probing", lambda: {**head, "plant": plain_json(asdict(plant.info))})
        yield kept


def note_end(kept: Plant, why: str) -> None:
    """Note in the journal, where there is one, that the probing has ended."""
    if isinstance(kept, RecordedPlant):
        kept.noted("end", lambda: {"why": why})


def _building(testcase: TestCase) -> Json:
    return {"testcase": testcase.name, "names": plain_json(asdict(testcase.layout.names))}
