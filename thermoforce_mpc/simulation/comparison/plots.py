"""Plot of cost against discomfort, one panel per group (window, tariff, forecast error level)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from thermoforce_mpc.simulation.comparison.outcome import COST, DISCOMFORT, Row, group_title, grouped
from thermoforce_mpc.simulation.comparison.store import DONE
from thermoforce_mpc.simulation.report.plots import BASELINE_COLOURS, FORCED, INK, QUIET

_PANEL_INCHES, _COLUMNS = (5.5, 4.3), 2
# Linear range of the symmetric logarithmic axis: discomfort spans orders of magnitude and may be zero.
_LINEAR_BELOW_KH = 0.5
# Up to this many points are labelled directly; more get a legend.
_MOST_LABELS = 5
_MARKERS = "o^Dv<>ph"


def pareto_figure(rows: Sequence[Row], currency: str, swept: Mapping[str, str] | None = None) -> Figure:
    """Figure with one panel per group.

    Args:
        rows: result of `outcome_rows`; failed cells are left out.
        currency: currency of the cost axis.
        swept: labels, by controller, of the points connected by a line, in its order.
    """
    done = [row for row in rows if row["status"] == DONE]
    groups = grouped(done)
    names = list(dict.fromkeys(row["controller"] for row in done))
    colours = (FORCED, "#1f5a99", *BASELINE_COLOURS)
    colour = {name: colours[i % len(colours)] for i, name in enumerate(n for n in names if n not in (swept or {}))}
    columns = min(_COLUMNS, max(len(groups), 1))
    lines = -(-len(groups) // columns) or 1
    figure = Figure(figsize=(_PANEL_INCHES[0] * columns, _PANEL_INCHES[1] * lines), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    for axis, (group, members) in zip(axes, groups.items(), strict=False):
        _panel(axis, members, colour, swept or {})
        axis.set_title(group_title(group), loc="left", fontsize=10)
        axis.set_xlabel("discomfort, K·h")
        axis.set_ylabel(f"cost, {currency}/m²")
    for axis in axes[len(groups) :]:
        axis.set_visible(False)
    named: dict[str, Artist] = {}
    for axis in axes:
        named |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    if named:
        figure.legend(
            list(named.values()),
            list(named),
            loc="outside lower center",
            ncols=2 * columns,
            frameon=False,
            fontsize=8,
        )
    return figure


def png_bytes(figure: Figure) -> bytes:
    """The figure as PNG with reproducible bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    return buffer.getvalue()


def _panel(axis: Axes, rows: Sequence[Row], colour: Mapping[str, str], swept: Mapping[str, str]) -> None:
    by_name = {row["controller"]: row for row in rows}
    front = sorted((row for row in rows if row["pareto"]), key=lambda row: (row[DISCOMFORT], -row[COST]))
    if front:
        axis.step([r[DISCOMFORT] for r in front], [r[COST] for r in front], where="post", color=QUIET, linewidth=0.8)
    line = [(by_name[name], label) for name, label in swept.items() if name in by_name]
    if line:
        axis.plot([r[DISCOMFORT] for r, _ in line], [r[COST] for r, _ in line], "o-", color=FORCED, markersize=4)
    others = [row for name, row in by_name.items() if name not in swept]
    crowded = len(others) > _MOST_LABELS
    for row in others:
        name = row["controller"]
        shape = _MARKERS[list(colour).index(name) // 3 % len(_MARKERS)] if row["needs_model"] else "s"
        label = name if crowded else None
        axis.plot(row[DISCOMFORT], row[COST], shape, color=colour[name], markersize=7, alpha=0.85, label=label)
    labelled = line + ([] if crowded else [(row, row["controller"]) for row in others])
    for i, (row, text) in enumerate(labelled):
        axis.annotate(
            text,
            (row[DISCOMFORT], row[COST]),
            xytext=(6, 5 if i % 2 == 0 else -11),
            textcoords="offset points",
            fontsize=8,
            color=INK,
        )
    axis.set_xscale("symlog", linthresh=_LINEAR_BELOW_KH)
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.margins(0.18)
    axis.set_xlim(left=-0.05)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
