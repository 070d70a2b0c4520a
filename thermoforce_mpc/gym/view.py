"""What an agent sees and does of a plant, and the box its observations lie in.

Two conventions: BOPTEST-Gym's, overwritten points in, measurements and forecasts by BOPTEST's names and units out; and
our own, levels of actuators in, temperatures, weather and forecasts in °C out.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

import numpy as np
from gymnasium import spaces

from controllers.policy.trained import FORECAST, PolicySpec, Seen, inside
from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym.sources import PointSource
from thermoforce_mpc.model.forecast_gaps import lengthened
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.settings import suggestion, validate
from thermoforce_mpc.scenario.testcase import TestCase

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
        predictive_s: float | None,
        regressive_s: float | None,
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


class LevelsView(View):
    """Any plant by the levels of its actuators.

    Actions (A,) are levels in [0, 1]. Observations, in this order: sine and cosine of the hour of the day; zone
    temperatures (Z), °C; outdoor temperature, °C; global irradiance, W/m²; mean levels of the last step (A); the zone
    temperatures and levels of earlier steps, latest first; and the forecast from now to `ahead_s` every `every_s` of
    outdoor temperature, irradiance, occupancy and comfort bounds (Z each) and price (M). `PolicySpec` puts them
    together, `spec` here.
    """

    changes = ("_now", "_past", "_table")

    def __init__(
        self,
        plant: Plant,
        testcase: TestCase,
        *,
        step_s: float,
        ahead_s: float,
        every_s: float,
        behind_s: float,
        observations: Mapping[str, tuple[float, float] | None] | None,
        perfect: bool,
    ) -> None:
        """Look at a plant.

        Args:
            step_s: length of a step, s.
            ahead_s: length of the forecast, s.
            every_s: distance of its instants, s, a whole number of steps.
            behind_s: length of the past that is observed, s.
            observations: what is observed (`SIGNALS`), with its bounds, None for the default ones; by default all.
            perfect: forecasts depend on the time alone, so that those of an episode can be read at once.

        Raises `ConfigError` for actuators that take room set-points instead of levels, lengths that do not fit the
        step, or observations that there are not.
        """
        for name, value, least in (("predictive_period", ahead_s, 0.0), ("regressive_period", behind_s, 0.0)):
            if not (np.isfinite(value) and value >= least):
                raise ConfigError(f"{name}: {value!r} s: expected {least:g} s or more")
        if any(isinstance(point.actuator, RoomSetpoints) for point in testcase.points.actuators):
            raise ConfigError(
                f"test case '{testcase.name}' is run by room set-points, not by levels: choose convention='boptest' "
                "where their points are actions"
            )
        self.plant, self._layout, self._perfect = plant, testcase.layout, perfect
        self._step_s, self._ahead_s = step_s, ahead_s
        names, u_min = self._layout.names, self._layout.u_min
        chosen = {} if observations is None else {"observations": dict(observations)}
        seen = {"step_s": step_s, "ahead_s": ahead_s, "every_s": every_s, "behind_s": behind_s, **chosen}
        self.spec = validate(PolicySpec, {**asdict(names), "u_min": u_min, **seen}, "the environment")
        self.spec.check()
        self._behind, self.action_names = self.spec.n_behind, names.actuators
        self.action_space = spaces.Box(np.array(u_min, np.float32), np.ones(len(u_min), np.float32))
        self.box = ObservationBox.of(self.spec.entries)

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self._now.time_s

    def begin(self, start_s: float, warmup_s: float, length_s: float, scenario: Mapping[str, Any]) -> None:
        """See `View.begin`; raises `ConfigError` for another key in the scenario than `electricity_price`."""
        for unknown in sorted(set(scenario) - {"electricity_price"}):
            raise ConfigError(f"scenario: unknown key '{unknown}'; this convention knows electricity_price")
        price = scenario.get("electricity_price") or "constant"
        self._now = self.plant.reset(start_s, warmup_s, price)
        self._past = self.spec.past(self.plant.past(self._step_s), self._now.T_zone_C)
        if np.isnan(self._now.u).any():  # right after a reset, what the native control did in the step before
            self._now = replace(self._now, u=np.nan_to_num(self._past[0, len(self._now.T_zone_C) :]))
        self._table = (start_s, self._forecast(length_s + self._ahead_s)) if self._perfect else (start_s, np.empty(0))

    def act(self, action: Array) -> None:
        """Apply levels (A,) for one step; of actuators that exclude one another the one with the highest level acts."""
        levels: list[float | None] = [float(level) for level in action]
        for a in self._layout.excluded(levels) if self._layout.exclusive else ():
            levels[a] = 0.0
        self._now = self.plant.advance(levels, self._step_s)
        if self._behind:
            row = np.concatenate([self._now.T_zone_C, self._now.u])
            self._past = np.concatenate([row[None], self._past[:-1]])

    def observe(self) -> Array:
        """The observation now, in the order of the class's description."""
        now = self._now
        past = np.vstack([np.concatenate([now.T_zone_C, now.u]), self._past[1:]])
        return self.spec.values(now.time_s, past, (now.T_out_C, now.solar_W_m2), self._coming())

    def state(self) -> dict[str, float]:
        """Time, temperatures, levels and comfort bounds now."""
        names, coming = self._layout.names, self._coming()
        values = {"time": self.now_s, "T_out_C": float(self._now.T_out_C)}
        values |= {names.label("T_zone_C", z): float(T) for z, T in enumerate(self._now.T_zone_C)}
        zones = len(names.zones)
        for i, name in enumerate(("lower_C", "upper_C"), start=1):
            values |= {names.label(name, z): float(coming[2 + i * zones + z, 0]) for z in range(zones)}
        return values

    def _coming(self) -> Array:
        start_s, table = self._table
        first = round((self.now_s - start_s) / self._step_s)
        if not table.size or first + self.spec.offsets[-1] >= table.shape[1]:
            first, table = 0, self._forecast(self._ahead_s)
        return np.asarray(table[:, first + self.spec.offsets])

    def _forecast(self, horizon_s: float) -> Array:
        """Forecast from now at every step (signals, n); NaN at instants that the plant leaves out."""
        steps = max(int(horizon_s / self._step_s + 1e-9), 1)
        boundary = lengthened(self.plant.forecast(steps * self._step_s, self._step_s), steps, self._step_s)
        return np.vstack([np.atleast_2d(getattr(boundary, name)) for name in FORECAST])
