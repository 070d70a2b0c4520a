"""What an agent sees and does of a plant, and the box its observations lie in.

BOPTEST-Gym's convention: overwritten points in, measurements and forecasts by BOPTEST's names and units out.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from controllers.policy.trained import Seen, inside
from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym.sources import PointSource
from thermoforce_mpc.scenario.settings import suggestion

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


class PointsView(View):
    """A test of BOPTEST's interface by its points (conventions of BOPTEST-Gym, Arroyo et al. 2021).

    Observations, in this order: the time, modulo its upper bound; measurements; each measurement at earlier steps,
    latest first; and each forecast from now to `predictive_s` at every step, both ends included.
    """

    changes = ("_past", "_table")

    def __init__(
        self,
        source: PointSource,
        actions: Sequence[str],
        observations: Mapping[str, tuple[float, float]],
        *,
        step_s: float,
        predictive_s: float | None = None,
        regressive_s: float | None = None,
    ) -> None:
        """Look at a test.

        Args:
            actions: inputs that are overwritten, `<point>_u`; their limits are those of the test case.
            observations: bounds by name of measurement or forecast, or 'time'.
            step_s: length of a step, s.
            predictive_s: length of the forecasts, s; needed where one is observed, 0 is the value now.
            regressive_s: length of the past of every measurement, s; None or a step or more.

        Raises `ConfigError`, which names the argument, for an unknown name, bounds that are no pair, or a length out of
        range.
        """
        self.plant, self.action_names, self._step_s = source, tuple(actions), step_s
        for name in actions:
            if name not in source.inputs or not name.endswith("_u"):
                names = [key for key in source.inputs if key.endswith("_u")]
                raise ConfigError(
                    f"actions: unknown input '{name}'{suggestion(name, names)}; known: {', '.join(names)}"
                )
        if not actions:
            raise ConfigError("actions: give at least one input")
        for name, bounds in observations.items():
            if np.shape(bounds) != (2,):
                raise ConfigError(f"observations: '{name}' is {bounds!r}: expected a pair of lower and upper bound")
            if name != "time" and name not in source.measurements and name not in source.forecasts:
                names = ["time", *source.measurements, *source.forecasts]
                raise ConfigError(
                    f"observations: '{name}' is neither measured nor forecast{suggestion(name, names)}; "
                    f"known: {', '.join(names)}"
                )
        self._measured = [name for name in observations if name in source.measurements]
        self._forecast = [name for name in observations if name in source.forecasts and name not in self._measured]
        if self._forecast and not (predictive_s is not None and 0 <= predictive_s < np.inf):
            raise ConfigError(
                f"predictive_period: {predictive_s!r}: the forecasts {', '.join(self._forecast)} need 0 s or more"
            )
        if regressive_s is not None and not step_s <= regressive_s < np.inf:
            raise ConfigError(f"regressive_period: {regressive_s!r} s: expected None, or {step_s:g} s (a step) or more")
        self._predictive_s = float(predictive_s or 0.0)
        self._n_ahead = int(self._predictive_s / step_s + 1e-9) + 1
        self._n_behind = int((regressive_s or 0.0) / step_s + 1e-9)
        self._modulo = float(observations["time"][1]) if "time" in observations else None
        bounds_of = {name: (float(low), float(high)) for name, (low, high) in observations.items()}
        entries = [(name, bounds_of[name]) for name in (*(["time"] if "time" in bounds_of else []), *self._measured)]
        behind, ahead = range(1, self._n_behind + 1), range(self._n_ahead)
        for kind, names, steps in (("regr", self._measured, behind), ("pred", self._forecast, ahead)):
            entries += [(f"{name}_{kind}_{int(k * step_s)}", bounds_of[name]) for name in names for k in steps]
        if not entries:
            raise ConfigError("observations: give at least one point")
        self.box = ObservationBox.of(entries)
        limits = [source.inputs[name] for name in actions]
        for name, (low, high) in zip(actions, limits, strict=True):
            if low is None or high is None:
                raise ConfigError(f"actions: the test case gives no limits for '{name}'")
        self._limits = np.array(limits, dtype=np.float64)
        lowest, highest = self._limits.T.astype(np.float32)
        self.action_space = spaces.Box(lowest, highest)

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self.plant.now_s

    def begin(self, start_s: float, warmup_s: float, length_s: float, scenario: Mapping[str, Any]) -> None:
        """See `View.begin`."""
        self.plant.begin(start_s, warmup_s, self._step_s, scenario)
        self._past = self.plant.measured(self._measured)[:, None]
        if n := self._n_behind:
            times = self.now_s - np.arange(1.0, n + 1) * self._step_s
            self._past = np.hstack([self._past, self.plant.past(self._measured, times)])
        table = np.empty((0, 0))
        if self._forecast and self.plant.perfect:
            table = self.plant.forecast(self._forecast, length_s + self._predictive_s, self._step_s)
        self._table = (start_s, table)

    def act(self, action: Array) -> None:
        """Overwrite the inputs with these values (A,), in the units of the interface, for one step."""
        # float32 of a limit may lie beyond it.
        values = np.clip(action, self._limits[:, 0], self._limits[:, 1])
        inputs = {name: float(value) for name, value in zip(self.action_names, values, strict=True)}
        self.plant.advance(inputs | {name[: -len("_u")] + "_activate": 1.0 for name in self.action_names})
        now = self.plant.measured(self._measured)[:, None]
        self._past = np.hstack([now, self._past[:, : self._n_behind]])

    def observe(self) -> Array:
        """The observation now, in the order of the class's description."""
        time = () if self._modulo is None else (self.now_s % self._modulo,)
        return np.concatenate([time, self._past[:, 0], self._past[:, 1:].ravel(), self._coming().ravel()])

    def state(self) -> dict[str, float]:
        """Time and observed measurements now; zone temperatures in K also in °C, as `T_zone_C[name]`."""
        measured = dict(zip(self._measured, self._past[:, 0].tolist(), strict=True))
        zones = {f"T_zone_C[{name}]": T - ZERO_C_K for name, T in measured.items() if name.startswith("reaTZon")}
        return {"time": self.now_s} | measured | zones

    def _coming(self) -> Array:
        if not self._forecast:
            return np.empty(0)
        start_s, table = self._table
        first = round((self.now_s - start_s) / self._step_s)
        if first + self._n_ahead <= table.shape[1]:
            return np.asarray(table[:, first : first + self._n_ahead])
        return self.plant.forecast(self._forecast, self._predictive_s, self._step_s)
