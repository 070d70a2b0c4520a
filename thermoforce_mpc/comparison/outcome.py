"""Evaluation of a comparison: one row per cell, best values, Pareto front, and differences over the same windows.

JSON of comparisons and benchmarks: rows of figures, and targets with whether they are met.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from thermoforce_mpc.comparison.cells import SEED
from thermoforce_mpc.comparison.store import DONE
from thermoforce_mpc.data import Array, PlanStatus
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.records.run_folder import environment, own_of
from thermoforce_mpc.report.findings import COST, DISCOMFORT, most_comparable_Kh


@dataclass(frozen=True)
class Target:
    """Target of a figure: `value` must be at most (or at least) `goal`. NaN does not meet it."""

    name: str
    value: float
    goal: float
    sense: Literal["at most", "at least"] = "at most"

    @property
    def holds(self) -> bool:
        """Whether the goal is met."""
        if math.isnan(self.value):
            return False
        return self.value <= self.goal if self.sense == "at most" else self.value >= self.goal


def results_json(name: str, rows: Iterable[Mapping[str, Any]], targets: Iterable[Target]) -> dict[str, Any]:
    """Rows and targets of a comparison or benchmark as a JSON object, with command and environment."""
    return {
        "bench": name,
        "command": " ".join(["tf-mpc", *sys.argv[1:]]),
        "environment": environment(),
        "rows": [dict(row) for row in rows],
        "targets": [asdict(target) | {"holds": target.holds} for target in targets],
    }


KPIS = (COST, DISCOMFORT, "ener_tot", "emis_tot", "pele_tot")
# Tolerances within which two results are equal: relative for cost, K·h for discomfort.
_COST_TIE, _DISCOMFORT_TIE_KH = 1e-4, 0.005
# What is no fallback: also levels that were checked and not shown to be the best ones, as all of a trained policy are.
_AS_PLANNED = {PlanStatus.SOLVED.value, PlanStatus.ACCEPTABLE.value, PlanStatus.RULE.value}

Row = dict[str, Any]


def outcome_rows(records: Iterable[Mapping[str, Any]]) -> list[Row]:
    """One row per cell, in the order given; units as in the KPIs of BOPTEST, times in s and ms.

    `zones`: discomfort of each zone by name, K·h, empty where there is one. `own`: KPIs of the user's, by name and
    unit. `saving`: cost saved against a thermostat that is as comfortable, %, and `equal_comfort` that in words, where
    it was searched. `comparable` (to the least discomfort), `best_cost` (of those), `best_discomfort` and `pareto` (no
    other cell dominates it) refer to the cells of one group. Failed cells have None for every figure and a `reason`.
    """
    rows = [_row(record) for record in records]
    for group in grouped(rows).values():
        ran = finished(group)
        least = min((row[DISCOMFORT] for row in ran), default=0.0)
        for row in ran:
            row["comparable"] = row[DISCOMFORT] <= most_comparable_Kh(least)
        for row in ran:
            row["best_cost"] = row["comparable"] and not any(_cheaper(o, row) for o in ran if o["comparable"])
            row["best_discomfort"] = row[DISCOMFORT] <= least + _DISCOMFORT_TIE_KH
            row["pareto"] = not any(dominates(other, row) for other in ran)
    return rows


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
    return f"{f'day {window}' if window[:1].isdigit() else window}, {tariff_title(f'{price} tariff', uncertainty)}"


def tariff_title(price: str, uncertainty: str) -> str:
    """A tariff, with the forecast error level where there is one."""
    return price + ("" if uncertainty == "none" else f", {uncertainty} forecast error")


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
    """Findings, one or more sentences per group: best values, and comparisons won by a controller without a model."""
    lines: list[str] = []
    for group, members in grouped(rows).items():
        title = group_title(group)
        ran = finished(members)
        if not ran:
            lines.append(f"{title}: no result")
            continue
        cheapest = [row for row in ran if row["best_cost"]]
        calmest = [row for row in ran if row["best_discomfort"]]
        least = calmest[0][DISCOMFORT]
        lines.append(
            f"{title}: cheapest at comparable comfort (at most {most_comparable_Kh(least):.2f} K·h) {_names(cheapest)} "
            f"({cheapest[0][COST]:.4f}), least discomfort {_names(calmest)} ({least:.2f} K·h)"
        )
        lines += [
            f"{title}: {row['controller']} costs less ({row[COST]:.4f}) with {row[DISCOMFORT]:.2f} K·h of discomfort"
            for row in ran
            if not row["comparable"] and _cheaper(row, cheapest[0])
        ]
        baselines = [row for row in ran if not row["needs_model"]]
        for row in (row for row in ran if row["needs_model"]):
            lines += [f"{title}: {row['controller']} costs {row['equal_comfort']}"] * bool(row["equal_comfort"])
            lines += [f"{title}: {text}" for text in _losses(row, baselines)]
    return lines


def cost_targets(rows: Iterable[Row]) -> list[Target]:
    """One target per model-based cell: cost relative to the thermostat (else the cheapest baseline), at most 1.

    None in groups where that costs nothing, or earns: there is no share of it.
    """
    targets: list[Target] = []
    for group, members in grouped(rows).items():
        ran = finished(members)
        baselines = {row["controller"]: row[COST] for row in ran if not row["needs_model"]}
        if not baselines:
            continue
        name = "thermostat" if "thermostat" in baselines else min(baselines, key=lambda key: baselines[key])
        if baselines[name] > 0:
            label = f"{group_title(group)}: cost of {{}} over {name}"
            costs = {row["controller"]: row[COST] for row in ran if row["needs_model"]}
            targets += [Target(label.format(who), cost / baselines[name], 1.0) for who, cost in costs.items()]
    return targets


def failures(rows: Iterable[Row]) -> list[Row]:
    """The rows of failed cells."""
    return [row for row in rows if row["status"] != DONE]


def finished(rows: Iterable[Row]) -> list[Row]:
    """The rows of cells that were run."""
    return [row for row in rows if row["status"] == DONE]


def _names(rows: Sequence[Row]) -> str:
    return ", ".join(str(row["controller"]) for row in rows)


def _losses(row: Row, baselines: Sequence[Row]) -> Iterator[str]:
    for baseline in baselines:
        if dominates(baseline, row):
            how = "beats"
        elif _cheaper(baseline, row):
            how = "is cheaper than"
        elif baseline[DISCOMFORT] < row[DISCOMFORT] - _DISCOMFORT_TIE_KH:
            how = "is more comfortable than"
        else:
            continue
        figures = " against ".join(f"{one[COST]:.4f} / {one[DISCOMFORT]:.2f} K·h" for one in (baseline, row))
        yield f"baseline {baseline['controller']} {how} {row['controller']} ({figures})"


def _row(record: Mapping[str, Any]) -> Row:
    is_done = record["status"] == DONE
    kpis, seconds, equal = (record.get(of, {}) if is_done else {} for of in ("kpis", "seconds", "equal_comfort"))
    fallbacks = (n for level, n in record.get("fallback_levels", {}).items() if level not in _AS_PLANNED)
    return {
        **{name: record[name] for name in ("window", "price", "uncertainty")},
        "controller": record["variant"],
        **{name: record[name] for name in ("needs_model", "status")},
        **{name: kpis.get(name) for name in KPIS},
        "zones": zone_kpis(kpis),
        "own": own_of(kpis),
        "saving": None if (saving := equal.get("saving")) is None else 100.0 * saving,
        "equal_comfort": equal.get("in_words", ""),
        **dict.fromkeys(("comparable", "best_cost", "best_discomfort", "pareto"), False),
        "fallbacks": sum(fallbacks) if is_done else None,
        "plan_ms": 1e3 * seconds["plan_median"] if is_done else None,
        "controller_s": seconds.get("controller"),
        "plant_s": seconds.get("plant"),
        "reason": record["reason"],
    }


# Probability with which an interval holds the mean.
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """Differences of n windows, their mean, and the half width of its interval; None of one window or two."""

    values: Array
    mean: float
    half: float | None

    @classmethod
    def of(cls, values: Array) -> Difference:
        """The differences `values` (n,) of n ≥ 1 windows."""
        from scipy.special import stdtrit  # takes time to import, which `--help` need not wait for

        n, half = values.size, None
        if n > 2:
            half = float(stdtrit(n - 1, 0.5 + CONFIDENCE / 2)) * float(values.std(ddof=1)) / np.sqrt(n)
        return cls(values, float(values.mean()), half)


@dataclass(frozen=True)
class ControllerPair:
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
    ran = finished(rows)
    without = [row for row in ran if not row["needs_model"]]
    if any(row["controller"] == "thermostat" for row in without):
        return "thermostat"
    cheapest = min(without, key=lambda row: float(row[COST]), default=None) or next(iter(ran), None)
    return None if cheapest is None else str(cheapest["controller"])


def pairs(rows: Iterable[Row], reference: str) -> list[ControllerPair]:
    """Every controller beside `reference`, by tariff and forecast error level, in the order of the rows.

    Seeds of a window that change nothing, as of a rule beside a rule, are one window: repeated they would narrow the
    interval to nothing.
    """
    compared = []
    by_set: dict[tuple[str, str], dict[str, dict[str, Row]]] = {}
    for row in finished(rows):
        of_set = by_set.setdefault((row["price"], row["uncertainty"]), {})
        of_set.setdefault(row["controller"], {})[row["window"]] = row
    for tariff, by_controller in by_set.items():
        beside = by_controller.get(reference, {})
        for controller, of in by_controller.items():
            # Without a cost there is no share of it.
            both_ran = [window for window in of if window in beside and beside[window][COST] > 0]
            windows = tuple(
                {_result(window, of[window], beside[window]): window for window in reversed(both_ran)}.values()
            )
            windows = windows[::-1]
            if controller != reference and windows:
                cost = np.array([100.0 * (of[w][COST] / beside[w][COST] - 1.0) for w in windows])
                discomfort = np.array([of[w][DISCOMFORT] - beside[w][DISCOMFORT] for w in windows])
                both = Difference.of(cost), Difference.of(discomfort)
                compared.append(ControllerPair(controller, reference, *tariff, windows, *both))
    return compared


def _result(window: str, *rows: Row) -> tuple[object, ...]:
    """What tells a window of a comparison from others: its name without the seed, and what came of it."""
    return window.partition(SEED)[0], *(row[key] for row in rows for key in (COST, DISCOMFORT))


def in_words(difference: Difference, digits: int) -> str:
    """'−3.1 (−4.0 to −2.2)'."""
    mean = f"{difference.mean:+.{digits}f}"
    if difference.half is None:
        return mean
    low, high = difference.mean - difference.half, difference.mean + difference.half
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"
