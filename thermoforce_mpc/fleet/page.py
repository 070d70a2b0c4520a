"""What came out of a fleet, against a reference: by kind of building, who lost and why, as one self-contained page."""

from __future__ import annotations

import io
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import yaml
from markupsafe import Markup

from thermoforce_mpc.comparison.store import DONE
from thermoforce_mpc.data import Array, PlanStatus
from thermoforce_mpc.errors import counted
from thermoforce_mpc.report.page import rendered
from thermoforce_mpc.scenario.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Runs whose reference uses less than this are left out of the savings, kWh/m² a week.
LEAST_HEATING_KWH_M2 = 0.05
# Discomfort above the reference's that counts as lost comfort, K·h a week.
MORE_DISCOMFORT_KH = 0.5
# Share of the plans from which a status is named as the cause.
_OFTEN = 0.05
_CAUSES = (
    (("gate",), "the model was not competent, the building's own control stayed"),
    (("watch",), "the model did not hold, the building's own control took over"),
    (("guard",), "the guard acted instead of the plan"),
    (("acceptable", "shifted", "thermostat", "native"), "plans failed and the fallback acted"),
)
_BY = ("emitter", "machine", "mass", "source", "window", "price")
_SAME = ["building", "window", "price", "seed"]


@dataclass(frozen=True)
class RunGroup:
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


def groups(pairs: pd.DataFrame) -> list[RunGroup]:
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


def _group(by: str, value: str, rows: pd.DataFrame) -> RunGroup:
    savings, more_Kh = rows["saving"].dropna(), rows["more_Kh"]
    cheaper, colder = float((savings > 0).mean()), float((more_Kh > MORE_DISCOMFORT_KH).mean())
    return RunGroup(by, value, len(rows), savings.size, _percentiles(savings), cheaper, _percentiles(more_Kh), colder)


def _percentiles(values: pd.Series) -> tuple[float, float, float]:
    low, middle, high = np.percentile(values, [10.0, 50.0, 90.0]) if len(values) else [float("nan")] * 3
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
    for statuses, cause in _CAUSES:
        if sum(plans[status] for status in statuses) / total > _OFTEN:
            return f"{what}: {cause}"
    if dearer and not colder and row["more_Kh"] < -MORE_DISCOMFORT_KH:
        return "dearer: but more comfortable than the reference"
    return f"{what}: the plans acted on their model"


_SHOWN = 20
# Points beyond these percentiles are drawn at the edge.
_EDGE = (0.5, 99.5)
_MOST_POINTS = 4000
# Marker and colour of a run by what it lost.
_MARKS = {"": ("o", "#2a78b8"), "dearer": ("^", "#d29a1c"), "less comfortable": ("x", "#c4422b")}


def fleet_page(runs: pd.DataFrame, reference: str, title: str, command: str, scenarios: Mapping[str, Scenario]) -> str:
    """The page of the dataset `runs`, against the variant `reference`; `scenarios`: what was run, by key."""
    variants = [name for name in dict.fromkeys(runs["variant"]) if name != reference]
    parts = [_part(paired(runs, name, reference), name, reference, scenarios) for name in variants]
    failed = runs[runs["status"] != DONE]
    axes = (("building", "building"), ("window", "window"), ("price", "tariff"), ("seed", "seed"))
    several = [counted(n, what) for column, what in axes if (n := runs[column].nunique()) > 1]
    plants = ", ".join(sorted(plant for plant in runs["plant"].unique() if plant))
    return rendered(
        "fleet.html.j2",
        (),
        {},
        title=title,
        command=command,
        counts=", ".join([*several, counted(len(runs), "run"), f"{len(failed)} failed"]),
        origin=f"Results of simulated buildings ({plants or 'none finished'}), not of real ones.",
        reference=reference,
        parts=[part for part in parts if part],
        several_seeds=runs["seed"].nunique() > 1,
        failed=failed.head(_SHOWN).to_dict("records"),
        more_failed=max(len(failed) - _SHOWN, 0),
        least=f"{LEAST_HEATING_KWH_M2:g}",
        more=f"{MORE_DISCOMFORT_KH:g}",
    )


