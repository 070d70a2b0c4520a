"""Test cases by name: those that are read from a file, and those that a plant makes. And scenarios, which name one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.registry import Registry, builder
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import find_config, merge, read_yaml, validate
from thermoforce_mpc.scenario.testcase import TestCase, read_testcase


def _house(name: str) -> TestCase:
    from thermoforce_mpc.plants.rooms.plant import house_testcase

    return house_testcase(name)


def _generated(name: str) -> TestCase:
    from thermoforce_mpc.plants.random_houses.plant import named_testcase

    return named_testcase(name)


# Test cases that are made instead of read, by what stands before the colon of their name: the function that makes one
# from its whole name. Other distributions announce theirs in the group `thermoforce_mpc.testcases`.
MADE_TESTCASES: Registry[Callable[[str], TestCase]] = Registry(
    "test case", "testcases", {"house": _house, "office": _house, "generated": _generated}, ConfigError, builder
)


def is_read(name: str) -> bool:
    """Whether `name` is that of a shipped test case, or has the ending of a YAML file."""
    return Path(name).suffix in {".yaml", ".yml"} or name in named_configs("testcases")


def load_testcase(name: str) -> TestCase:
    """Read a test case by name or YAML path, or make it; raises `ConfigError`.

    `energyplus:NAME` is the shipped file `energyplus_NAME.yaml`; `house:Nrooms`, `office:Nrooms` and
    `generated:SEED:INDEX` are drawn; a plugin's has its name.
    """
    prefix = name.partition(":")[0]
    if not is_read(name) and prefix in MADE_TESTCASES:
        make = MADE_TESTCASES.find(prefix)
        try:
            return make(name)
        except InputError as error:
            raise ConfigError(f"testcase: {error}") from error
    path = find_config("testcases", name.replace("energyplus:", "energyplus_", 1), MADE_TESTCASES.names)
    return read_testcase(path)


def load_scenario(
    path: Path | None, overrides: Mapping[str, Any], also: Callable[[], Iterable[str]] = tuple
) -> Scenario:
    """Read a scenario file (or none) and apply `overrides`; raises `ConfigError` naming file and key.

    `also`: keys that may be meant by one that is not known, as `settings.validate` takes them.

    Without a period, a heated building gets 'peak_heat_day' and a cooled one 'peak_cool_day'; `model_fields_set` has no
    period then.
    """
    data = merge(read_yaml(path) if path else {}, overrides)
    source = str(path) if path else "options"
    scenario = validate(Scenario, data, source, also)
    if "period" not in data and _is_cooled(scenario.testcase):
        return Scenario.model_construct(scenario.model_fields_set, **{**dict(scenario), "period": "peak_cool_day"})
    return scenario


def _is_cooled(testcase: str) -> bool:
    """Whether a test case is cooled; False if it cannot be read, which its later use reports."""
    try:
        return load_testcase(testcase).mode == "cooling"
    except ConfigError:
        return False
