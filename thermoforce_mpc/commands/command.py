"""A command: what can be set at a building's own control, with unit, limits, resolution, slowest change and hold.

Inside, temperatures are in °C. Where a device has °F, its command is read, set and shown in °F (`told_in`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.clock import in_celsius, in_fahrenheit
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
    name_in_words: ClassVar[str] = "a command"
    # Whether it rises by kelvins of the water that a machine makes for the rooms.
    of_flow: ClassVar[bool] = False
    # Whether it goes by the outdoor temperature when it is left alone.
    follows_weather: ClassVar[bool] = False

    kind: str
    column: str = Field(description="column with what was set, in the unit of the command")
    usual: float | str | None = Field(
        None,
        description="what it is when it is left alone, a number or a column: what a plan is compared with. Default: "
        "the median at each time of the week in the record; say it where the record is of planned commands",
    )
    hold_min: float = Field(30.0, ge=0, le=720, description="least time between two changes, min")

    @property
    def reads(self) -> tuple[float, float]:
        """From where to where a column may say that it was set; what lies outside is something else."""
        return -np.inf, np.inf

    @property
    def told_in(self) -> str:
        """Unit in which it is read, set and shown."""
        return ""

    def as_told(self, value: Any) -> Any:
        """A command, or several, as its device has it."""
        return value

    def from_told(self, told: Any) -> Any:
        """Inverse of `as_told`."""
        return told

    @abstractmethod
    def values(self, low: float, high: float) -> Array:
        """What can be set from `low` to `high` (n,), rising; the nearest one where there is none between."""

    @abstractmethod
    def tried(self, before: float, T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> float | None:
        """Another value than `before` for a short trial, that may be set and is near it; None where there is none.

        `T_zone_C`, `bounds_C`: temperatures of the rooms that it acts on, °C, and their comfort bounds, NaN where there
        is none; less heat is tried first where one is above its own (`is_warm`).
        """

    def allows(self, value: float) -> bool:
        """Whether `value` may be set at any time."""
        return bool(np.isfinite(value))

    @abstractmethod
    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """Least and largest command (N,) each, with comfort bounds of the room, °C, and what it usually is, (N,)."""

    @abstractmethod
    def in_words(self, value: float) -> str:
        """A command, or what else its column holds, with its unit."""

    def reference_of(self, room: str) -> str:
        """The room whose temperature its loop works against where it heats `room`."""
        return room

    def check_rooms(self, rooms: Sequence[str], *, of_machine: bool) -> None:
        """Raise `ValueError` where it does not say all that is needed of a command for these `rooms`, of all that a
        machine feeds (`of_machine`) or of one actuator."""

    def check_bounds(self, of: str, lower_C: float, upper_C: float) -> None:
        """Raise `ValueError` where it cannot keep `of`, a room or a tank, above its highest lower bound `lower_C` and
        below its lowest upper one `upper_C`, °C; infinite where it has none."""

    def most_change(self, seconds: float) -> float:
        """Largest change from one value to the next, of which the first was held for `seconds` s."""
        return float("inf")

    def longest_s(self, value: float) -> float:
        """Longest time that a command may be held, s."""
        return float("inf")

    @property
    def tank_first(self) -> float:
        """Share of its rooms' heat that a tank gets in the first hour in which it is above what it usually is.

        Where the machine's meter tells that it has none, nothing.
        """
        return 0.0


def is_warm(T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> bool:
    """Whether one of the rooms is above its upper bound."""
    return any(upper < T for T, (_, upper) in zip(T_zone_C, bounds_C, strict=True))


def first_of(values: Sequence[float], before: float, falls: bool) -> float | None:
    """The first of `values`, where `falls` the first that does not rise from `before` if there is one; None of none."""
    return next(iter(sorted(values, key=lambda one: one > before) if falls else values), None)


class SwitchCommand(Command):
    """A command that is on (1) or off (0)."""

    @model_validator(mode="after")
    def _is_usually_on_or_off(self) -> SwitchCommand:
        if isinstance(self.usual, float) and not self.allows(self.usual):
            raise ValueError(f"usual ({self.usual:g}) is neither 1, on, nor 0, off")
        return self

    @property
    def reads(self) -> tuple[float, float]:
        """See `Command.reads`."""
        return 0.0, 1.0

    def values(self, low: float, high: float) -> Array:
        """See `Command.values`."""
        return np.array([0.0, 1.0])

    def tried(self, before: float, T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> float | None:
        """See `Command.tried`."""
        return 0.0 if before >= 0.5 else 1.0

    def allows(self, value: float) -> bool:
        """See `Command.allows`."""
        return value in (0.0, 1.0)

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return np.zeros(lower_C.shape), np.ones(upper_C.shape)


class StepwiseCommand(Command):
    """A command that is a number in steps of its resolution."""

    # By how much a trial moves it, °C, K or its unit, in the order of preference; a step of it at least.
    trial_changes: ClassVar[tuple[float, ...]] = (1.0, -1.0)

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
            first = np.ceil(self.minimum / self.resolution - SAME)
            last = np.floor(self.maximum / self.resolution + SAME)
            if first >= last:
                few = "no" if first > last else "only one"
                raise ValueError(
                    f"there is {few} multiple of resolution ({self.resolution:g}) from "
                    f"minimum ({self.minimum:g}) to maximum ({self.maximum:g})"
                )
        if isinstance(self.usual, float):
            for key, sign in (("minimum", 1.0), ("maximum", -1.0)):
                limit = getattr(self, key)
                if limit is not None and sign * (self.usual - limit) < -SAME:
                    raise ValueError(
                        f"usual ({self.usual:g}) lies {'below' if key == 'minimum' else 'above'} {key} ({limit:g}): "
                        "what is set when it is left alone is a command too"
                    )
        return self

    def values(self, low: float, high: float) -> Array:
        """See `Command.values`."""
        steps_low, steps_high = (self.as_told(one) / self.resolution for one in (low, high))
        first, last = np.ceil(steps_low - SAME), np.floor(steps_high + SAME)
        if first > last:
            around = self._at_steps(np.array([last, first]))
            around = around[[self.allows(value) for value in around]]
            return around[[int(np.argmin(np.abs(around - 0.5 * (low + high))))]]
        return self._at_steps(np.arange(first, min(last, first + _MOST_VALUES) + 1.0))

    def tried(self, before: float, T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> float | None:
        """See `Command.tried`."""
        return first_of(self._moved(before), before, is_warm(T_zone_C, bounds_C))

    def _moved(self, before: float) -> list[float]:
        """`before` changed by each of `trial_changes`, as far as that may be set."""
        steps = [np.copysign(max(1.0, round(abs(one) / self.step)), one) for one in self.trial_changes]
        values = [float(self.nearest(before, one)) for one in steps]
        return [one for one in values if self.allows(one) and self.allows(before)]

    def nearest(self, value: Any, steps: float = 0.0) -> Array:
        """The commands nearest to `value` (n,), or those so many steps of its resolution above."""
        return self._at_steps(np.round(self.as_told(np.asarray(value)) / self.resolution) + steps)

    def _at_steps(self, steps: Array) -> Array:
        """Commands (n,) at whole numbers of steps from zero of the device's scale."""
        return np.asarray(np.round(self.from_told(np.round(steps * self.resolution, 9)), 9))

    @property
    def step(self) -> float:
        """From one command to the next, °C or K."""
        return float(self.from_told(self.resolution) - self.from_told(0.0))

    def allows(self, value: float) -> bool:
        """See `Command.allows`."""
        told = self.as_told(value)
        above = self.minimum is None or told >= self.minimum - SAME
        return above and (self.maximum is None or told <= self.maximum + SAME) and super().allows(value)

    def within(self, low: Array, high: Array) -> tuple[Array, Array]:
        """`low` and `high` (N,) inside `minimum` and `maximum`, in order."""
        least = -np.inf if self.minimum is None else self.from_told(self.minimum)
        most = np.inf if self.maximum is None else self.from_told(self.maximum)
        return np.clip(low, least, most), np.clip(np.maximum(low, high), least, most)

    def most_change(self, seconds: float) -> float:
        """See `Command.most_change`."""
        if self.change_per_h is None:
            return float("inf")
        steps = max(self.change_per_h * seconds / HOUR_S, self.resolution) / self.resolution
        return steps * self.step


