"""Scores of rooms beside those of an earlier run, from its JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measured_rooms.score import DEFAULT, LEADS_H, PERSISTENCE, RC
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.errors import DataError

Row = Mapping[str, Any]

COMPARED = (DEFAULT, RC)
# RMSE now over RMSE then: the median of the rooms, and the worst room.
_MEDIAN, _WORST = 1.0, 1.10


def error_key(method: str, hours: int) -> str:
    """Column of the RMSE of a method at a lead time, K."""
    return f"{method}_{hours}h_K"


def earlier_rooms(file: Path, bench: str) -> list[dict[str, Any]]:
    """Rows of the errors of rooms in the JSON of an earlier run.

    Raises:
        DataError: the file is not the JSON of this bench.
    """
    key = error_key(PERSISTENCE, LEADS_H[0])
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        rows = [row for row in content["rows"] if key in row] if content["bench"] == bench else []
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"--against {file}: it cannot be read as the JSON of this bench ({error})") from error
    if not rows:
        raise DataError(f"--against {file}: it holds no rooms of `tf-mpc bench {bench}`")
    return rows


def ratio_rows(errors: Sequence[Row], before: Sequence[Row]) -> list[dict[str, Any]]:
    """RMSE over that of the earlier run, for each room that had a model then and whose record was run now.

    NaN where there is no model now.

    Raises:
        DataError: the starts are not those of the earlier run.
    """
    rooms = {(row["record"], row["room"]): row for row in errors}
    keys = {error_key(method, hours): _ratio_key(method, hours) for method in COMPARED for hours in LEADS_H}
    rows = []
    for old in before:
        new = rooms.get((old["record"], old["room"]))
        then = {key: old[key] for key in keys}
        if new is None or None in then.values():
            continue
        if new["starts"] and new["starts"] != old["starts"]:
            raise DataError(
                f"--against: {old['record']} had {old['starts']} starts, now {new['starts']}: run both with --quick or "
                "both without, on the same records"
            )
        ratios = {ratio: float("nan") if new[key] is None else new[key] / then[key] for key, ratio in keys.items()}
        rows.append({"record": old["record"], "room": old["room"], **ratios})
    return rows


def _ratio_key(method: str, hours: int) -> str:
    return f"{method}_{hours}h_ratio"


def targets(ratios: Sequence[Row]) -> list[Target]:
    """No worse in the median, and no room by more than a tenth."""
    out = []
    for method in COMPARED:
        for hours in LEADS_H:
            found = np.array([row[_ratio_key(method, hours)] for row in ratios])
            label = f"{method}, {hours} h: RMSE over that of the earlier run"
            if not found.size:
                out.append(Target(f"{label}, median of no room", float("nan"), _MEDIAN))
                continue
            worst = ratios[int(np.argmax(np.where(np.isnan(found), np.inf, found)))]
            out.append(Target(f"{label}, median of {found.size} rooms", float(np.median(found)), _MEDIAN))
            who = f"{worst['record']} {worst['room']}"
            out.append(Target(f"{label}, worst room ({who})", float(np.max(found)), _WORST))
    return out
