"""All that moves the comfort bounds inside, or a machine's capacity down, in one table.

| margin | moves | applies | comes from |
|---|---|---|---|
| comfort | both bounds | always | `comfort_margin_K` |
| back-off | each bound, by lead time | `backoff_level` below 0.5 | band of the free forecast |
| reserve | the bound that actuation protects | `corrections`: fast zones, unless loops keep room set-points | card of the model |
| learned | each bound | more: readings were beyond it while there was more to give; less: a day had room to spare | this run |
| recovery | each bound, where it begins after a setback | how far the zone has to come times the uncertainty of the effect | card of the model |
| | | more: the zone was not there in time | this run |
| offset | the prediction | `corrections` | errors of the last plans, one step ahead |
| passing | the prediction | a first step does more than the model says | these errors, beside the changes of levels |
| unused capacity | the capacity of a machine | several metered actuators share it | heat that they lacked in this run |
| | the highest level | heat is not metered, any level is held | power and heat that were missing at it in this run |

`MarginRules.learn` moves the last five after each step, `MarginRules.bounds` adds the first five; their sum is never
below 0, nor, where actuation protects the bound, below half a step of the sensor. With room set-points what is learned
counts only where a bound is set back, and is never less than 0.

Their sizes:

Back-off is a chance and an integrated chance constraint (Klein Haneveld 1986), which bounds the expected violation in
K: the chance level holds where forecasts are good, and is lowered elsewhere until the bound on the violation holds.

The reserve is for what a plan, which knows the zone at the ends of its steps, cannot see in a fast one: swing under
on/off blocks, error of the next hour. What is missed all the same is learned, and what was not needed is given back. So
is the share of a shared machine's capacity that is left unused: at its limit what one takes too much another lacks.
"""  # noqa: E501

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from controllers.actuation.actuator import Actuation
from controllers.actuation.actuators import Actuators
from controllers.mpc.config import MPCConfig
from controllers.safety.fallback_policy import GoodPlan
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Observation, Record, steps_in
from thermoforce_mpc.data.boundary import SET_BACK_K
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.load import LACKING, LEVEL_EDGE
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K

# Calibrated quantile level from which the standard deviation is computed.
_SPREAD_LEVEL = 0.1
# Averaging window of the expected violation, h: heat given now arrives within it; later violations can be corrected. A
# third more moves levels of a cold day of the heat pump, not its cost (`benchmarks.constants`, 2026-11-28).
_AHEAD_H = 6.0


@cache
def _normal() -> tuple[float, Array, Array]:
    """Normal score of the level of the spread; expected shortfalls below −z, increasing, and their z."""
    from scipy.special import ndtr, ndtri

    z = np.linspace(0.0, 4.0, 401)
    shortfall = np.exp(-(z**2) / 2.0) / np.sqrt(2.0 * np.pi) - z * ndtr(-z)  # φ(z) − z (1 − Φ(z)), decreasing
    return float(-ndtri(_SPREAD_LEVEL)), shortfall[::-1].copy(), z[::-1].copy()


def steps_soon(step_s: float) -> int:
    """Number of steps of `step_s` seconds in the averaging window, at least one."""
    return steps_in(_AHEAD_H * HOUR_S, step_s)


def backoff_K(forecast: FreeForecast, step_s: float, level: float, violation_K: float | None, *, below: bool) -> Array:
    """Back-off from the lower (`below`) or upper bound at the end of each step, (N,) or (Z, N), K, nonnegative.

    `level`: allowed probability of violating the bound, in (0, 0.5]; `violation_K`: allowed expected violation, mean
    over the next 6 h, K; None for the chance level alone.
    """
    T_C = forecast.median_C
    sign, quantile, spread_at = (1.0, level, _SPREAD_LEVEL) if below else (-1.0, 1.0 - level, 1.0 - _SPREAD_LEVEL)
    chance = np.maximum(sign * (T_C - forecast.quantile_C(quantile)), 0.0)
    if violation_K is None:
        return np.asarray(chance)
    spread_z, shortfall, of_z = _normal()
    sd = np.maximum(sign * (T_C - forecast.quantile_C(spread_at)), 0.0) / spread_z
    soon = sd[..., : steps_soon(step_s)].mean(axis=-1, keepdims=True)
    # Solve sd · shortfall(z) = violation.
    z = np.interp(violation_K / np.maximum(soon, 1e-9), shortfall, of_z)
    return np.asarray(np.maximum(chance, z * sd))