def headline(everything: RunGroup, variant: str, reference: str) -> str:
    """The result in a sentence, of the group of all runs."""
    colder = f"{100 * everything.colder:.0f} %"
    saving = "saving –"
    if everything.counted:
        low, middle, high = (100 * value for value in everything.saving)
        saving = (
            f"saving {middle:+.1f} % (median; 10 to 90 %: {low:+.1f} to {high:+.1f} %), "
            f"cheaper in {100 * everything.cheaper:.0f} % of them"
        )
    return (
        f"{variant} against {reference} in {counted(everything.runs, 'run')}, {everything.counted} of which count for "
        f"the saving: {saving}; {colder} more than {MORE_DISCOMFORT_KH:g} K·h a week less comfortable."
    )


def _part(pairs: pd.DataFrame, variant: str, reference: str, scenarios: Mapping[str, Scenario]) -> dict[str, Any]:
    if pairs.empty:
        return {}
    worst, distributions = lost(pairs), groups(pairs)
    with_saving = pairs.dropna(subset=["saving"])
    return {
        "variant": variant,
        "headline": headline(distributions[0], variant, reference),
        "scatter": _scatter(with_saving) if len(with_saving) else "",
        "cumulative": _cumulative(with_saving) if len(with_saving) else "",
        "groups": distributions,
        "causes": causes(worst),
        "lost": [
            row | {"command": run_command(scenarios[row["key"]])} for row in worst.head(_SHOWN).to_dict("records")
        ],
    }


def run_command(scenario: Scenario) -> str:
    """`tf-mpc run` of a scenario, without baselines."""
    words = ["tf-mpc", "run", "--testcase", scenario.testcase, "--controller", scenario.controller.name,
             "--baselines", "", "--period", scenario.period, "--price", scenario.price,
             "--days", f"{scenario.days:.12g}", "--seed", str(scenario.seed)]  # fmt: skip
    settings = scenario.model_dump(mode="json", include={"plant", "step_s", "identification"}, exclude_defaults=True)
    if scenario.controller.options:
        settings["controller.options"] = scenario.controller.options
    for key, value in settings.items():
        text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
        words += ["--set", f"{key}={text.strip().removesuffix('...').strip()}"]
    return shlex.join(words)


def _drawing(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure  # takes time to import

    figure = Figure(figsize=(7.2, 3.2), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.grid(alpha=0.2)
    axes.axvline(0.0, color="black", linewidth=1.0)
    return figure, axes


def _svg(figure: Figure) -> Markup:
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "fleet"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    return Markup(re.sub(r'width="[^"]*" height="[^"]*"', 'width="100%"', svg[svg.index("<svg") :], count=1))


def _range(values: Array, *more: float) -> tuple[float, float]:
    low, high = np.percentile(values, _EDGE)
    low, high = min(float(low), *more), max(float(high), *more)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _scatter(pairs: pd.DataFrame) -> Markup:
    figure, axes = _drawing("saving, %", "discomfort above, K·h a week")
    saving, more = 100.0 * pairs["saving"].to_numpy(), pairs["more_Kh"].to_numpy()
    axes.set(xlim=_range(saving, 0.0), ylim=_range(more, 0.0, 2 * MORE_DISCOMFORT_KH))
    axes.axhline(MORE_DISCOMFORT_KH, color="black", linewidth=1.0, linestyle="--")
    what = pairs["why"].str.partition(":")[0].to_numpy()
    every = max(1, -(-len(pairs) // _MOST_POINTS))
    for kind, (marker, colour) in _MARKS.items():
        x, y = (
            np.clip(of[what == kind][::every], *ends)
            for of, ends in ((saving, axes.get_xlim()), (more, axes.get_ylim()))
        )
        axes.scatter(x, y, s=14, marker=marker, color=colour, alpha=0.6, linewidths=0.8)
    return _svg(figure)


def _cumulative(pairs: pd.DataFrame) -> Markup:
    figure, axes = _drawing("saving of at least, %", "share of runs, %")
    axes.set(xlim=_range(100.0 * pairs["saving"].to_numpy(), 0.0), ylim=(0.0, 100.0))
    for price, style in zip(sorted(pairs["price"].unique()), ("-", "--", ":"), strict=False):
        values = np.sort(100.0 * pairs.loc[pairs["price"] == price, "saving"].to_numpy())
        axes.plot(values, 100.0 * (1.0 - np.arange(values.size) / values.size), linestyle=style, label=price)
    axes.legend(frameon=False)
    return _svg(figure)
