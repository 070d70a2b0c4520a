"""`tf-mpc bench NAME`: benchmarks that reproduce the figures in the documentation."""

from __future__ import annotations

import click

from benchmarks.cli import closed_loop, models, speed, suites


@click.group()
def command() -> None:
    """Run a benchmark: print its table, check its targets, write plots and JSON."""


for _command in (
    closed_loop.buildings_command,
    closed_loop.boptest_command,
    closed_loop.worth_command,
    closed_loop.contest_command,
    closed_loop.zones_command,
    closed_loop.commands_command,
    closed_loop.hot_water_command,
    closed_loop.mqtt_command,
    closed_loop.faults_command,
    closed_loop.fallback_command,
    closed_loop.detectors_command,
    models.operator_command,
    models.probing_command,
    models.effects_command,
    models.verdicts_command,
    models.operation_command,
    models.saving_command,
    models.rooms_command,
    models.records_command,
    models.names_command,
    models.free_response_command,
    models.backbones_command,
    models.forecasters_command,
    speed.plant_command,
    speed.controller_command,
    speed.gym_command,
    speed.fleet_command,
    suites.factual_command,
    suites.interventions_command,
):
    command.add_command(_command)
