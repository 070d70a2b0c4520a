"""Evaluation of a comparison: one row per cell, best values, Pareto front, and differences over the same windows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from thermoforce_mpc.data import Array, PlanStatus
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.simulation.comparison.results_json import Target
from thermoforce_mpc.simulation.comparison.store import DONE
from thermoforce_mpc.simulation.own_kpis import own_of

COST, DISCOMFORT = "cost_tot", "tdis_tot"
KPIS = (COST, DISCOMFORT, "ener_tot", "emis_tot", "pele_tot")
# Tolerances within which two results are equal: relative for cost, K·h for discomfort.
_COST_TIE, _DISCOMFORT_TIE_KH = 1e-4, 0.005
# Comparable comfort: at most so many times the least discomfort of the group, or so much more, K·h.
_COMPARABLE, _COMPARABLE_KH = 2.0, 0.5
_AS_PLANNED = {PlanStatus.SOLVED.value, PlanStatus.RULE.value}

Row = dict[str, Any]


def outcome_rows(records: Iterable[Mapping[str, Any]]) -> list[Row]:
    """One row per cell, in the order given; units as in the KPIs of BOPTEST, times in s and ms.

    `zones` has the discomfort of each zone by name, K·h; it is empty where there is one zone. `own` has KPIs of the
    user's, by name and unit. `saving` is the cost
    saved against a thermostat that is as comfortable, %, and `equal_comfort` that in words, where it was searched.

    `comparable` (to the least discomfort), `best_cost` (of those that are comparable), `best_discomfort` and `pareto`
    (no other cell dominates it) refer to the cells of one group.
    Failed cells have None for every figure and a `reason`.
    """
    rows = [_row(record) for record in records]
    for group in grouped(rows).values():
        finished = [row for row in group if row["status"] == DONE]
        least = min((row[DISCOMFORT] for row in finished), default=0.0)
        for row in finished:
            row["comparable"] = row[DISCOMFORT] <= _most_comparable(least)
        for row in finished:
            row["best_cost"] = row["comparable"] and not any(_cheaper(o, row) for o in finished if o["comparable"])
            row["best_discomfort"] = row[DISCOMFORT] <= least + _DISCOMFORT_TIE_KH
            row["pareto"] = not any(dominates(other, row) for other in finished)
    return rows


def _most_comparable(least_Kh: float) -> float:
    return max(_COMPARABLE * least_Kh, least_Kh + _COMPARABLE_KH)


def best_values(everyone: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Least of each KPI among the controllers whose discomfort is comparable to the least; of discomfort, of all."""
    least = min((kpis[DISCOMFORT] for kpis in everyone.values() if DISCOMFORT in kpis), default=math.inf)
    warm = [kpis for kpis in everyone.values() if kpis.get(DISCOMFORT, least) <= _most_comparable(least)]
    best: dict[str, float] = {}
    for kpis in warm:
        for key, value in kpis.items():
            if math.isfinite(value):
                best[key] = min(value, best.get(key, math.inf))
    return best


def ranked(rows: Iterable[Row]) -> list[Row]:
    """The rows of a group by cost, those of comparable comfort first, failed ones last."""
    return sorted(rows, key=lambda row: (row["status"] != DONE, not row["comparable"], row[COST] or 0.0))


