"""What a run names that acts outside its folder, and whether this user has given it here before.

The folder of a run may come from anybody. Its journal names a service, to which requests and BOPTEST_TOKEN would go, an
FMU, which is native code, files of Python (`file.py:name`), trained policies, which are unpickled, or a plugin's plant,
which may be a real one. From a journal such a setting is used only if the user gives it again, or gave it before:
`tf-mpc run` and `resume` note in the user's cache folder what they were given, a file by the SHA-256 of its content. No
folder of a run can forge that, whoever owns it. All else that a journal names is read as data.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from thermoforce_mpc.data.cache import known_marks, note_marks
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import file_sha256
from thermoforce_mpc.plants.boptest.token import allow_token
from thermoforce_mpc.plants.registry import REGISTRY, plant_name
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.own_code import code_file
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import merge, parse_overrides, validate

CODE = "file of Python"


class Outside(NamedTuple):
    """A setting that acts outside: its key and value, the option of `tf-mpc resume` that gives it, and what it does."""

    key: str
    value: str
    option: str
    does: str

    @property
    def mark(self) -> str:
        """What it is known by, a line; '' where its file cannot be read."""
        if self.key not in ("plant.path", CODE):
            return json.dumps([self.key, self.value.rstrip("/")])
        try:
            return json.dumps([self.key, file_sha256(Path(self.value))])
        except (OSError, ValueError):  # ValueError: a NUL in the name
            return ""


def outside(scenario: Scenario) -> list[Outside]:
    """The settings of a scenario that act outside; raises `ConfigError` where nothing implements its test case."""
    plant, found = scenario.plant, []
    name = plant_name(plant, load_testcase(scenario.testcase))
    if name == "boptest":
        found.append(Outside("plant.url", plant.url, "--url", "requests and BOPTEST_TOKEN go there"))
    elif plant.path is not None:
        found.append(Outside("plant.path", plant.path, "--fmu", "an FMU runs native code"))
    elif name not in REGISTRY.own:
        found.append(Outside("plant.kind", name, "--plant", "a plugin's plant, which may be a real one"))
    return found + [Outside(CODE, file, "--code", "it is run") for file in _python(scenario)]


def _python(scenario: Scenario) -> list[str]:
    """Files of Python and policies that a scenario names."""
    controller = scenario.controller
    named = [controller.name, *scenario.baselines, *scenario.kpis, str(controller.options.get("terms") or "")]
    return sorted({file for where in named if (file := code_file(where)) is not None})


def note_given(scenario: Scenario) -> None:
    """Note what the user gave."""
    note_marks(mark for one in outside(scenario) if (mark := one.mark))


def unknown(scenario: Scenario) -> list[Outside]:
    """The settings that act outside and that this user has not given before, or whose file was changed since."""
    found = outside(scenario)
    known = known_marks() if found else set()
    return [one for one in found if one.mark not in known]


def with_given(scenario: Scenario, given: Mapping[str, str], code: Collection[str], folder: Path) -> Scenario:
    """The scenario of a journal in `folder` with the settings `given` again, by key, and `code`, files; and noted.

    Raises:
        ConfigError: one that acts outside was not given, now or before; or one was given that the run does not have.
    """
    named = {one.key: one for one in outside(scenario)}
    for what in (*(set(given) - set(named)), *(set(code) - set(_python(scenario)))):
        raise ConfigError(f"{folder}: its run has no {what}: leave the option out")
    if given.get("plant.kind", scenario.plant.kind) != scenario.plant.kind:
        raise ConfigError(f"{folder}: its run is on plant '{scenario.plant.kind}', not '{given['plant.kind']}'")
    missing = [one for one in unknown(scenario) if one.key not in given and one.value not in code]
    if missing:
        lines = [f"  {one.key}: {one.value} ({one.does})" for one in missing]
        words = " ".join(f"{one.option} {shlex.quote(one.value)}" for one in missing)
        lines.insert(0, f"{folder}: its journal names what acts outside it, and you have not given it here before:")
        lines.append(f"Where you trust it, give it again: tf-mpc resume {shlex.quote(str(folder))} {words}")
        raise ConfigError("\n".join(lines))
    nested = parse_overrides(f"{key}={json.dumps(value)}" for key, value in given.items())
    scenario = validate(Scenario, merge(scenario.model_dump(mode="json"), nested), "options")
    if "plant.url" in given:
        allow_token(given["plant.url"])
    note_given(scenario)
    return scenario