# Share of full level that is taken to be free at most for correcting what the forecast missed: half, by judgement, when
# random houses and offices were first run by `bench buildings` (2026-11-25).
_FREE_SHARE = 0.5


def with_recourse_K(backoff: Array, operator: OperatorParameters, free: Array | None = None) -> Array:
    """Back-off (N,), K, from an actuator's own bound, where later plans know more and can still act.

    From the step on by whose end what is free of full level moves the zone as far as the back-off of that lead, what a
    forecast misses is made up for when it is seen: no more is kept for later leads than for that one. That is half of
    full level, or what a plan leaves of it where that is less: `free` (N,), shares; None: no plan.
    """
    rise_K = _rise_K(operator, backoff.size)
    moves_K = _FREE_SHARE * rise_K
    if free is not None:
        moves_K = np.minimum(moves_K, np.convolve(np.diff(rise_K, prepend=0.0), free)[: backoff.size])
    enough = np.flatnonzero(moves_K >= backoff)
    if not enough.size:
        return backoff
    kept = backoff.copy()
    kept[enough[0] :] = np.minimum(kept[enough[0] :], backoff[enough[0]])
    return kept


# Effect of an hour at full level from which a zone is fast, K: a slab gives a few tenths, radiators and air several. A
# third more changes the cost of the heat pump's peak day by 2.4 % (`benchmarks.constants`, 2026-11-28).
_FAST_K = 0.6
# Mean share of on-time that is assumed for the swing, by judgement: at 0.25 and 0.45 blocks swing 0.82 and 1.09 times
# as much.
_SHARE = 0.35
# Share of the held-out error one hour ahead: half of it is felt below the bound. Set with `_SHARE` on generated houses,
# whose light zones were below the bound between the ends of steps (2026-11-22).
_ERROR_SHARE = 0.5


def is_fast(operator: OperatorParameters) -> bool:
    """Whether an hour at full level moves the zone by more than 0.6 K."""
    steps = steps_in(HOUR_S, operator.step_s)
    of_longer_step = min(1.0, HOUR_S / operator.step_s)
    return float(_rise_K(operator, steps)[-1]) * of_longer_step > _FAST_K


def _rise_K(operator: OperatorParameters, steps: int) -> Array:
    """Effect of full level after each of the first steps, in the winter of the limits here, 0 °C outdoors, K."""
    return np.abs(operator.step_response(steps) * operator.heat_input.winter_share)


def reserve_K(operator: OperatorParameters, actuation: Actuation, card: ModelCard) -> float:
    """Reserve inside the bound that actuation protects, K: 0 in a slow zone.

    In a fast one half the swing of on/off blocks and half the held-out error of the next hour. The rounding of a coarse
    sensor is in that error and in the band of the forecast.
    """
    if not is_fast(operator):
        return 0.0
    verdict = card.competence
    errors = [score.model_K for score in verdict.horizons if score.hours == 1.0] if verdict else []
    needed_K = _swing_K(operator, actuation) + _ERROR_SHARE * sum(errors)
    # More than a thermostat keeps would make comfort cost more than a thermostat's.
    return min(needed_K, THERMOSTAT_INSIDE_K) if math.isfinite(needed_K) else THERMOSTAT_INSIDE_K


def _swing_K(operator: OperatorParameters, actuation: Actuation) -> float:
    """Half the swing of the zone under on/off blocks, K: on and off for as long as minimum times and starts ask."""
    if not actuation.switches:
        return 0.0
    c, step_s = actuation.config, operator.step_s
    cycle_s = max(2 * c.block_s, c.min_on_s / _SHARE, c.min_off_s / (1.0 - _SHARE), c.least_cycle_s)
    return 0.5 * float(_rise_K(operator, 1)[0]) * actuation.block_level * _SHARE * (1.0 - _SHARE) * cycle_s / step_s


@dataclass(frozen=True)
class Learning:
    """How a reserve is learned.

    `growth_1_h`: K per hour and K of mean violation above the allowed one, in a step at most the violation. `most_K`:
    the most that is learned, and that one reading counts. `allowed_K`: mean violation that a plan may expect. `fades`:
    whether a reading within the bound takes back what such a violation is allowed.
    """

    growth_1_h: float
    most_K: float
    allowed_K: float
    fades: bool = True


