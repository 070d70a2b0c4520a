"""Read YAML files and `--set` overrides; error messages name file, key and allowed values.

YAML as the package reads it: plain values only, bounded in size, depth and repetition, errors with their line.

A subset of YAML 1.2's core schema: text, numbers, true and false (also yes, no, on, off), null, lists, mappings,
anchors and merge keys. Tags, dates and numbers in base 8 or 60 are not read: 2026-01-01 and 12:30 stay text.

Base class of everything that users configure: what cannot be right is refused where it enters.
"""

from __future__ import annotations

import difflib
import functools
import math
import os
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args, get_origin

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from thermoforce_mpc.errors import ConfigError, OptionError, suggestion
from thermoforce_mpc.files import named_configs, odd_number, read_bounded

# Largest magnitude by the unit at the end of a key: far beyond any building, but finite. Temperatures in °C also have a
# least value; no key is in kelvin.
_MOST = {
    "_C": 200.0, "_K": 500.0, "_h": 24.0 * 366, "_hours": 24.0 * 366, "_s": 366 * 86400.0, "_days": 3660.0,
    "days": 3660.0, "_steps": 1e6, "_m2": 1e7, "_W": 1e9, "_kW": 1e6,
}  # fmt: skip
_LEAST = {"_C": -100.0}
_SHOWN = {"_C": "°C", "_m2": "m²"}
_MOST_ANY = 1e12
_NO_NUMBER = "expected a number, not true or false (nor yes, no, on, off)"
# BOPTEST's names are those of Modelica variables, with the zone in brackets; EnergyPlus' are words.
_POINT = re.compile(r"[A-Za-z_][\w.:/-]*( [\w.:/-]+)*(\[[\w .:,-]+\][\w.]*)*")


def _possible_point(name: str) -> str:
    if not _POINT.fullmatch(name) or len(name) > 200:
        raise ValueError(
            "no point has this name: letters, digits, _ . : / - and single spaces, an index in [ ], a letter first"
        )
    return name


PointName = Annotated[str, AfterValidator(_possible_point)]
"""Name of a point at the plant's interface."""


def _no_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(_NO_NUMBER)
    return value


Factor = Annotated[float, BeforeValidator(_no_truth_value), Field(ge=-1e6, le=1e6)]
"""Factor of a point in a sum."""


def _is_currency(code: str) -> str:
    if not re.fullmatch(r"([A-Z]{3})?", code):
        raise ValueError("expected a code of three capitals, such as EUR")
    return code


Currency = Annotated[str, AfterValidator(_is_currency), Field(json_schema_extra={"pattern": "^([A-Z]{3})?$"})]
"""A currency's code of three letters, or nothing."""


def one_of(*usual: str) -> WithJsonSchema:
    """The JSON Schema of a name that is one of the `usual` ones, or a plugin's."""
    return WithJsonSchema({"anyOf": [{"enum": list(usual)}, {"type": "string"}]})


