"""What hands on all that it is asked for, as wrappers of users do."""

from __future__ import annotations

from typing import Any


class HandsOn:
    """Has what `inside` has, by `__getattr__` alone."""

    def __init__(self, inside: Any) -> None:
        self.inside = inside

    def __getattr__(self, name: str) -> Any:
        if name == "inside":
            raise AttributeError(name)
        return getattr(self.inside, name)