def of_plans(allowed_K: float) -> Learning:
    """For plans of levels: 0.05 K too much all day adds 0.2 K; at most what a thermostat keeps above its bound."""
    return Learning(0.25, 0.3, allowed_K, fades=False)


# Where the plant's own loops keep set-points. They miss them by short drops, as of a fan that pauses at night: few
# readings show them, so one is made up for at once in steps of 15 min. Chosen on two cold weeks of the small office.
OF_LOOPS = Learning(4.0, 1.0, 0.001)
# Share of the room to spare of a day that is given back, and how far beyond its margin a zone was near a
# bound, K; by judgement (2026-11-25).
_GIVEN_BACK, _NEAR_K = 0.5, 0.15
# Most that a bound is anticipated by where it begins, K: by judgement, offices of `bench buildings` at hand
# (2026-11-25); what lacks more is a machine at its limit.
_MOST_RECOVERY_K = 1.0


@dataclass(frozen=True)
class LearnedMargin:
    """What a run has learned of its bounds; of the lower and the upper bound of each zone (2, Z):

    `reserve_K`: reserve inside it; below 0: so much less than what is kept beforehand. `tightest_C`: the highest lower
    and the lowest upper one that was met. `nearest_K`: how near readings were, from inside, while there was more to
    give, since `since_s`, s. `recovery_K`: reserve where it begins, after a setback, besides what the uncertainty of
    the effect asks for. `now_C`: the bounds at the last step, NaN where they are not known.
    """

    reserve_K: Array
    tightest_C: Array
    nearest_K: Array = field(default_factory=lambda: np.full((2, 1), np.inf))
    since_s: float | None = None
    recovery_K: Array = field(default_factory=lambda: np.zeros((2, 1)))
    now_C: Array = field(default_factory=lambda: np.full((2, 1), np.nan))

    @classmethod
    def nothing(cls, zones: int) -> LearnedMargin:
        """At the begin of a run."""
        tightest_C = np.stack([np.full(zones, -np.inf), np.full(zones, np.inf)])
        of_bounds = (2, zones)
        return cls(
            np.zeros(of_bounds),
            tightest_C,
            np.full(of_bounds, np.inf),
            recovery_K=np.zeros(of_bounds),
            now_C=np.full(of_bounds, np.nan),
        )

    def meeting(self, lower_C: Array, upper_C: Array) -> LearnedMargin:
        """With the bounds (Z, N), °C, of the instants ahead, NaN where they are not known."""
        now_C = np.array([lower_C[:, 0], upper_C[:, 0]])
        lower_C, upper_C = np.fmax.reduce(lower_C, axis=-1), np.fmin.reduce(upper_C, axis=-1)
        tightest_C = np.fmax(self.tightest_C[0], lower_C), np.fmin(self.tightest_C[1], upper_C)
        return replace(self, tightest_C=np.array(tightest_C), now_C=now_C)

    def after_setback(self, T_C: Array, lower_C: Array, upper_C: Array, spare: NDArray[np.bool_]) -> LearnedMargin:
        """With a reading (Z,) at the instant at which a bound begins; what is missing there is added for the next time.

        The machine may well have been at full level in the end: the next recovery begins earlier. Half of what there
        was to spare is given back. Bounds (Z,) of now, °C; `spare` (2, Z): whether there was more to give in the hours
        before, else nothing is added.
        """
        missing_K = np.array([lower_C - T_C, T_C - upper_C])
        begins = self.begins(self.now_C, np.array([lower_C, upper_C])) & np.isfinite(missing_K)
        change_K = np.where(begins, np.where(missing_K > 0.0, spare * missing_K, _GIVEN_BACK * missing_K), 0.0)
        return replace(self, recovery_K=np.clip(self.recovery_K + change_K, 0.0, _MOST_RECOVERY_K))

    @staticmethod
    def begins(before_C: Array, bounds_C: Array) -> NDArray[np.bool_]:
        """Where a lower and an upper bound (2, …), °C, are tighter than before."""
        return np.array([bounds_C[0] - before_C[0], before_C[1] - bounds_C[1]]) > SET_BACK_K

    def at_begin_K(self, z: int, now_C: Array, bounds_C: Array, unsure_K: Array) -> Array:
        """Reserve inside the bounds (2, N) of zone `z`, °C, where they begin, K; 0 elsewhere.

        `now_C` (2,): bounds of now. `unsure_K` (2, N): standard deviation of the recovery, K.
        """
        begins = self.begins(np.concatenate([now_C[:, None], bounds_C[:, :-1]], axis=1), bounds_C)
        # One column for all zones: a state from before it was learned.
        recovery_K = np.broadcast_to(self.recovery_K, self.reserve_K.shape)[:, z, None]
        return np.where(begins, np.minimum(recovery_K + unsure_K, _MOST_RECOVERY_K), 0.0)

    def after_reading(
        self, inside_K: Array, spare: NDArray[np.bool_], planned_K: Array, left_K: Array, time_s: float
    ) -> LearnedMargin:
        """With a reading, and after a day with what its readings had to spare.

        What was kept and never used in a day in which the zone came near the bound is halved: down to nothing, since
        the margins that a plan was made with are the most that is given back.

        Of each bound (2, Z): `inside_K`: how far the reading is inside, NaN: not known; `spare`: whether there was more
        to give; `planned_K`: margins in all of the step's plan; `left_K`: the most of them that may be given back.
        """
        nearest_K = np.fmin(self.nearest_K, np.where(spare, inside_K, np.inf))
        since_s = time_s if self.since_s is None else self.since_s
        if time_s - since_s < DAY_S:
            return replace(self, nearest_K=nearest_K, since_s=since_s)
        unused_K = np.where(nearest_K <= planned_K + _NEAR_K, np.maximum(nearest_K, 0.0), 0.0)
        given_K = np.minimum(_GIVEN_BACK * unused_K, left_K)
        fresh = np.full_like(nearest_K, np.inf)
        return replace(self, reserve_K=self.reserve_K - given_K, nearest_K=fresh, since_s=time_s)

    def set_back(self, z: int | slice, lower_C: Array, upper_C: Array) -> NDArray[np.bool_]:
        """Where bounds of zone `z` (N,), or of zones at an instant, °C, are wider than at their tightest, (2, N).

        There loops cycle at low load, and a reserve costs little. The instants ahead do not tell: a weekend is longer.
        """
        tightest_C = self.tightest_C[:, z]
        return np.array([lower_C < tightest_C[0] - SET_BACK_K, upper_C > tightest_C[1] + SET_BACK_K])

    def inside_K(self, z: int, lower_C: Array, upper_C: Array, *, by_loops: bool) -> Array:
        """Reserve inside the bounds (N,) of zone `z`, (2, N), K; `by_loops`: only where they are set back."""
        reserve_K = np.repeat(self.reserve_K[:, z, None], lower_C.size, axis=1)
        return reserve_K * self.set_back(z, lower_C, upper_C) if by_loops else reserve_K


