"""How the service says no."""

from __future__ import annotations


class Refusal(Exception):
    """A request that is answered with HTTP `status` and a message: what was wrong, and what would be right."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status, self.message = status, message
