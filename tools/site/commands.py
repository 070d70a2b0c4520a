"""Markdown extension: `::: commands MODULE:GROUP as NAME` becomes the help of every command of a click group.

Each command gets a heading, its text, with what `\\b` keeps as typed in a block of code, and a table of its options.
`::: text MODULE:NAME` becomes a text of the program, in a block of code.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator

import click
from markdown import Markdown
from markdown.extensions import Extension
from markdown.preprocessors import Preprocessor

_LINE = re.compile(r"::: (commands|text) ([\w.]+):(\w+)(?: as ([\w-]+))?\s*")


def pages(command: click.Command, name: str, level: int = 2, above: click.Context | None = None) -> Iterator[str]:
    """Yield the Markdown lines of a command called `name`, and of the commands below it."""
    context = click.Context(command, parent=above, info_name=name)
    yield from ("", f"{'#' * level} {context.command_path} {{ #{context.command_path.replace(' ', '-')} }}", "")
    yield from ("```text", command.get_usage(context).removeprefix("Usage: "), "```", "")
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        typed = "\b" in paragraph
        text = paragraph.replace("\b\n", "").replace("\b", "")
        yield from ("```text", inspect.cleandoc(text), "```", "") if typed else (_escaped(text), "")
    records = [one for one in (param.get_help_record(context) for param in command.get_params(context)) if one]
    yield from ("| option | |", "|---|---|")
    for option, meaning in records:
        yield f"| `{option}` | {_escaped(' '.join(meaning.split()))} |"
    if isinstance(command, click.Group):
        for below in command.list_commands(context):
            found = command.get_command(context, below)
            if found is not None:
                yield from pages(found, below, level + 1, context)


def _escaped(text: str) -> str:
    """Text as Markdown that shows it as it is: no HTML, emphasis or table columns by accident."""
    return re.sub(r"(?<!`)([*_<>|\[\]])(?!`)", r"\\\1", text)


def _of_program(kind: str, module: str, name: str, title: str | None) -> Iterator[str]:
    """Yield the lines for an object of the program: a click group called `title`, or a text."""
    found = getattr(importlib.import_module(module), name)
    return pages(found, title or name) if kind == "commands" else iter(("```text", *found.splitlines(), "```"))


class _Expand(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        out: list[str] = []
        for line in lines:
            found = _LINE.fullmatch(line)
            out += _of_program(*found.groups()) if found else [line]
        return out


class Commands(Extension):
    """Registers the preprocessor before fenced code is read."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register with a `Markdown` instance."""
        md.preprocessors.register(_Expand(md), "commands", 28)


def makeExtension(**options: object) -> Commands:
    """Entry point of Python-Markdown."""
    return Commands(**options)
