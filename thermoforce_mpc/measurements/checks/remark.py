"""A remark on a record: what is wrong, where, how sure it is, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "stamps late",
    "stamps early",
    "level is no level",
    "meter holds another load",
    "unit of power",
    "unit of temperature",
]


@dataclass(frozen=True)
class Remark:
    """One finding of a check.

    Attributes:
        kind: what is wrong.
        where: signals concerned, as in the record.
        words: what was found, with its numbers.
        remedy: what to do.
        sure: the statistic that found it, as a number of its standard deviations; inf where a physical limit is
            exceeded, as of units.
        actuators: numbers of the actuators whose model it bars; none where the record may serve all the same.
    """

    kind: Kind
    where: str
    words: str
    remedy: str
    sure: float = float("inf")
    actuators: tuple[int, ...] = ()

    def in_words(self) -> str:
        """One line."""
        return f"{self.kind}: {self.where}: {self.words}; {self.remedy}"
