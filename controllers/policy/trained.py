"""A policy of Stable-Baselines3 as a controller: `--controller policy.zip`, its settings beside it in policy.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from controllers.checks import ControllerConfigError
from controllers.entries.entry import Entry
from controllers.policy.seen import PolicySpec, Seen
from thermoforce_mpc.data import Block, Layout, Observation, Plan, PlanStatus
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.errors import suggestion
from thermoforce_mpc.files import parse_json, read_bounded
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.scenario.own_code import policy_settings
from thermoforce_mpc.scenario.settings import StrictModel, validate
from thermoforce_mpc.scenario.testcase import TestCase

ALGORITHMS = ("A2C", "DDPG", "DQN", "PPO", "SAC", "TD3")
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
    content = parse_json(
        read_bounded(settings, _MOST_BYTES, ControllerConfigError), str(settings), ControllerConfigError
    )
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
