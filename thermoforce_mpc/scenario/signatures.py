"""Functions and classes that make something by name: what they are handed, and what of their parameters are options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from typing import Any

from pydantic import Field, create_model

from thermoforce_mpc.scenario.strict_model import StrictModel

_PLAIN = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def unfit(make: object, handed: Collection[str]) -> str:
    """What is wrong with a plugin's function or class: every parameter that is not `handed` needs a default.

    Returns nothing where it can be used.
    """
    if not callable(make):
        return f"it is a {type(make).__name__}, not a function or class"
    try:
        parameters = inspect.signature(make).parameters
    except ValueError as error:
        return str(error)
    if odd := [name for name, one in parameters.items() if one.kind not in _PLAIN]:
        return f"its parameters {', '.join(odd)} have no name to set them by"
    bare = [name for name, one in parameters.items() if name not in handed and one.default is inspect.Parameter.empty]
    if bare:
        can = f"; without one: {', '.join(handed)}" if handed else ""
        return f"its parameters {', '.join(bare)} have no default{can}"
    try:
        options_model(make, handed).model_validate({})
    except Exception as error:  # somebody's annotations
        return f"its options cannot be checked: {error}"
    return ""


def options_model(make: Callable[..., Any], handed: Collection[str]) -> type[StrictModel]:
    """The options of a function or class as a model: its parameters but those `handed`, with their types and defaults.

    A parameter without an annotation has the type of its default. Its meaning is that of the docstring's `Args:`.
    """
    meanings = _meanings(make)
    names = getattr(make.__init__ if inspect.isclass(make) else make, "__globals__", {})
    fields: dict[str, Any] = {}
    for name, one in inspect.signature(make).parameters.items():
        if name not in handed:
            kind = one.annotation
            if kind is inspect.Parameter.empty:
                kind = Any if one.default is None else type(one.default)
            # Only these: what is handed may have a type that is imported for type checking alone.
            kind = eval(kind, names) if isinstance(kind, str) else kind
            fields[name] = (kind, Field(one.default, description=meanings.get(name)))
    return create_model(f"Options of {getattr(make, '__name__', 'a plugin')}", __base__=StrictModel, **fields)


def _meanings(make: Callable[..., Any]) -> dict[str, str]:
    """What the section `Args:` of a docstring says of each parameter."""
    doc = inspect.getdoc(make.__init__ if inspect.isclass(make) else make) or ""
    descriptions: dict[str, str] = {}
    for line in doc.partition("\nArgs:\n")[2].splitlines():
        if not line.startswith("    "):
            break
        name, colon, text = line.strip().partition(": ")
        if colon and line[4] != " ":
            descriptions[name] = text
        elif descriptions:
            descriptions[next(reversed(descriptions))] += f" {line.strip()}"
    return descriptions


def called(make: Callable[..., Any], options: StrictModel, given: Mapping[str, Any]) -> Any:
    """What `make` returns for validated `options`, and of what is `given` the parameters that it has."""
    asked = inspect.signature(make).parameters
    own = {name: getattr(options, name) for name in type(options).model_fields}
    return make(**{name: value for name, value in given.items() if name in asked}, **own)


def first_line(make: object) -> str:
    """First line of the docstring of a function or class."""
    return (getattr(getattr(make, "func", make), "__doc__", None) or "").strip().partition("\n")[0].rstrip(".")
