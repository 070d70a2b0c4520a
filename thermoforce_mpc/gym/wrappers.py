"""Wrappers of BOPTEST-Gym, by its names: observations and actions between −1 and 1, actions in bins."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.policy.trained import of_bins, scaled, unscaled
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym.view import Observed

_Env = gymnasium.Env[Any, Any]


class NormalizedObservationWrapper(gymnasium.ObservationWrapper[Observed, Any, Observed]):
    """Observations scaled by their bounds to lie between −1 and 1; the space says so."""

    def __init__(self, env: _Env) -> None:
        super().__init__(env)
        self._box = _box(env.observation_space, "observation_space")
        self.observation_space = spaces.Box(-1.0, 1.0, self._box.shape, np.float32)

    def observation(self, observation: Observed) -> Observed:
        """The scaled observation (n,)."""
        return scaled(observation, self._box.low, self._box.high)


class NormalizedActionWrapper(gymnasium.ActionWrapper[Any, NDArray[np.float32], Any]):
    """Actions between −1 and 1, scaled to their limits."""

    def __init__(self, env: _Env) -> None:
        super().__init__(env)
        self._box = _box(env.action_space, "action_space")
        self.action_space = spaces.Box(-1.0, 1.0, self._box.shape, np.float32)

    def action(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """The action (A,) within its limits."""
        return unscaled(action, self._box.low, self._box.high).astype(np.float32)


class DiscretizedActionWrapper(gymnasium.ActionWrapper[Any, int, Any]):
    """`n_bins_act` + 1 equally spaced values of each action as one number; the last action changes fastest."""

    def __init__(self, env: _Env, n_bins_act: int = 10) -> None:
        super().__init__(env)
        if n_bins_act < 1:
            raise ConfigError(f"n_bins_act: {n_bins_act}: expected 1 or more")
        box = _box(env.action_space, "action_space")
        self.n_bins_act, self.n_act = n_bins_act, int(box.shape[0])
        self._box, self.val_bins_act = box, np.linspace(box.low, box.high, n_bins_act + 1, axis=-1)
        self.action_space = spaces.Discrete((n_bins_act + 1) ** self.n_act)  # type: ignore[assignment]

    def action(self, action: int) -> NDArray[np.float32]:
        """The values (A,) of a number."""
        return of_bins(int(action), self.n_bins_act, self._box.low, self._box.high).astype(np.float32)


def _box(space: spaces.Space[Any], name: str) -> spaces.Box:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ConfigError(f"{name} is {space}: this wrapper needs a Box of one axis")
    return space
