"""Output of a comparison: tables (Markdown, CSV, LaTeX), JSON, and one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from thermoforce_mpc.comparison.cells import SEED
from thermoforce_mpc.comparison.outcome import (
    CONFIDENCE,
    KPIS,
    ControllerPair,
    Row,
    cost_targets,
    failures,
    finished,
    group_title,
    grouped,
    in_words,
    outcome_rows,
    pairs,
    ranked,
    reference_of,
    results_json,
    tariff_title,
    verdicts,
)
from thermoforce_mpc.files import write_json, write_plain
from thermoforce_mpc.report.findings import COST, DISCOMFORT
from thermoforce_mpc.report.page import rendered

HEADINGS = {
    "cost_tot": "cost, {currency}/m²",
    "tdis_tot": "discomfort, K·h",
    "saving": "saving at equal comfort, %",
    "ener_tot": "energy, kWh/m²",
    "emis_tot": "CO₂, kg/m²",
    "pele_tot": "electric peak, kW/m²",
    "plan_ms": "plan, ms",
    "fallbacks": "fallbacks",
}
FORMS = ("csv", "latex", "markdown")
_DIGITS = {"cost_tot": ".4f", "tdis_tot": ".2f", "saving": ".1f", "plan_ms": ".1f", "fallbacks": "d"}
_BEST = {"cost_tot": "best_cost", "tdis_tot": "best_discomfort"}


def write_outcome(
    folder: Path,
    records: Sequence[Mapping[str, Any]],
    *,
    name: str,
    title: str,
    currency: str,
    swept: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Write `table.md`, `table.csv`, `results.json`, whose content is returned, and `comparison.html` into `folder`.

    `records`: results of the cells; `name`: 'compare' or 'sweep'; `swept`: labels, by variant, of points on a line.
    """
    rows = outcome_rows(records)
    if swept is None:  # a sweep is read in the order of its values
        rows = [row for group in grouped(rows).values() for row in ranked(group)]
    result = results_json(name, rows, cost_targets(rows))
    write_json(folder / "results.json", result)
    write_plain(folder / "table.csv", _csv(rows))
    says = verdicts(rows)
    write_plain(folder / "table.md", markdown(rows, title, currency, says))
    plants = sorted({f"{r['plant']['kind']}: {r['plant']['weather']}" for r in records if "plant" in r})
    first = {record["variant"]: record for record in reversed(records)}
    data = comparison_data(rows, currency, swept or {})
    page = rendered(
        "comparison.html.j2",
        SCRIPTS,
        data,
        paired=bool(data["references"]),
        confidence=CONFIDENCE,
        title=title,
        emulated=any(plant.startswith("embedded") for plant in plants),
        plants=plants,
        headings=headings(currency, rows),
        groups=[
            (group_title(group), [_table_row(row, own_columns(rows)) for row in members], _zones(members))
            for group, members in grouped(rows).items()
        ],
        verdicts=says,
        failed=failures(rows),
        variants=[_variant(first[variant]) for variant in dict.fromkeys(record["variant"] for record in records)],
        command=result["command"],
    )
    write_plain(folder / "comparison.html", page)
    return result


def headings(currency: str, rows: Sequence[Row]) -> list[str]:
    """Column headings of the figures of `rows`, those of the user's own KPIs last."""
    return [*(text.format(currency=currency) for text in HEADINGS.values()), *own_columns(rows)]


def own_columns(rows: Sequence[Row]) -> list[str]:
    """Names and units of the user's own KPIs in any of `rows`."""
    return list(dict.fromkeys(key for row in rows for key in row["own"]))


def shown_figures(row: Row, own: Sequence[str]) -> list[str]:
    """The figures of a row as text, then those of its `own` KPIs.

    An asterisk marks the best cost and discomfort of its group.
    """
    texts = []
    for key in HEADINGS:
        star = "*" if row.get(_BEST.get(key, ""), False) else ""
        texts.append("–" if row[key] is None else f"{row[key]:{_DIGITS.get(key, '.4g')}}{star}")
    values = [row["own"].get(key) for key in own]
    return texts + ["–" if value is None else f"{value:.4g}" for value in values]


