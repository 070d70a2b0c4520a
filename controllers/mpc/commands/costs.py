"""What a building under commands costs at its meters, and what it holds at the end of a plan."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from controllers.actuation.commands import CommandedLoop, CommandState
from controllers.mpc.commands.following import power_of_levels
from controllers.optimisation.plan_model import Evaluation, Evaluator
from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import CourseState, MeterEffect, MeterRecord, chance_sd, learn_meter, left_of
from thermoforce_mpc.data import Array, energy_kWh
from thermoforce_mpc.data.dataframes import clock_s
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel

# What plans save at all, as a share of what levels cost: root mean square of what came true by set-points, offset and
# SG-Ready, .16, .09 and .11 of the whole cost (50 houses of `bench commands`, seeds 9530 to 9541 and 9550 to 9554,
# 2026-11-29), of which levels are .86. With it, what is said is off by .046 of the cost (.058 without).
_SAVES = 0.145


def meters_of(model: ThermalModel, learned: Iterable[LearnedCommand]) -> dict[str, MeterEffect]:
    """What the commands of machines do on their meters beside what levels take, by the machine's name."""
    out: dict[str, MeterEffect] = {}
    for one in learned:
        if not one.machine or one.machine in out or one.record is None or one.set_to is None:
            continue
        record, m = one.record, model.names.machines.index(one.machine)
        law_W = model.power_by_law_of(m, record)
        begins_s = record.time_s[:-1]
        T_out_C = step_means(record.T_out_C)
        usual = one.usual_at(one.from_origin_s(begins_s, record.origin), T_out_C)
        at_s = clock_s(begins_s, record.origin)
        seen = MeterRecord(one.set_to, usual, law_W, record.power_W[m], T_out_C, at_s, record.step_s)
        if (found := learn_meter(one.command, seen)) is not None:
            out[one.machine] = found
    return out


@dataclass(frozen=True, eq=False)
class MeteredCommand:
    """What the command of actuator `first` does on the meter of machine `m`."""

    first: int
    m: int
    meter: MeterEffect


@dataclass(frozen=True, eq=False)
class BesideLevels:
    """What S buildings take on meters beside what levels do: currency and kWh (S,), and after the plan; `sd` of both
    costs by what is not known of effects; mean `power_W` (S, N) over each step."""

    cost: Array
    kWh: Array
    after: Array
    sd: Array
    power_W: Array


@dataclass(frozen=True, eq=False)
class BuildingCost:
    """What S buildings cost (S,), currency, all in all, and of it the `peak` and power above a `cap`.

    `law`: what levels alone bring; `beside`: what commands do beside them, with what it changes of what is bought.
    """

    law: Sequence[Evaluation]
    beside: BesideLevels
    cost: Array
    peak: Array
    cap: Array


@dataclass(frozen=True, eq=False)
class MeanCost:
    """What S buildings cost (S,), currency, of it for levels, the levels (S,) and energy (S,), kWh, that they used for
    it, see `BuildingMeters.used`."""

    cost: Array
    of_levels: Array
    used: Array
    kWh: Array

    @property
    def per_kWh(self) -> Array:
        """Mean price of energy, (S,)."""
        return np.asarray(self.cost / np.maximum(self.kWh, 1e-6))

    @property
    def per_used(self) -> Array:
        """Mean cost of a level, (S,)."""
        return np.where(self.used > 1e-6, np.maximum(self.of_levels, 0.0) / np.maximum(self.used, 1e-6), 0.0)


