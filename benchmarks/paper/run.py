"""Run the parts, and write the paper's tables beside ours: Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import io
import math
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy.stats import t

from benchmarks.paper.parts import NOT_MEASURED, PARTS, Setting, Table
from benchmarks.paper.tables import Rows
from thermoforce_mpc.comparison.outcome import results_json
from thermoforce_mpc.errors import ThermoForceError
from thermoforce_mpc.files import write_json, write_whole

_COLUMNS = ("table", "row", "quantity", "paper", "here", "low", "high", "seeds")


def run_paper(names: Sequence[str], setting: Setting) -> dict[str, Any]:
    """Run the parts `names` and write `tables.md`, `tables.csv` and `tables.json` into `setting.out` after each.

    A part that cannot run here is told in its tables, not left out.

    Returns:
        The content of `tables.json`: a bench's result, with `parts` by name (`minutes`, `differs`, `missing`).
    """
    rows, texts, parts = list[dict[str, Any]](), list[str](), dict[str, Any]()
    setting.out.mkdir(parents=True, exist_ok=True)
    for name in names:
        part, began = PARTS[name], time.perf_counter()
        setting.say(f"{name}: {', '.join(table.label for table in part.tables)}")
        try:
            result, missing = part.run(setting, setting.out / name), ""
        except ThermoForceError as error:
            result, missing = None, str(error)
            setting.say(f"{name}: not reproduced: {missing}")
        minutes = (time.perf_counter() - began) / 60.0
        parts[name] = {"minutes": minutes, "differs": part.differs, "missing": missing}
        for table in part.tables:
            found = table.rows(result) if result else {}
            rows += _cells(table, found)
            texts.append(markdown(name, table, found, parts[name]))
        content = results_json("paper", rows, []) | {"parts": parts, "not_measured": NOT_MEASURED}
        _write(setting.out, content, texts)
    return content


def _cells(table: Table, rows: Rows) -> list[dict[str, Any]]:
    """One row a figure."""
    found = []
    for row, cells in rows.items():
        for quantity, cell in cells.items():
            each = cell[2] if len(cell) == 3 else ()
            values = (table.label, row, quantity, *cell[:2], *_interval(each), " ".join(map(repr, each)))
            found.append(dict(zip(_COLUMNS, values, strict=True)))
    return found


def markdown(name: str, table: Table, rows: Rows, part: Mapping[str, Any]) -> str:
    """A table with the paper's figure in brackets."""
    lines = [f"## {table.label}: {table.title}", "", f"`tf-mpc paper --only {name}`, {part['minutes']:.1f} min."]
    lines += [f"What differs: {part['differs']}.", ""]
    if part["missing"]:
        return "\n".join([*lines, f"**Not reproduced here:** {part['missing']}.", ""])
    columns = list(dict.fromkeys(quantity for cells in rows.values() for quantity in cells))
    lines += [f"| here (paper) | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for row, cells in rows.items():
        lines.append(f"| {row} | {' | '.join(_pair(*cells.get(column, (None, None))) for column in columns)} |")
    lines += ["", *(f"![{figure}]({name}/{figure})" for figure in table.figures), ""]
    return "\n".join(lines)


def _interval(values: Sequence[float]) -> tuple[float | None, float | None]:
    """The 95 % interval of the mean over seeds by Student's t; none from fewer than three."""
    if len(values) < 3:
        return None, None
    half = float(t.ppf(0.975, len(values) - 1)) * statistics.stdev(values) / math.sqrt(len(values))
    return statistics.mean(values) - half, statistics.mean(values) + half


def _pair(paper: float | None, here: float | None, each: tuple[float, ...] = ()) -> str:
    """As '5.6 [3.1, 8.2] (1.73): 9.9 7.8 2.7': mean, its interval, the paper's, each seed's."""
    mine = "–" if here is None else _number(here)
    low, high = _interval(each)
    mine += "" if low is None or high is None else f" [{_number(low)}, {_number(high)}]"
    mine += "" if paper is None else f" ({_number(paper)})"
    return mine + (f": {' '.join(map(_number, each))}" if each else "")


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _write(out: Path, content: Mapping[str, Any], texts: Sequence[str]) -> None:
    whole = sum(part["minutes"] for part in content["parts"].values())
    summary = ["# The paper's tables, here", "", f"Measured in {whole:.0f} min; the paper's figure in brackets.", ""]
    summary += ["| part | figures | of them beside one of the paper | min | |", "|---|---|---|---|---|"]
    for name, part in content["parts"].items():
        labels = [table.label for table in PARTS[name].tables]
        mine = [row for row in content["rows"] if row["table"] in labels and row["here"] is not None]
        both = sum(row["paper"] is not None for row in mine)
        state = f"not reproduced: {part['missing']}" if part["missing"] else ", ".join(labels)
        summary.append(f"| {name} | {len(mine)} | {both} | {part['minutes']:.1f} | {state} |")
    summary += ["", *(f"- {labels}: not measured, {why}." for labels, why in NOT_MEASURED.items()), ""]
    write_whole(out / "tables.md", "\n".join([*summary, *texts]))
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS)
    writer.writeheader()
    writer.writerows(content["rows"])
    write_whole(out / "tables.csv", text.getvalue())
    write_json(out / "tables.json", dict(content))
