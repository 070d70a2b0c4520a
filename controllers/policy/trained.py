"""A policy of Stable-Baselines3 as a controller: `--controller policy.zip`, its settings beside it in policy.json.

What an agent sees of a building and what its actions mean: the same in its environment and in a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from controllers.checks import ControllerConfigError
from controllers.entries.entry import Entry
from thermoforce_mpc.data import DAY_S, Array, Block, Layout, Names, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.errors import DataError, suggestion
from thermoforce_mpc.files import read_json
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.scenario.own_code import policy_settings
from thermoforce_mpc.scenario.settings import StrictModel, validate
from thermoforce_mpc.scenario.testcase import TestCase

Seen = NDArray[np.float32]
# Bounds of what is observed, °C, W/m², persons per zone and currency/kWh. What lies outside is clipped.
_BOUNDS = {
    "hour": (-1.0, 1.0), "T_zone_C": (10.0, 35.0), "T_out_C": (-30.0, 45.0), "solar_W_m2": (0.0, 1200.0),
    "lower_C": (10.0, 35.0), "upper_C": (10.0, 35.0), "occupancy": (0.0, 20.0), "price_per_kWh": (-0.5, 1.5),
}  # fmt: skip
_WEATHER = ("T_out_C", "solar_W_m2")
# What is forecast, in the order of the observation.
FORECAST = (*_WEATHER, "occupancy", "lower_C", "upper_C", "price_per_kWh")
SIGNALS = ("hour", "T_zone_C", *_WEATHER, "u", *(f"forecast_{name}" for name in FORECAST))
"""What can be observed."""


class PolicySpec(StrictModel):
    """Settings of an environment by the levels of actuators, which a policy trained there needs in a run."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    zones: tuple[str, ...] = Field(description="names of the zones")
    actuators: tuple[str, ...] = Field(description="names of the actuators")
    machines: tuple[str, ...] = Field(description="names of the machines")
    # Files of policies name it as those of models do.
    u_min: tuple[float, ...] = Field(alias="lowest", description="lowest level of each actuator")
    step_s: float = Field(ge=1, description="length of a step, s")
    ahead_s: float = Field(ge=0, description="length of the forecast, s")
    every_s: float = Field(ge=1, description="distance of its instants, s, a whole number of steps")
    behind_s: float = Field(0.0, ge=0, description="length of the past that is observed, s")
    observations: dict[str, tuple[float, float] | None] = Field(
        default_factory=lambda: dict.fromkeys(SIGNALS),
        description="what is observed, and its bounds; null: the default",
    )
    scaled_observations: bool = Field(False, description="observations lie between -1 and 1")
    scaled_actions: bool = Field(False, description="actions lie between -1 and 1")
    bins: int = Field(0, ge=0, description="intervals between the values of a discrete action; 0: continuous")
    algorithm: str = Field("", description="class of Stable-Baselines3 that the policy is of")

    @cached_property
    def names(self) -> Names:
        """Names of zones, actuators and machines."""
        return Names(self.zones, self.actuators, self.machines)

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Steps ahead of the observed instants of the forecast (n,)."""
        return np.arange(0, int(self.ahead_s / self.step_s + 1e-9) + 1, round(self.every_s / self.step_s))

    @cached_property
    def n_behind(self) -> int:
        """Number of earlier steps that are observed."""
        return int(self.behind_s / self.step_s + 1e-9)

    def check(self) -> None:
        """Raise `ControllerConfigError` for a distance of forecasts or an observation that there is not."""
        ratio = self.every_s / self.step_s
        if not ratio >= 1 or abs(ratio - round(ratio)) > 1e-9:
            raise ControllerConfigError(
                f"forecast_every: {self.every_s!r} s: expected a whole number of steps of {self.step_s:g} s"
            )
        for name in self.observations:
            if name not in SIGNALS:
                raise ControllerConfigError(
                    f"observations: '{name}' cannot be observed{suggestion(name, SIGNALS)}; known: {', '.join(SIGNALS)}"
                )
        if not self.observations:
            raise ControllerConfigError(f"observations: give at least one of {', '.join(SIGNALS)}")

    @cached_property
    def entries(self) -> list[tuple[str, tuple[float, float]]]:
        """Names of what is observed, with their bounds, in the order of the observation."""
        chosen = [one for one in self._all if one[0] in self.observations]
        return [(label, self.observations[signal] or bounds) for signal, label, bounds in chosen]

    def values(self, time_s: float, past: Array, weather: Sequence[float], coming: Array) -> Array:
        """The observation, unclipped (n,); NaN where something was not measured.

        At `time_s`, s since 1 January: `past` (n_behind + 1, Z + A), zone temperatures, °C, and mean levels of the step
        before, now and at earlier steps, latest first; `weather`: outdoor temperature, °C, and irradiance, W/m², now;
        `coming` (rows, n): forecasts (`FORECAST`, rows of each) at `offsets`.
        """
        angle, Z = 2.0 * np.pi * (time_s % DAY_S) / DAY_S, len(self.zones)
        now = past[0]
        parts = [[np.sin(angle), np.cos(angle)], now[:Z], weather, now[Z:], past[1:].ravel(), coming.ravel()]
        return np.concatenate(parts)[[signal in self.observations for signal, *_ in self._all]]

    def past(self, record: Record, now_C: Array) -> Array:
        """Temperatures and mean levels of the steps of a record, latest first (n_behind + 1, Z + A).

        Where the record is shorter, its first step stands for those before it; without a step, `now_C` (Z,), °C, and
        level 0 do.
        """
        before = np.vstack([record.T_zone_C[:, 1:], record.u]).T[::-1][: self.n_behind + 1]
        if not len(before):
            before = np.concatenate([now_C, np.zeros(len(self.actuators))])[None]
        return np.vstack([before, *[before[-1:]] * (self.n_behind + 1 - len(before))])

    def of(self, observation: Observation) -> Array:
        """`values` of what a controller sees; raises `DataError` where it is of another building, or its step is
        another.
        """
        record, ahead = observation.history, observation.boundary
        check_same_building("the policy", self.names, "the building", record.names, error=DataError)
        for what, times in (("history", record.time_s), ("forecast", ahead.time_s)):
            if len(times) > 1 and abs(float(times[1] - times[0]) - self.step_s) > 1e-3:
                raise DataError(f"{what}: its step is {times[1] - times[0]:g} s, the policy's {self.step_s:g} s")
        past = self.past(record, record.T_zone_C[:, -1])
        past[0, len(self.zones) :] = np.nan_to_num(past[0, len(self.zones) :])
        coming = np.vstack([np.atleast_2d(getattr(ahead, name)) for name in FORECAST])
        missing = int(self.offsets[-1]) + 1 - coming.shape[1]
        coming = np.pad(coming, ((0, 0), (0, max(missing, 0))), constant_values=np.nan)[:, self.offsets]
        return self.values(observation.time_s, past, (record.T_out_C[-1], record.solar_W_m2[-1]), coming)

    def observe(self, observation: Observation) -> Seen:
        """The environment's observation of what a controller sees (see `of`); what was not measured is mid-bounds."""
        low, high = np.array([bounds for _, bounds in self.entries]).T
        values = self.of(observation)
        seen = inside(np.where(np.isnan(values), (low + high) / 2.0, values), low, high)
        return scaled(seen, low, high) if self.scaled_observations else seen

    def levels(self, action: Any) -> Array:
        """The levels (A,) that an action means."""
        low, high = np.array(self.u_min), np.ones(len(self.u_min))
        ends = (-np.ones_like(low), high) if self.scaled_actions else (low, high)
        values = of_bins(int(action), self.bins, *ends) if self.bins else np.asarray(action, dtype=np.float64)
        return np.clip(unscaled(values, low, high) if self.scaled_actions else values, low, high)

    @cached_property
    def _all(self) -> list[tuple[str, str, tuple[float, float]]]:
        """Signal, name and default bounds of all that can be observed, in order."""
        names = self.names
        zones = [("T_zone_C", names.label("T_zone_C", z), _BOUNDS["T_zone_C"]) for z in range(len(names.zones))]
        acted = [("u", names.label("u", a), (low, 1.0)) for a, low in enumerate(self.u_min)]
        found = [("hour", name, _BOUNDS["hour"]) for name in ("hour_sin", "hour_cos")]
        found += [*zones, *((name, name, _BOUNDS[name]) for name in _WEATHER), *acted]
        for back in range(1, self.n_behind + 1):
            found += [(signal, f"{label}-{back * self.step_s:g}s", pair) for signal, label, pair in (*zones, *acted)]
        for name in FORECAST:
            labels = [name] if name in _WEATHER else [names.label(name, row) for row in range(names.rows(name))]
            coming = [f"{label}+{k * self.step_s:g}s" for label in labels for k in self.offsets]
            found += [(f"forecast_{name}", label, _BOUNDS[name]) for label in coming]
        return found


