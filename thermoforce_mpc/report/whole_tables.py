"""Tables for people."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table

# Widest table, characters.
_WIDEST = 1000


def plain_table(headings: Sequence[str], title: str | None = None, *, folded: bool = False) -> Table:
    """A table without lines but that under its headings; the first column holds names, the others figures.

    `folded`: names may take several lines.
    """
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1))
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="right" if k else "left", no_wrap=bool(k) or not folded, overflow="fold")
    return table


def in_lines(name: str, most: int = 24) -> str:
    """A name in lines of `most` characters where they part behind its marks (. _ - / : and spaces); longer words
    stay whole.
    """
    lines = [""]
    for word in re.findall(r"[^._\-/: ]*[._\-/: ]?", name):
        if lines[-1] and len(lines[-1] + word) > most:
            lines.append("")
        lines[-1] += word
    return "\n".join(lines)


def width_of(table: Table, console: Console, *, folded: bool = False) -> int:
    """Characters that a table needs to show all of its figures; `folded`: where names may take several lines."""
    needed = console.measure(table, options=console.options.update(width=_WIDEST))
    return needed.minimum if folded else needed.maximum


def print_whole(table: Table, console: Console, *, folded: bool = False) -> None:
    """Print a table, wider than a narrow terminal rather than with figures cut off; `folded`: see `width_of`."""
    wide = max(console.width, width_of(table, console, folded=folded))
    Console(file=console.file, highlight=False, markup=False, width=wide).print(table)


def figure(key: str, value: float) -> str:
    """A KPI as text: discomfort to 0.01 K·h, else three digits."""
    return f"{value:.2f}" if key == "tdis_tot" else f"{value:#.3g}".rstrip(".")
