"""What a run names that acts outside its folder, and whether this user has given it here before.

A scenario, comparison or fleet file may come from anybody too. Code that it names, and that the command line does not,
is shown and asked for (`check_code`); so is all of the following.

The folder of a run may come from anybody. Its journal names a service, to which requests and BOPTEST_TOKEN would go,
an FMU, which is native code, files of Python (`file.py:name`), trained policies, which are unpickled, a plugin's
plant, which may be a real one, or a forecaster of a model hub, which is asked for it. From a journal such a setting
is used only if the user gives it again, or gave it before: `tf-mpc run` and `resume` note in the user's cache folder
what they were given, a file by the SHA-256 of its content. No folder of a run can forge that, whoever owns it. All
else that a journal names is read as data.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import file_sha256, known_marks, note_marks
from thermoforce_mpc.model.free_response.backbones.loading import is_fetched
from thermoforce_mpc.plants.boptest.plant import allow_token
from thermoforce_mpc.plants.registry import REGISTRY, plant_name
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.scenario.own_code import code_file, is_policy, looked_at
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.scenario.settings import merge, parse_overrides, validate

CODE = "file of Python"
HUB = "controller.options.free_response.options.backbone"


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


def outside(scenario: Scenario, plant_of: str | None = None) -> list[Outside]:
    """The settings of a scenario that act outside; `plant_of`: name of its plant, where that is known.

    Raises `ConfigError` where nothing implements its test case.
    """
    plant, found = scenario.plant, []
    name = plant_of or plant_name(plant, load_testcase(scenario.testcase))
    if name == "boptest":
        found.append(Outside("plant.url", plant.url, "--url", "requests and BOPTEST_TOKEN go there"))
    elif plant.path is not None:
        found.append(Outside("plant.path", plant.path, "--fmu", "an FMU runs native code"))
    elif name not in REGISTRY.own:
        found.append(Outside("plant.kind", name, "--plant", "a plugin's plant, which may be a real one"))
    found += [Outside(CODE, file, "--code", "it is run") for file in python_of(scenario.model_dump())]
    forecaster = scenario.controller.options.get("free_response")
    options = forecaster.get("options") if isinstance(forecaster, Mapping) else None
    backbone = options.get("backbone") if isinstance(options, Mapping) else None
    if isinstance(backbone, str) and is_fetched(backbone):
        found.append(Outside(HUB, backbone, "--forecaster", "a model hub is asked for it"))
    return found


def python_of(keys: Mapping[str, Any]) -> list[str]:
    """Files of Python and policies that keys of a scenario name."""
    return sorted({file for name in own_names(keys) if (file := code_file(name)) is not None})


def own_names(keys: Mapping[str, Any]) -> list[str]:
    """Names that keys of a scenario, all or some, give to what is in a file: `file.py:name`, or a policy's file."""
    controller = keys.get("controller")
    if not isinstance(controller, Mapping):
        controller = {"name": controller}
    options = controller.get("options")
    options = options if isinstance(options, Mapping) else {}
    forecaster = options.get("free_response")
    named = [controller.get("name"), options.get("terms")]
    named += [forecaster.get("name")] if isinstance(forecaster, Mapping) else []
    for key in ("baselines", "kpis"):
        named += keys[key] if isinstance(keys.get(key), list | tuple) else []
    return [name for name in named if isinstance(name, str) and code_file(name) is not None]


def code_of(keys: Mapping[str, Any]) -> list[Outside]:
    """All code that keys of a scenario name: Python, policies and an FMU."""
    plant = keys.get("plant")
    path = plant.get("path") if isinstance(plant, Mapping) else None
    fmu = [Outside("plant.path", path, "--code", "an FMU runs native code")] if isinstance(path, str) else []
    return fmu + [Outside(CODE, file, "--code", "it is run") for file in python_of(keys)]


def check_code(found: Iterable[Outside], named: Collection[str], file: str) -> None:
    """Note the code `found` in a `file`, where all of it is `named` on the command line or was given before.

    Raises:
        ConfigError: some was neither; what is in it is shown, and the option that gives it.
    """
    found, known, given = list(found), known_marks(), {Path(name).resolve() for name in named}
    missing = [one for one in found if Path(one.value).resolve() not in given and one.mark not in known]
    if missing:
        lines = [f"{file}: it names code that would be run, and you have not given it here before:"]
        lines += [f"  {one.value} ({shown_code(one)})" for one in missing]
        words = " ".join(dict.fromkeys(f"--code {shlex.quote(one.value)}" for one in missing))
        raise ConfigError("\n".join([*lines, f"Where you trust it, repeat the command with {words}"]))
    note_marks(mark for one in found if (mark := one.mark))


def shown_code(one: Outside) -> str:
    """What a file of code is, in words, without running it."""
    if one.key != CODE:
        return one.does
    if is_policy(one.value):
        return "a policy, which is unpickled: that runs whatever is in it"
    try:
        return str(looked_at(one.value, one.key, ConfigError))
    except ConfigError as error:
        return str(error)


def note_given(scenario: Scenario, plant_of: str | None = None) -> None:
    """Note what the user gave; arguments and errors as of `outside`."""
    note_marks(mark for one in outside(scenario, plant_of) if (mark := one.mark))


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
    found = outside(scenario)
    named = {one.key: one for one in found}
    for what in (*(set(given) - set(named)), *(set(code) - {one.value for one in found if one.key == CODE})):
        raise ConfigError(f"{folder}: its run has no {what}: leave the option out")
    for key, what in (("plant.kind", "is on plant"), (HUB, "has the forecaster")):
        if given.get(key, value := named[key].value if key in named else "") != value:
            raise ConfigError(f"{folder}: its run {what} '{value}', not '{given[key]}'")
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
