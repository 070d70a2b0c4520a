"""From an environment to a run: what a trained policy needs to be a controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.wrappers.common import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit

from controllers.policy.trained import ALGORITHMS, PolicySpec, Seen
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import write_whole
from thermoforce_mpc.gym.env import BuildingEnv
from thermoforce_mpc.gym.model_env import ModelVectorEnv
from thermoforce_mpc.gym.view import LevelsView
from thermoforce_mpc.gym.wrappers import DiscretizedActionWrapper, NormalizedActionWrapper, NormalizedObservationWrapper
from thermoforce_mpc.scenario.own_code import policy_settings

# Wrappers that change neither observations nor actions.
_TRANSPARENT = (OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit)


def spec_of(env: gymnasium.Env[Any, Any] | ModelVectorEnv) -> PolicySpec:
    """What an agent sees and does in an environment of convention 'levels', in our wrappers; raises `ConfigError`."""
    if isinstance(env, ModelVectorEnv):
        return env.policy_spec
    changes: dict[str, Any] = {}
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, NormalizedObservationWrapper):
            changes["scaled_observations"] = True
        elif isinstance(env, NormalizedActionWrapper):
            changes["scaled_actions"] = True
        elif isinstance(env, DiscretizedActionWrapper):
            changes["bins"] = env.n_bins_act
        elif not isinstance(env, _TRANSPARENT):
            raise ConfigError(
                f"env: what {type(env).__name__} changes cannot be repeated in a run; use the wrappers of "
                "thermoforce_mpc.gym.wrappers"
            )
        env = env.env
    if not (isinstance(env, BuildingEnv) and isinstance(env.view, LevelsView)):
        raise ConfigError("env: a policy can be run from an environment of convention='levels' only")
    return env.view.spec.model_copy(update=changes)


def observe(spec: PolicySpec, observation: Observation) -> Seen:
    """The environment's observation of what a controller sees; raises `DataError` for another building or step."""
    return spec.observe(observation)


def save(agent: Any, env: gymnasium.Env[Any, Any] | ModelVectorEnv, path: str | Path) -> None:
    """Write a policy for `tf-mpc run --controller policy.zip`: `path`, and the settings of `env` beside it as .json.

    Args:
        agent: an algorithm of Stable-Baselines3 that was trained in `env`.
        env: the environment, with its wrappers; not a vector of them.
        path: file that ends in .zip.

    Raises `ConfigError` where one of them does not fit, `StorageError` where a file cannot be written.
    """
    path, algorithm = Path(path), type(agent).__name__
    if path.suffix != ".zip":
        raise ConfigError(f"path: {path}: expected a name that ends in .zip")
    if algorithm not in ALGORITHMS:
        raise ConfigError(f"agent: {algorithm} cannot be run; known: {', '.join(ALGORITHMS)}")
    if agent.get_vec_normalize_env() is not None:
        raise ConfigError("agent: VecNormalize is not kept in a run; use NormalizedObservationWrapper instead")
    spec = spec_of(env).model_copy(update={"algorithm": algorithm})
    path.parent.mkdir(parents=True, exist_ok=True)
    agent.save(path)
    write_whole(policy_settings(str(path)), spec.model_dump_json(indent=2) + "\n")
