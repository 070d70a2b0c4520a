"""The summary page of a fleet: distributions, kinds of buildings, and who lost, in one self-contained file."""

from __future__ import annotations

import io
import re
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import yaml
from markupsafe import Markup

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import counted
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.comparison.store import DONE
from thermoforce_mpc.simulation.fleet.summary import (
    LEAST_HEATING_KWH_M2,
    MORE_DISCOMFORT_KH,
    Group,
    causes,
    groups,
    lost,
    paired,
)
from thermoforce_mpc.simulation.report.page import rendered

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def headline(everything: Group, variant: str, reference: str) -> str:
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