def grouped(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Rows grouped by window, tariff and forecast error level, in their order."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["window"], row["price"], row["uncertainty"]), []).append(row)
    return groups


def group_title(group: tuple[str, str, str]) -> str:
    """Title of a group in tables and plots."""
    window, price, uncertainty = group
    day = f"day {window}" if window[:1].isdigit() else window
    return f"{day}, {price} tariff" + ("" if uncertainty == "none" else f", {uncertainty} forecast error")


def dominates(row: Row, other: Row) -> bool:
    """Whether `row` is no worse than `other` in cost and in discomfort, and better in one of them."""
    calmer = row[DISCOMFORT] < other[DISCOMFORT] - _DISCOMFORT_TIE_KH
    harsher = row[DISCOMFORT] > other[DISCOMFORT] + _DISCOMFORT_TIE_KH
    return (_cheaper(row, other) or calmer) and not _cheaper(other, row) and not harsher


def _cheaper(row: Row, other: Row) -> bool:
    """Whether `row` costs less; costs may be 0, and negative where prices are."""
    tie = _COST_TIE * max(abs(row[COST]), abs(other[COST]))
    return bool(row[COST] < other[COST] - tie)


def verdicts(rows: Iterable[Row]) -> list[str]:
    """Findings, one or more sentences per group: best values, and comparisons that a baseline wins.

    A baseline is a controller without a model. It beats a model-based controller where it dominates it; a baseline that
    is only cheaper or only more comfortable is listed too.
    """
    lines: list[str] = []
    for group, members in grouped(rows).items():
        title = group_title(group)
        finished = [row for row in members if row["status"] == DONE]
        if not finished:
            lines.append(f"{title}: no result")
            continue
        cheapest = [row for row in finished if row["best_cost"]]
        calmest = [row for row in finished if row["best_discomfort"]]
        least = calmest[0][DISCOMFORT]
        lines.append(
            f"{title}: cheapest at comparable comfort (at most {_most_comparable(least):.2f} K·h) {_names(cheapest)} "
            f"({cheapest[0][COST]:.4f}), least discomfort {_names(calmest)} ({least:.2f} K·h)"
        )
        colder = [row for row in finished if not row["comparable"] and _cheaper(row, cheapest[0])]
        lines += [
            f"{title}: {row['controller']} costs less ({row[COST]:.4f}) with {row[DISCOMFORT]:.2f} K·h of discomfort"
            for row in colder
        ]
        baselines = [row for row in finished if not row["needs_model"]]
        for row in finished:
            if row["needs_model"]:
                lines += [f"{title}: {row['controller']} costs {row['equal_comfort']}"] * bool(row["equal_comfort"])
                lines += [f"{title}: {text}" for text in _losses(row, baselines)]
    return lines


def cost_targets(rows: Iterable[Row]) -> list[Target]:
    """One target per model-based cell: cost relative to the thermostat (else the cheapest baseline), at most 1.

    None in groups where that costs nothing, or earns: there is no share of it.
    """
    targets: list[Target] = []
    for group, members in grouped(rows).items():
        finished = [row for row in members if row["status"] == DONE]
        baselines = {row["controller"]: row for row in finished if not row["needs_model"]}
        if not baselines:
            continue
        name = "thermostat" if "thermostat" in baselines else min(baselines, key=lambda key: baselines[key][COST])
        if baselines[name][COST] <= 0:
            continue
        for row in finished:
            if row["needs_model"]:
                label = f"{group_title(group)}: cost of {row['controller']} over {name}"
                targets.append(Target(label, row[COST] / baselines[name][COST], 1.0))
    return targets


def failures(rows: Iterable[Row]) -> list[Row]:
    """The rows of failed cells."""
    return [row for row in rows if row["status"] != DONE]


def _names(rows: Sequence[Row]) -> str:
    return ", ".join(str(row["controller"]) for row in rows)


def _losses(row: Row, baselines: Sequence[Row]) -> list[str]:
    texts = []
    for baseline in baselines:
        pair = (
            f"({baseline[COST]:.4f} / {baseline[DISCOMFORT]:.2f} K·h against {row[COST]:.4f} / "
            f"{row[DISCOMFORT]:.2f} K·h)"
        )
        if dominates(baseline, row):
            texts.append(f"baseline {baseline['controller']} beats {row['controller']} {pair}")
        elif _cheaper(baseline, row):
            texts.append(f"baseline {baseline['controller']} is cheaper than {row['controller']} {pair}")
        elif baseline[DISCOMFORT] < row[DISCOMFORT] - _DISCOMFORT_TIE_KH:
            texts.append(f"baseline {baseline['controller']} is more comfortable than {row['controller']} {pair}")
    return texts


def _row(record: Mapping[str, Any]) -> Row:
    is_done = record["status"] == DONE
    kpis = record["kpis"] if is_done else {}
    seconds = record["seconds"] if is_done else {}
    equal = record.get("equal_comfort", {}) if is_done else {}
    return {
        "window": record["window"],
        "price": record["price"],
        "uncertainty": record["uncertainty"],
        "controller": record["variant"],
        "needs_model": record["needs_model"],
        "status": record["status"],
        **{name: kpis.get(name) for name in KPIS},
        "zones": zone_kpis(kpis),
        "own": own_of(kpis),
        "saving": None if (saving := equal.get("saving")) is None else 100.0 * saving,
        "equal_comfort": equal.get("in_words", ""),
        "comparable": False,
        "best_cost": False,
        "best_discomfort": False,
        "pareto": False,
        "fallbacks": sum(n for level, n in record["fallback_levels"].items() if level not in _AS_PLANNED)
        if is_done
        else None,
        "plan_ms": 1e3 * seconds["plan_median"] if is_done else None,
        "controller_s": seconds.get("controller"),
        "plant_s": seconds.get("plant"),
        "reason": record["reason"],
    }


# Probability with which an interval holds the mean.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """Differences of n windows, their mean, and the half width of its interval; None of one window."""

    values: Array
    mean: float
    half: float | None

    @classmethod
    def of(cls, values: Array) -> Difference:
        """The differences `values` (n,) of n ≥ 1 windows."""
        n = values.size
        half = None
        if n > 1:
            from scipy.special import stdtrit  # takes time to import, which `--help` need not wait for

            spread = float(values.std(ddof=1)) / np.sqrt(n)
            half = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2)) * spread
        return cls(values, float(values.mean()), half)


