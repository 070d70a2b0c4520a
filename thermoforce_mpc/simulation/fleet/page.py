"""The summary page of a fleet: distributions, kinds of buildings, and who lost, in one self-contained file."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import yaml
from markupsafe import Markup, escape

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

_SHOWN = 20
_WIDE, _HIGH, _LEFT, _BELOW = 720.0, 300.0, 60.0, 46.0
# Points beyond these percentiles are drawn at the edge.
_EDGE = (0.5, 99.5)
_MOST_POINTS = 4000


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


class _Axes:
    """Linear scales of a drawing."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.x_range, self.y_range = x, y

    def x(self, value: float) -> float:
        low, high = self.x_range
        return _LEFT + (min(max(value, low), high) - low) / (high - low) * (_WIDE - _LEFT - 10.0)

    def y(self, value: float) -> float:
        low, high = self.y_range
        return 10.0 + (high - min(max(value, low), high)) / (high - low) * (_HIGH - _BELOW - 10.0)

    def drawn(self, marks: str, x_label: str, y_label: str, lines: str = "") -> Markup:
        """The drawing with its axes."""
        left, bottom = _LEFT, _HIGH - _BELOW
        ticks = []
        for value in _ticks(*self.x_range):
            x = self.x(value)
            ticks.append(
                f'<path d="M{x:.1f} 10V{bottom:.1f}" stroke="currentColor" opacity="0.12"/>'
                f'<text x="{x:.1f}" y="{bottom + 16:.1f}" text-anchor="middle">{value:g}</text>'
            )
        for value in _ticks(*self.y_range):
            y = self.y(value)
            ticks.append(
                f'<path d="M{left} {y:.1f}H{_WIDE - 10}" stroke="currentColor" opacity="0.12"/>'
                f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
            )
        labels = (
            f'<text x="{(left + _WIDE) / 2}" y="{_HIGH - 8}" text-anchor="middle">{escape(x_label)}</text>'
            f'<text transform="translate(14 {bottom / 2}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>'
        )
        return Markup(
            f'<svg viewBox="0 0 {_WIDE:g} {_HIGH:g}" role="img" aria-label="{escape(y_label)} over {escape(x_label)}" '
            f'font-size="12" fill="currentColor" width="100%">{"".join(ticks)}{lines}{marks}{labels}</svg>'
        )


def _ticks(low: float, high: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10((high - low) / 3.0))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0) if (high - low) / (step * factor) <= 8.0)
    return [round(float(value), 10) for value in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]


def _range(values: Array, *more: float) -> tuple[float, float]:
    low, high = np.percentile(values, _EDGE)
    low, high = min(float(low), *more), max(float(high), *more)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _scatter(pairs: pd.DataFrame) -> Markup:
    saving, more = 100.0 * pairs["saving"].to_numpy(), pairs["more_Kh"].to_numpy()
    axes = _Axes(_range(saving, 0.0), _range(more, 0.0, 2 * MORE_DISCOMFORT_KH))
    every = max(1, -(-len(pairs) // _MOST_POINTS))
    marks = "".join(
        f'<circle cx="{axes.x(s):.1f}" cy="{axes.y(m):.1f}" r="3" opacity="0.55"{_colour(why)}>'
        f"<title>{escape(building)}, {escape(window)}, {escape(price)}: {s:+.1f} %, {m:+.2f} K·h a week"
        f"{escape(': ' + why if why else '')}</title></circle>"
        for s, m, building, window, price, why in list(
            zip(saving, more, pairs["building"], pairs["window"], pairs["price"], pairs["why"], strict=True)
        )[::every]
    )
    zero, allowed = axes.x(0.0), axes.y(MORE_DISCOMFORT_KH)
    lines = (
        f'<path d="M{zero:.1f} 10V{_HIGH - _BELOW}" stroke="currentColor"/>'
        f'<path d="M{_LEFT} {allowed:.1f}H{_WIDE - 10}" stroke="currentColor" stroke-dasharray="5 4"/>'
    )
    return axes.drawn(marks, "saving, %", "discomfort above, K·h a week", lines)


def _colour(why: str) -> str:
    if not why:
        return ' fill="#2a78b8"'
    return ' fill="#c4422b"' if why.startswith("less comfortable") else ' fill="#d29a1c"'


def _cumulative(pairs: pd.DataFrame) -> Markup:
    savings = 100.0 * pairs["saving"].to_numpy()
    axes = _Axes(_range(savings, 0.0), (0.0, 100.0))
    lines = [f'<path d="M{axes.x(0.0):.1f} 10V{_HIGH - _BELOW}" stroke="currentColor"/>']
    for place, price in enumerate(sorted(pairs["price"].unique())):
        values = np.sort(100.0 * pairs.loc[pairs["price"] == price, "saving"].to_numpy())
        share = 100.0 * (1.0 - np.arange(values.size) / values.size)
        points = " ".join(f"{axes.x(v):.1f},{axes.y(s):.1f}" for v, s in zip(values, share, strict=True))
        colour = ("#2a78b8", "#d29a1c", "#3c9a5f")[place % 3]
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
        at = f'x="{_WIDE - 16}" y="{26 + 16 * place}" text-anchor="end" style="fill:{colour}"'
        lines.append(f"<text {at}>{escape(price)}</text>")
    return axes.drawn("", "saving of at least, %", "share of runs, %", "".join(lines))
