"""Exception for refused requests."""

from __future__ import annotations


class Refusal(Exception):
    """Refused request: HTTP `status` and a message with the error and the allowed values."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status, self.message = status, message
