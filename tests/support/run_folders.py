"""`tf-mpc` in this process, and what two runs must have in common."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from thermoforce_mpc.cli import cli


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def results(folder: Path) -> dict[str, object]:
    """What must be the same, octet by octet: all trajectories, plans and KPIs."""
    return {path.name: path.read_bytes() for path in folder.glob("*") if path.name in SAME or _is_course(path)}


SAME = ("kpis.json", "kpis.csv", "steps.csv")


def _is_course(path: Path) -> bool:
    return path.name.startswith("trajectory")
