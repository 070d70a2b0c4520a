"""The environment: episodes, reward, snapshot, branch and picture over a view of a plant.

It is no controller in `thermoforce_mpc.loop`: the agent decides outside, and looks back no further than its observation
says. The loop around a controller that does nothing makes 1,600 steps a second of a core on the embedded test case, the
environment 4,750, the plant alone 11,000 (a day ahead, steps of 15 min, 2026-11-28).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, YEAR_S, Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym.view import Observed, View, ViewState
from thermoforce_mpc.plants.shell import is_number


@dataclass(frozen=True)
class Episodes:
    """Length and start of episodes, s; times count from 1 January.

    `start_time` is the start of every episode unless `random_start_time`: then it is any whole number of steps after 1
    January for which the episode, with `behind` before it and `ahead` after it, lies in the year and overlaps none of
    `excluding_periods`. An episode may touch an excluded period. `warmup_period` under native control comes before it.

    Raises `ConfigError`, which names the argument, where a length is out of range, or no start is possible.
    """

    step_period: float = 900.0
    max_episode_length: float = 7 * DAY_S
    warmup_period: float = DAY_S
    start_time: float = 0.0
    random_start_time: bool = False
    excluding_periods: Sequence[tuple[float, float]] | None = None
    ahead: float = 0.0
    behind: float = 0.0

    def __post_init__(self) -> None:
        least = {"step_period": 30.0, "max_episode_length": self.step_period, "warmup_period": 0.0, "start_time": 0.0}
        for name, low in least.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and low <= value < YEAR_S):
                raise ConfigError(f"{name}: {value!r} s: expected {low:g} s or more, less than a year")
        # Their limits are the view's, which knows what it observes; here they only have to be numbers.
        for name, value in (("predictive_period", self.ahead), ("regressive_period", self.behind)):
            if not np.isfinite(value):
                raise ConfigError(f"{name}: {value!r} s: expected a finite number")
        for pair in self.excluding_periods or ():
            if not (np.shape(pair) == (2,) and all(map(is_number, pair)) and pair[0] < pair[1]):
                raise ConfigError(
                    f"excluding_periods: {pair!r}: expected pairs of begin and later end, s since 1 January; a period "
                    "over New Year is two of them"
                )
        if self.random_start_time and not self.possible_starts.size:
            raise ConfigError(
                "excluding_periods: with random_start_time no episode of "
                f"{self.max_episode_length / DAY_S:g} days fits into the rest of the year"
            )

    @cached_property
    def possible_starts(self) -> Array:
        """Every start that `random_start_time` may draw (n,), s."""
        last = YEAR_S - self.max_episode_length - self.ahead
        starts = np.arange(np.ceil(self.behind / self.step_period), last / self.step_period + 1e-9) * self.step_period
        free = np.ones(starts.size, dtype=bool)
        for first, final in self.excluding_periods or ():
            free &= (starts + self.max_episode_length <= first) | (starts >= final)
        return np.asarray(starts[free])

    def start_s(self, rng: np.random.Generator) -> float:
        """Start of the next episode, s; draws from `rng` only with `random_start_time`."""
        return float(rng.choice(self.possible_starts)) if self.random_start_time else float(self.start_time)


def drawn(
    trace: Sequence[tuple[Mapping[str, float], Array]], rewards: Sequence[float], actions: Sequence[str]
) -> NDArray[np.uint8]:
    """Temperatures with their bounds, actions and summed reward over the hours, as pixels (400, 800, 3).

    `trace`: measured values by name, °C for names that begin with T, and actions (A,), one pair per step.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    above, below, last = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1, 1))
    if trace:
        hours = (np.array([state["time"] for state, _ in trace]) - trace[0][0]["time"]) / HOUR_S
        for name in trace[0][0]:
            values = [state[name] for state, _ in trace]
            if name.startswith("T_zone"):
                above.plot(hours, values, label=name)
            elif name.startswith(("lower", "upper")):
                above.plot(hours, values, color="0.6", linewidth=1, drawstyle="steps-post")
        for i, name in enumerate(actions):
            below.plot(hours, [action[i] for _, action in trace], drawstyle="steps-pre", label=name)
        last.plot(hours, np.cumsum(rewards))
        above.legend(fontsize=7, ncols=3)
    above.set_ylabel("°C")
    below.set_ylabel("action")
    last.set_ylabel("reward")
    last.set_xlabel("hours")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