def inside(values: Array, low: NDArray[Any], high: NDArray[Any]) -> Seen:
    """Values (n,) clipped to their bounds."""
    return np.minimum(np.maximum(values.astype(np.float32), low.astype(np.float32)), high.astype(np.float32))


def scaled(values: Seen, low: NDArray[Any], high: NDArray[Any]) -> Seen:
    """Values between their bounds as numbers from −1 to 1."""
    low, high = low.astype(np.float32), high.astype(np.float32)
    return np.clip(2.0 * (values - low) / (high - low) - 1.0, -1.0, 1.0).astype(np.float32)


def unscaled(action: Any, low: NDArray[Any], high: NDArray[Any]) -> Array:
    """The action between its limits that a number from −1 to 1 means."""
    return np.asarray(low + (np.asarray(action) + 1.0) / 2.0 * (high - low))


def of_bins(number: int, bins: int, low: NDArray[Any], high: NDArray[Any]) -> Array:
    """The action (A,) of a number, of `bins` + 1 equally spaced values of each; the last changes fastest."""
    at = np.unravel_index(number, (bins + 1,) * len(low))
    return np.asarray(np.linspace(low, high, bins + 1, axis=-1)[np.arange(len(low)), at])


ALGORITHMS = ("A2C", "DDPG", "DQN", "PPO", "SAC", "TD3")
# A settings file has some kilobytes; one that is longer cannot be one, and would fill the memory.
_MOST_BYTES = 1_000_000