class StrictModel(BaseModel):
    """Base class of all configuration models; values are immutable.

    Refused: unknown keys, NaN and infinity, true and false where a number is meant, text that only Python takes for one
    (1_0), and numbers that no building can have, by the unit that a key's name ends with. A class variable is a
    constant: files that name it with its own value are read, another value is refused. So are keys of `gone`, with the
    value that they had by default, and what to write instead of another one.
    """

    gone: ClassVar[Mapping[str, tuple[Any, str]]] = {}
    # What validates a model is built with its first value: a process has values of few of them.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    def __init__(self, **data: Any) -> None:
        """Raises `OptionError` listing invalid keys, their values and what is allowed."""
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise OptionError(_explained(type(self), data, error, type(self).__name__)) from None

    # What stands inside other models is validated by pydantic itself, whose errors then name the whole path of a key.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """As pydantic's; what was derived from the values (`cached_property`) is derived anew from the copy's."""
        copied = super().model_copy(update=update, deep=deep)
        for derived in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[derived]
        return copied

    @model_validator(mode="before")
    @classmethod
    def _constants_are_no_options(cls, data: Any) -> Any:
        known = cls.gone.keys() | (cls.__class_vars__ - {"gone"})
        named = known & data.keys() if isinstance(data, Mapping) else set()
        for key in named:
            constant, instead = cls.gone.get(key) or (getattr(cls, key), "")
            value = data[key]
            if not _is_same(constant, value):
                shown = "what it is" if _is_model(constant, value) else f"{constant}"
                instead = instead or f"it stays {shown}; leave the key out"
                raise ValueError(f"{key} is no option any more: {instead}")
        return {key: value for key, value in data.items() if key not in named} if named else data

    @field_validator("*", mode="before")
    @classmethod
    def _numbers_are_no_truth_values(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        if isinstance(value, bool) and _takes_numbers(cls, name):
            raise ValueError(_NO_NUMBER)
        if _takes_numbers_only(cls, name):
            for one in _leaves(value):
                if isinstance(one, bool):
                    raise ValueError(_NO_NUMBER)
                if isinstance(one, str) and not _may_be_text(cls, name) and odd_number(one):
                    raise ValueError(f"{one!r:.60} is not a number")
        return value

    @field_validator("*", mode="after")
    @classmethod
    def _numbers_are_possible(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        if not _takes_numbers_only(cls, name):
            return value
        unit = max((unit for unit in _MOST if name.endswith(unit)), key=len, default="")
        most = _MOST.get(unit, _MOST_ANY)
        least = _LEAST.get(unit, -most)
        for one in _leaves(value):
            if isinstance(one, int | float) and not least <= one <= most:
                in_unit = f" {_SHOWN.get(unit, unit.removeprefix('_'))}" if unit else ""
                bound = f"at most {most:g}" if one > most else f"at least {least:g}"
                expected = f"{least:g} to {most:g}" if unit in _LEAST else bound
                raise ValueError(f"no building has {one:g}; expected {expected}{in_unit}")
        return value


def _is_model(constant: Any, value: Any) -> bool:
    return isinstance(constant, BaseModel) and isinstance(value, Mapping)


def _is_same(constant: Any, value: Any) -> bool:
    """Whether a value in a file says what a constant is."""
    if _is_model(constant, value):
        return all(hasattr(constant, key) and _is_same(getattr(constant, key), one) for key, one in value.items())
    return (tuple(value) if isinstance(value, list) else value) == constant


@functools.cache
def _takes_numbers(model: type[BaseModel], name: str) -> bool:
    """Whether a value of a field may be a number and is never true or false."""
    kinds = set(_kinds(model.model_fields[name].annotation))
    return bool(kinds & {int, float}) and not kinds & {bool, Any, object}


@functools.cache
def _takes_numbers_only(model: type[BaseModel], name: str) -> bool:
    """Whether the values of a field are numbers (and text), alone or in lists and mappings."""
    nested = any(_is_a_model(kind) for kind in _kinds(model.model_fields[name].annotation))
    return _takes_numbers(model, name) and not nested


@functools.cache
def _may_be_text(model: type[BaseModel], name: str) -> bool:
    """Whether a value of the field may be any text, such as the name of a column."""
    annotation = model.model_fields[name].annotation
    return str in _kinds(annotation) and get_origin(annotation) is not dict


def _is_a_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _kinds(annotation: Any) -> Iterator[Any]:
    below = get_args(annotation)
    if below:
        for one in below:
            yield from _kinds(one)
    elif isinstance(annotation, type) or annotation is Any:
        yield annotation


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple | set | frozenset):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


def check_range(minimum: float, maximum: float, unit: str) -> None:
    """Raise `ValueError` unless the ends of a range are in order, and in K temperatures of a building, not in °C."""
    if not minimum < maximum:
        raise ValueError(f"minimum ({minimum}) must be below maximum ({maximum})")
    for name, value in {"minimum": minimum, "maximum": maximum}.items():
        if unit == "K" and not 200.0 <= value <= 500.0:
            raise ValueError(f"{name} is {value:g} K; in unit K a temperature is between 200 and 500 (20 °C is 293.15)")


# The largest shipped file has 5 kB; PyYAML reads about 100 kB a second.
MOST_BYTES = 250_000
MOST_DEPTH = 32
# Values with every alias written out.
MOST_VALUES = 50_000
# A number of more digits is not a setting, and Python refuses to print one of more than 4300.
_MOST_DIGITS = 40
_HALVES = re.compile("[\ud800-\udfff]")
_CORE = "tag:yaml.org,2002:"

Place = tuple[str | int, ...]


class YamlDocument(dict[str, Any]):
    """Keys and values of a file, with the line of each by its path of keys and indices; 0: not from the file."""

    def __init__(self, values: Mapping[str, Any], lines: Mapping[Place, int]) -> None:
        super().__init__(values)
        self.lines = dict(lines)

    def line(self, path: Place) -> int | None:
        """Line of the value at `path`, or of the innermost one above it; None for one that is not from the file."""
        return next((self.lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.lines), 0) or None


class _Loader(yaml.SafeLoader):
    """Safe loader with the bounds of this module; refuses what PyYAML would guess or silently drop."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._values = 0
        # Number of values in each node with an anchor that was read to its end.
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self._sizes:
                raise _wrong(f"'*{event.anchor}' contains itself", mark)
            self._values += self._sizes[id(node)]
        else:
            if event.tag not in (None, "!"):
                raise _wrong(f"the tag {event.tag!r:.60} is not read here; write a plain value", mark)
            if isinstance(event, yaml.ScalarEvent) and _HALVES.search(event.value):
                raise _wrong("a character that cannot be written (half of a surrogate pair)", mark)
            before, self._values, self._depth = self._values, self._values + 1, self._depth + 1
            if self._depth > MOST_DEPTH:
                raise _wrong(f"nested deeper than {MOST_DEPTH} levels", mark)
            node = super().compose_node(parent, index)
            self._sizes[id(node)] = self._values - before
            self._depth -= 1
        if self._values > MOST_VALUES:
            raise _wrong(f"more than {MOST_VALUES:,} values, aliases written out", mark)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, value in node.value:
            if key.tag == _CORE + "merge":
                continue
            if not isinstance(key, yaml.ScalarNode) or key.tag != _CORE + "str":
                shown = f"{key.value!r:.60} is read as {key.tag.removeprefix(_CORE)}, " if key.id == "scalar" else ""
                if key.tag == _CORE + "int" and value.tag == _CORE + "null" and node.flow_style:  # {area: 40,5}
                    raise _wrong(
                        f"',{key.value:.60}': a decimal comma? write a point, as in 0.{key.value:.60}", key.start_mark
                    )
                raise _wrong(f"a key must be text: {shown}put it in quotes", key.start_mark)
            if key.value in seen:
                raise _wrong(f"key '{key.value:.60}' appears twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def text(self, node: yaml.ScalarNode) -> str:
        """Value of a text; a path that begins in the home folder is that of its user, as in a shell."""
        return os.path.expanduser(node.value) if node.value.startswith("~/") else node.value

    def number(self, node: yaml.ScalarNode) -> int | float:
        """Value of a number."""
        if len(node.value) > _MOST_DIGITS:
            raise _wrong(f"a number of {len(node.value)} characters; at most {_MOST_DIGITS}", node.start_mark)
        if node.tag == _CORE + "int":
            return int(node.value)
        return float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan"))


_Loader.yaml_implicit_resolvers = {}  # those of YAML 1.1, which read 12:30 as 750
_Loader.add_constructor(_CORE + "str", _Loader.text)
_Loader.add_constructor(_CORE + "int", _Loader.number)
_Loader.add_constructor(_CORE + "float", _Loader.number)
for _name, _pattern, _first in (
    ("bool", r"(?i:true|false|yes|no|on|off)", "tTfFyYnNoO"),
    ("null", r"~|(?i:null)|", ["~", "n", "N", ""]),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+\.?[0-9]*)([eE][-+]?[0-9]+)?|[-+]?\.(?i:inf)|\.(?i:nan)", "-+.0123456789"),
    ("merge", r"<<", "<"),
):
    _Loader.add_implicit_resolver(_CORE + _name, re.compile(rf"(?:{_pattern})\Z"), list(_first))


def read_yaml(path: Path) -> YamlDocument:
    """Read one YAML mapping; raises `ConfigError` naming file, line and reason."""
    return parse_yaml(read_bounded(Path(path), MOST_BYTES, ConfigError), path)


def parse_yaml(content: bytes, path: Path) -> YamlDocument:
    """The YAML mapping that is the content of the file at `path`; raises `ConfigError` naming file, line and reason."""
    try:
        document, lines = _load(content.decode("utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid YAML: {_reason(error)}") from error
    if document is None:
        document = {}
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: expected keys and values at the top, found {type(document).__name__}")
    return YamlDocument(document, lines)


def parse_value(text: str, where: str) -> Any:
    """Return the value of a YAML text, such as that of an option; raises `ConfigError` naming `where`."""
    if len(text) > MOST_BYTES:
        raise ConfigError(f"{where}: more than {MOST_BYTES:,} characters")
    try:
        return _load(text)[0]
    except yaml.YAMLError as error:
        raise ConfigError(f"{where}: the value is not valid YAML: {_reason(error)}") from error


def _load(text: str) -> tuple[Any, dict[Place, int]]:
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None, {}
        # Before construction, which moves what a merge key names into its mapping.
        lines = dict(_lines(node, ()))
        return loader.construct_document(node), lines
    finally:
        loader.dispose()


def _lines(node: yaml.Node, path: Place) -> Any:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                yield (*path, key.value), key.start_mark.line + 1
                yield from _lines(value, (*path, key.value))
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            yield (*path, index), value.start_mark.line + 1
            yield from _lines(value, (*path, index))


def _wrong(problem: str, mark: yaml.Mark) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(None, None, problem, mark)


def _reason(error: Exception) -> str:
    if isinstance(error, yaml.MarkedYAMLError):
        mark = error.problem_mark or error.context_mark
        said = " ".join(filter(None, (error.context, error.problem)))
        return f"{said:.300}" + (f" (line {mark.line + 1})" if mark else "")
    return " ".join(str(error).split())[:300]


__all__ = ["StrictModel", "find_config", "merge", "nested", "parse_overrides", "read_yaml", "suggestion", "validate"]

Model = TypeVar("Model", bound=BaseModel)
_MOST_LISTED = 20
_BRIEF = reprlib.Repr()
_BRIEF.maxstring = _BRIEF.maxother = 160
_BRIEF.maxdict = _BRIEF.maxlist = _BRIEF.maxtuple = 12
# Tags of the alternatives of a key, which pydantic puts into the place of an error; no key of ours has these names.
UNION_TAGS = ("direct", "room", "one_zone", "weather_only", "meters", "factors", "air")


# How a file of a kind is made that is none of those that are known.
_OTHER = {
    "testcases": ". Another one is a YAML file (docs/reference/testcase.md): `tf-mpc init DIR --testcase NAME "
    "--from-url URL` proposes it from the points of a BOPTEST service, `tf-mpc init DIR --testcase KNOWN "
    "--copy-testcase` begins with a known one",
}  # fmt: skip


def check_no_folder(path: Path) -> None:
    """Raise `ConfigError` where `path`, which is to be a YAML file, is a folder, such as one of `tf-mpc init`."""
    if os.path.isdir(path):  # what is no name of a file at all is none; `Path.is_dir` raises on some of these
        inside = ", ".join(sorted(one.name for one in path.iterdir() if one.suffix in {".yaml", ".yml"}))
        raise ConfigError(f"{path}: is a folder; name the file in it{inside and ': '}{inside}")


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
        check_no_folder(path)
        all_names = [*known, *others]
        known_names, other = ", ".join(all_names), _OTHER.get(kind, "")
        raise ConfigError(f"unknown {kind[:-1]} '{name}'{suggestion(name, all_names)}; known: {known_names}{other}")
    return known[name]


# A word from which on what begins nearly so is meant, and how nearly.
_SHORT_WORD, _SPELT = 5, 0.85


def validate(
    model: type[Model], data: Mapping[str, Any], source: str, also: Callable[[], Iterable[str]] = tuple
) -> Model:
    """Build `model` from `data`; raises `ConfigError` listing invalid keys, their lines, values and what is allowed.

    `also`: dotted keys below `model` that it does not know itself, and that may be meant.
    """
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        raise ConfigError(_explained(model, data, error, source, also)) from error


def _explained(
    model: type[BaseModel],
    data: Mapping[str, Any],
    error: ValidationError,
    source: str,
    also: Callable[[], Iterable[str]] = tuple,
) -> str:
    """What is wrong with `data` from `source`, a line for each key; see `validate`."""
    items = _without_consequences(error.errors())
    lines = [_explain(model, data, item, also) for item in items[:_MOST_LISTED]]
    if len(items) > _MOST_LISTED:
        lines.append(f"and {len(items) - _MOST_LISTED} more")
    return f"{source}:\n" + "\n".join(f"  {line}" for line in lines)


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
    """The errors of pydantic but those of lists that are too short because their wrong entries do not count.

    Where a value may be plain or a mapping, that a mapping is not plain is none either, nor that a plain one is no
    mapping.
    """
    above = {item["loc"][:n] for item in items for n in range(len(item["loc"]))}

    def follows(item: Any) -> bool:
        loc, keys_given = item["loc"], isinstance(item["input"], Mapping)
        plain = loc[-1:] in (("str",), ("int",), ("float",))
        if (plain and item["type"].endswith("_type") and keys_given) or (
            item["type"] == "model_type" and not keys_given
        ):
            return any(one["loc"][: len(loc) - 1] == loc[:-1] and one["loc"] != loc for one in items)
        return item["type"] == "too_short" and loc in above

    return [item for item in items if not follows(item)]


def _place(model: type[BaseModel], data: Mapping[str, Any], item: Any) -> tuple[Any, ...]:
    """Return the keys and indices that lead to an error, without tags; a zone called 'room' is no tag."""
    tags = {*UNION_TAGS, "str", "int", "float", *(below.__name__ for below in _models_below(model))}
    place: list[Any] = []
    here: Any = data
    for part in item["loc"]:
        inside = isinstance(here, Mapping) and part in here
        if not inside and (part in tags or str(part).startswith("function-")):
            continue
        place.append(part)
        if inside or (isinstance(here, list | tuple) and isinstance(part, int) and part < len(here)):
            here = here[part]
    return tuple(place)


def _explain(model: type[BaseModel], data: Mapping[str, Any], item: Any, also: Callable[[], Iterable[str]]) -> str:
    place = _place(model, data, item)
    path = [str(part) for part in place]
    line = data.line(place) if isinstance(data, YamlDocument) else None
    key = ("" if line is None else f"line {line}: ") + (".".join(path) or "(top level)")
    if item["type"] == "extra_forbidden":
        known = _keys_at(model, path[:-1])
        return f"{key}: unknown key{_meant(model, path[-1], known, also)}; known here: {', '.join(known)}"
    if item["type"] == "missing":
        return f"{key}: missing"
    reason = item["msg"].removeprefix("Value error, ")
    if item["type"] in ("model_type", "dict_type"):
        of = ", ".join(_keys_at(model, path)) if path and item["type"] == "model_type" else ""
        reason = "expected keys and values" + (f", of {of}" if of else "")
    # At the top the value is the whole file.
    return f"{key}: {reason:.500}" + (f" (got {_shown(item['input'])})" if path else "")


def _shown(value: Any) -> str:
    try:
        return _BRIEF.repr(value)
    except ValueError:  # Python prints no integer of more than 4300 digits
        return "a number of thousands of digits"


def _keys_at(model: type[BaseModel], path: list[str]) -> list[str]:
    current: type[BaseModel] | None = model
    is_name = False
    for part in path:
        field = None if is_name or current is None else current.model_fields.get(part)
        is_name = field is not None and _by_name(field.annotation)
        if field is None:
            continue  # a name that people gave, a union tag or list index in pydantic's location, not a field
        current = next(iter(_models_in(field.annotation)), None)
    return sorted(current.model_fields) if current else []


def _meant(model: type[BaseModel], word: str, known: Sequence[str], also: Callable[[], Iterable[str]]) -> str:
    """Return ", did you mean ...?" for an unknown key, where one here or elsewhere is like it or begins like it."""
    everywhere = [*all_keys(model), *also()]
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.8)
    begun = [key for key in everywhere if _begins_like(key.rpartition(".")[2], word)]
    alike = difflib.get_close_matches(word, {key.rpartition(".")[2] for key in everywhere}, n=1, cutoff=0.8)
    elsewhere = begun or [key for key in everywhere if key.rpartition(".")[2] in alike]
    if near or not elsewhere:
        return suggestion(word, known)
    return f", did you mean '{min(elsewhere, key=len)}'?"


def _begins_like(key: str, word: str) -> bool:
    """Whether a key begins with a word, or with one that is spelt nearly so."""
    begin = key[: len(word)]
    alike = len(word) > _SHORT_WORD and difflib.SequenceMatcher(None, begin, word).ratio() > _SPELT
    return begin == word or alike


def all_keys(model: type[BaseModel], above: str = "") -> Iterable[str]:
    """Dotted names of all fields of a model and of those in it; NAME stands for a name that people give."""
    for name, field in model.model_fields.items():
        yield above + name
        named = "NAME." if _by_name(field.annotation) else ""
        for below in _models_in(field.annotation):
            yield from all_keys(below, f"{above}{name}.{named}")


def _models_below(model: type[BaseModel]) -> Iterable[type[BaseModel]]:
    for field in model.model_fields.values():
        for below in _models_in(field.annotation):
            yield below
            yield from _models_below(below)


def _by_name(annotation: Any) -> bool:
    """Whether values of a field stand under names that people give, as zones do."""
    if isinstance(get_origin(annotation), type) and issubclass(get_origin(annotation), Mapping):
        return True
    return any(_by_name(arg) for arg in get_args(annotation))


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for arg in getattr(annotation, "__args__", ()) for found in _models_in(arg)]
