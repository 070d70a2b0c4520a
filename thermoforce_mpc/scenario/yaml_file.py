"""YAML as the package reads it: plain values only, bounded in size, depth and repetition, errors with their line.

A subset of YAML 1.2's core schema: text, numbers, true and false (also yes, no, on, off), null, lists, mappings,
anchors and merge keys. Tags, dates and numbers in base 8 or 60 are not read: 2026-01-01 and 12:30 stay text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import read_bounded

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
        for key, _ in node.value:
            if key.tag == _CORE + "merge":
                continue
            if not isinstance(key, yaml.ScalarNode) or key.tag != _CORE + "str":
                shown = f"{key.value!r:.60} is read as {key.tag.removeprefix(_CORE)}, " if key.id == "scalar" else ""
                raise _wrong(f"a key must be text: {shown}put it in quotes", key.start_mark)
            if key.value in seen:
                raise _wrong(f"key '{key.value:.60}' appears twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def number(self, node: yaml.ScalarNode) -> int | float:
        """Value of a number."""
        if len(node.value) > _MOST_DIGITS:
            raise _wrong(f"a number of {len(node.value)} characters; at most {_MOST_DIGITS}", node.start_mark)
        if node.tag == _CORE + "int":
            return int(node.value)
        return float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan"))


_Loader.yaml_implicit_resolvers = {}  # those of YAML 1.1, which read 12:30 as 750
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