@dataclass(frozen=True, eq=False)
class BuildingMeters:
    """What a building under commands costs at its meters, beside what levels do by what commands do there.

    The arguments are those of `CommandedPlan`.
    """

    problem: MPCProblem
    evaluator: Evaluator
    loops: Mapping[int, CommandedLoop]
    now: Mapping[int, CommandState]
    clock_s: Array
    beside: tuple[MeteredCommand, ...]

    def mean_cost(self, levels: Array) -> MeanCost:
        """What the building costs under its usual commands, of which `levels` (1, A, N) come."""
        usual = {one.first: self.loops[one.first].usual_row[None] for one in self.beside}
        at_meter = self.at_meter(levels, usual, 0.0)
        (brought,), more = at_meter.law, at_meter.beside
        kWh = energy_kWh(brought.power_W.sum(), self.problem.step_s) + more.kWh
        cost = brought.energy_cost.sum()
        of_levels = np.array([cost - self.idle_cost])
        return MeanCost(cost + more.cost, of_levels, self.used(levels), kWh)

    @cached_property
    def idle_cost(self) -> float:
        """What is on the meters at no level, currency: it is no cost of heat."""
        nothing = np.zeros((len(self.problem.power_per_u_W), self.problem.n_steps))
        return float(self.evaluator.evaluate(self._numbers, nothing).energy_cost.sum())

    @cached_property
    def _numbers(self) -> Array:
        return self.evaluator.numbers(self.problem)

    def at_meter(
        self, levels: Array, held: Mapping[int, Array], per_kWh: Array | float, effects: Sequence[Array] = ()
    ) -> BuildingCost:
        """What levels (S, A, N) under commands `held` cost by the statement, see `_on_meters`."""
        evaluator, numbers = self.evaluator, self._numbers
        law = whole = [evaluator.evaluate(numbers, u) for u in levels]
        beside = self._on_meters(held, np.stack([one.power_W for one in law]), per_kWh, effects)
        if self.beside and evaluator.sees_the_meter:
            whole = [
                evaluator.evaluate(evaluator.beside(numbers, W), u) for u, W in zip(levels, beside.power_W, strict=True)
            ]
            bought = [one.parts["energy"] - by.parts["energy"] for one, by in zip(whole, law, strict=True)]
            beside = replace(beside, cost=beside.cost + np.array(bought))
        peak, cap = (np.array([one.parts[part] for one in whole]) for part in ("peak", "cap"))
        moved = [one.parts["peak"] + one.parts["cap"] for one in law]
        cost = np.array([one.cost for one in law]) - moved + peak + cap + beside.cost
        return BuildingCost(law, beside, cost, peak, cap)

    def _on_meters(
        self, held: Mapping[int, Array], law_W: Array, per_kWh: Array | float, effects: Sequence[Array] = ()
    ) -> BesideLevels:
        """What commands `held` (S or 1, P), by actuator, cost and take on meters beside what levels do there.

        `law_W` (S, M, N): power by levels; `per_kWh`: what energy that follows after the plan counts; `effects` (S, p)
        of each of `beside`, the most likely ones by default.
        """
        S = len(law_W)
        cost, kWh, after, variance = np.zeros(S), np.zeros(S), np.zeros(S), np.zeros(S)
        power_W = np.zeros((S, self.problem.n_steps))
        for i, one in enumerate(self.beside):
            loop, meter, law = self.loops[one.first], one.meter, law_W[:, one.m]
            usual, (now, left) = loop.usual_row, self._courses_begin[i]
            values = held.get(one.first, usual[None])
            course = meter.course(values, usual, loop.step_s / loop.parts, loop.parts, law, self.clock_s, now, left)
            of = effects[i] if effects else meter.mean[None]
            beside_W = meter.power_W(course, of, law, self.clock_s)
            each_kWh = energy_kWh(beside_W, self.problem.step_s)
            power_W += beside_W
            price = self.problem.price_per_kWh[one.m]
            cost += each_kWh @ price
            kWh += each_kWh.sum(axis=1)
            after += np.einsum("ps,sp->s", course.after_h, np.broadcast_to(of, (S, of.shape[-1]))) / 1000.0 * per_kWh
            moved = energy_kWh(course.columns @ price, self.problem.step_s) + course.after_h * per_kWh / 1000.0
            variance += ((moved.T @ meter.root) ** 2).sum(axis=1)
        return BesideLevels(cost, kWh, after, np.sqrt(variance), power_W)

    @cached_property
    def _courses_begin(self) -> tuple[tuple[CourseState, float], ...]:
        """Where the course of each of `beside` begins, and what warm water still gives while the machine is off."""
        found = []
        for one in self.beside:
            loop, state = self.loops[one.first], self.now[one.first]
            usual, T_C = float(loop.usual[0]), float(self.problem.T_now_C[loop.room])
            now = one.meter.begin(state.value, usual, state.held_s, float(self.clock_s[0]))
            found.append((now, left_of(loop.learned, one.meter, usual, T_C, float(loop.T_out_C[0]))))
        return tuple(found)

    def used(self, levels: Array) -> Array:
        """Levels (S, A, N) by what their actuators take of the power, (S,)."""
        return np.asarray((power_of_levels(self.problem) * levels.sum(axis=2)).sum(axis=1))

    def chance_sd(self, moved: Collection[int], scatter_W: Sequence[Array]) -> float | None:
        """What chance does to the cost of machines whose actuators `moved` have other commands, currency; None: none.

        `scatter_W` (M): of the meters, where no command was learned on them.
        """
        known = dict(enumerate(scatter_W)) | {one.m: one.meter.scatter_W for one in self.beside}
        price, step_s = self.problem.price_per_kWh, self.problem.step_s
        machines = {int(self.problem.machinery.machine_of[a]) for a in moved}
        each = [chance_sd(known[m], price[m], self.clock_s, step_s) for m in machines if m in known]
        return float(np.sqrt(sum(one**2 for one in each))) if moved else None


def worth_of_states(operator: BuildingOperator, problem: MPCProblem, more_K: Array, mean: MeanCost) -> Array:
    """What the states at the end (S, Z, A, r) that differ by `more_K` are worth, (S,).

    A kelvin of an actuator's slowest mode in its home zone took so many steps at full level; they count at the `mean`
    cost of a level, by what its actuator takes of the power.
    """
    per_u, price = power_of_levels(problem), mean.per_used
    worth, ones = np.zeros(len(more_K)), np.ones(1)
    for a, home in enumerate(operator.home):
        pair, features = operator.of_actuator(a), problem.features[home, -1]
        slowest = int(np.flatnonzero(pair.acting)[-1])
        drive = float(pair.drive(ones, features[None])[0])
        if pair.gains[slowest] * drive:
            worth += price * per_u[a] * more_K[:, home, a, slowest] / (pair.gains[slowest] * drive)
    return worth


def spread_of_savings(of_levels: float, moved: float, off_peak: float) -> float:
    """Prior standard deviation of what a plan saves, currency.

    `of_levels`: what levels cost in the building left alone; `moved`: what its commands change on meters beside them,
    such as hot water that is made when it is cheap, and `off_peak` what it saves of peaks: of both no other prior is
    known. Of 21 plans by SG-Ready of houses 9900 and 9901 of `bench commands --days 14` (2026-11-30) 14 were in their
    bands without `moved`, 18 with it, .17 of currency off instead of .20 and .10 instead of .12.
    """
    return float(np.linalg.norm([_SAVES * of_levels, moved, off_peak]))
