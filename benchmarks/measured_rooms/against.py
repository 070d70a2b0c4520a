"""Scores of rooms beside those of an earlier run, from its JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_rooms.score import DEFAULT, LEADS_H, RC
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.simulation.comparison.results_json import Target

Row = Mapping[str, Any]

COMPARED = (DEFAULT, RC)
# RMSE now over RMSE then: the median of the rooms, and the worst room.
_MEDIAN, _WORST = 1.0, 1.10


def earlier_rooms(file: Path, bench: str) -> list[dict[str, Any]]:
    """Rows of the rooms in the JSON of an earlier run.

    Raises:
        DataError: the file is not the JSON of this bench.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        rows = [row for row in content["rows"] if "room" in row] if content["bench"] == bench else []
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"--against {file}: it cannot be read as the JSON of this bench ({error})") from error
    if not rows:
        raise DataError(f"--against {file}: it holds no rooms of `tf-mpc bench {bench}`")
    return rows


def ratio_rows(rooms: Sequence[Row], before: Sequence[Row]) -> list[dict[str, Any]]:
    """RMSE over that of the earlier run, for the rooms that were scored in it and belong to a record that was run now.

    NaN where there is no model now.
    """
    now = {(row["record"], row["room"]): row for row in rooms}
    run = {row["record"] for row in rooms}
    rows = []
    for old in before:
        if old["record"] not in run or old[f"{DEFAULT}_{LEADS_H[0]}h_K"] is None:
            continue
        new = now.get((old["record"], old["room"]), {})
        row = {"record": old["record"], "compared room": old["room"]}
        for method in COMPARED:
            for hours in LEADS_H:
                key = f"{method}_{hours}h"
                rmse = new.get(f"{key}_K")
                row[key] = float("nan") if rmse is None else rmse / old[f"{key}_K"]
        rows.append(row)
    return rows


def targets(ratios: Sequence[Row]) -> list[Target]:
    """No worse in the median, and no room by more than a tenth."""
    out = []
    for method in COMPARED:
        for hours in LEADS_H:
            found = np.array([row[f"{method}_{hours}h"] for row in ratios])
            label = f"{method}, {hours} h: RMSE over that of the earlier run"
            if not found.size:
                out.append(Target(f"{label}, median of no room", float("nan"), _MEDIAN))
                continue
            worst = ratios[int(np.argmax(np.where(np.isnan(found), np.inf, found)))]
            out.append(Target(f"{label}, median of {found.size} rooms", float(np.median(found)), _MEDIAN))
            who = f"{worst['record']} {worst['compared room']}"
            out.append(Target(f"{label}, worst room ({who})", float(np.max(found)), _WORST))
    return out
