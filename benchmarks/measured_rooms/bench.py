"""`tf-mpc bench rooms`: how well models predict measured rooms that they were not identified from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.cases import run_all
from benchmarks.measured_rooms.against import earlier_rooms, ratio_rows, targets
from benchmarks.measured_rooms.records import MeasuredRecord, found_records
from benchmarks.measured_rooms.score import EVERY_H, LEADS_H, METHODS, STEP_RESPONSE_H, identified, score
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.simulation.comparison.results_json import results_json

Row = dict[str, Any]
Case = tuple[MeasuredRecord, Path, float]

BENCH = "rooms"
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

    def told(done: int, rows: list[Row]) -> None:
        progress(f"{done} of {len(cases)}: {rows[0]['record']}, {rows[0]['seconds']:.0f} s")

    rooms = [row for rows in run_all(run_record, cases, engine, told) for row in rows]
    ratios = ratio_rows(rooms, before)
    return results_json(BENCH, [*rooms, *summary(rooms), *ratios], targets(ratios) if against else [])


def run_record(case: Case) -> list[Row]:
    """A row for each room of one record; without a model its scores are None and `says` has the reason."""
    record, folder, every_h = case
    began = perf_counter()
    measured = record.read(folder)
    columns = [f"{method}_{hours}h_K" for method in METHODS for hours in LEADS_H]
    own, together = f"full_{STEP_RESPONSE_H}h_K", f"all_full_{STEP_RESPONSE_H}h_K"
    rooms = measured.layout.names.zones
    try:
        model = identified(measured.record, measured.layout)
    except DataError as error:
        unknown = dict.fromkeys((*columns, own, together))
        says, seconds = f"refused: {error}", perf_counter() - began
        return [
            {"record": record.name, "room": room, "starts": 0, **unknown, "says": says, "seconds": seconds}
            for room in rooms
        ]
    scores = score(model, measured.record, every_h)
    rows = []
    for z, room in enumerate(rooms):
        errors = [scores.rmse_K[method][z] for method in METHODS]
        row: Row = {"record": record.name, "room": room, "starts": scores.starts}
        row |= dict(zip(columns, np.concatenate(errors).tolist(), strict=True))
        row |= {own: float(scores.own_K[z]), together: float(scores.all_K[z])}
        verdicts = [model.cards[a].competence for a in measured.layout.actuators_of(z)]
        competent = all(verdict is not None and verdict.competent for verdict in verdicts)
        rows.append(row | {"says": "competent" if competent else "not competent", "seconds": 0.0})
    for row in rows:
        row["seconds"] = perf_counter() - began
    return rows


def summary(rooms: Sequence[Row]) -> list[Row]:
    """Median and range over the rooms of each record that have a model, by method."""
    rows = []
    for record in dict.fromkeys(row["record"] for row in rooms):
        for method in METHODS:
            line: Row = {"record": record, "method": method}
            for hours in LEADS_H:
                values = [row[f"{method}_{hours}h_K"] for row in rooms if row["record"] == record]
                known = np.array([value for value in values if value is not None])
                for what, of in (("median", np.median), ("least", np.min), ("most", np.max)):
                    line[f"{what}_{hours}h_K"] = float(of(known)) if known.size else None
            rows.append(line)
    return rows
