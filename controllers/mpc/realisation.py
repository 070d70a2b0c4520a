"""From decisions to blocks: the plan, what overrides it, and the rungs below it, actuator by actuator.

    solved, bridged → acceptable → shifted (previous plan, limited in age) → thermostat (on/off rule) → native

Watch, gate and lost zones stand before a plan, the guard after it. Whatever acts, `Actuators` turns its levels into
blocks and keeps the state of the machines, so that minimum on and off times hold from one rung to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from controllers.actuation.actuators import Actuators, Demand, PowerLimit
from controllers.mpc.readings import Failure, joined
from controllers.mpc.state import MPCState
from controllers.safety.fallback_policy import FallbackPolicy, GoodPlan
from controllers.safety.overrides import ComfortGuard, Override, Situation, unplanned_status
from thermoforce_mpc.data import Array, Block, Plan, PlanStatus
from thermoforce_mpc.data.plan import UNDECIDED
from thermoforce_mpc.model.machine.load import LEVEL_EDGE

# From the first rung to the last: of several actuators the plan is named after the lowest.
_LADDER = (
    PlanStatus.SOLVED,
    PlanStatus.BRIDGED,
    PlanStatus.ACCEPTABLE,
    PlanStatus.SHIFTED,
    PlanStatus.THERMOSTAT,
    PlanStatus.NATIVE,
)
# Of several overrides the plan is named after the first of these.
_FIRST_NAMED = (PlanStatus.WATCH, PlanStatus.GATE, PlanStatus.NATIVE, PlanStatus.THERMOSTAT)


def _told(blocks: Sequence[Block]) -> set[object]:
    return {block.command[0] for block in blocks}


class Realisation:
    """Turns what is decided into a plan with blocks; it holds no state. `fallbacks` (A,): of each actuator."""

    def __init__(
        self, actuators: Actuators, fallbacks: Sequence[FallbackPolicy], guard: ComfortGuard, step_s: float
    ) -> None:
        self._actuators, self._fallbacks, self._guard, self._step_s = actuators, tuple(fallbacks), guard, step_s
        self._layout = actuators.layout

    def realise(
        self,
        plan: Plan,
        demands: Sequence[Demand],
        overrides: Mapping[int, Override],
        situation: Situation,
        limit: PowerLimit | None = None,
        capacity: Array | None = None,
        by_command: Mapping[int, tuple[tuple[Block, ...], tuple[Block, ...]]] | None = None,
    ) -> Plan:
        """The plan with its blocks.

        `demands` (A,): what it asks of each actuator; `overrides`: what takes its place; `situation`: what the guard
        decides from; `limit`: power that the plan allows in its first step, to which what takes its place is not held;
        `capacity` (M,): as of `Actuators.realise`; `by_command`: what off and full level are of actuators that are set
        by commands.
        """
        by_command = by_command or {}
        begun = self._with_blocks(plan, demands, overrides, limit and limit.without(overrides), capacity)
        planned = {
            a: sum((block.u[a] or 0.0) * block.duration_s for block in begun.blocks) / self._step_s
            for a, demand in enumerate(demands)
            if a not in overrides and (isinstance(demand, float) or a in by_command)  # own control acts on the bounds
        }
        for a, ends in by_command.items():
            if a in planned and not any({block.command[a] for block in begun.blocks} == _told(end) for end in ends):
                # Its loop may give all there is at another command too, as long as the room stays as it is.
                planned[a] = min(max(planned[a], LEVEL_EDGE), 1.0 - LEVEL_EDGE)
        guarded = self._guard.overrides(replace(situation, planned=planned))
        if not guarded:
            return begun
        levels: dict[int, Demand] = {
            a: by_command[a][bool(override.level)] if a in by_command else override.level
            for a, override in guarded.items()
        }
        return self._with_guard(begun, plan, demands, overrides, guarded, levels, limit, capacity)

    def stand_back(self, overrides: Mapping[int, Override], state: MPCState) -> Plan:
        """A step in which every actuator is overridden; nothing is planned, and the last plan is not followed later."""
        plan = Plan((), PlanStatus.NATIVE, "", names=self._layout.names, state=replace(state, good=None))
        return self._with_blocks(plan, [None] * len(overrides), overrides)

    def fall_back(
        self,
        failure: Failure,
        overrides: Mapping[int, Override],
        doubtful: Sequence[bool],
        doubts: Sequence[str],
        situation: Situation,
    ) -> Plan:
        """The last plan one step on, the on/off rule, or native control, actuator by actuator; the guard comes after.

        `doubtful` (A,): whether evidence against the model has gathered, so that older plans are not to be followed.
        """
        names = self._layout.names
        state = replace(failure.state, failures=failure.state.failures + 1)
        fallen = [
            self._fallen(a, None if is_doubtful else state.good, situation) for a, is_doubtful in enumerate(doubtful)
        ]
        free = [a for a in range(len(fallen)) if a not in overrides]
        plan = Plan(
            (),
            max((fallen[a].status for a in free), key=_LADDER.index),
            joined([failure.reason, *doubts, *names.of_actuators({a: fallen[a].why for a in free})]),
            solver_status=failure.solver_status,
            seconds=failure.seconds,
            names=names,
            acting=tuple(override.status for override in fallen),
            state=state,
        )
        return self.realise(plan, [override.level for override in fallen], overrides, situation)

    def release(self, state: MPCState, error: str) -> Plan:
        """A step of native control for all, the last rung, after an error that there is no answer to."""
        names = self._layout.names
        state = replace(state, good=None, failures=state.failures + 1)
        why = f"no decision was made ({error}): native control"
        plan = Plan((), PlanStatus.NATIVE, why, solver_status=f"{UNDECIDED}: {error}", names=names, state=state)
        return self._with_blocks(plan, [None] * len(names.actuators), {})

    def _fallen(self, a: int, good: GoodPlan | None, situation: Situation) -> Override:
        """What actuator `a` does without a new plan; `good`: the last one, None where it is not to be followed."""
        fallback, observation = self._fallbacks[a], situation.observation
        u = fallback.level_to_follow(good, observation, a)
        if u is not None:
            return Override(u, PlanStatus.SHIFTED, f"following the previous plan (u = {u:.2f})")
        u, why = fallback.rule(observation, situation.zones.T_C)
        return Override(u, unplanned_status(u), why)

    def _with_blocks(
        self,
        plan: Plan,
        demands: Sequence[Demand],
        overrides: Mapping[int, Override],
        limit: PowerLimit | None = None,
        capacity: Array | None = None,
    ) -> Plan:
        assert isinstance(plan.state, MPCState)
        levels = [overrides[a].level if a in overrides else demand for a, demand in enumerate(demands)]
        acting = [overrides[a].status if a in overrides else status for a, status in enumerate(plan.acting)]
        acted = self._actuators.realise(levels, self._step_s, plan.state.actuation, limit, capacity)
        excluded = self._actuators.excluded_in_words(acted)
        for a in acted.excluded:
            if acted.states[a].native:
                acting[a] = PlanStatus.NATIVE
        told = self._layout.names.of_actuators({a: override.why for a, override in overrides.items()})
        status = min((o.status for o in overrides.values()), key=_FIRST_NAMED.index) if overrides else plan.status
        return replace(
            plan,
            blocks=acted.together(),
            status=status,
            acting=tuple(acting),
            why=joined([*excluded, *told, acted.over, plan.why]),
            state=replace(plan.state, actuation=acted.states),
        )

    def _with_guard(
        self,
        begun: Plan,
        plan: Plan,
        demands: Sequence[Demand],
        overrides: Mapping[int, Override],
        guarded: Mapping[int, Override],
        instead: Mapping[int, Demand],
        limit: PowerLimit | None,
        capacity: Array | None,
    ) -> Plan:
        """The plan with what the guard asks for `instead`; `begun`: with its own blocks.

        Where the guard acts, the plan is not followed, so it must not be shifted later.
        """
        assert isinstance(plan.state, MPCState)
        guarded = dict(guarded)
        levels = [instead[a] if a in guarded else demand for a, demand in enumerate(demands)]
        names, excluded = self._layout.names.actuators, []
        for a, b in self._layout.excluding():
            if (
                levels[b] and a in guarded and (guarded[a].level or 0.0) > 0.0
            ):  # also of the plan's, whatever their level
                levels[b] = 0.0
                guarded.pop(b, None)
                excluded.append(self._layout.names.of_actuator(b, f"excluded by {names[a]}"))
        state = replace(plan.state, good=None)
        limit = limit and limit.without({*overrides, *guarded})
        redone = self._with_blocks(replace(plan, why="", state=state), levels, overrides, limit, capacity)
        if redone.blocks == begun.blocks:  # minimum on or off time: the machine cannot do more
            return begun
        told = self._layout.names.of_actuators({a: override.why for a, override in guarded.items()})
        why = joined([*told, *excluded, begun.why])
        acting = tuple(PlanStatus.GUARD if a in guarded else status for a, status in enumerate(begun.acting))
        return replace(redone, status=PlanStatus.GUARD, acting=acting, why=why)
