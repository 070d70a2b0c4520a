"""What acts where no new plan does: the rungs below it, actuator by actuator, through the same actuation.

    solved, bridged → acceptable → shifted (previous plan, limited in age) → thermostat (on/off rule) → native

Gate and watch stand before a plan, the guard after it. Whatever acts, `Actuators` turns its levels into blocks and
keeps the state of the machines, so that minimum on and off times hold from one rung to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from controllers.actuation.actuator import Actuation, ActuationState
from controllers.actuation.actuators import Demand
from controllers.mpc.state import MPCState
from controllers.safety.base import ActuatedController
from controllers.safety.fallback_policy import FallbackConfig, Override
from controllers.safety.overrides import GuardConfig, guard_level
from thermoforce_mpc.data import Array, Layout, Observation, Plan, PlanStatus

# From the first rung to the last: of several actuators the plan is named after the lowest.
_LADDER = (
    PlanStatus.SOLVED,
    PlanStatus.BRIDGED,
    PlanStatus.ACCEPTABLE,
    PlanStatus.SHIFTED,
    PlanStatus.THERMOSTAT,
    PlanStatus.NATIVE,
)


class FallbackController(ActuatedController):
    """A controller whose plans may fail, or be overruled, for one actuator or for all."""

    def __init__(
        self,
        name: str,
        step_s: float,
        n_steps: int,
        layout: Layout,
        actuations: Sequence[Actuation],
        fallback: FallbackConfig,
        guard: GuardConfig,
    ) -> None:
        """Set up what acts; `guard`: options of the comfort guard, the others as in `ActuatedController`."""
        super().__init__(name, step_s, n_steps, layout, actuations, fallback)
        self._guard = guard

    def _acted(
        self,
        observation: Observation,
        plan: Plan,
        demands: Sequence[Demand],
        held: Mapping[int, Override],
        T_zone_C: Array,
    ) -> Plan:
        """The plan with the blocks of `demands` (A,), of those `held` what native control or the rule does instead.

        `T_zone_C` (Z,): temperatures that the rule acts on, °C.
        """
        assert isinstance(plan.state, MPCState)
        demands, why, status = list(demands), plan.why, plan.status
        acting = list(plan.acting)
        for a, one in held.items():
            demands[a], who = self._fallbacks[a].standing_back(observation, T_zone_C)
            why = f"{self._told(a, one.why)}: {who}; {why}"
            acting[a] = status = one.status or _named(demands[a])
        acted = self._actuators.realise(demands, self.step_s, plan.state.actuation)
        for a in acted.excluded:
            if acted.states[a].native:
                acting[a] = PlanStatus.NATIVE
        why = "; ".join(filter(None, [*self._excluded(acted), why]))
        state = replace(plan.state, actuation=acted.states)
        return replace(plan, blocks=acted.together(), status=status, acting=tuple(acting), why=why, state=state)

    def _with_guard(
        self,
        observation: Observation,
        plan: Plan,
        demands: Sequence[Demand],
        held: Mapping[int, Override],
        now: MPCState,
        T_zone_C: Array,
    ) -> Plan:
        """The plan, with the guard's level for actuators whose zone is far outside the comfort band."""
        found = {}
        for a, demand in enumerate(demands):
            if a in held or not isinstance(demand, float):
                continue  # the plant's own control acts on the bounds
            planned = sum((block.u[a] or 0.0) * block.duration_s for block in plan.blocks) / self.step_s
            level = guard_level(
                self._guard,
                observation,
                u=planned,
                highest=self._actuators.each[a].highest,
                sign=self._layout.signs[a],
                zone=self._layout.home[a],
            )
            if level is not None:
                found[a] = level
        if not found:
            return plan
        levels: list[Demand] = [found[a][0] if a in found else demand for a, demand in enumerate(demands)]
        names, excluded = self._layout.names.actuators, []
        for a, b in self._layout.excluding():
            if levels[b] and a in found and found[a][0] > 0.0:  # also of the plan's, whatever their level
                levels[b] = 0.0
                found.pop(b, None)
                excluded.append(self._told(b, f"excluded by {names[a]}"))
        # The plan is not followed, so it must not be shifted later.
        begun = replace(plan, why="", state=replace(now, good=now.good))
        guarded = self._acted(observation, begun, levels, held, T_zone_C)
        if guarded.blocks == plan.blocks:  # minimum on or off time: the machine cannot do more
            return plan
        why = "; ".join([*(self._told(a, text) for a, (_, text) in found.items()), *excluded, plan.why])
        acting = tuple(PlanStatus.GUARD if a in found else status for a, status in enumerate(plan.acting))
        return replace(guarded, status=PlanStatus.GUARD, acting=acting, why=why)

    def _stood_back(
        self, observation: Observation, now: MPCState, held: Mapping[int, Override], T_zone_C: Array
    ) -> Plan:
        """A step of native control or of the on/off rule (`fallback.stand_back`) for all; nothing is planned."""
        demands: list[Demand] = []
        told, acting = [], []
        for a, fallback in enumerate(self._fallbacks):
            demand, who = fallback.standing_back(observation, T_zone_C)
            demands.append(demand)
            told.append(self._told(a, f"{held[a].why}: {who}"))
            acting.append(held[a].status or _named(demand))
        acted = self._actuators.realise(demands, self.step_s, now.actuation)
        told += self._excluded(acted)
        acting = [
            PlanStatus.NATIVE if a in acted.excluded and acted.states[a].native else s for a, s in enumerate(acting)
        ]
        status = PlanStatus.WATCH if PlanStatus.WATCH in acting else acting[0]
        # The plan before was not followed, so it must not be shifted later.
        state = replace(now, actuation=acted.states, good=None)
        return Plan(
            acted.together(),
            status,
            "; ".join(told),
            acting=tuple(acting),
            names=self._layout.names,
            state=state,
        )

    def _released(self, before: MPCState, actuation: tuple[ActuationState, ...], reason: str) -> Plan:
        """A step of native control for all, the last rung; `actuation` (A,): the actuators now."""
        acted = self._actuators.realise([None] * len(actuation), self.step_s, actuation)
        state = replace(before, actuation=acted.states, good=None, failures=before.failures + 1)
        return Plan(
            acted.together(),
            PlanStatus.NATIVE,
            f"{reason}: native control",
            acting=(PlanStatus.NATIVE,) * len(actuation),
            names=self._layout.names,
            state=state,
        )

    def _fall_back(
        self,
        observation: Observation,
        now: MPCState,
        held: Mapping[int, Override],
        T_zone_C: Array,
        doubtful: Sequence[bool],
        reason: str,
        solver_status: str,
        seconds: Mapping[str, float],
    ) -> Plan:
        """The last plan one step on, the on/off rule, or native control, actuator by actuator; the guard comes after.

        `doubtful` (A,): whether evidence against the model has gathered, so that older plans are not to be followed.
        """
        demands: list[Demand] = []
        acting, told = [], []
        for a, fallback in enumerate(self._fallbacks):
            u = fallback.level_to_follow(None if doubtful[a] else now.good, observation, a)
            if u is not None:
                acting.append(PlanStatus.SHIFTED)
                why = f"following the previous plan (u = {u:.2f})"
            else:
                u, why = fallback.rule(observation, T_zone_C)
                acting.append(_named(u))
            demands.append(u)
            told.append(self._told(a, why))
        plan = Plan(
            (),
            max(acting, key=_LADDER.index),
            f"{reason}; {'; '.join(told)}",
            solver_status=solver_status,
            seconds=seconds,
            names=self._layout.names,
            acting=tuple(acting),
            state=replace(now, failures=now.failures + 1),
        )
        acted = self._acted(observation, plan, demands, held, T_zone_C)
        return self._with_guard(observation, acted, demands, held, replace(now, failures=now.failures + 1), T_zone_C)


def _named(demand: Demand) -> PlanStatus:
    """What acts by a demand that is not of a plan."""
    return PlanStatus.NATIVE if demand is None else PlanStatus.THERMOSTAT