def formatted(rows: Sequence[Row], form: str, title: str, currency: str) -> str:
    """The figures of all rows as text in a `form` of `FORMS`, to go on with elsewhere."""
    if form == "csv":
        return _csv(rows)
    if form == "markdown":
        return markdown(rows, title, currency, verdicts(rows))
    own = own_columns(rows)
    columns = ["window", "tariff", "controller", *headings(currency, rows)]
    texts = [[row["window"], row["price"], row["controller"], *shown_figures(row, own)] for row in rows]
    tables = [_latex(columns, texts, 3)]
    if found := _differences(rows):
        tables.append(f"% {found[0]}\n{_latex(_DIFFERENCES, found[1], 2)}")
    return "\n".join(tables)


def _latex(columns: Sequence[str], texts: Sequence[Sequence[str]], names: int) -> str:
    """A table in LaTeX (booktabs), its first `names` columns to the left."""
    layout = "l" * names + "r" * (len(columns) - names)
    latex = str(
        pd.DataFrame([list(row) for row in texts], columns=list(columns)).to_latex(
            index=False, escape=True, column_format=layout
        )
    )
    for character, command in (("₂", "$_2$"), ("²", "$^2$"), ("·", "$\\cdot$"), ("–", "--"), ("−", "$-$")):
        latex = latex.replace(character, command)
    return latex


def markdown(rows: Sequence[Row], title: str, currency: str, says: Sequence[str]) -> str:
    """The tables as Markdown, followed by the findings `says`."""
    lines = [f"# {title}", ""]
    for group, members in grouped(rows).items():
        lines += [f"## {group_title(group)}", ""]
        own = own_columns(members)
        names = [f"{row['controller']}{' (front)' if row['pareto'] else ''}" for row in members]
        figures = [[name, *shown_figures(row, own)] for name, row in zip(names, members, strict=True)]
        lines += [*_table_lines(["controller", *headings(currency, members)], figures), *_zone_lines(members)]
    lines += [
        "By cost, comparable comfort first. `*`: best of its table (cost at comparable comfort); (front): on the "
        "Pareto front of cost and discomfort.",
        "",
    ]
    lines += _paired_lines(rows)
    lines += [f"- {text}" for text in says]
    lines += [
        f"- failed: {row['controller']}, {row['window']}, {row['price']}: {row['reason']}" for row in failures(rows)
    ]
    return "\n".join(lines) + "\n"


_DIFFERENCES = ("controller", "tariff", "windows", "cost, %", "discomfort, K·h")


def _differences(rows: Sequence[Row]) -> tuple[str, list[list[str]]] | None:
    """Heading and rows of the differences to the reference over windows; None where there is one window."""
    reference = reference_of(rows)
    several = [pair for pair in pairs(rows, reference) if len(pair.windows) > 1] if reference else []
    if not several:
        return None
    rows_of_pairs = []
    for pair in several:
        tariff, windows = tariff_title(pair.price, pair.uncertainty), str(len(pair.windows))
        figures = [in_words(pair.cost_percent, 1), in_words(pair.discomfort_Kh, 2)]
        rows_of_pairs.append([pair.controller, tariff, windows, *figures])
    over = "windows and seeds" if any(SEED in window for pair in several for window in pair.windows) else "windows"
    return f"Difference to {reference}, mean over {over} (95 % interval, from three on)", rows_of_pairs


def _paired_lines(rows: Sequence[Row]) -> list[str]:
    """The differences in Markdown."""
    found = _differences(rows)
    return [f"## {found[0]}", "", *_table_lines(_DIFFERENCES, found[1], names=2)] if found else []


def _table_lines(columns: Sequence[str], rows: Sequence[Sequence[str]], names: int = 1) -> list[str]:
    """A table in Markdown, its first `names` columns to the left, and an empty line."""
    lines = [f"| {' | '.join(cells)} |" for cells in (columns, *rows)]
    return [lines[0], "|---" * names + "|---:" * (len(columns) - names) + "|", *lines[1:], ""]


