"""`tf-mpc` in this process, and what two runs must have in common."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from thermoforce_mpc.cli import cli


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def results(folder: Path) -> dict[str, object]:
    """What must be the same: all trajectories and KPIs but the computing time."""
    kpis = json.loads((folder / "kpis.json").read_text())
    for one in (kpis["kpis"], *kpis["baselines"].values()):
        one.pop("time_rat")
    return {"kpis": kpis} | {path.name: path.read_bytes() for path in folder.glob("trajectory*.csv")}