class Agent(Protocol):
    """What decides by what it sees; an algorithm of Stable-Baselines3."""

    def predict(self, observation: Seen, *, deterministic: bool) -> tuple[Any, Any]:
        """The action for an observation, and a state."""
        ...


class PolicyController:
    """A trained policy; native control where a zone's temperature is missing. Stateless.

    Raises:
        ControllerConfigError: it was trained for another building.
    """

    def __init__(self, spec: PolicySpec, agent: Agent, layout: Layout, *, name: str) -> None:
        check_same_building("the policy", spec.names, "the test case", layout.names, error=ControllerConfigError)
        self.name, self._spec, self.agent, self._layout = name, spec, agent, layout
        # Those of the training.
        self.step_s, self.horizon_s = spec.step_s, max(spec.ahead_s, spec.step_s)

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One block of the levels that the policy prefers."""
        names = self._layout.names
        if np.isnan(observation.T_zone_C).any():
            blocks, why = Block.native(len(names.actuators), self.step_s), "zone temperature missing: native control"
        else:
            action, _ = self.agent.predict(self._spec.observe(observation), deterministic=True)
            levels: list[float | None] = self._spec.levels(action).tolist()
            why = "the policy's levels: " + ", ".join(f"{level:.2f}" for level in levels)
            for a in self._layout.excluded(levels):
                levels[a] = 0.0
            blocks = Block(levels, self.step_s)
        return Plan((blocks,), PlanStatus.RULE, why, names=names)


def policy_entry(name: str) -> Entry:
    """The entry of the policy in the file `name`; raises `ControllerConfigError` where it cannot be used."""
    spec = _spec(Path(name))

    def build(name: str, options: StrictModel, testcase: TestCase, model: object) -> Controller:
        return PolicyController(spec, _agent(name, spec.algorithm), testcase.layout, name=name)

    return Entry(f"a policy of {spec.algorithm}", False, lambda: StrictModel, build)


def _spec(path: Path) -> PolicySpec:
    settings = policy_settings(str(path))
    for file in (path, settings):
        if not file.is_file():
            raise ControllerConfigError(
                f"controller '{path}': no file {file}; `thermoforce_mpc.gym.save(agent, env, '{path}')` writes both"
            )
    content = read_json(settings, _MOST_BYTES, ControllerConfigError)
    spec = validate(PolicySpec, content, str(settings))
    spec.check()
    if spec.algorithm not in ALGORITHMS:
        near = suggestion(spec.algorithm, ALGORITHMS)
        raise ControllerConfigError(
            f"{settings}: algorithm: unknown '{spec.algorithm}'{near}; known: {', '.join(ALGORITHMS)}"
        )
    return spec


def _agent(name: str, algorithm: str) -> Agent:
    """The policy, on the processor; its file is unpickled by the library, which runs what is in it."""
    try:
        import stable_baselines3
    except ModuleNotFoundError as error:
        raise ControllerConfigError(
            f"controller '{name}' needs {error.name}, which is not installed: pip install 'thermoforce-mpc[rl]'"
        ) from error
    try:
        agent: Agent = getattr(stable_baselines3, algorithm).load(name, device="cpu")
    except Exception as error:  # the library raises many types
        raise ControllerConfigError(
            f"controller '{name}': cannot be loaded as {algorithm} ({type(error).__name__}: {str(error)[:200]})"
        ) from error
    return agent
