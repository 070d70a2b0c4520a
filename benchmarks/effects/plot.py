"""Plot of `tf-mpc bench effects`: the effect that each model says, with its band, over the true one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.effects.asking import Answer
from benchmarks.effects.windows import WINDOWS

_COLOURS = {"competent": "C0", "not competent": "C3"}


def plot_answers(answers: Sequence[Answer], out: Path) -> Path:
    """Write `effects.png` into the folder `out`: a row for each number of days, a column for each window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    days = sorted({answer.days for answer in answers})
    figure = Figure(figsize=(3.4 * len(WINDOWS), 3.4 * len(days)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(days), len(WINDOWS), squeeze=False)
    for axes, probed in zip(grid, days, strict=True):
        for axis, window in zip(axes, WINDOWS, strict=True):
            highest = 0.0
            for verdict, colour in _COLOURS.items():
                some = [a.score(window.name) for a in answers if a.days == probed and a.verdict == verdict]
                true, said = [s.true_K for s in some], [s.said_K for s in some]
                bands = [[s.said_K - s.low_K for s in some], [s.high_K - s.said_K for s in some]]
                axis.errorbar(true, said, bands, fmt="o", ms=4, lw=1, color=colour, label=verdict)
                highest = max([highest, *true, *said])
            axis.plot([0, 1.1 * highest], [0, 1.1 * highest], "k-", lw=0.8)
            axis.set(title=f"{window.name}, {probed:g} days of probing", xlabel="true effect, K")
    for axis in grid[:, 0]:
        axis.set_ylabel("effect by the model, with its 90 % band, K")
    grid[0, 0].legend(loc="upper left", fontsize=8)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "effects.png"
    figure.savefig(path, dpi=110)
    return path
