"""`tf-mpc` in this process, and what two runs must have in common."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.plants.testcases import load_scenario
from thermoforce_mpc.protocols import Plant


def call(*words: object):
    return CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=True)


def experiment_on(plant: Plant) -> Experiment:
    """The default experiment, whose plant is this one."""
    experiment = Experiment.of(load_scenario(None, {"testcase": "bestest_hydronic_heat_pump"}))
    entry = replace(experiment.plant.entry, build=lambda *_: plant)
    return replace(experiment, plant=replace(experiment.plant, entry=entry))


def results(folder: Path) -> dict[str, object]:
    """What must be the same, octet by octet: all trajectories, plans and KPIs."""
    return {path.name: path.read_bytes() for path in folder.glob("*") if path.name in SAME or _is_course(path)}


SAME = ("kpis.json", "kpis.csv", "steps.csv")


def _is_course(path: Path) -> bool:
    return path.name.startswith("trajectory")