_RESET_OPTIONS = ("start_time",)
# Tolerance on times, s.
_CLOCK_S = 1e-3


@dataclass(frozen=True)
class EnvSnapshot:
    """State of an environment at one instant; opaque, for `BuildingEnv.restore`."""

    view: ViewState
    episode: Mapping[str, Any]
    random: Mapping[str, Any]


class BuildingEnv(gymnasium.Env[Any, Any]):
    """A building as a Gymnasium environment.

    The reward of a step is −(Δcost_tot + `discomfort_weight` · Δtdis_tot): the rise of BOPTEST's KPIs in currency/m²
    and K·h (mean over zones), as in BOPTEST-Gym. Derive a class with another `get_reward`, `compute_terminated` or
    `compute_truncated` for other tasks. Episodes never terminate; they are truncated after `max_episode_length`.

    Attributes:
        view: what is seen and done of the plant.
        observations, action_names: names of the observations, in order, and of the actions.
        max_episode_length, step_period: lengths of an episode and of a step, s.
        start_time: start of the episode, s since 1 January.
        episode_rewards: rewards since the start.
        objective_integrand: cost_tot + `discomfort_weight` · tdis_tot since the start.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        view: View,
        episodes: Episodes,
        *,
        scenario: Mapping[str, Any] | None = None,
        discomfort_weight: float = 1.0,
        reward: Callable[[BuildingEnv], float] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Put a view into episodes; raises `ConfigError` where an option is out of range.

        Args:
            scenario: BOPTEST's scenario, of which `electricity_price` is known to every plant.
            discomfort_weight: weight of a K·h, currency/m².
            reward: the reward of the last step of the environment that it is called with, instead of `get_reward`'s.
            render_mode: 'rgb_array', or None.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode: {render_mode!r}: expected None or one of {self.metadata['render_modes']}")
        if not (np.isfinite(discomfort_weight) and discomfort_weight >= 0):
            raise ConfigError(f"discomfort_weight: {discomfort_weight!r}: expected a number from 0")
        self.view, self._episodes = view, episodes
        self.max_episode_length, self.step_period = episodes.max_episode_length, episodes.step_period
        self.scenario = dict(scenario or {"electricity_price": "constant"})
        self.discomfort_weight, self.render_mode, self._reward = discomfort_weight, render_mode, reward
        self.observation_space, self.action_space = view.box.space, view.action_space
        self.observations, self.action_names = list(view.box.names), view.action_names
        self.start_time = episodes.start_time
        self.objective_integrand = 0.0
        self.episode_rewards: list[float] = []
        self._trace: list[tuple[dict[str, float], Array]] = []
        self._last: Array | None = None
        self._kpis: dict[str, float] = {}
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Begin an episode. `seed` alone determines it; `options={"start_time": s}` sets its start instead.

        Raises `ConfigError` for an unknown option, `InputError` for a start that the plant does not have, `PlantError`.
        """
        super().reset(seed=seed)
        for unknown in sorted(set(options or {}) - set(_RESET_OPTIONS)):
            raise ConfigError(f"reset: unknown option '{unknown}'; known: {', '.join(_RESET_OPTIONS)}")
        start_s = (options or {}).get("start_time")
        if start_s is not None and not (is_number(start_s) and start_s >= 0):
            raise ConfigError(f"reset: start_time: {start_s!r}: expected seconds since 1 January")
        self._running = False  # until the plant stands at the new start
        self.start_time = self._episodes.start_s(self.np_random) if start_s is None else float(start_s)
        self.view.begin(self.start_time, self._episodes.warmup_period, self.max_episode_length, self.scenario)
        self.objective_integrand, self.episode_rewards, self._trace = 0.0, [], []
        self._last, self._kpis, self._running = None, {}, True
        return self._observe()

    def step(self, action: Any) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Apply `action` for one step; returns observation, reward, terminated, truncated and info.

        `info` has the time `time_s`, `cost_tot` and `tdis_tot` since the start, and `missing`, the number of
        observations that were not measured.

        Raises:
            ResetNeeded: no episode is running.
            ConfigError: the action has another shape, or is not finite.
            PlantError: the plant or its service failed.
        """
        if not self._running:
            raise ResetNeeded("no episode is running: call reset() first")
        requested = np.asarray(action, dtype=np.float64)
        if requested.shape != self.action_space.shape or not np.isfinite(requested).all():
            raise ConfigError(
                f"action {action!r}: expected {self.action_space.shape[0]} finite numbers "  # type: ignore[index]
                f"({', '.join(self.action_names)})"
            )
        applied = np.minimum(np.maximum(requested, self.view.action_space.low), self.view.action_space.high)
        self.view.act(applied)
        self._kpis = {}
        reward = float(self._reward(self) if self._reward else self.get_reward())
        self.episode_rewards.append(reward)
        state = {"time": self.view.now_s}
        if self.render_mode is not None:
            state = self.view.state()
            self._trace.append((state, applied))
        observation, info = self._observe()
        terminated = bool(self.compute_terminated(state, reward))
        truncated = bool(self.compute_truncated(state, reward))
        self._running = not (terminated or truncated)
        return observation, reward, terminated, truncated, info

    def get_reward(self) -> float:
        """Reward of the last step: the fall of `objective_integrand`, which this updates."""
        kpis = self.get_kpis()
        objective = kpis["cost_tot"] + self.discomfort_weight * kpis["tdis_tot"]
        reward, self.objective_integrand = self.objective_integrand - objective, objective
        return reward

    def compute_terminated(self, res: Mapping[str, float], reward: float | None = None) -> bool:
        """Whether the task is over: never. `res` has the `time`, s."""
        return False

    def compute_truncated(self, res: Mapping[str, float], reward: float | None = None) -> bool:
        """Whether the episode has reached its length. `res` has the `time`, s."""
        return res["time"] >= self.start_time + self.max_episode_length - _CLOCK_S

    def get_kpis(self) -> dict[str, float]:
        """BOPTEST's KPIs since the start of the episode."""
        if not self._kpis:
            self._kpis = self.view.kpis()
        return dict(self._kpis)

    def snapshot(self) -> EnvSnapshot:
        """State of plant, episode and random numbers, for `restore`; raises `ConfigError` as `View.snapshot`."""
        return EnvSnapshot(self.view.snapshot(), copy.deepcopy(self._episode()), self.np_random.bit_generator.state)

    def restore(self, snapshot: EnvSnapshot) -> None:
        """Return to a snapshot of this environment, or of one that was branched from it."""
        self.view.restore(snapshot.view)
        self.__dict__.update(copy.deepcopy(dict(snapshot.episode)))
        self.np_random.bit_generator.state = snapshot.random

    def branch(self) -> BuildingEnv:
        """Another environment in the same state with a plant of its own; raises `ConfigError` as `snapshot`."""
        other = copy.copy(self)
        other.view = self.view.branched()
        other.__dict__.update(copy.deepcopy(self._episode()))
        other.np_random = copy.deepcopy(self.np_random)
        return other

    def render(self) -> Any:
        """The episode so far as a picture (height, width, 3); None without `render_mode`."""
        if self.render_mode is None:
            return None
        from thermoforce_mpc.gym.env import drawn

        return drawn(self._trace, self.episode_rewards, self.action_names)

    def close(self) -> None:
        """Release the plant; safe to call twice."""
        self.view.close()

    def _observe(self) -> tuple[Observed, dict[str, Any]]:
        observation, self._last, missing = self.view.box.inside(self.view.observe(), self._last)
        kpis = self.get_kpis()
        info = {"time_s": self.view.now_s, "missing": missing}
        return observation, info | {name: kpis[name] for name in ("cost_tot", "tdis_tot") if name in kpis}

    def _episode(self) -> dict[str, Any]:
        """What an episode changes, besides plant and random numbers."""
        names = ("start_time", "objective_integrand", "episode_rewards", "_trace", "_last", "_kpis", "_running")
        return {name: getattr(self, name) for name in names}
