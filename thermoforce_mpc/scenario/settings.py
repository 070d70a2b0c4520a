"""Read YAML files and `--set` overrides; error messages name file, key and allowed values."""

from __future__ import annotations

import difflib
import math
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from thermoforce_mpc.errors import ConfigError, suggestion
from thermoforce_mpc.scenario.strict_model import StrictModel
from thermoforce_mpc.scenario.yaml_file import MOST_DEPTH, YamlDocument, parse_value, read_yaml

__all__ = [
    "StrictModel", "configs_folder", "find_config", "is_config", "merge", "named_configs", "nested", "parse_overrides",
    "read_yaml", "suggestion", "validate",
]  # fmt: skip

Model = TypeVar("Model", bound=BaseModel)
_MOST_LISTED = 20
_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = 160
_BRIEF.maxdict = _BRIEF.maxlist = _BRIEF.maxtuple = 12
# Tags of the alternatives of a key, which pydantic puts into the place of an error; no key of ours has these names.
UNION_TAGS = ("direct", "room", "one_zone", "weather_only", "meters", "factors", "air")


def configs_folder() -> Path:
    """Return the `configs` folder: beside the package in a source tree, inside it when installed from a wheel."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parent / "configs", package / "configs"):
        if (folder / "testcases").is_dir():
            return folder
    raise ConfigError(f"configs folder not found beside or inside {package}: reinstall thermoforce-mpc")


def named_configs(kind: str) -> dict[str, Path]:
    """Return the shipped YAML files of one kind ('testcases' or 'scenarios'), by name."""
    return {path.stem: path for path in sorted((configs_folder() / kind).glob("*.yaml"))}


def is_config(kind: str, name: str) -> bool:
    """Whether `name` is that of a shipped configuration, or has the ending of a YAML file."""
    return Path(name).suffix in {".yaml", ".yml"} or name in named_configs(kind)


# How a file of a kind is made that is none of those that are known.
_OTHER = {
    "testcases": ". Another one is a YAML file (docs/reference/testcase.md): `tf-mpc init DIR --testcase NAME "
    "--from-url URL` proposes it from the points of a BOPTEST service, `tf-mpc init DIR --testcase KNOWN "
    "--copy-testcase` begins with a known one",
}  # fmt: skip


def find_config(kind: str, name: str, others: Iterable[str] = ()) -> Path:
    """Return the path of a shipped configuration by name, or `name` itself if it is a YAML file.

    Raises `ConfigError` where there is none; `others` are names that are known besides.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"}:
        try:
            there = path.is_file()
        except OSError as error:
            raise ConfigError(f"{name[:120]}: not the name of a file ({error.strerror or error})") from error
        if not there:
            raise ConfigError(f"{path}: no such file{'' if path.is_absolute() else f' in {Path.cwd()}'}")
        return path
    known = named_configs(kind)
    if name not in known:
        all_names = [*known, *others]
        known_names, other = ", ".join(all_names), _OTHER.get(kind, "")
        raise ConfigError(f"unknown {kind[:-1]} '{name}'{suggestion(name, all_names)}; known: {known_names}{other}")
    return known[name]


def validate(model: type[Model], data: Mapping[str, Any], source: str) -> Model:
    """Build `model` from `data`; raises `ConfigError` listing invalid keys, their lines, values and what is allowed."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        items = _without_consequences(error.errors())
        lines = [_explain(model, data, item) for item in items[:_MOST_LISTED]]
        if len(items) > _MOST_LISTED:
            lines.append(f"and {len(items) - _MOST_LISTED} more")
        raise ConfigError(f"{source}:\n" + "\n".join(f"  {line}" for line in lines)) from error


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated by `over`; nested mappings are merged key by key."""
    out = dict(base)
    for key, value in over.items():
        below = out.get(key)
        out[key] = merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    if isinstance(base, YamlDocument):
        replaced = list(_replaced(base, over))
        lines = {path: line for path, line in base.lines.items() if not any(path[: len(r)] == r for r in replaced)}
        return YamlDocument(out, lines | dict.fromkeys(replaced, 0))
    return out


