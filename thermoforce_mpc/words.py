"""Numbers in sentences."""

from __future__ import annotations


def counted(n: int, one: str) -> str:
    """A number of things by the name of `one`: '1 run', '0 runs', '2 runs'."""
    return f"{n} {one}{'' if n == 1 else 's'}"
