"""Contacts: SG-Ready, and enabling a machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from thermoforce_mpc.commands.command import SAME, Command, SwitchCommand, is_warm
from thermoforce_mpc.data import Array

_SG_STATES = {1: "blocked", 2: "normal", 3: "recommended", 4: "ordered"}
# Share of the heat of rooms that a tank gets in the first hour of a state that is recommended or ordered: hot water
# comes first. Two such hours from ten times on, against none: levels of the first were .15, .12, .11 and .05 less of
# .52, .46, .42 and .18 in 10033, 9741, 9742 and 9961 of `bench commands`, rooms colder for four hours by up to .5 K.
# Three days of trials hold some six such hours, most after a blocked one, and do not tell it (2026-11-30).
_TANK_FIRST = 0.3


class SGReady(Command):
    """State of the SG-Ready contacts (bwp, SG Ready 1.1): 1 blocked, 2 normal, 3 recommended, 4 ordered.

    Of `states` only those are planned that the record holds.
    """

    name_in_words: ClassVar[str] = "SG-Ready"

    kind: Literal["sg_ready"]
    hold_min: float = Field(10.0, ge=10, le=720, description="least time between two changes, min")
    blocked_at_most_min: float = Field(120.0, gt=0, le=120, description="longest time blocked at a time, min")
    states: tuple[int, ...] = Field((1, 2, 3), description="states that may be set")

    @field_validator("states")
    @classmethod
    def _are_states(cls, states: tuple[int, ...]) -> tuple[int, ...]:
        if not states or not set(states) <= set(_SG_STATES):
            raise ValueError("states of SG-Ready are 1 blocked, 2 normal, 3 recommended, 4 ordered")
        if set(states) == {1}:
            raise ValueError("states of SG-Ready: blocked alone cannot be held, name another one")
        if len(set(states)) == 1:
            raise ValueError("states of SG-Ready: of one alone there is nothing to plan, name another one")
        return tuple(sorted(set(states)))

    @model_validator(mode="after")
    def _is_usually_a_state(self) -> SGReady:
        if isinstance(self.usual, float) and self.usual not in _SG_STATES:
            raise ValueError(f"usual ({self.usual:g}) is no state of SG-Ready, 1 to 4")
        return self

    @property
    def reads(self) -> tuple[float, float]:
        """See `Command.reads`."""
        return float(min(_SG_STATES)), float(max(_SG_STATES))

    def values(self, low: float, high: float) -> Array:
        """See `Command.values`."""
        allowed = np.array(self.states, dtype=np.float64)
        inside = allowed[(allowed >= low - SAME) & (allowed <= high + SAME)]
        return inside if inside.size else allowed[[int(np.argmin(np.abs(allowed - 0.5 * (low + high))))]]

    def tried(self, before: float, T_zone_C: Sequence[float], bounds_C: Sequence[tuple[float, float]]) -> float | None:
        """See `Command.tried`."""
        order = (2.0, 1.0, 3.0) if is_warm(T_zone_C, bounds_C) else (3.0, 2.0, 1.0)
        return next((one for one in order if one != round(before) and self.allows(one)), None)

    def limits(self, lower_C: Array, upper_C: Array, usual: Array) -> tuple[Array, Array]:
        """See `Command.limits`."""
        return np.full(lower_C.shape, float(self.states[0])), np.full(upper_C.shape, float(self.states[-1]))

    def allows(self, value: float) -> bool:
        """See `Command.allows`."""
        return any(abs(value - state) <= SAME for state in self.states)

    def longest_s(self, value: float) -> float:
        """See `Command.longest_s`."""
        return 60.0 * self.blocked_at_most_min if round(value) == 1 else float("inf")

    @property
    def tank_first(self) -> float:
        """See `Command.tank_first`."""
        return _TANK_FIRST

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return f"SG-Ready {round(value)} ({_SG_STATES.get(round(value), 'unknown')})"


class Enable(SwitchCommand):
    """A contact that lets a machine run (1) or not (0)."""

    name_in_words: ClassVar[str] = "an enable contact"

    kind: Literal["enable"]

    def in_words(self, value: float) -> str:
        """See `Command.in_words`."""
        return "enabled" if value >= 0.5 else "off"
