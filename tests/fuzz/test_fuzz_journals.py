"""Journals: bytes that were changed are refused by their line, and one made to deceive ends in a named error."""

from __future__ import annotations

import json
import shutil
import zlib

import pytest
from fuzzing import fuzz, mutated, result_or_error, tampered
from hypothesis import given
from hypothesis import strategies as st
from run_folders import experiment_on
from simple_house import SimpleHouse

from controllers import Thermostat
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.experiment.explaining import alternatives_of, decision_at
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.records.journal import NAME, JournalError, read_journal


def run(book: RunBook) -> None:
    plant = book.connect()
    plant.noted("loop", {"controller": "thermostat"})
    run_closed_loop(plant, Thermostat(), Period("test", 10 * DAY_S, 3600.0, DAY_S), keeper=plant)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    book = RunBook.begin(folder, experiment_on(SimpleHouse()), ["tf-mpc", "run"])
    run(book)
    book.journal.close()
    return folder


def records(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / NAME).read_bytes().splitlines()]


def written(folder, found: list) -> None:
    """A journal of these records, its checksums as they must be."""
    crc, lines = 0, []
    for record in found:
        if isinstance(record, dict):
            record.pop("crc", None)
        text = json.dumps(record, ensure_ascii=True)[:-1]
        crc = zlib.crc32(text.encode(), crc)
        lines.append(f'{text},"crc":"{crc:08x}"}}\n')
    (folder / NAME).write_text("".join(lines))


def explained(folder) -> None:
    decision = decision_at(folder)
    decision.bounds()
    alternatives_of(folder, decision)


def resumed(folder) -> None:
    book = RunBook.reopen(folder, resolved=lambda _: experiment_on(SimpleHouse()))
    try:
        run(book)
    finally:
        book.journal.close()


def test_a_whole_journal_is_explained_and_resumed(folder, tmp_path):
    shutil.copy(folder / NAME, tmp_path / NAME)
    explained(tmp_path)
    resumed(tmp_path)
    written(tmp_path, records(folder))
    resumed(tmp_path)  # what the tests below write is such a one


@fuzz(40)
@given(data=st.data())
def test_changed_bytes_are_refused_or_drop_the_end(folder, tmp_path_factory, data):
    whole = (folder / NAME).read_bytes()
    there = tmp_path_factory.mktemp("changed")
    (there / NAME).write_bytes(data.draw(mutated(whole)))
    found = result_or_error(JournalError, lambda: read_journal(there / NAME).entries, names=str(there))
    expected = read_journal(folder / NAME).entries
    for entry, true in zip(found or (), expected, strict=False):
        assert entry.content == true.content


@pytest.mark.slow
@fuzz(60)
@given(data=st.data())
@pytest.mark.parametrize("act", [explained, resumed])
def test_a_journal_made_to_deceive_ends_in_a_named_error(folder, tmp_path_factory, act, data):
    found = records(folder)
    at = data.draw(st.integers(0, len(found) - 1))
    n, kind = found[at]["n"], found[at]["kind"]
    other = data.draw(tampered({key: value for key, value in found[at].items() if key not in ("n", "kind", "crc")}))
    found[at] = {"n": n, "kind": kind, **other} if isinstance(other, dict) else {"n": n, "kind": kind}
    there = tmp_path_factory.mktemp("deceiving")
    written(there, found)
    result_or_error(ThermoForceError, lambda: act(there), most=3000)


@pytest.mark.parametrize(
    "blocks",
    [
        "",
        [],
        [{"u": [], "duration_s": 900.0}],
        [{"u": [2.0], "duration_s": 900.0}],
        [{"u": [float("nan")], "duration_s": 900.0}],
        [{"u": [0.5], "duration_s": 1800.0}],
        [{"u": [0.5], "duration_s": 0.0}],
    ],
)
def test_blocks_that_no_plan_could_have_are_not_applied_again(folder, tmp_path, blocks):
    found = records(folder)
    step = next(record for record in found if record["kind"] == "step")
    assert step["blocks"][0]["duration_s"] == 900.0
    step["blocks"] = blocks
    written(tmp_path, found)
    with pytest.raises(ThermoForceError, match="was it edited"):
        resumed(tmp_path)


def test_a_packed_array_that_unpacks_to_more_than_it_says_is_refused(folder, tmp_path):
    found = records(folder)
    past = next(record for record in found if record["kind"] == "past")
    past["answer"]["T_out_C"]["shape"] = [10**12]
    written(tmp_path, found)
    with pytest.raises(JournalError, match="line 5: cannot be made sense of"):
        resumed(tmp_path)