def _zone_lines(members: Sequence[Row]) -> list[str]:
    zones = _zones(members)
    cells = [[f"{row['zones'][zone]:.2f}" if zone in row["zones"] else "–" for zone in zones] for row in members]
    rows = [[row["controller"], *of] for row, of in zip(members, cells, strict=True)]
    return _table_lines(["discomfort, K·h", *zones], rows) if zones else []


def _csv(rows: Sequence[Row]) -> str:
    zones = dict.fromkeys(f"tdis_tot[{zone}]" for row in rows for zone in row["zones"])
    columns = [
        "window", "price", "uncertainty", "controller", "status", *KPIS, *own_columns(rows), "saving", *zones,
        "comparable", "best_cost",
        "best_discomfort", "pareto", "fallbacks", "plan_ms", "controller_s", "plant_s", "reason",
    ]  # fmt: skip
    flat = [row | row["own"] | {f"tdis_tot[{zone}]": value for zone, value in row["zones"].items()} for row in rows]
    return pd.DataFrame(flat, columns=columns, dtype=object).to_csv(index=False, lineterminator="\n")


def _zones(members: Sequence[Row]) -> list[str]:
    """The zones of a group, none where there is one only."""
    return list(dict.fromkeys(zone for row in members for zone in row["zones"]))


def _table_row(row: Row, own: Sequence[str]) -> dict[str, Any]:
    figures = shown_figures(row, own)
    return {"name": row["controller"], "front": row["pareto"], "figures": figures, "zones": row["zones"]}


def _variant(record: Mapping[str, Any]) -> dict[str, Any]:
    """Controller, options, step and, if it uses a model, identification settings."""
    scenario = record["scenario"]
    return {
        "name": record["variant"],
        "controller": record["controller"],
        "options": scenario["controller"]["options"],
        "step_s": scenario["step_s"],
        "identification": scenario["identification"] if record["needs_model"] else None,
    }


SCRIPTS = (
    "base.js", "tip.js", "looks.js", "marks.js", "pareto_panel.js", "pareto.js", "paired.js", "comparison_page.js",
)  # fmt: skip

# Of each point of a plot, by the name that the script has for it.
_POINT = {
    "name": "controller", "cost": COST, "discomfort": DISCOMFORT, "energy": "ener_tot", "fallbacks": "fallbacks",
    "pareto": "pareto",
}  # fmt: skip


def comparison_data(rows: Sequence[Row], currency: str, swept: Mapping[str, str]) -> dict[str, Any]:
    """What the scripts of the page read, see `assets/pareto.js` and `assets/paired.js`."""
    ran = finished(rows)
    names = dict.fromkeys(row["controller"] for row in ran)
    compared = [pair for name in names for pair in pairs(rows, name)]
    windows: dict[tuple[str, str], dict[str, None]] = {}
    for row in ran:
        windows.setdefault((row["price"], row["uncertainty"]), {})[row["window"]] = None
    # Swept values in the order of the sweep: the line joins them in it.
    ordered = [*(name for name in swept if name in names), *(name for name in names if name not in swept)]
    return {
        "currency": currency,
        "controllers": [{"name": name, "swept": swept.get(name)} for name in ordered],
        "groups": [
            {
                "title": group_title(group),
                "points": [{name: row[key] for name, key in _POINT.items()} for row in finished(members)],
            }
            for group, members in grouped(rows).items()
        ],
        "references": list(names) if compared else [],
        "reference": reference_of(rows),
        "paired": [
            {
                "title": tariff_title(f"{tariff[0]} tariff", tariff[1]),
                "windows": list(of),
                "differences": [_pair(pair) for pair in compared if (pair.price, pair.uncertainty) == tariff],
            }
            for tariff, of in windows.items()
        ],
    }


def _pair(pair: ControllerPair) -> dict[str, Any]:
    content: dict[str, Any] = {name: getattr(pair, name) for name in ("controller", "reference", "windows")}
    for name, of in (("cost", pair.cost_percent), ("discomfort", pair.discomfort_Kh)):
        content[name] = {"values": of.values.tolist(), "mean": of.mean, "half": of.half}
    return content