def learned_K(before_K: Array, beyond_K: Array, spare: NDArray[np.bool_], step_s: float, learning: Learning) -> Array:
    """The reserve inside each bound after a step of `step_s` seconds, K, from that before it, any shape.

    `beyond_K`: how far the reading at its end was beyond the bound, negative inside; NaN: not known. `spare`: whether
    the actuators that protect the bound were less than fully used; otherwise nothing is learned.
    """
    violation_K = np.clip(beyond_K, 0.0, learning.most_K)
    change_K = min(learning.growth_1_h * step_s / HOUR_S, 1.0) * (violation_K - learning.allowed_K)
    if not learning.fades:
        change_K = np.maximum(change_K, 0.0)
    learned = spare & np.isfinite(beyond_K)
    least_K = np.minimum(before_K, 0.0)
    return np.asarray(np.clip(before_K + np.where(learned, change_K, 0.0), least_K, learning.most_K))


# Time over which errors are remembered, h; the least standard deviation that they have, K; and how many say
# something. By judgement, when the numbers below were chosen.
_REMEMBERED_H, _LEAST_ERROR_K, _LEAST_ERRORS = 72.0, 0.02, 8.0
# Change of level from which steps count the same, K: large ones are starts, which machines at a limit make slowly. By
# judgement.
_SMALL_K = 0.2
# Prior standard deviation of what a first step gives beyond the model, relative; standard deviations from which it is
# believed; and the share of what it explains of an error that does not last. A model with two thirds of the first step
# does not swing with 0.3 to 0.7 of it (a plant with the responses of `bestest_hydronic`, 2026-11-28).
_FIRST_STEP_SD, _BELIEVED, _PASSES = 0.5, 3.0, 0.7


