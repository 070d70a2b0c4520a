"""Notes for people whose figures move while what they say stays."""

from __future__ import annotations

from typing import Self


class Note(str):
    """A note on a `matter` that stays the same while figures of the text move from step to step.

    `size`: how much of it there is, such as rows; twice as much is worth another word. 0 where that is not counted.
    """

    matter: str
    size: float

    def __new__(cls, text: str, matter: str, size: float = 0.0) -> Self:
        """`text` on a `matter`."""
        note = super().__new__(cls, text)
        note.matter, note.size = matter, size
        return note


def matter_of(note: str) -> str:
    """What a note is about: all of its text where its figures are what it says."""
    return note.matter if isinstance(note, Note) else note


class NotesTold:
    """What was told, so that a note is told once: again after `again_s` s, or where there is twice as much of it."""

    def __init__(self, again_s: float) -> None:
        self._again_s = again_s
        self._told: dict[str, tuple[float, float]] = {}

    def is_news(self, note: str, time_s: float) -> bool:
        """Whether `note` is to be told at `time_s`, s of any clock; it counts as told then."""
        size = note.size if isinstance(note, Note) else 0.0
        told_s, told_size = self._told.get(matter_of(note), (-self._again_s, 0.0))
        news = not 0.0 <= time_s - told_s < self._again_s or size >= 2.0 * max(told_size, 1.0)
        if news:
            self._told[matter_of(note)] = time_s, size
        return news
