"""JSON Schema of the files that people write, from the models that read them: editors complete and check by it.

A model's own checks across keys (such as a minimum below a maximum) are not in its schema; `tf-mpc validate` has them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode, models_json_schema

from controllers.actuation.actuator import ActuationConfig
from controllers.registry import REGISTRY
from thermoforce_mpc.comparison.cells import ComparisonFile, Variant
from thermoforce_mpc.errors import ConfigError, suggestion
from thermoforce_mpc.fleet.file import FleetFile
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.scenario.scenario import ControllerSpec, ProbingSpec, Scenario
from thermoforce_mpc.scenario.testcase import Defaults, TestCase

KINDS: dict[str, type[BaseModel]] = {
    "scenario": Scenario,
    "testcase": TestCase,
    "comparison": ComparisonFile,
    "fleet": FleetFile,
    "map": MeasurementMap,
}
_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_MODE: JsonSchemaMode = "validation"

# Keys that hold options of something else: by model and key, the model of these options.
_OPTIONS: dict[type[BaseModel], dict[str, type[BaseModel]]] = {
    ProbingSpec: {"probing": ProbingConfig, "options": IdentificationConfig},
    Defaults: {"actuation": ActuationConfig, "probing": ProbingConfig, "identification": IdentificationConfig},
}
# Models whose key `options` holds those of the controller that another key names.
_OF_CONTROLLER: dict[type[BaseModel], str] = {ControllerSpec: "name", Variant: "controller"}


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a file of one of `KINDS`, with controllers' options; raises `ConfigError`."""
    if kind not in KINDS:
        raise ConfigError(f"no schema '{kind}'{suggestion(kind, KINDS)}; there are {', '.join(KINDS)}")
    root = KINDS[kind]
    of_controllers = {name: entry.config() for name, entry in REGISTRY.own.items()}
    options_of_others = [options for keys in _OPTIONS.values() for options in keys.values()]
    models = list(dict.fromkeys([root, *_inside(root), *of_controllers.values(), *options_of_others]))
    refs, combined = models_json_schema([(model, _MODE) for model in models], schema_generator=_Untitled)
    definitions = combined["$defs"]

    def definition(model: type[BaseModel]) -> Any:
        return definitions[refs[model, _MODE]["$ref"].rpartition("/")[2]]

    for model, keys in _OPTIONS.items():
        if model in models:
            for key, options in keys.items():
                properties = definition(model)["properties"]
                properties[key] = refs[options, _MODE] | {"description": properties[key]["description"]}
    for model, key in _OF_CONTROLLER.items():
        if model in models:
            definition(model)["allOf"] = [
                {
                    # The default needs not be named.
                    "if": {"properties": {key: {"const": name}}}
                    | ({} if name == model.model_fields[key].default else {"required": [key]}),
                    "then": {"properties": {"options": refs[options, _MODE]}},
                }
                for name, options in of_controllers.items()
            ]
    top = {"$schema": _DRAFT, "title": f"{kind} of thermoforce-mpc"} | definition(root)
    return top | {"$defs": {name: definitions[name] for name in sorted(_needed(top, definitions))}}


def schema_text(kind: str) -> str:
    """`schema_of` as the text of a file."""
    return json.dumps(schema_of(kind), indent=1, ensure_ascii=False) + "\n"


class _Untitled(GenerateJsonSchema):
    """Without titles, which only repeat the keys."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def _inside(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """The models of this module's tables that a model contains."""
    tabled = [*_OPTIONS, *_OF_CONTROLLER]
    schema = json.dumps(model.model_json_schema(mode=_MODE))
    yield from (options for options in tabled if f'"#/$defs/{options.__name__}"' in schema)


def _needed(value: Any, definitions: dict[str, Any], names: set[str] | None = None) -> set[str]:
    """Names of the definitions that are referred to, directly or by others."""
    names = set() if names is None else names
    if isinstance(value, dict):
        name = str(value.get("$ref", "")).rpartition("/")[2]
        if name and name not in names:
            names.add(name)
            _needed(definitions[name], definitions, names)
    for below in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _needed(below, definitions, names)
    return names