@dataclass(frozen=True)
class Innovations:
    """What plans missed one step ahead, and what of it lasts; of each zone (Z,).

    A forecast begins at the reading: all that the last plan missed is taken to last. Where a change of level gives more
    in its first step than the model says, that is not so: the next plan takes back too much, and levels and zone swing
    from step to step. The innovations of a right model are white (Mehra 1970); here they go with the change of level.

    `moments` (3, Z): means of x², x e and e², forgotten over 72 h: e is the error, x what the change of level from the
    step before does in its first step by the model, both over the size of x. `count`: of how many steps. `passing_K`:
    what of the last error does not last, K.
    """

    moments: Array
    count: Array
    passing_K: Array

    @classmethod
    def nothing(cls, zones: int) -> Innovations:
        """At the begin of a run."""
        return cls(np.zeros((3, zones)), np.zeros(zones), np.zeros(zones))

    def at_rest(self) -> Innovations:
        """After a step that no plan decided."""
        return replace(self, passing_K=np.zeros_like(self.passing_K))

    def after(self, error_K: Array, change_K: Array, step_s: float) -> Innovations:
        """With the errors e (Z,) of a step, K, and the changes x (Z,), K, NaN where the levels were not the plan's."""
        told = np.isfinite(error_K) & np.isfinite(change_K)
        e, x = np.where(told, error_K, 0.0), np.where(told, change_K, 0.0)
        count = np.minimum(self.count + told, _REMEMBERED_H * HOUR_S / step_s)
        products = np.array([x**2, x * e, e**2]) / (x**2 + _SMALL_K**2)
        moments = self.moments + told / np.maximum(count, 1.0) * (products - self.moments)
        after = replace(self, moments=moments, count=count)
        more, sd = after.first_step
        believed = (count >= _LEAST_ERRORS) & (more > _BELIEVED * sd)
        passing_K = np.where(believed, _PASSES * more * x, 0.0)
        return replace(after, passing_K=np.clip(passing_K, np.minimum(e, 0.0), np.maximum(e, 0.0)))

    @property
    def first_step(self) -> tuple[Array, Array]:
        """How much more a change of level does in its first step than the model says, as a share of that (Z,), with its
        standard deviation.
        """
        x2, xe, e2 = self.moments
        noise = np.maximum(e2 - xe**2 / np.maximum(x2, 1e-12), (_LEAST_ERROR_K / _SMALL_K) ** 2)
        precision = self.count * x2 / noise + _FIRST_STEP_SD**-2
        return self.count * xe / noise / precision, precision**-0.5


# Plans ask for all that they may from this share of it; a machine is at its limit from this share of its capacity:
# below, a warm floor takes less than its level stands for.
_ALL_ASKED, _AT_LIMIT, _MORE_THAN_ALL = 0.85, 0.92, 1.05
# An emitter is cool whose mean level over so many hours was not above this: what it lacks is no warmth of its own, and
# a machine that ran before has warm water. A capacity that mild weather did not show may be far too large: that of
# `house:4rooms:8813` gives .86 of it at 0 °C and .78 at -5 °C, below `_AT_LIMIT`.
_COOL_H, _COOL_LEVEL = 2.0, 0.5
# Levels below this say nothing of heat, by judgement.
_LEAST_LEVEL = 0.1
# Change of the share that is kept: while heat is lacking, and while none is, 1/h; and the most that is kept.
_GROWTH_1_H, _FADING_1_H, _MOST = 0.12, 0.01, 0.25


def learned_share(
    before: float,
    load: float,
    most_W: float,
    heat_W: Array,
    expected_W: Array,
    u: Array,
    step_s: float,
    cool: NDArray[np.bool_],
) -> float:
    """The share kept of one machine's capacity after a step; below 0 where it has given more than that.

    `load`: what the actuators asked for, as a share of the capacity `most_W`. Of each (A,): `heat_W` that it got (NaN:
    not metered), `expected_W` that its level stands for, its mean level `u`, and whether its emitter is `cool`, see
    `cool_emitters`.
    """
    if not (np.isfinite(heat_W).all() and np.isfinite(u).all()):
        return before
    given = float(np.abs(heat_W.sum())) / most_W
    if given > _MORE_THAN_ALL * (1.0 - min(before, 0.0)):
        return before + _TAKEN_OVER * (1.0 - given - before)
    if load < _ALL_ASKED * (1.0 - before):
        return before
    lacking = (np.abs(heat_W) < LACKING * np.abs(expected_W)) & (u >= _LEAST_LEVEL)
    at_limit = given >= _AT_LIMIT * (1.0 - min(before, 0.0)) or (lacking & cool).any()
    rate = _GROWTH_1_H if at_limit and lacking.any() else -_FADING_1_H
    return float(np.clip(before + rate * step_s / HOUR_S, min(before, 0.0), _MOST))


