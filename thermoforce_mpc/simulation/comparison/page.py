"""The page of a comparison: Pareto plots, confidence over windows, tables and findings in one self-contained file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.simulation.comparison.outcome import COST, DISCOMFORT, Row, group_title, grouped
from thermoforce_mpc.simulation.comparison.paired import CONFIDENCE, Difference, pairs, reference_of
from thermoforce_mpc.simulation.comparison.store import DONE
from thermoforce_mpc.simulation.report.page import rendered

SCRIPTS = (
    "base.js",
    "tip.js",
    "looks.js",
    "marks.js",
    "pareto_panel.js",
    "pareto.js",
    "paired.js",
    "comparison_page.js",
)

# Of each point of a plot, by the name that the script has for it.
_POINT = {
    "name": "controller", "cost": COST, "discomfort": DISCOMFORT, "energy": "ener_tot", "fallbacks": "fallbacks",
    "pareto": "pareto",
}  # fmt: skip


def comparison_page(rows: Sequence[Row], currency: str, swept: Mapping[str, str] | None = None, **values: Any) -> str:
    """The page of the rows of a comparison.

    Args:
        rows: result of `outcome_rows`.
        currency: currency of the costs.
        swept: labels, by variant, of the points that a line connects.
        values: what the template says beside the plots.
    """
    data = comparison_data(rows, currency, swept or {})
    return rendered(
        "comparison.html.j2", SCRIPTS, data, paired=bool(data["references"]), confidence=CONFIDENCE, **values
    )


def comparison_data(rows: Sequence[Row], currency: str, swept: Mapping[str, str]) -> dict[str, Any]:
    """What the scripts of the page read, see `assets/pareto.js` and `assets/paired.js`."""
    finished = [row for row in rows if row["status"] == DONE]
    names = dict.fromkeys(row["controller"] for row in finished)
    compared = [pair for name in names for pair in pairs(rows, name)]
    return {
        "currency": currency,
        # Swept values in the order of the sweep: the line joins them in it.
        "controllers": [
            {"name": name, "swept": swept.get(name)}
            for name in [*(name for name in swept if name in names), *(name for name in names if name not in swept)]
        ],
        "groups": [
            {
                "title": group_title(group),
                "points": [
                    {name: row[key] for name, key in _POINT.items()} for row in members if row["status"] == DONE
                ],
            }
            for group, members in grouped(rows).items()
        ],
        "references": list(names) if compared else [],
        "reference": reference_of(rows),
        "paired": [
            {
                "title": _set_title(price, uncertainty),
                "windows": list(
                    dict.fromkeys(
                        r["window"] for r in finished if (r["price"], r["uncertainty"]) == (price, uncertainty)
                    )
                ),
                "differences": [
                    {
                        "controller": pair.controller,
                        "reference": pair.reference,
                        "windows": pair.windows,
                        "cost": _difference(pair.cost_percent),
                        "discomfort": _difference(pair.discomfort_Kh),
                    }
                    for pair in compared
                    if (pair.price, pair.uncertainty) == (price, uncertainty)
                ],
            }
            for price, uncertainty in dict.fromkeys((r["price"], r["uncertainty"]) for r in finished)
        ],
    }


def _set_title(price: str, uncertainty: str) -> str:
    return f"{price} tariff" + ("" if uncertainty == "none" else f", {uncertainty} forecast error")


def _difference(difference: Difference) -> dict[str, Any]:
    return {"values": difference.values.tolist(), "mean": difference.mean, "half": difference.half}