class TemperatureCommand(StepwiseCommand):
    """A command that is a temperature, in `unit`; so are the numbers of its keys, but for those of `beyond_K`."""

    # What it is by default, and what it may be: least and largest temperature, °C; the device's step, °C and °F.
    usual_C: ClassVar[tuple[float, float]]
    possible_C: ClassVar[tuple[float, float]]
    usual_steps: ClassVar[tuple[float, float]] = (1.0, 1.0)
    # A reading so far below and above what is possible is of another unit, K.
    another_unit_K: ClassVar[tuple[float, float]] = (5.0, 10.0)

    unit: Literal["°C", "°F"] = Field("°C", description="unit of the column, of what is set, and of these numbers")
    resolution: float = Field(1.0, gt=0, description="step between two commands; default: 1, of a set-point in °C 0.5")
    minimum: float | None = Field(None, description="lowest command; default: by kind")
    maximum: float | None = Field(None, description="highest command; default: by kind")

    @model_validator(mode="before")
    @classmethod
    def _with_defaults(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        in_F = given.get("unit") == "°F"
        least, most = (round(in_fahrenheit(one)) if in_F else one for one in cls.usual_C)
        usual = {"resolution": cls.usual_steps[in_F], "minimum": least, "maximum": most}
        return {**usual, **given}

    @model_validator(mode="after")
    def _are_possible(self) -> TemperatureCommand:
        for key in ("minimum", "maximum", "usual"):
            if not isinstance(getattr(self, key), float):  # none, or the name of a column
                continue
            value_C = self.from_told(getattr(self, key))
            if not self.possible_C[0] - SAME <= value_C <= self.possible_C[1] + SAME:
                least, most = (self.as_told(one) for one in self.possible_C)
                raise ValueError(f"{key} ({getattr(self, key):g} {self.unit}) lies outside {least:g} to {most:g}")
        return self

    def _check_reach(self, of: str, lower_C: float, upper_C: float) -> None:
        """As `check_bounds`, of a command that is what its room or tank is kept at."""
        for key, bound, bound_C, sign in (("maximum", "lower", lower_C, -1.0), ("minimum", "upper", upper_C, 1.0)):
            limit = getattr(self, key)
            if limit is not None and sign * (self.from_told(limit) - bound_C) > SAME:
                where = "below" if sign < 0.0 else "above"
                raise ValueError(
                    f"{key}: {limit:g} {self.unit} lies {where} the {bound} bound of {of}, "
                    f"{self.as_told(bound_C):.4g} {self.unit}, which it cannot keep then"
                )

    @property
    def told_in(self) -> str:
        """See `Command.told_in`."""
        return self.unit

    @property
    def reads(self) -> tuple[float, float]:
        """See `Command.reads`."""
        (least, most), (below, above) = self.possible_C, self.another_unit_K
        return least - below, most + above

    def as_told(self, value: Any) -> Any:
        """See `Command.as_told`."""
        # Inside values have nine decimals: whole degrees come out whole.
        return value if self.unit == "°C" else np.round(in_fahrenheit(value), 6)

    def from_told(self, told: Any) -> Any:
        """See `Command.from_told`."""
        return told if self.unit == "°C" else in_celsius(told)

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"{self.as_told(value):.10g} {self.unit}"
