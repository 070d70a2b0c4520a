"""Draw the picture of the README from a run folder: `python -m tools.site.run_picture RUN docs/assets/run.png`."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

INK, FREE, FORCED, BAND, QUIET = "#1b1f24", "#228b22", "#b22222", "#dfeaf5", "#8a6d3b"
DAY_S = 86400.0


def draw(run: Path, out: Path) -> None:
    """Zone temperature beside the thermostat's, free and forced part, and the power of the machine, by day."""
    trajectory, steps = pd.read_csv(run / "trajectory.csv"), pd.read_csv(run / "steps.csv")
    thermostat = pd.read_csv(run / "trajectory_thermostat.csv")
    kpis = json.loads((run / "kpis.json").read_text(encoding="utf-8"))
    begin = trajectory.start_s.iloc[0]
    with rc_context({"font.size": 10, "axes.spines.top": False}):
        figure = Figure(figsize=(9.5, 5.6), layout="constrained", facecolor="white")
        top, middle, below = figure.subplots(3, 1, sharex=True, height_ratios=[3, 3, 1.2])
        day = (trajectory.start_s - begin) / DAY_S
        top.fill_between(day, trajectory.lower_C, trajectory.upper_C, step="post", color=BAND, label="comfort band")
        of_thermostat = (thermostat.start_s + thermostat.duration_s - begin) / DAY_S
        top.plot(
            of_thermostat,
            thermostat.T_zone_C,
            color=QUIET,
            linewidth=0.9,
            label=_told("thermostat", kpis["baselines"]["thermostat"]),
        )
        top.plot(day, trajectory.T_zone_C, color=INK, linewidth=1.4, label=_told("thermoforce_mpc", kpis["kpis"]))
        top.set_ylabel("room, °C")
        top.set_ylim(trajectory.T_zone_C.min() - 0.3, 24.3)
        top.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False, ncols=3)
        at = (steps.time_s - begin) / DAY_S
        middle.plot(at, steps.T_free_now_C, color=FREE, linewidth=1.3, label="free: without heating")
        middle.fill_between(at, steps.T_free_now_C, steps.T_zone_C, color=FORCED, alpha=0.18, linewidth=0)
        middle.plot(at, steps.T_zone_C, color=INK, linewidth=1.0)
        middle.annotate("forced: what heating adds", (0.5, 0.6), xycoords="axes fraction", color=FORCED, ha="center")
        middle.set_ylabel("°C")
        middle.legend(loc="lower left", frameon=False)
        below.fill_between(day, trajectory.power_W / 1000, step="post", color=FORCED, alpha=0.8, linewidth=0)
        below.set_ylabel("power, kW")
        below.set_xlabel("day")
        for axis in (top, middle, below):
            axis.spines["right"].set_visible(False)
        below.set_xlim(0, float(day.iloc[-1]))
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=130)
    Image.open(picture).convert("RGB").quantize(64).save(out, optimize=True)  # a third of the size, and as sharp


def _told(name: str, of: dict[str, float]) -> str:
    return f"{name}: {of['cost_tot']:.3f} EUR/m², {of['tdis_tot']:.2f} K·h"


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
