"""What an agent sees and does of a plant, and the box its observations lie in."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from controllers.policy.seen import Seen, inside
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError

Observed = Seen


@dataclass(frozen=True)
class ViewState:
    """State of a view: that of its plant, and what else a step changes."""

    plant: Any
    changed: Mapping[str, Any]


class View(ABC):
    """One convention of actions and observations on one plant, stepped by `BuildingEnv`.

    Attributes:
        plant: the plant, or what stands for it.
        box: names and bounds of the observations.
        action_space: space of the actions, one entry per actuator or overwritten point.
        action_names: names of the actions.
        changes: names of the attributes that a step changes; it replaces their values, and alters none in its place.
    """

    plant: Any
    box: ObservationBox
    action_space: spaces.Box
    action_names: tuple[str, ...]
    changes: tuple[str, ...]

    @property
    @abstractmethod
    def now_s(self) -> float:
        """Current time, s since 1 January."""

    @abstractmethod
    def begin(self, start_s: float, warmup_s: float, length_s: float, scenario: Mapping[str, Any]) -> None:
        """Start at `start_s` after `warmup_s` of native control; `length_s` is the expected length of the episode."""

    @abstractmethod
    def act(self, action: Array) -> None:
        """Apply an action for one step."""

    @abstractmethod
    def observe(self) -> Array:
        """The observation now, unclipped; NaN where something was not measured."""

    @abstractmethod
    def state(self) -> dict[str, float]:
        """Time and what was measured now, by name, for people and for `compute_truncated`."""

    def kpis(self) -> dict[str, float]:
        """BOPTEST's KPIs since the start."""
        return dict(self.plant.kpis())

    def snapshot(self) -> ViewState:
        """State of plant and view, for `restore`; raises `ConfigError` where the plant has none."""
        if not hasattr(self.plant, "snapshot"):
            raise ConfigError(
                "this plant cannot be branched: a service, an FMU and EnergyPlus keep their state to themselves; the "
                "embedded test case and drawn houses can"
            )
        return ViewState(self.plant.snapshot(), {name: getattr(self, name) for name in self.changes})

    def restore(self, snapshot: ViewState) -> None:
        """Return to a snapshot of this view or of one that was branched from it."""
        self.plant.restore(snapshot.plant)
        self.__dict__.update(snapshot.changed)

    def branched(self) -> Self:
        """Another view in the same state on a plant of its own, which shares what no step changes."""
        snapshot, other = self.snapshot(), copy.copy(self)
        other.plant = copy.copy(self.plant)
        other.restore(snapshot)
        return other

    def close(self) -> None:
        """Release the plant; safe to call twice."""
        self.plant.close()


@dataclass(frozen=True)
class ObservationBox:
    """Names and bounds of observations (n,), in their units; raises `ConfigError` for bounds not finite or in order."""

    names: tuple[str, ...]
    low: Array
    high: Array
    space: spaces.Box = field(init=False)
    middle: Array = field(init=False)

    def __post_init__(self) -> None:
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ConfigError(f"observations: bounds of '{name}' are {low:g} and {high:g}: expected low < high")
        low32, high32 = np.asarray(self.low, dtype=np.float32), np.asarray(self.high, dtype=np.float32)
        object.__setattr__(self, "space", spaces.Box(low32, high32, dtype=np.float32))
        object.__setattr__(self, "middle", (np.asarray(self.low) + np.asarray(self.high)) / 2.0)

    @classmethod
    def of(cls, bounds: Sequence[tuple[str, tuple[float, float]]]) -> ObservationBox:
        """The box of names with their bounds, in this order."""
        low, high = (np.array([float(pair[i]) for _, pair in bounds]) for i in (0, 1))
        return cls(tuple(name for name, _ in bounds), low, high)

    def inside(self, values: Array, before: Array | None) -> tuple[Observed, Array, int]:
        """The observation in the box, its values (missing ones as `before`, or mid-way), and how many were missing."""
        missing = np.isnan(values)
        values = np.where(missing, self.middle if before is None else before, values)
        return inside(values, self.space.low, self.space.high), values, int(np.count_nonzero(missing))
