"""What came out of a fleet: saving and discomfort against a reference, by kind of building, and who lost and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from thermoforce_mpc.data import PlanStatus
from thermoforce_mpc.simulation.comparison.store import DONE

# Runs whose reference uses less than this are left out of the savings, kWh/m² a week.
LEAST_HEATING_KWH_M2 = 0.05
# Discomfort above the reference's that counts as lost comfort, K·h a week.
MORE_DISCOMFORT_KH = 0.5
# Share of the plans from which a status is named as the cause.
_OFTEN = 0.05
_BY = ("emitter", "machine", "mass", "source", "window", "price")
_SAME = ["building", "window", "price", "seed"]


@dataclass(frozen=True)
class Group:
    """Distribution over the runs of one kind: `by` and `value` say which.

    `runs`, of which `counted` have a saving. `saving`: 10th, 50th and 90th percentile, relative to the cost of the
    reference; `cheaper`: share of the counted runs. `more_Kh`: the same percentiles of discomfort above the reference,
    K·h a week; `colder`: share of runs above `MORE_DISCOMFORT_KH`. NaN where there is none.
    """

    by: str
    value: str
    runs: int
    counted: int
    saving: tuple[float, float, float]
    cheaper: float
    more_Kh: tuple[float, float, float]
    colder: float


def paired(runs: pd.DataFrame, variant: str, reference: str) -> pd.DataFrame:
    """The finished runs of `variant` beside the same of `reference`.

    Adds the columns `saving` (NaN where the reference hardly heats, costs nothing or earns), `more_Kh` (discomfort
    above the reference's, K·h a week), `cost_ref`, `tdis_ref`, and `why`: what the run lost by, '' where it lost
    nothing.
    """
    finished = runs[runs["status"] == DONE]
    of_variant, of_reference = finished[finished["variant"] == variant], finished[finished["variant"] == reference]
    pairs = of_variant.merge(
        of_reference[[*_SAME, "cost_tot", "tdis_tot", "ener_tot"]], on=_SAME, suffixes=("", "_ref")
    )
    pairs = pairs.rename(columns={"cost_tot_ref": "cost_ref", "tdis_tot_ref": "tdis_ref"})
    weeks = pairs["days"] / 7.0
    heated = pairs["ener_tot_ref"] / weeks >= LEAST_HEATING_KWH_M2
    # Of a cost of 0 or less there is no share; which of two such costs is the lower is known.
    share = heated & (pairs["cost_ref"] > 0.0)
    pairs["saving"] = 1.0 - pairs["cost_tot"] / pairs["cost_ref"].where(share)
    pairs["dearer"] = heated & (pairs["cost_tot"] > pairs["cost_ref"])
    pairs["more_Kh"] = (pairs["tdis_tot"] - pairs["tdis_ref"]) / weeks
    pairs["why"] = [_why(row) for _, row in pairs.iterrows()] if len(pairs) else []
    return pairs


def groups(pairs: pd.DataFrame) -> list[Group]:
    """All runs, then those of every kind by each property in which the fleet differs."""
    distributions = [_group("all", "", pairs)]
    for by in _BY:
        values = sorted(value for value in pairs[by].unique() if value)
        if len(values) > 1:
            distributions += [_group(by, value, pairs[pairs[by] == value]) for value in values]
    return distributions


def lost(pairs: pd.DataFrame) -> pd.DataFrame:
    """The runs that lost something, the most first: comfort before cost."""
    rows = pairs[pairs["why"] != ""].copy()
    rows["colder"] = rows["more_Kh"] > MORE_DISCOMFORT_KH
    order = rows.assign(by=np.where(rows["colder"], rows["more_Kh"], -rows["saving"].fillna(0.0)))
    return order.sort_values(["colder", "by"], ascending=False).drop(columns="by")


def causes(rows: pd.DataFrame) -> list[tuple[str, int]]:
    """Causes of what was lost, with how many runs each has, the most frequent first."""
    return [(str(cause), int(n)) for cause, n in rows["why"].value_counts().items()]


def _group(by: str, value: str, rows: pd.DataFrame) -> Group:
    savings = rows["saving"].dropna().to_numpy()
    return Group(
        by,
        value,
        len(rows),
        savings.size,
        _percentiles(savings),
        float((savings > 0).mean()) if savings.size else float("nan"),
        _percentiles(rows["more_Kh"].to_numpy()),
        float((rows["more_Kh"] > MORE_DISCOMFORT_KH).mean()) if len(rows) else float("nan"),
    )


def _percentiles(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    if not len(values):
        return float("nan"), float("nan"), float("nan")
    low, middle, high = np.percentile(values, [10.0, 50.0, 90.0])
    return float(low), float(middle), float(high)


def _why(row: pd.Series) -> str:
    """What a run lost by, in words; '' where it is neither dearer nor less comfortable than the reference."""
    colder, dearer = row["more_Kh"] > MORE_DISCOMFORT_KH, row["dearer"]
    if not (colder or dearer):
        return ""
    # Those that were refused have a status too.
    plans = {status.value: row[f"plans_{status.value}"] for status in PlanStatus}
    total = max(sum(plans.values()), 1)
    what = "less comfortable" if colder else "dearer"
    if plans["rule"] == total:
        return what
    if plans["gate"] / total > _OFTEN:
        return f"{what}: the model was not competent, the building's own control stayed"
    if plans["watch"] / total > _OFTEN:
        return f"{what}: the model did not hold, the building's own control took over"
    if plans["guard"] / total > _OFTEN:
        return f"{what}: the guard acted instead of the plan"
    if sum(plans[name] for name in ("acceptable", "shifted", "thermostat", "native")) / total > _OFTEN:
        return f"{what}: plans failed and the fallback acted"
    if dearer and not colder and row["more_Kh"] < -MORE_DISCOMFORT_KH:
        return "dearer: but more comfortable than the reference"
    return f"{what}: the plans acted on their model"
