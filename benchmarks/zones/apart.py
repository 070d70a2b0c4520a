"""A controller per zone, each of which knows only its own zone: what planning the zones together is compared with."""

from __future__ import annotations

from collections.abc import Sequence

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.data import Block, Commands, Observation, Plan, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel

# Blocks end together when their ends differ by less, s.
_CLOCK_S = 1e-6


class OnePerZone:
    """Independent controllers side by side, one per zone with its actuator.

    Each has the model of its zone alone, the share of the machine's capacity that is its own, and pays the machine's
    fixed part whenever it asks for heat: it does not know whether others do.
    """

    def __init__(self, model: ThermalModel, config: MPCConfig, name: str = "one_per_zone") -> None:
        """Build the controllers.

        Args:
            model: the building; its effects between zones are left out.
            config: options of each controller.
            name: name in reports.

        Raises:
            DataError: a zone has no actuator or more than one.
        """
        home = model.operator.home
        if sorted(home) != list(range(len(model.operator.zones))):
            raise DataError("one controller per zone: each zone needs one actuator")
        self.name, self._home, self._machine_of = name, home, model.machine_of
        own = [{"actuation": config.actuation_of(name), "actuations": {}} for name in model.names.actuators]
        self._each = [ThermoForceMPC(_alone(model, a), config.model_copy(update=own[a])) for a in range(len(home))]

    @property
    def step_s(self) -> float:
        """Control step, s."""
        return self._each[0].step_s

    @property
    def horizon_s(self) -> float:
        """Required length of the boundary forecast, s."""
        return self._each[0].horizon_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """The plans of all zones as one."""
        states = state if isinstance(state, tuple) else (None,) * len(self._each)
        plans = []
        for a, (controller, before) in enumerate(zip(self._each, states, strict=True)):
            z, m = self._home[a], self._machine_of[a]
            part = Observation(observation.history.part(z, [a], [m]), observation.boundary.part(z, m))
            plans.append(controller.plan(part, before))
        acting = tuple(plan.acting[0] for plan in plans)
        return Plan(
            blocks=_side_by_side([plan.blocks for plan in plans]),
            status=next((status for status in acting if status is not PlanStatus.SOLVED), PlanStatus.SOLVED),
            why="; ".join(plan.why for plan in plans),
            names=observation.history.names,
            acting=acting,
            state=tuple(plan.state for plan in plans),
        )


def _alone(model: ThermalModel, a: int) -> ThermalModel:
    """Actuator `a` with its home zone, and its share of the machine."""
    z, m = model.operator.home[a], model.machine_of[a]
    pair = model.operator.of_actuator(a)
    operator = BuildingOperator((model.operator.zones[z],), (model.operator.actuators[a],), ((pair,),), (0,))
    return ThermalModel(
        operator, (model.power[m],), (model.free[z],), (model.cards[a],), (model.machines[m],), (0,), (model.shares[a],)
    )


def _side_by_side(blocks: Sequence[Sequence[Block]]) -> tuple[Block, ...]:
    """One sequence of blocks with the levels of all: each ends where a block of any of them ends."""
    ends = []
    for one in blocks:
        passed = 0.0
        for block in one:
            passed += block.duration_s
            ends.append(passed)
    out, before = [], 0.0
    for end in sorted(ends):
        if end - before < _CLOCK_S:
            continue
        now = [_at(one, 0.5 * (before + end)) for one in blocks]
        commands: Commands = tuple(block.command[0] for block in now)
        out.append(Block(tuple(block.u[0] for block in now), end - before, commands))
        before = end
    return tuple(out)


def _at(blocks: Sequence[Block], time_s: float) -> Block:
    """The block that holds at `time_s` after the first began."""
    for block in blocks:
        time_s -= block.duration_s
        if time_s < 0.0:
            return block
    return blocks[-1]