def cool_emitters(u: Array, step_s: float) -> NDArray[np.bool_]:
    """Whether the emitters of one machine with levels `u` (A, n) are cool in the last step while its water is warm."""
    before = u[:, :-1]
    if not (before.shape[1] and (before[:, -1] >= _LEAST_LEVEL).any()):
        return np.zeros(len(u), dtype=bool)
    return np.asarray(before[:, -steps_in(_COOL_H * HOUR_S, step_s) :].mean(axis=1) <= _COOL_LEVEL)


# Power below this share of that of the level, and a zone that stays behind the plan by this, K, together say that the
# machine is at a limit below the level; half of a step's finding is taken over, and no more than this share kept. The
# burner of `bestest_hydronic` gives 0.68 of its level there: its peak day went from 0.62 to 0.24 K·h (2026-11-28).
_LESS_POWER, _BEHIND_K, _TAKEN_OVER, _MOST_BEYOND = 0.9, 0.1, 0.5, 0.4
# A machine that takes less than this share of the power of its level is not at a limit: it stands, as that of an office
# of `bench detectors` does whose mornings were blocked (house 7311:0, 2026-11-28).
_STANDS = 0.25


def share_beyond_limit(
    before: float, u: float, power_W: float, expected_W: float, behind_K: float, step_s: float
) -> float:
    """The share of the highest level beyond a machine's limit after a step, where heat is not metered.

    A machine that has to warm its water first, or whose burner ends below the highest set-point, gives at high levels
    what it gives at a lower one. `u`: the level as a share of the highest, `power_W` measured and `expected_W` by the
    law at that level, `behind_K`: how far the zone stayed behind the plan.
    """
    if not (np.isfinite([u, power_W, expected_W]).all() and u >= _ALL_ASKED and expected_W > 0.0):
        return before
    reached = u * power_W / expected_W
    if _STANDS < reached < _LESS_POWER * u and behind_K > _BEHIND_K:
        return float(np.clip(before + _TAKEN_OVER * (1.0 - reached - before), before, _MOST_BEYOND))
    return max(before - (_FADING_1_H * step_s / HOUR_S if reached >= _LESS_POWER * u else 0.0), 0.0)


# Share of the highest level from which an actuator counts as fully used, by judgement.
_FULLY_USED = 0.95
# Chance levels of the bound that actuation does not protect. A margin there costs heat that is not stored, and saves
# discomfort that cannot be taken back: best is the quantile at the ratio of the two (newsvendor, Arrow et al. 1951).
_OTHER_LEVELS = (0.05, 0.3)
# Hours before a bound begins in which a recovery could have begun: those of a setback by night, by judgement.
_BEFORE_H = 12.0
# Largest offset added to a prediction, K: beyond, the model is wrong rather than off, which the watch tells. The
# radiators' zones for which offsets were made sat 0.05 K below their bound (2026-11-22).
_OFFSET_K = 0.3


