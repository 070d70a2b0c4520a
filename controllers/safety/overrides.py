"""What takes an actuator from the plan: one class an override, tried in order, the first that applies wins.

Before a plan is made: the watch (the model does not hold), the competence gate (it never did,
docs/how-it-works/competence.md), a zone that is not known any more. After it: the comfort guard, where a zone is far
outside its band at the planned level.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np
from pydantic import Field

from controllers.monitoring.watch import WatchState
from controllers.monitoring.zone_sensors import Zones
from controllers.safety.fallback_policy import FallbackPolicy
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.data import Layout, Observation, PlanStatus
from thermoforce_mpc.model.card import FAR_K, MOST_RELATIVE_SD, ModelCard
from thermoforce_mpc.scenario.settings import StrictModel


class GateConfig(StrictModel):
    """Options of the competence gate."""

    enabled: bool = Field(True, description="do not act on a model that is not competent or was not judged")


class GuardConfig(StrictModel):
    """Options of the comfort guard."""

    enabled: bool = Field(True, description="override a plan while the zone is far outside the comfort band")
    # Distance from the band at which the guard acts, K.
    margin_K: ClassVar[float] = FAR_K


@dataclass(frozen=True)
class Override:
    """What one actuator does in the place of a plan: its level (None: native control), what acts by name, and why."""

    level: float | None
    status: PlanStatus
    why: str


@dataclass(frozen=True)
class Situation:
    """What overrides decide from.

    `zones`: each zone now; `watch` (A,): the watch over each actuator's predictions; `planned`: mean
    level of actuators over the step by their number, empty before there is a plan.
    """

    observation: Observation
    zones: Zones
    watch: tuple[WatchState, ...]
    planned: Mapping[int, float] = field(default_factory=dict)


class OverrideRule(Protocol):
    """Says which actuators are not left to the plan."""

    def overrides(self, situation: Situation) -> Mapping[int, Override]:
        """The overrides by number of the actuator."""
        ...


def decide(rules: Sequence[OverrideRule], situation: Situation) -> dict[int, Override]:
    """Which actuators are overridden, by number in increasing order: of several rules the first that applies wins."""
    first: dict[int, Override] = {}
    for rule in rules:
        for a, override in rule.overrides(situation).items():
            first.setdefault(a, override)
    return dict(sorted(first.items()))


class WatchAlarm:
    """Control was handed back because predictions did not come true; `fallbacks` (A,) act instead."""

    def __init__(self, fallbacks: Sequence[FallbackPolicy]) -> None:
        self._fallbacks = tuple(fallbacks)

    def overrides(self, situation: Situation) -> dict[int, Override]:
        """Of the actuators whose watch has given alarm."""
        time_s = situation.observation.time_s
        alarms = {a: state.reason(time_s) for a, state in enumerate(situation.watch) if state.alarm}
        return {a: backup_override(self._fallbacks[a], situation, PlanStatus.WATCH, why) for a, why in alarms.items()}


@dataclass(frozen=True)
class ActsTogether:
    """An actuator that acts with others by one command, of which all together `relative_sd` is known.

    `held`: what is done to its room is not known, so that the room is kept away from its bounds.
    """

    relative_sd: float
    held: bool

    @property
    def in_words(self) -> str:
        """Why it acts."""
        known = f"acts with the others, since their one command is known to ± {100 * self.relative_sd:.0f} % together"
        return known + (", and its room is held away from its bounds" if self.held else "")


class SharedCommands:
    """One command of several actuators acts where what it does to their rooms together is known.

    Each room counts by the heat that the command moves there. Of a room whose model may act it is known as well as the
    card says, of its own actuator or of all together; of another one not at all, unless its model only cannot tell its
    own actuator from the others. All together it must be known as well as an effect that may act
    (`card.MOST_RELATIVE_SD`).
    """

    def __init__(self, layout: Layout, learned: Mapping[int, LearnedCommand], cards: Sequence[ModelCard]) -> None:
        """`learned`: by number of the actuator; `cards` (A,): of each actuator's model."""
        self._layout, self._cards = layout, tuple(cards)
        self._moves = {a: float(layout.weights[a]) * one.loop.moves for a, one in learned.items()}
        groups: dict[str, list[int]] = {}
        for a, one in learned.items():
            if one.machine:
                groups.setdefault(one.machine, []).append(a)
        self._groups = [
            tuple(group) for group in groups.values() if len(group) > 1 and not all(learned[a].untold for a in group)
        ]

    def together(self, closed: Collection[int]) -> dict[int, float]:
        """The actuators, of those `closed` by themselves, that act with others, and how well their sum is known."""
        out: dict[int, float] = {}
        for group in self._groups:
            sd = self._relative_sd(group, closed)
            if sd <= MOST_RELATIVE_SD:
                out |= {a: sd for a in group if a in closed}
        return out

    def open(self, overrides: Mapping[int, Override]) -> tuple[dict[int, Override], dict[int, ActsTogether]]:
        """`overrides` without those of actuators that act together, and these, by number.

        Models that may not act, or whose predictions did not come true, are no hindrance; whatever else is.
        """
        closed = {a for a, one in overrides.items() if one.status in (PlanStatus.GATE, PlanStatus.WATCH)}
        lost = overrides.keys() - closed
        acting = self.together(closed)
        for group in self._groups:
            if lost.intersection(group):
                acting = {a: sd for a, sd in acting.items() if a not in group}
        left = {a: one for a, one in overrides.items() if a not in acting}
        return left, {a: ActsTogether(sd, not self._told(a, closed)) for a, sd in acting.items()}

    def _told(self, a: int, closed: Collection[int]) -> bool:
        """Whether what all actuators do to the room of `a` is known."""
        return a not in closed or (self._cards[a].only_not_apart and self._own_sd(a) <= MOST_RELATIVE_SD)

    def _own_sd(self, a: int) -> float:
        card = self._cards[a]
        own = 0.0 if card.competence is None else card.competence.relative_sd
        return min(own, card.together_sd)

    def _relative_sd(self, group: Sequence[int], closed: Collection[int]) -> float:
        """Relative standard deviation of the heat that one command moves: of rooms not known, all of it at once."""
        moves = np.array([self._moves[a] for a in group])
        told = np.array([self._told(a, closed) for a in group])
        sd = np.array([min(self._own_sd(a), 1.0) for a in group])
        spread = float(np.hypot(np.linalg.norm((moves * sd)[told]), moves[~told].sum()))
        return spread / float(moves.sum()) if moves.sum() > 0.0 else math.inf


