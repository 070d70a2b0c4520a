"""All that moves the comfort bounds inside, or a machine's capacity down, in one table.

| margin | moves | applies | comes from |
|---|---|---|---|
| comfort | both bounds | always | `comfort_margin_K` |
| back-off | each bound, by lead time | chance levels below 0.5, or `backoff_violation_K` | band of the free forecast |
| reserve | the bound that actuation protects | fast zones, unless loops keep room set-points | card of the model |
| learned | each bound | more: readings were beyond it while there was more to give; less: a day had room to spare | this run |
| recovery | each bound, where it begins after a setback | how far the zone has to come times the uncertainty of the effect | card of the model |
| | | more: the zone was not there in time | this run |
| offset | the prediction | `offset_h` | errors of the last plans, one step ahead |
| passing | the prediction | a first step does more than the model says | these errors, beside the changes of levels |
| unused capacity | the capacity of a machine | several metered actuators share it | heat that they lacked in this run |
| | the highest level | heat is not metered, any level is held | power and heat that were missing at it in this run |

`MarginRules.learn` moves the last five after each step, `MarginRules.bounds` adds the first five; their sum is never
below 0, nor, where actuation protects the bound, below half a step of the sensor. With room set-points what is learned
counts only where a bound is set back, and is never less than 0.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuators import Actuators
from controllers.mpc.config import MPCConfig
from controllers.mpc.margin_rules import (
    OF_LOOPS,
    Innovations,
    LearnedMargin,
    backoff_K,
    is_fast,
    learned_K,
    learned_share,
    of_plans,
    reserve_K,
    share_beyond_limit,
    steps_soon,
    with_recourse_K,
)
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import HOUR_S, Array, Boundary, FreeForecast, Observation, Record
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel

# Share of the highest level from which an actuator counts as fully used.
_FULLY_USED = 0.95
# Chance levels of the bound that actuation does not protect. A margin there costs heat that is not stored, and saves
# discomfort that cannot be taken back: best is the quantile at the ratio of the two (newsvendor, Arrow et al. 1951).
_OTHER_LEVELS = (0.05, 0.3)
# Hours before a bound begins in which a recovery could have begun: those of a setback.
_BEFORE_H = 12.0
# Levels that differ by less are the same.
_SAME_LEVEL = 0.02
# Largest offset added to a prediction, K: beyond, the model is wrong rather than off.
_OFFSET_K = 0.3


@dataclass(frozen=True)
class Margins:
    """What a run has learned.

    `offset_K` (Z,): recent mean error of the zone temperatures planned for the end of a step. `learned`: reserve inside
    the bounds. `unused` (M,): share of each machine's capacity that plans leave unused. `innovations`: what of such an
    error does not last.
    """

    offset_K: Array = field(default_factory=lambda: np.zeros(1))
    learned: LearnedMargin = field(default_factory=lambda: LearnedMargin.nothing(1))
    unused: Array = field(default_factory=lambda: np.zeros(1))
    innovations: Innovations = field(default_factory=lambda: Innovations.nothing(1))

    @classmethod
    def nothing(cls, zones: int, machines: int) -> Margins:
        """At the begin of a run."""
        return cls(np.zeros(zones), LearnedMargin.nothing(zones), np.zeros(machines), Innovations.nothing(zones))

    @property
    def moved_K(self) -> Array:
        """What is added to the free response of each zone (Z,), K."""
        return self.offset_K - self.innovations.passing_K


@dataclass(frozen=True)
class Bounds:
    """Comfort bounds with all margins inside, (Z, N) each, °C.

    `first_step`: `comfort`, `backoff`, `reserve` and `learned` inside the lower and the upper bound of the first step
    (2, Z), K. `whole_K`: all of them together, mean over the next 6 h (2, Z), K.
    """

    lower_C: Array
    upper_C: Array
    first_step: dict[str, Array]
    whole_K: Array


class MarginRules:
    """Learns margins and adds them up; `model` is at the control step."""

    def __init__(self, config: MPCConfig, model: ThermalModel, actuators: Actuators) -> None:
        self._config, self._actuators, self._layout = config, actuators, model.layout
        self._cards, self._step_s, self._shares = model.cards, model.operator.step_s, np.array(model.layout.shares)
        self._powers = model.power
        # Half a step of each zone's sensor (Z,), K, and the relative standard deviation of the effect of what protects
        # its lower and its upper bound (2, Z).
        self._half_K, self._unsure = np.zeros(len(model.names.zones)), np.zeros((2, len(model.names.zones)))
        for card, z, sign in zip(model.cards, model.layout.home, model.layout.signs, strict=True):
            self._half_K[z] = max(self._half_K[z], 0.5 * card.uncertainty.get("sensor_resolution_K", 0.0))
            if card.competence and np.isfinite(card.competence.relative_sd):
                side = 0 if sign > 0 else 1
                self._unsure[side, z] = max(self._unsure[side, z], card.competence.relative_sd)

    def learn(
        self,
        operator: BuildingOperator,
        before: Margins,
        good: GoodPlan | None,
        observation: Observation,
        forecast: Boundary,
    ) -> Margins:
        """The margins after the last step.

        `operator`: of the model as identified, adjusted to the actuation; `before`: margins of the last step, `good`
        its solved plan; `observation`: what is believed now; `forecast`: boundary conditions as they were given, for
        the bounds.
        """
        if good is None or good.age(observation.time_s, self._step_s) != 1:  # no plan decided the last step
            learned = before.learned.meeting(forecast.lower_C, forecast.upper_C)
            return replace(before, learned=learned, innovations=before.innovations.at_rest())
        planned_C, T_C = good.T_zone_C[:, 0], observation.T_zone_C
        # A sensor that reads in steps says in which step the zone is, and the plan where in it.
        inside_C = np.clip(planned_C, T_C - self._half_K, T_C + self._half_K)
        seen_C = np.where(np.isfinite(planned_C), inside_C, T_C)
        learned = before.learned.after_setback(
            seen_C, forecast.lower_C[:, 0], forecast.upper_C[:, 0], self.could_begin_earlier(observation.history)
        ).meeting(forecast.lower_C, forecast.upper_C)
        return Margins(
            self._learned_offset_K(before.offset_K, seen_C - planned_C),
            self._learned_margin(learned, good.margin_K, seen_C, observation, forecast),
            self._learned_unused(operator, before.unused, observation.history, seen_C - planned_C),
            before.innovations.after(seen_C - planned_C, self._change_K(operator, good, observation), self._step_s),
        )

    def bounds(
        self,
        operator: BuildingOperator,
        free: FreeForecast,
        boundary: Boundary,
        learned: LearnedMargin,
        T_C: Array,
        heat_share: Array,
    ) -> Bounds:
        """Comfort bounds at the end of each step with all margins inside: the only place where they are added.

        `operator`: adjusted to the actuation; `boundary`: the bounds, N steps; `T_C` (Z,): temperatures of the zones
        now, °C; `heat_share` (Z,): what the heat costs that avoids a K·h of discomfort, over what that counts.
        """
        c, rows, soon = self._config, [], steps_soon(self._step_s)
        for z in range(len(operator.zones)):
            own = self._layout.actuators_of(z)
            signs = {self._layout.signs[a] for a in own}
            # The bound that actuation protects has the chance level of its own; both, where heat and cold are at hand.
            other = c.backoff_level_other or float(np.clip(heat_share[z], *_OTHER_LEVELS))
            low = c.backoff_level if 1 in signs or not own else other
            high = c.backoff_level if -1 in signs else other
            below, above = (
                np.minimum(
                    backoff_K(free, self._step_s, level, c.backoff_violation_K, below=is_lower)[z], c.backoff_max_K
                )
                for level, is_lower in ((low, True), (high, False))
            )
            for a in own:
                if self._layout.signs[a] > 0:
                    below = with_recourse_K(below, operator.of_actuator(a))
                else:
                    above = with_recourse_K(above, operator.of_actuator(a))
            lower_C, upper_C = boundary.lower_C[z, 1:], boundary.upper_C[z, 1:]
            if any(is_fast(operator.of_actuator(a)) for a in own):
                # A bound holds until the next instant: such a zone would leave it in the last step before it ends.
                lower_C = np.maximum(boundary.lower_C[z, :-1], lower_C)
                upper_C = np.minimum(boundary.upper_C[z, :-1], upper_C)
            # Bounds that have crossed in it, or were given so, meet in the middle.
            crossed = lower_C > upper_C
            lower_C, upper_C = (np.where(crossed, 0.5 * (lower_C + upper_C), bound) for bound in (lower_C, upper_C))
            # Margins wider than half the band would swap the bounds.
            half = 0.5 * (upper_C - lower_C)
            by_loops = any(self._actuators.each[a].by_rooms for a in own)
            learned_K = learned.inside_K(z, lower_C, upper_C, by_loops=by_loops)
            reserves_K = np.array([self._reserve_K(operator, z, sign) for sign in (1, -1)])
            inside_K = c.comfort_margin_K + np.stack([below, above]) + reserves_K[:, None] + learned_K
            now_C = np.array([boundary.lower_C[z, 0], boundary.upper_C[z, 0]])
            outside_K = np.array([boundary.lower_C[z, 1:] - T_C[z], T_C[z] - boundary.upper_C[z, 1:]])
            unsure_K = self._unsure[:, z, None] * np.maximum(np.nan_to_num(outside_K), 0.0)
            inside_K += learned.at_begin_K(z, now_C, np.stack([lower_C, upper_C]), unsure_K)
            protected = np.array([1 in signs, -1 in signs]) & (c.reserve and not by_loops)
            inside_K = np.clip(inside_K, np.minimum(protected[:, None] * self._half_K[z], half), half)
            rows.append(
                (
                    lower_C + inside_K[0],
                    upper_C - inside_K[1],
                    (np.full(2, c.comfort_margin_K), np.array([below[0], above[0]]), reserves_K, learned_K[:, 0]),
                    inside_K[:, :soon].mean(axis=1),
                )
            )
        lower, upper, firsts, whole = zip(*rows, strict=True)
        names = ("comfort", "backoff", "reserve", "learned")
        first_step = {
            name: np.stack(of_zones, axis=1) for name, of_zones in zip(names, zip(*firsts, strict=True), strict=True)
        }
        return Bounds(np.stack(lower), np.stack(upper), first_step, np.stack(whole, axis=1))

    def could_begin_earlier(self, history: Record) -> NDArray[np.bool_]:
        """Whether what protects the lower and the upper bound of each zone had more to give in the last 12 h (2, Z)."""
        last = history.last(min(history.n_steps, round(_BEFORE_H * HOUR_S / self._step_s)))
        used = np.nan_to_num(last.u, nan=1.0).mean(axis=1) if last.n_steps else np.ones(len(self._layout.home))
        return self._had_more(used)

    def _had_more(self, used: Array) -> NDArray[np.bool_]:
        """Whether what protects the lower and the upper bound of each zone had more to give (2, Z) at levels (A,).

        An actuator at its highest level had not, nor one whose machine was at its capacity.
        """
        more = np.zeros((2, len(self._layout.names.zones)), dtype=bool)
        for a, (z, sign) in enumerate(zip(self._layout.home, self._layout.signs, strict=True)):
            fed = self._layout.fed_by(self._layout.machine_of[a])
            load = float(self._shares[fed] @ used[fed]) if len(fed) > 1 else 0.0
            more[0 if sign > 0 else 1, z] |= max(used[a] / self._actuators.each[a].highest, load) < _FULLY_USED
            if self._layout.lowest[a] < 0.0:
                more[1, z] |= used[a] / self._layout.lowest[a] < _FULLY_USED
        return more

    def capacity(self, operator: BuildingOperator, T_out_C: Array, unused: Array) -> Array | None:
        """What the actuators of each machine may take together (M, N), in the unit of their shares; None: 1.

        Metered actuators take more at full level the colder it is. Their shares, those of the record's mean, are taken
        as those at 0 °C: after a mild record that asks for some too much, which `unused` (M,) takes back. What the
        machine has is taken as constant.
        """
        most = np.ones((len(self._layout.names.machines), T_out_C.size)) * (1.0 - unused[:, None])
        for m, fed, full, _ in self._metered(operator, T_out_C):
            shares = self._shares[fed]
            most[m] *= shares.sum() / (shares @ full)
        return None if (most == 1.0).all() else most

    def _change_K(self, operator: BuildingOperator, good: GoodPlan, observation: Observation) -> Array:
        """What the change of levels from the step before the last did in the last step by the model (Z,), K.

        NaN where the last levels were not the planned ones: what is missed then is of the levels too.
        """
        u, change_K = observation.history.u[:, -2:], np.full(len(operator.zones), np.nan)
        if u.shape[1] < 2:
            return change_K
        for z in range(change_K.size):
            own = self._layout.actuators_of(z)
            first_K = np.array([float(operator.of_actuator(a).impulse(1)[0]) for a in own])
            same = np.abs(u[own, 1] - good.u[own, 0]) <= _SAME_LEVEL
            if own and same.all():
                change_K[z] = first_K @ (u[own, 1] - u[own, 0])
        return change_K

    def _learned_offset_K(self, before_K: Array, error_K: Array) -> Array:
        """Mean of the errors of planned zone temperatures one step ahead (Z,), K, forgotten over `offset_h`.

        A machine that gives more or less heat at a level than its law misses every step to the same side; the mean of
        these errors is added to the prediction, so that the zone settles on the bound (offset-free control).
        """
        if self._config.offset_h is None:
            return before_K
        weight = -np.expm1(-self._step_s / HOUR_S / self._config.offset_h)
        # The plan held the offset of its time: what it missed comes on top.
        offset_K = before_K + weight * np.where(np.isfinite(error_K), error_K, 0.0)
        return np.clip(offset_K, -_OFFSET_K, _OFFSET_K)

    def _learned_margin(
        self, before: LearnedMargin, planned_K: Array, T_C: Array, observation: Observation, forecast: Boundary
    ) -> LearnedMargin:
        """Reserve inside the bounds after a step to `T_C` (Z,), °C, with margins of `planned_K` (2, Z) in all, K."""
        allowed_K = self._config.backoff_violation_K
        # Plans of set-points have no back-off, since the plant's own loops keep them; this is for what these miss.
        by_loops = self._config.actuation.mode == "room_setpoints"
        learning = OF_LOOPS if by_loops else None if allowed_K is None else of_plans(allowed_K)
        if learning is None:
            return before
        lower_C, upper_C = forecast.lower_C[:, 0], forecast.upper_C[:, 0]
        beyond_K = np.stack([lower_C - T_C, T_C - upper_C])
        spare = self._had_more(np.nan_to_num(observation.history.u[:, -1], nan=1.0)) & self._config.reserve
        if by_loops:
            spare &= before.set_back(slice(None), lower_C, upper_C)
        reserve_K = learned_K(before.reserve_K, beyond_K, spare, self._step_s, learning)
        after = replace(before, reserve_K=reserve_K)
        # Half a step of the sensor is kept anyhow.
        left_K = np.maximum(planned_K - self._half_K, 0.0)
        return after if by_loops else after.after_reading(-beyond_K, spare, planned_K, left_K, observation.time_s)

    def _learned_unused(self, operator: BuildingOperator, before: Array, history: Record, error_K: Array) -> Array:
        unused = before.copy()
        if not self._config.unused_capacity:
            return unused
        for m, fed, full, reference_W in self._metered(operator, history.T_out_C[-2:-1]):
            u, heat_W = history.u[fed, -1], history.heat_W[fed, -1]
            full_W, share = full[:, 0] * reference_W, self._shares[fed]
            most_W = float(np.mean(reference_W / share))
            load = float((share * u * full[:, 0]).sum())
            unused[m] = learned_share(float(before[m]), load, most_W, heat_W, u * full_W, u, self._step_s)
        for m, a in self._by_levels(operator):
            u, last = history.u[a, -1:] / self._actuators.each[a].highest, slice(-2, -1)
            power = self._powers[m]
            assert power is not None
            expected_W = power.metered(
                history.u[a, -1:], history.time_s[last], history.T_out_C[last], history.T_return_C[m, -1:]
            )
            behind_K = -self._layout.signs[a] * float(error_K[self._layout.home[a]])
            measured_W = float(history.power_W[m, -1])
            unused[m] = share_beyond_limit(
                float(before[m]), float(u[0]), measured_W, float(expected_W[0]), behind_K, self._step_s
            )
        return unused

    def most_u(self, operator: BuildingOperator, unused: Array, n_steps: int) -> Array | None:
        """The highest levels that plans count with (A, n_steps) where machines end below them; None: all."""
        limited = [(m, a) for m, a in self._by_levels(operator) if unused[m] > 0.0]
        if not limited:
            return None
        most = np.array([actuation.highest for actuation in self._actuators.each])
        for m, a in limited:
            most[a] *= 1.0 - unused[m]
        return np.repeat(most[:, None], n_steps, axis=1)

    def _by_levels(self, operator: BuildingOperator) -> Iterator[tuple[int, int]]:
        """Machines with one actuator whose heat is not metered and whose levels are held, and that actuator."""
        for m, power in enumerate(self._powers):
            fed = self._layout.fed_by(m)
            if power is None or len(fed) != 1 or self._layout.lowest[fed[0]] < 0.0:
                continue
            if self._actuators.each[fed[0]].modulates and operator.of_actuator(fed[0]).heat_input.law is None:
                yield m, fed[0]

    def _reserve_K(self, operator: BuildingOperator, z: int, sign: int) -> float:
        """Reserve inside the bound that the actuators of one sign protect in zone `z`, K."""
        reserves = [
            reserve_K(operator.of_actuator(a), self._actuators.each[a], self._cards[a])
            for a in self._layout.actuators_of(z)
            if self._layout.signs[a] == sign and self._config.reserve and not self._actuators.each[a].by_rooms
        ]
        return max(reserves, default=0.0)

    def _metered(self, operator: BuildingOperator, T_out_C: Array) -> Iterator[tuple[int, list[int], Array, Array]]:
        """Machines with known shares whose several actuators are all metered: number, actuators, heat at full level.

        The heat (A of the machine, n) is relative to that at the reference outdoors, which follows (A,), W.
        """
        for m in range(len(self._layout.names.machines)):
            fed = self._layout.fed_by(m)
            maps = [operator.of_actuator(a).heat_input for a in fed]
            if len(fed) > 1 and self._shares[fed].all() and all(heat_map.law is not None for heat_map in maps):
                full = np.stack([heat_map.full_share(T_out_C) for heat_map in maps])
                yield m, fed, full, np.array([heat_map.reference_W for heat_map in maps])
