"""The composition root: builds plant, model and controllers from a scenario. The only module that knows both sides."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from thermoforce_mpc.configuration import suggestion
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario import PlantSpec
from thermoforce_mpc.testcase import TestCase
from thermoforce_mpc.types import DAY_S, Period

__all__ = ["build_plant", "scored_period"]


def build_plant(spec: PlantSpec, testcase: TestCase, seed: int = 1) -> Plant:
    """Build the plant of a scenario.

    Raises:
        ConfigError: the embedded emulator is not this test case.
        WeatherError: the weather file cannot be used.
        PlantError: the service does not answer.
    """
    if spec.kind == "boptest":
        from thermoforce_mpc.plants.boptest import BoptestPlant

        return BoptestPlant(spec.url, testcase)
    if not testcase.embedded:
        raise ConfigError(
            f"plant.kind: the embedded emulator is bestest_hydronic_heat_pump, not {testcase.name}; "
            "give the address of a BOPTEST service with --url"
        )
    from thermoforce_mpc.plants.embedded import EmbeddedPlant
    from thermoforce_mpc.weather import load_weather, synthetic_weather

    weather = synthetic_weather() if spec.weather == "synthetic" else load_weather(Path(spec.weather))
    return EmbeddedPlant(weather, seed=seed)


def scored_period(plant: Plant, name: str, days: float) -> Period:
    """The window called `name` on this plant, `days` long; raises `ConfigError` for a name that is not one."""
    known = ("peak_heat_day", "typical_heat_day")
    try:
        float(name)
    except ValueError:
        if name not in known:
            raise ConfigError(
                f"period: '{name}' is not a window{suggestion(name, known)}; "
                f"use {', '.join(known)}, or the day of the year it starts, such as 44"
            ) from None
    return replace(plant.period(name), scored_s=days * DAY_S)
