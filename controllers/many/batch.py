"""Plans of many buildings made together: one pass of the forecaster for all of them, each plan checked on its own.

Every building is planned by the computation of a single one (`ThermoForceMPC.planning`); only the work that these
computations ask for is done together. What is wrong with one building costs that one its plan: its own controller takes
over, and the reason says so.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from controllers.checks import ControllerConfigError, check_later, checked_state, message_of
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.state import MPCState
from controllers.safety.deadline import BoundedCalls
from thermoforce_mpc.data import Block, Observation, Plan, PlanStatus
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.execution.cooperative import Computation, DirectHandler, gather, run, timed
from thermoforce_mpc.model.thermal_model import ThermalModel

# Buildings whose computations are open at a time. What a forecaster holds for 128 stays in the process: 128 houses took
# 748 MB at the peak of their first plans, and 388 by 8 at a time, in a tenth less processor time (2026-11-28).
AT_A_TIME = 8
# Calls that may be left behind at a time: each holds a thread, so that a service that hangs cannot take all memory.
_ABANDONED = 16

PlanRequest = tuple[str, Observation, object]
"""A building's name, its observation, and its state after the last plan (None: a run begins)."""
Buildings = Mapping[str, tuple[ThermalModel, MPCConfig]]
"""Model and options of each building by name."""


def buildings_of(models: Mapping[str, ThermalModel], config: MPCConfig | Mapping[str, MPCConfig] | None) -> Buildings:
    """Model and options of each building, the default options where `config` names none.

    Raises `ControllerConfigError` where that names a building without a model, or what is given is no model or no
    options, and `DataError` where models are not given by name.
    """
    check_kind(models, Mapping, "models", "give them by the name of the building")
    configs = config if isinstance(config, Mapping) else {} if config is None else dict.fromkeys(models, config)
    if unknown := sorted(configs.keys() - models.keys()):
        raise ControllerConfigError(f"config: there is no model of building '{unknown[0]}' ({len(unknown)} such)")
    all_configs = {**dict.fromkeys(models, MPCConfig()), **configs}
    for option, values, kind in (("models", models, ThermalModel), ("config", all_configs, MPCConfig)):
        for name, value in values.items():
            if not isinstance(value, kind):
                raise ControllerConfigError(
                    f"{option}: that of building '{name}' is a {type(value).__name__}, expected {kind.__name__}"
                )
    return {name: (model, all_configs[name]) for name, model in models.items()}


@dataclass(frozen=True)
class Planned:
    """What one building is to do. Times are those of the observation's clock, s.

    The blocks of `plan` hold one after another from `begins_s` on, the instant of the observation, the last one until
    `expires_s`; then the building's own controller acts. `state`: to be given with its next observation; None: a run
    begins. `reason`: why it is no plan of a solve that was checked and optimal; empty where it is. `seconds` that it
    cost: `estimate`, `forecast` (its share of the common pass), `solve`, and `all`.
    """

    plan: Plan
    begins_s: float
    expires_s: float
    state: object
    reason: str
    seconds: Mapping[str, float]

    def block_at(self, time_s: float) -> Block | None:
        """What holds at `time_s`; None where the plan is not valid, so that the building's own controller acts."""
        if not self.begins_s <= time_s < self.expires_s:
            return None
        until_s = self.begins_s
        for block in self.plan.blocks:
            until_s += block.duration_s
            if time_s < until_s:
                return block
        return self.plan.blocks[-1]


class BatchPlanner:
    """Plans buildings together, in this process; a plan stays valid for `grace_s` after its step, s."""

    def __init__(self, buildings: Buildings, grace_s: float) -> None:
        self._buildings, self._grace_s = buildings, grace_s
        self._built: dict[str, ThermoForceMPC | Exception] = {}
        self.answer = DirectHandler(BoundedCalls(_ABANDONED), strangers=True)

    @property
    def controllers(self) -> int:
        """How many controllers have been built."""
        return len(self._built)

    def plans(self, requests: Iterable[PlanRequest]) -> Iterator[tuple[str, Planned]]:
        """The plans in the order of `wanted`; no error of a building is raised."""
        remaining = iter(requests)
        while batch := list(islice(remaining, AT_A_TIME)):
            plans = run(gather([self.planning(*request) for request in batch]), self.answer)
            for (name, observation, _), ((plan, state), seconds) in zip(batch, plans, strict=True):
                yield name, self.to_planned(observation, plan, state, seconds)

    def planning(
        self, name: str, observation: Observation, state: object
    ) -> Computation[tuple[tuple[Plan, object], float]]:
        """Plan and next state of one building, and what they cost, s; raises no error of the building."""
        return timed(self._plan_or_native(name, observation, state))

    def _plan_or_native(self, name: str, observation: Observation, state: object) -> Computation[tuple[Plan, object]]:
        """Plan and next state of one building; where there can be no plan, native control, and the state as it was."""
        try:
            plan = yield from self._controller(name).planning(observation, state)
        except Exception as error:  # of the building's data, model or options, which are the caller's
            return self.native_plan(name, observation, message_of(error)), self._usable_state(name, observation, state)
        return plan, plan.state

    def _usable_state(self, name: str, observation: Observation, state: object) -> MPCState | None:
        """`state` where it is one of the building, so that its run goes on; None begins a new one."""
        names = self._buildings[name][0].names if name in self._buildings else observation.names
        try:
            usable = checked_state(state, MPCState, names)
            check_later(None if usable is None else usable.last_s, observation.time_s)
        except DataError:
            return None
        return usable

    def _controller(self, name: str) -> ThermoForceMPC:
        if name not in self._buildings:
            raise DataError(f"there is no model of building '{name}'")
        built = self._built.get(name)
        if built is None:
            try:
                built = ThermoForceMPC(*self._buildings[name], name=name)
            except Exception as error:  # raised at every plan: building anew would give the same
                built = error
            self._built[name] = built
        if isinstance(built, Exception):
            raise built
        return built

    def native_plan(self, name: str, observation: Observation, reason: str) -> Plan:
        """A step of native control because of `reason`."""
        if name in self._buildings:
            model, config = self._buildings[name]
            names, step_s = model.names, config.step_s or model.operator.step_s
        else:  # a forecast of one instant has no step
            boundary = observation.boundary
            names, step_s = observation.names, boundary.step_s if boundary.n_steps else 0.0
        block = Block.native(len(names.actuators), step_s)
        return Plan((block,), PlanStatus.NATIVE, f"{reason}: native control", names=names)

    def without_plan(self, name: str, observation: Observation, reason: str, state: object) -> Planned:
        """A building without a plan because of `reason`."""
        return self.to_planned(observation, self.native_plan(name, observation, reason), state, 0.0)

    def to_planned(self, observation: Observation, plan: Plan, state: object, seconds: float) -> Planned:
        """What a plan and its state mean for the building."""
        begins_s = observation.time_s
        expires_s = begins_s + sum(block.duration_s for block in plan.blocks) + self._grace_s
        acts = plan.status in (PlanStatus.SOLVED, PlanStatus.BRIDGED)
        return Planned(plan, begins_s, expires_s, state, "" if acts else plan.why, {**plan.seconds, "all": seconds})