def _replaced(base: Any, over: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterable[tuple[str, ...]]:
    for key, value in over.items():
        below = base.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            yield from _replaced(below, value, (*path, key))
        else:
            yield (*path, key)


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Convert `a.b=1` assignments, with values in YAML, into nested mappings; raises `ConfigError` for others."""
    out: dict[str, Any] = {}
    for word in assignments:
        key, separator, text = word.partition("=")
        parts = [part.strip() for part in key.split(".")]
        if not separator or not all(parts) or len(parts) > MOST_DEPTH:
            raise ConfigError(f"--set {word:.200}: expected KEY=VALUE")
        value = parse_value(text, f"--set {word:.200}")
        if isinstance(value, float) and math.isnan(value):
            raise ConfigError(f"--set {word}: not a number")
        out = merge(out, nested(".".join(parts), value))
    return out


def nested(key: str, value: Any) -> dict[str, Any]:
    """Mappings with `value` at the dotted `key`."""
    first, _, rest = key.partition(".")
    return {first: nested(rest, value) if rest else value}


def _without_consequences(items: Sequence[Any]) -> list[Any]:
    """The errors of pydantic but those of lists that are too short because their wrong entries do not count."""
    above = {item["loc"][:n] for item in items for n in range(len(item["loc"]))}
    return [item for item in items if item["type"] != "too_short" or item["loc"] not in above]


def _place(data: Mapping[str, Any], item: Any) -> tuple[Any, ...]:
    """Return the keys and indices that lead to an error, without tags; a zone called 'room' is no tag."""
    place: list[Any] = []
    here: Any = data
    for part in item["loc"]:
        inside = isinstance(here, Mapping) and part in here
        if part in UNION_TAGS and not inside:
            continue
        place.append(part)
        if inside or (isinstance(here, list | tuple) and isinstance(part, int) and part < len(here)):
            here = here[part]
    return tuple(place)


def _explain(model: type[BaseModel], data: Mapping[str, Any], item: Any) -> str:
    place = _place(data, item)
    path = [str(part) for part in place]
    line = data.line(place) if isinstance(data, YamlDocument) else None
    key = ("" if line is None else f"line {line}: ") + (".".join(path) or "(top level)")
    if item["type"] == "extra_forbidden":
        known = _keys_at(model, path[:-1])
        return f"{key}: unknown key{_meant(model, path[-1], known)}; known here: {', '.join(known)}"
    if item["type"] == "missing":
        return f"{key}: missing"
    reason = item["msg"].removeprefix("Value error, ")
    # At the top the value is the whole file.
    return f"{key}: {reason:.500}" + (f" (got {_shown(item['input'])})" if path else "")


def _shown(value: Any) -> str:
    try:
        return _BRIEF.repr(value)
    except ValueError:  # Python prints no integer of more than 4300 digits
        return "a number of thousands of digits"


def _keys_at(model: type[BaseModel], path: list[str]) -> list[str]:
    current: type[BaseModel] | None = model
    for part in path:
        field = current.model_fields.get(part) if current else None
        if field is None:
            continue  # a union tag or list index in pydantic's location, not a field
        current = next(iter(_models_in(field.annotation)), None)
    return sorted(current.model_fields) if current else []


def _meant(model: type[BaseModel], word: str, known: Sequence[str]) -> str:
    """Return ", did you mean ...?" for an unknown key, where one here or elsewhere is like it or begins with it."""
    everywhere = list(_all_keys(model))
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.8)
    begun = [key for key in everywhere if key.rpartition(".")[2].startswith(word)]
    alike = difflib.get_close_matches(word, {key.rpartition(".")[2] for key in everywhere}, n=1, cutoff=0.8)
    elsewhere = begun or [key for key in everywhere if key.rpartition(".")[2] in alike]
    if near or not elsewhere:
        return suggestion(word, known)
    return f", did you mean '{min(elsewhere, key=len)}'?"


def _all_keys(model: type[BaseModel], above: str = "") -> Iterable[str]:
    for name, field in model.model_fields.items():
        yield above + name
        for below in _models_in(field.annotation):
            yield from _all_keys(below, f"{above}{name}.")


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for arg in getattr(annotation, "__args__", ()) for found in _models_in(arg)]