@dataclass(frozen=True)
class Pair:
    """A controller and a reference under one tariff and forecast error level, on the windows that both finished.

    `cost_percent`: difference of cost, % of the reference's; `discomfort_Kh`: difference of discomfort, K·h.
    """

    controller: str
    reference: str
    price: str
    uncertainty: str
    windows: tuple[str, ...]
    cost_percent: Difference
    discomfort_Kh: Difference


def reference_of(rows: Iterable[Row]) -> str | None:
    """The controller to compare with: the thermostat, else the cheapest without a model, else the first."""
    finished = [row for row in rows if row["status"] == DONE]
    without = [row for row in finished if not row["needs_model"]]
    if any(row["controller"] == "thermostat" for row in without):
        return "thermostat"
    cheapest = min(without, key=lambda row: float(row[COST]), default=None) or next(iter(finished), None)
    return None if cheapest is None else str(cheapest["controller"])


def pairs(rows: Iterable[Row], reference: str) -> list[Pair]:
    """Every controller beside `reference`, by tariff and forecast error level, in the order of the rows."""
    finished = [row for row in rows if row["status"] == DONE]
    compared = []
    for price, uncertainty in dict.fromkeys((row["price"], row["uncertainty"]) for row in finished):
        by_controller: dict[str, dict[str, Row]] = {}
        for row in finished:
            if (row["price"], row["uncertainty"]) == (price, uncertainty):
                by_controller.setdefault(row["controller"], {})[row["window"]] = row
        beside = by_controller.get(reference, {})
        for controller, of in by_controller.items():
            # Without a cost there is no share of it.
            windows = tuple(window for window in of if window in beside and beside[window][COST] > 0)
            if controller == reference or not windows:
                continue
            cost = [100.0 * (of[w][COST] / beside[w][COST] - 1.0) for w in windows]
            discomfort = [of[w][DISCOMFORT] - beside[w][DISCOMFORT] for w in windows]
            compared.append(
                Pair(
                    controller,
                    reference,
                    price,
                    uncertainty,
                    windows,
                    Difference.of(np.array(cost)),
                    Difference.of(np.array(discomfort)),
                )
            )
    return compared


def in_words(difference: Difference, digits: int) -> str:
    """'−3.1 (−4.0 to −2.2)'."""
    mean = f"{difference.mean:+.{digits}f}"
    if difference.half is None:
        return mean
    low, high = difference.mean - difference.half, difference.mean + difference.half
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"
