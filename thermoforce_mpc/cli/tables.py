"""Tables for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

# Widest table, characters.
_WIDEST = 1000


def print_whole(table: Table, console: Console) -> None:
    """Print a table, wider than a narrow terminal rather than with figures cut off."""
    wide = console.measure(table, options=console.options.update(width=_WIDEST)).maximum
    Console(highlight=False, markup=False, width=max(console.width, wide)).print(table)