def _side(unused: float) -> int:
    """Whether so large a share of a capacity is left unused (1), is none (0) or is more than it (-1)."""
    return int(np.sign(round(unused, 2)))


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
        self._allowed_K = config.backoff_violation_K if config.backs_off else None
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

    def news(self, before: Margins, after: Margins) -> str:
        """What the last step taught of the capacity of machines that plans did not count with before, or do not any
        more, in words; '' where nothing of whole percents.
        """
        told = []
        for machine, was, share in zip(self._layout.names.machines, before.unused, after.unused, strict=True):
            if (side := _side(share)) == _side(was):
                continue
            gave = (
                f"it gave {-100.0 * share:.0f} % more than the capacity of the record: plans count on that"
                if side < 0
                else "it did not give all that was asked for at its limit: "
                f"plans leave {100.0 * share:.0f} % of it unused"
                if side > 0
                else "it gives what is asked for again: plans count on all of it"
                if _side(was) > 0
                else "it is at its limit where the record says: plans count on no more"
            )
            told.append(f"{machine}: {gave}")
        return "; ".join(told)

    def bounds(
        self,
        operator: BuildingOperator,
        free: FreeForecast,
        boundary: Boundary,
        learned: LearnedMargin,
        T_C: Array,
        heat_share: Array,
        good: GoodPlan | None = None,
    ) -> Bounds:
        """Comfort bounds at the end of each step with all margins inside: the only place where they are added.

        `operator`: adjusted to the actuation; `boundary`: the bounds, N steps; `T_C` (Z,): temperatures of the zones
        now, °C; `heat_share` (Z,): what the heat costs that avoids a K·h of discomfort, over what that counts; `good`:
        the last plan, which tells how much of each actuator is free for corrections.
        """
        c, rows, soon = self._config, [], steps_soon(self._step_s)
        left = self._left_free(good, boundary)
        for z in range(len(operator.zones)):
            own = self._layout.actuators_of(z)
            signs, acting = {self._layout.signs[a] for a in own}, {a: operator.of_actuator(a) for a in own}
            # The bound that actuation protects has the chance level of its own; both, where heat and cold are at hand.
            other = float(np.clip(heat_share[z], *_OTHER_LEVELS)) if c.backs_off else c.backoff_level
            low = c.backoff_level if 1 in signs or not own else other
            high = c.backoff_level if -1 in signs else other
            below, above = (
                np.minimum(backoff_K(free, self._step_s, level, self._allowed_K, below=is_lower)[z], c.backoff_max_K)
                for level, is_lower in ((low, True), (high, False))
            )
            for a, by in acting.items():
                # What a fast zone misses at its machine's limit passes with it: more kept beforehand cost 0.4 % and
                # saved nothing there, in slow ones it is worth it (11 cold weeks of houses, 2026-11-30).
                spare = None if left is None or is_fast(by) else left[a]
                if self._layout.signs[a] > 0:
                    below = with_recourse_K(below, by, spare)
                else:
                    above = with_recourse_K(above, by, spare)
            lower_C, upper_C = boundary.lower_C[z, 1:], boundary.upper_C[z, 1:]
            if any(map(is_fast, acting.values())):
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
            reserves_K = np.array([self._reserve_K(acting, sign) for sign in (1, -1)])
            inside_K = c.comfort_margin_K + np.array([below, above]) + reserves_K[:, None] + learned_K
            now_C = np.array([boundary.lower_C[z, 0], boundary.upper_C[z, 0]])
            outside_K = np.array([boundary.lower_C[z, 1:] - T_C[z], T_C[z] - boundary.upper_C[z, 1:]])
            unsure_K = self._unsure[:, z, None] * np.fmax(outside_K, 0.0)
            inside_K += learned.at_begin_K(z, now_C, np.array([lower_C, upper_C]), unsure_K)
            protected = np.array([1 in signs, -1 in signs]) & (c.corrections and not by_loops)
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
            name: np.array(of_zones).T for name, of_zones in zip(names, zip(*firsts, strict=True), strict=True)
        }
        return Bounds(np.array(lower), np.array(upper), first_step, np.array(whole).T)

    def _left_free(self, good: GoodPlan | None, boundary: Boundary) -> Array | None:
        """Share of full level of each actuator that the last plan leaves for corrections (A, N); None without one.

        In a cold night a machine near its limit has nothing left to make up for what the forecast missed.
        """
        planned = None if good is None else good.ahead(float(boundary.time_s[0]), self._step_s, boundary.n_steps)
        if planned is None:
            return None
        used = np.abs(np.where(np.isfinite(planned), planned, _FREE_SHARE))
        left = 1.0 - used / np.array([one.highest for one in self._actuators.each])[:, None]
        for fed in self._layout.actuators_of_machines:
            if len(fed) > 1:  # others may leave it more: not tried on enough houses of rooms
                left[fed] = 1.0
        return np.clip(left, 0.0, 1.0)

    def could_begin_earlier(self, history: Record) -> NDArray[np.bool_]:
        """Whether what protects the lower and the upper bound of each zone had more to give in the last 12 h (2, Z)."""
        steps = min(history.n_steps, round(_BEFORE_H * HOUR_S / self._step_s))
        u = history.u[:, history.n_steps - steps :]
        return self._had_more(np.where(np.isnan(u), 1.0, u).mean(axis=1) if steps else np.ones(len(self._layout.home)))

    def _had_more(self, used: Array) -> NDArray[np.bool_]:
        """Whether what protects the lower and the upper bound of each zone had more to give (2, Z) at levels (A,).

        An actuator at its highest level had not, nor one whose machine was at its capacity.
        """
        more = np.zeros((2, len(self._layout.names.zones)), dtype=bool)
        for a, (z, sign) in enumerate(zip(self._layout.home, self._layout.signs, strict=True)):
            fed = self._layout.fed_by(self._layout.machine_of[a])
            load = float(self._shares[fed] @ used[fed]) if len(fed) > 1 else 0.0
            more[0 if sign > 0 else 1, z] |= max(used[a] / self._actuators.each[a].highest, load) < _FULLY_USED
            if self._layout.u_min[a] < 0.0:
                more[1, z] |= used[a] / self._layout.u_min[a] < _FULLY_USED
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
            same = np.abs(u[own, 1] - good.u[own, 0]) <= LEVEL_EDGE
            if own and same.all():
                change_K[z] = first_K @ (u[own, 1] - u[own, 0])
        return change_K

    def _learned_offset_K(self, before_K: Array, error_K: Array) -> Array:
        """Mean of the errors of planned zone temperatures one step ahead (Z,), K, forgotten over `offset_h`.

        A machine that gives more or less heat at a level than its law misses every step to the same side; the mean of
        these errors is added to the prediction, so that the zone settles on the bound (offset-free control).
        """
        if not self._config.corrections:
            return before_K
        weight = -np.expm1(-self._step_s / HOUR_S / self._config.offset_h)
        # The plan held the offset of its time: what it missed comes on top.
        offset_K = before_K + weight * np.where(np.isfinite(error_K), error_K, 0.0)
        return np.clip(offset_K, -_OFFSET_K, _OFFSET_K)

    def _learned_margin(
        self, before: LearnedMargin, planned_K: Array, T_C: Array, observation: Observation, forecast: Boundary
    ) -> LearnedMargin:
        """Reserve inside the bounds after a step to `T_C` (Z,), °C, with margins of `planned_K` (2, Z) in all, K."""
        # Plans of set-points have no back-off, since the plant's own loops keep them; this is for what these miss.
        by_loops = self._config.actuation.mode == "room_setpoints"
        learning = OF_LOOPS if by_loops else None if self._allowed_K is None else of_plans(self._allowed_K)
        if learning is None:
            return before
        lower_C, upper_C = forecast.lower_C[:, 0], forecast.upper_C[:, 0]
        beyond_K = np.array([lower_C - T_C, T_C - upper_C])
        last = observation.history.u[:, -1]
        spare = self._had_more(np.where(np.isnan(last), 1.0, last)) & self._config.corrections
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
            cool = cool_emitters(history.u[fed], self._step_s)
            unused[m] = learned_share(float(before[m]), load, most_W, heat_W, u * full_W, u, self._step_s, cool)
        for m, a in self._by_levels(operator):
            u, last = history.u[a, -1:] / self._actuators.each[a].highest, slice(-2, -1)
            power = self._powers[m]
            assert power is not None
            before_W = history.u[[a]], history.time_s[:-1], history.T_out_C[:-1], history.power_W[m]
            expected_W = power.seen(*before_W).metered(
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
            if power is None or len(fed) != 1 or self._layout.u_min[fed[0]] < 0.0:
                continue
            if self._actuators.each[fed[0]].modulates and operator.of_actuator(fed[0]).heat_input.law is None:
                yield m, fed[0]

    def _reserve_K(self, acting: Mapping[int, OperatorParameters], sign: int) -> float:
        """Reserve inside the bound that the actuators of one sign among those `acting` in a zone protect, K."""
        reserves = [
            reserve_K(by, self._actuators.each[a], self._cards[a])
            for a, by in acting.items()
            if self._layout.signs[a] == sign and self._config.corrections and not self._actuators.each[a].by_rooms
        ]
        return max(reserves, default=0.0)

    def _metered(self, operator: BuildingOperator, T_out_C: Array) -> Iterator[tuple[int, list[int], Array, Array]]:
        """Machines with known shares whose several actuators are all metered: number, actuators, heat at full level.

        The heat (A of the machine, n) is relative to that at the reference outdoors, which follows (A,), W.
        """
        for m, fed in enumerate(self._layout.actuators_of_machines):
            maps = [operator.of_actuator(a).heat_input for a in fed]
            if len(fed) > 1 and self._shares[fed].all() and all(heat_map.law is not None for heat_map in maps):
                full = np.stack([heat_map.full_share(T_out_C) for heat_map in maps])
                yield m, fed, full, np.array([heat_map.reference_W for heat_map in maps])
