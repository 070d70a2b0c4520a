"""Markdown extension: `::: schema MODULE:MODEL` becomes tables of the keys of a pydantic model, from its JSON Schema.

Each nested model gets a heading and a table of its own, to which the types of the keys link.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator
from typing import Any

from markdown import Markdown
from markdown.extensions import Extension
from markdown.preprocessors import Preprocessor

_LINE = re.compile(r"::: schema ([\w.]+):(\w+)\s*")
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
_WORDS = {"string": "text", "boolean": "true, false", "object": "mapping"}
Schema = dict[str, Any]


class _Tables:
    """Tables of one model and of those below it, as Markdown lines."""

    def __init__(self, model: Any) -> None:
        self.name = model.__name__.lower()
        self.schema: Schema = model.model_json_schema()

    def lines(self) -> Iterator[str]:
        yield from self._model(self.schema)
        for name, below in self.schema.get("$defs", {}).items():
            if "properties" in below:
                yield from ("", f"### {name} {{ #{self.name}-{name.lower()} }}", "")
                yield from (below.get("description", "").split("\n\n")[0].replace("\n", " "), "")
                yield from self._model(below)

    def _model(self, schema: Schema) -> Iterator[str]:
        yield from ("| key | value | default | meaning |", "|---|---|---|---|")
        for key, value in schema.get("properties", {}).items():
            default = "**required**" if key in schema.get("required", []) else _default(value)
            meaning = value.get("description", "").replace("|", "\\|").replace("\n", " ")
            yield f"| `{key}` | {self._type(value)} | {default} | {meaning} |"

    def _type(self, value: Schema) -> str:
        if "$ref" in value:
            name = value["$ref"].rsplit("/", 1)[-1]
            below = self.schema["$defs"][name]
            return f"[{name}](#{self.name}-{name.lower()})" if "properties" in below else self._type(below)
        if "enum" in value or "const" in value:
            return ", ".join(f"`{one}`" for one in value.get("enum", [value.get("const")]))
        for union in ("anyOf", "oneOf", "allOf"):
            if union in value:
                return " or ".join(dict.fromkeys(self._type(one) for one in value[union] if one.get("type") != "null"))
        kind = value.get("type", "any")
        if kind == "array":
            return f"list of {self._type(value.get('items') or (value.get('prefixItems') or [{}])[0])}"
        inner = value.get("additionalProperties")
        if kind == "object" and isinstance(inner, dict) and inner:
            return f"name: {self._type(inner)}"
        limits = ", ".join(f"{sign} {value[key]:g}" for key, sign in _LIMITS.items() if key in value)
        return _WORDS.get(kind, kind) + (f" {limits}" if limits else "")


def _default(value: Schema) -> str:
    default = value.get("default")
    if default in (None, {}, [], ""):
        return "–"
    text = json.dumps(default, ensure_ascii=False).strip('"')
    return "as below" if isinstance(default, dict) else f"`{text}`"


class _Expand(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        out: list[str] = []
        for line in lines:
            found = _LINE.fullmatch(line)
            out += _Tables(getattr(importlib.import_module(found[1]), found[2])).lines() if found else [line]
        return out


class SchemaTables(Extension):
    """Registers the preprocessor before fenced code is read."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register with a `Markdown` instance."""
        md.preprocessors.register(_Expand(md), "schema", 27)


def makeExtension(**options: object) -> SchemaTables:
    """Entry point of Python-Markdown."""
    return SchemaTables(**options)