class CompetenceGate:
    """A model that is not competent, or was identified but not judged, does not act.

    `cards` (A,): of each actuator's model; `fallbacks` (A,) act instead. Those that `shared` commands set may act
    together all the same.
    """

    def __init__(
        self,
        config: GateConfig,
        cards: Sequence[ModelCard],
        fallbacks: Sequence[FallbackPolicy],
        shared: SharedCommands,
    ) -> None:
        self._fallbacks, self._shared = tuple(fallbacks), shared
        self._reasons = {a: f"gate: {card.unfit}" for a, card in enumerate(cards) if config.enabled and card.unfit}

    @property
    def closes_all(self) -> bool:
        """Whether no actuator may be planned for."""
        return len(self._reasons) == len(self._fallbacks) and not self._shared.together(self._reasons)

    def overrides(self, situation: Situation) -> dict[int, Override]:
        """Of the actuators whose model is not competent."""
        return {
            a: backup_override(self._fallbacks[a], situation, PlanStatus.GATE, why) for a, why in self._reasons.items()
        }


class UntoldCommand:
    """An actuator whose command the record does not tell the effect of, by number and why, is left to itself."""

    def __init__(self, why: Mapping[int, str], fallbacks: Sequence[FallbackPolicy]) -> None:
        self._why, self._fallbacks = dict(why), tuple(fallbacks)

    def overrides(self, situation: Situation) -> dict[int, Override]:
        """Of such actuators."""
        return {a: backup_override(self._fallbacks[a], situation, PlanStatus.GATE, why) for a, why in self._why.items()}


class LostZone:
    """A zone whose temperature is not known any more, by sensor or model; `fallbacks` (A,) act instead."""

    def __init__(self, fallbacks: Sequence[FallbackPolicy]) -> None:
        self._fallbacks = tuple(fallbacks)

    def overrides(self, situation: Situation) -> dict[int, Override]:
        """Of the actuators of such zones."""
        zones = [situation.zones.each[fallback.zone] for fallback in self._fallbacks]
        return {
            a: backup_override(self._fallbacks[a], situation, None, zone.why)
            for a, zone in enumerate(zones)
            if zone.lost
        }


class ComfortGuard:
    """Full level or off where a zone is far outside the comfort band, whatever the plan says.

    `highest` (A,): highest level that may be planned.
    """

    def __init__(self, config: GuardConfig, layout: Layout, highest: Sequence[float]) -> None:
        self._config, self._layout, self._highest = config, layout, tuple(highest)

    def overrides(self, situation: Situation) -> dict[int, Override]:
        """Of the planned actuators whose planned level does not bring such a zone back."""
        guarded = {a: self._guarded(a, u, situation.observation) for a, u in situation.planned.items()}
        return {a: override for a, override in guarded.items() if override is not None}

    def _guarded(self, a: int, u: float, observation: Observation) -> Override | None:
        """The level that brings the zone of actuator `a` back; None while the planned level `u` may act."""
        z, bounds = self._layout.home[a], observation.boundary
        T, lower, upper = (
            float(values[z]) for values in (observation.T_zone_C, bounds.lower_C[:, 0], bounds.upper_C[:, 0])
        )
        if not self._config.enabled or not all(map(math.isfinite, (T, lower, upper))):
            return None
        below, above = lower - T, T - upper
        if max(below, above) <= self._config.margin_K:
            return None
        needed = below > above if self._layout.signs[a] > 0 else above > below
        level = self._highest[a] if needed else 0.0
        if math.isclose(u, level, abs_tol=1e-3):
            return None
        side = f"{below:.2f} K below" if below > above else f"{above:.2f} K above"
        why = f"guard: {T:.2f} °C is {side} the comfort band at a planned level of {u:.2f}: {level:.2f} instead"
        return Override(level, PlanStatus.GUARD, why)


def backup_override(policy: FallbackPolicy, situation: Situation, status: PlanStatus | None, why: str) -> Override:
    """Native control or the on/off rule (`fallback.stand_back`); `status` None: that of which of them acts."""
    level, acting = policy.standing_back(situation.observation, situation.zones.T_C)
    return Override(level, status or unplanned_status(level), f"{why}: {acting}")


def unplanned_status(level: float | None) -> PlanStatus:
    """What acts where a level is not of a plan: the on/off rule, or native control (None)."""
    return PlanStatus.NATIVE if level is None else PlanStatus.THERMOSTAT
