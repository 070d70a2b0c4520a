"""`tf-mpc bench rooms`: how well models predict measured rooms that they were not identified from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.measured_rooms.against import earlier_rooms, error_key, ratio_rows, targets
from benchmarks.measured_rooms.records import KNOWN, MeasuredRecord, found_records
from benchmarks.measured_rooms.score import EVERY_H, LEADS_H, METHODS, STEP_RESPONSE_H, identified, score
from thermoforce_mpc.comparison.outcome import results_json
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine

Row = dict[str, Any]
Case = tuple[MeasuredRecord, Path, float]

BENCH = "rooms"
_RESPONSES = (f"full_{STEP_RESPONSE_H}h_K", f"all_full_{STEP_RESPONSE_H}h_K")
_QUICK, _QUICK_EVERY_H = ("one19", "box"), 12.0


def run_rooms_bench(
    folders: Sequence[Path],
    *,
    engine: Engine,
    only: Sequence[str] = (),
    against: Path | None = None,
    quick: bool = False,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Identify from the first part of each record and score the rest.

    Args:
        folders: where the measured records lie.
        engine: where the records are run.
        only: names of records; default: all that are there.
        against: JSON of an earlier run to compare with.
        quick: the two short records, and a start every twelve hours.
        progress: callback for progress lines.

    Raises:
        DataError: no record is there, or `against` is not the JSON of this bench.
    """
    before = earlier_rooms(against, BENCH) if against else []
    found = found_records(folders, only or (_QUICK if quick else ()))
    cases: list[Case] = [(record, folder, _QUICK_EVERY_H if quick else EVERY_H) for record, folder in found]
    names = [record.name for record, _ in found]
    progress(f"records: {', '.join(names)}")
    absent = [] if only or quick else [record.name for record in KNOWN if record.name not in names]
    if absent:
        progress(f"not found in --records, left out: {', '.join(absent)}")

    def told(done: int, rooms: list[Room]) -> None:
        model = rooms[0].model
        progress(f"{done} of {len(cases)}: {model['record']}, {model['seconds']:.0f} s")

    scored = [one for rooms in run_all(run_record, cases, engine, told) for one in rooms]
    errors, models = [one.errors for one in scored], [one.model for one in scored]
    ratios = ratio_rows(errors, before)
    return results_json(BENCH, [*errors, *models, *summary(errors), *ratios], targets(ratios) if against else [])


@dataclass(frozen=True)
class Room:
    """Rows of one room: `errors` of each method at each lead, None without a model, and what the `model` says."""

    errors: Row
    model: Row


def run_record(case: Case) -> list[Room]:
    """Identify from the first part of one record and score its rooms."""
    record, folder, every_h = case
    began = perf_counter()
    measured = record.read(folder)
    rooms = measured.layout.names.zones
    columns = [error_key(method, hours) for method in METHODS for hours in LEADS_H]
    try:
        model = identified(measured.record, measured.layout)
    except DataError as error:
        lead: list[Row] = [{"record": record.name, "room": room} for room in rooms]
        answer = {**dict.fromkeys(_RESPONSES), "says": f"refused: {error}", "seconds": perf_counter() - began}
        return [Room({**one, "starts": 0, **dict.fromkeys(columns)}, {**one, **answer}) for one in lead]
    scores = score(model, measured.record, every_h)
    seconds = perf_counter() - began
    found = []
    for z, room in enumerate(rooms):
        one: Row = {"record": record.name, "room": room}
        values = np.concatenate([scores.rmse_K[method][z] for method in METHODS]).tolist()
        responses = (float(scores.own_K[z]), float(scores.all_K[z]))
        verdicts = [model.cards[a].competence for a in measured.layout.actuators_of(z)]
        missed = [reason for verdict in verdicts if verdict is not None for reason in verdict.reasons]
        answer = {
            **dict(zip(_RESPONSES, responses, strict=True)),
            "says": missed[0].split(";")[0] if missed else "competent",
            "seconds": seconds,
        }
        errors = {"starts": scores.starts, **dict(zip(columns, values, strict=True))}
        found.append(Room({**one, **errors}, {**one, **answer}))
    return found


def summary(rooms: Sequence[Row]) -> list[Row]:
    """Median and range over the rooms of each record that have a model, by method."""
    rows = []
    for record in dict.fromkeys(row["record"] for row in rooms):
        for method in METHODS:
            line: Row = {"record": record, "method": method}
            for hours in LEADS_H:
                values = [row[error_key(method, hours)] for row in rooms if row["record"] == record]
                known = np.array([value for value in values if value is not None])
                for what, of in (("median", np.median), ("least", np.min), ("most", np.max)):
                    line[f"{what}_{hours}h_K"] = float(of(known)) if known.size else None
            rows.append(line)
    return rows
