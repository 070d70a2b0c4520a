"""Read YAML files and `--set` overrides; error messages name file, key and allowed values."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from thermoforce_mpc.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)


UNION_TAGS = ("direct", "room", "one_zone", "weather_only", "meters", "factors", "air")
"""Tags of the alternatives of a key, which pydantic puts into the place of an error; no key has these names."""


class StrictModel(BaseModel):
    """Base class of all configuration models: unknown keys are refused, values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe YAML loader that refuses duplicate keys, of which PyYAML would silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key}' appears twice", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)


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


def find_config(kind: str, name: str) -> Path:
    """Return the path of a shipped configuration by name, or `name` itself if it is a YAML file."""
    path = Path(name)
    if path.suffix in {".yaml", ".yml"}:
        if not path.is_file():
            raise ConfigError(f"{path}: no such file")
        return path
    known = named_configs(kind)
    if name not in known:
        raise ConfigError(f"unknown {kind[:-1]} '{name}'{suggestion(name, known)}; known: {', '.join(known)}")
    return known[name]


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ", did you mean ...?" if a known word is close, else an empty string."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f", did you mean '{close[0]}'?" if close else ""


def read_yaml(path: Path) -> dict[str, Any]:
    """Read one YAML mapping; raises `ConfigError` naming file, line and reason."""
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader=_UniqueKeyLoader)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: expected keys and values at the top, found {type(document).__name__}")
    return document


def validate(model: type[Model], data: Mapping[str, Any], source: str) -> Model:
    """Build `model` from `data`; raises `ConfigError` listing every invalid key, its value and what is allowed."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        lines = [_explain(model, item) for item in error.errors()]
        raise ConfigError(f"{source}:\n" + "\n".join(f"  {line}" for line in lines)) from error


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated by `over`; nested mappings are merged key by key."""
    out = dict(base)
    for key, value in over.items():
        below = out.get(key)
        out[key] = merge(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return out


def parse_overrides(assignments: Iterable[str]) -> dict[str, Any]:
    """Convert `a.b=1` assignments into nested mappings; values are parsed as YAML scalars or lists.

    Raises:
        ConfigError: an assignment has no '=', an empty key, a value that is not YAML, or NaN.
    """
    out: dict[str, Any] = {}
    for word in assignments:
        key, separator, text = word.partition("=")
        parts = [part.strip() for part in key.split(".")]
        if not separator or not all(parts):
            raise ConfigError(f"--set {word}: expected key=value, for example controller.horizon_h=36")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ConfigError(f"--set {word}: the value is not valid YAML") from error
        if isinstance(value, float) and math.isnan(value):
            raise ConfigError(f"--set {word}: not a number")
        nested: Any = value
        for part in reversed(parts):
            nested = {part: nested}
        out = merge(out, nested)
    return out


def _explain(model: type[BaseModel], item: Any) -> str:
    """Return one line per pydantic error: dotted key, reason, value; for an unknown key, the allowed keys."""
    path = [str(part) for part in item["loc"] if part not in UNION_TAGS]
    key = ".".join(path) or "(top level)"
    if item["type"] == "extra_forbidden":
        known = _keys_at(model, path[:-1])
        return f"{key}: unknown key{suggestion(path[-1], known)}; known here: {', '.join(known)}"
    if item["type"] == "missing":
        return f"{key}: missing"
    reason = item["msg"].removeprefix("Value error, ")
    return f"{key}: {reason}" + (f" (got {item['input']!r})" if path else "")  # not the whole file


def _keys_at(model: type[BaseModel], path: list[str]) -> list[str]:
    """Return the field names of the nested model at `path` (descends through unions and optionals)."""
    current: type[BaseModel] | None = model
    for part in path:
        field = current.model_fields.get(part) if current else None
        if field is None:
            continue  # a union tag or list index in pydantic's location, not a field
        current = next((m for m in _models_in(field.annotation)), None)
    return sorted(current.model_fields) if current else []


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for arg in getattr(annotation, "__args__", ()) for found in _models_in(arg)]
