"""A command: what can be set at a building's own control, with unit, limits, resolution, slowest change and hold."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.scenario.settings import StrictModel

# Commands nearer to one another than this are one, in their unit.
SAME = 1e-6
_MOST_VALUES = 1000


class Command(StrictModel):
    """What can be set in the place of a level; a subclass is a kind.

    The level that its loop answers with rises with the command, and falls with the signals that the loop works against:
    `of_zone` of the room's temperature (−1: by as much as the command rises, the difference of the two counts; None: by
    a weight that the record tells; 0: not at all), `of_outdoor` of the outdoor temperature likewise (0 or None).
    """

    of_zone: ClassVar[float | None] = None
    of_outdoor: ClassVar[float | None] = None
    unit: ClassVar[str] = ""
    name_in_words: ClassVar[str] = "a command"

    kind: str
    column: str = Field(description="column with what was set, in the unit of the command")
    usual: float | str | None = Field(
        None,
        description="what it is when it is left alone, a number or a column: what a plan is compared with. Default: "
        "the median at each time of the week in the record; say it where the record is of planned commands",
    )
    hold_min: float = Field(30.0, ge=0, le=720, description="least time between two changes, min")

    @abstractmethod
    def values(self, low: float, high: float) -> Array:
        """What can be set from `low` to `high` (n,), rising; the nearest one where there is none between."""

    def allows(self, value: float) -> bool:
        """Whether `value` may be set at any time."""
        return bool(np.isfinite(value))

    @abstractmethod
    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """Least and largest command (N,) each, with comfort bounds of the room, °C, and what it usually is, (N,)."""

    @abstractmethod
    def in_words(self, value: float) -> str:
        """A command with its unit."""

    def most_change(self, seconds: float) -> float:
        """Largest change from one value to the next, of which the first was held for `seconds` s."""
        return float("inf")

    def longest_s(self, value: float) -> float:
        """Longest time that a command may be held, s."""
        return float("inf")


class SwitchCommand(Command):
    """A command that is on (1) or off (0)."""

    def values(self, low: float, high: float) -> Array:
        """See `Command.values`."""
        return np.array([0.0, 1.0])

    def allows(self, value: float) -> bool:
        """See `Command.allows`."""
        return value in (0.0, 1.0)

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return np.zeros(lower_C.shape), np.ones(upper_C.shape)


class StepwiseCommand(Command):
    """A command that is a number in steps of its resolution."""

    resolution: float = Field(0.5, gt=0, description="step between two commands")
    minimum: float | None = Field(None, description="lowest command")
    maximum: float | None = Field(None, description="highest command")
    change_per_h: float | None = Field(None, gt=0, description="largest change in an hour; null: any")

    @model_validator(mode="after")
    def _has_commands(self) -> StepwiseCommand:
        if self.minimum is not None and self.maximum is not None:
            if not self.minimum < self.maximum:
                raise ValueError(f"minimum ({self.minimum:g}) must be below maximum ({self.maximum:g})")
            if (self.maximum - self.minimum) / self.resolution > _MOST_VALUES:
                raise ValueError(f"more than {_MOST_VALUES} commands: a larger resolution, or a smaller range")
            if np.ceil(self.minimum / self.resolution - SAME) > np.floor(self.maximum / self.resolution + SAME):
                raise ValueError(
                    f"there is no multiple of resolution ({self.resolution:g}) from minimum ({self.minimum:g}) to "
                    f"maximum ({self.maximum:g})"
                )
        return self

    def values(self, low: float, high: float) -> Array:
        """See `Command.values`."""
        first, last = np.ceil(low / self.resolution - SAME), np.floor(high / self.resolution + SAME)
        if first > last:
            around = np.round(np.array([last, first]) * self.resolution, 9)
            around = around[[self.allows(value) for value in around]]
            return around[[int(np.argmin(np.abs(around - 0.5 * (low + high))))]]
        last = min(last, first + _MOST_VALUES)
        return np.asarray(np.round(np.arange(first, last + 1.0) * self.resolution, 9))

    def allows(self, value: float) -> bool:
        """See `Command.allows`."""
        above = self.minimum is None or value >= self.minimum - SAME
        return above and (self.maximum is None or value <= self.maximum + SAME) and super().allows(value)

    def within(self, low: Array, high: Array) -> tuple[Array, Array]:
        """`low` and `high` (N,) inside `minimum` and `maximum`, in order."""
        least = -np.inf if self.minimum is None else self.minimum
        most = np.inf if self.maximum is None else self.maximum
        return np.clip(low, least, most), np.clip(np.maximum(low, high), least, most)

    def most_change(self, seconds: float) -> float:
        """See `Command.most_change`."""
        if self.change_per_h is None:
            return float("inf")
        return max(self.change_per_h * seconds / HOUR_S, self.resolution)
