"""A commented scenario to start from: every key with what it means, its value or an example."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from thermoforce_mpc.scenario.scenario import Scenario

_WIDTH = 110


def scenario_text(scenario: Scenario) -> str:
    """The scenario as YAML: keys without a value stand in comments, with an example of one."""
    return "\n".join(_lines(scenario, "")) + "\n"


def _lines(model: BaseModel, margin: str) -> Iterator[str]:
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        if not margin:
            yield ""
        if isinstance(value, BaseModel):
            yield from _comment((type(value).__doc__ or "").partition("\n")[0], margin)
            yield f"{margin}{key}:"
            yield from _lines(value, margin + "  ")
            continue
        yield from _comment(field.description or "", margin)
        if value is None or value == {}:
            yield f"{margin}# {key}: {_flow(_example(field, value))}"
        else:
            yield f"{margin}{key}: {_flow(list(value) if isinstance(value, tuple) else value)}"


def _example(field: FieldInfo, value: Any) -> Any:
    return field.examples[0] if field.examples else value


def _comment(words: str, margin: str) -> Iterator[str]:
    start = f"{margin}# "
    yield from textwrap.wrap(words, _WIDTH, initial_indent=start, subsequent_indent=start)


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, allow_unicode=True, width=1000)
    return text.removesuffix("...\n").strip()
