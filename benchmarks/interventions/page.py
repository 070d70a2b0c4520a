"""Self-contained HTML page of a bench result: targets, tables, embedded figures."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup


def write_page(path: Path, result: Mapping[str, Any], figures: Mapping[str, Path]) -> None:
    """Write the page of `result` (a dictionary of `results_json`) with SVG `figures` by caption."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("benchmarks.interventions", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["cell"] = _cell
    # Rows with the same columns form one table.
    tables = [
        {"columns": list(columns), "rows": [list(row.values()) for row in rows]}
        for columns, rows in groupby(result["rows"], key=tuple)
    ]
    # Element ids repeat between figures; they must be unique within a page.
    drawn = {
        name: Markup(_only_svg(re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{name}-", file.read_text(encoding="utf-8"))))
        for name, file in figures.items()
    }
    page = environment.get_template("interventions.html.j2").render(result=result, tables=tables, figures=drawn)
    path.write_text(page, encoding="utf-8")


def _only_svg(text: str) -> str:
    """The <svg> element without the XML prologue, which is invalid inside HTML."""
    return text[text.index("<svg") :]


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
