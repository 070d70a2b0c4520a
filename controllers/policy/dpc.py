"""Differentiable predictive control (Drgoňa et al., J. Process Control 116, 2022): a network instead of a solver.

The network gives the levels of a step from what they must bring about. It is rolled out over the horizon through the
identified operator and trained, before the first step, by the gradient of the statement's own cost of drawn instances.
All else is the MPC's: what is believed, gate, watch, margins, bounds of levels, the check of every plan, fallbacks.

The instances are drawn from the model alone: courses of levels that would just keep the zones at a bound, in weather as
far from the mean as the record's was. A free response less what these bring is one that asks for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from controllers.checks import ControllerConfigError
from controllers.mpc.controller import ThermoForceMPC
from controllers.optimisation.plan_model import PlanModel
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, SolverAnswer, checked, failed
from controllers.policy.config import DPCConfig, PolicyConfig
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record, steps_in
from thermoforce_mpc.data.clock import hour_of_day
from thermoforce_mpc.model.free_response.backbones.base import one_thread
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OUTDOOR, feature_matrix
from thermoforce_mpc.model.predictor import PredictionContext
from thermoforce_mpc.model.thermal_model import ThermalModel

# Hours ahead at which the network sees what is needed and what it costs, and where these are cut off. By judgement:
# twice as far each. The policy of `PolicyConfig` was trained with these and the numbers that follow (2026-11-28).
_LEADS_H = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 24.0)
_LEAST, _MOST = -2.0, 3.0
# How much the levels of the network reach beyond their bounds, where they are cut off: it can say off and full.
_BEYOND = 0.03
_BATCH, _RATE = 64, 5e-3


class DPC(ThermoForceMPC):
    """A policy trained through the operator of a model, in the place of the MPC's solver; trained when it is built."""

    def __init__(self, model: ThermalModel, config: DPCConfig | None = None, *, name: str = "dpc", **mpc: Any) -> None:
        """As `ThermoForceMPC`.

        Raises:
            ControllerConfigError: also where the gain sees the predicted temperature, or actuators exclude one another.
        """
        options = config or DPCConfig()
        if any(pair.feedback_active for *_, pair in model.operator.each()):
            raise ControllerConfigError(
                f"controller '{name}': the model's gain sees the predicted temperature, through which a policy is not "
                "trained; identify it with identification.options.feedback: false"
            )
        if model.layout.exclusive:
            raise ControllerConfigError(
                f"controller '{name}': of actuators that exclude one another a network cannot choose; use "
                "thermoforce_mpc"
            )
        self._policy: Policy | None = None
        super().__init__(model, options, name=name, solver=partial(PolicySolver, self), **mpc)
        self._policy = self._trained(options.policy)

    @property
    def policy(self) -> Policy:
        """The network."""
        if self._policy is None:
            raise ControllerConfigError(f"controller '{self.name}': its policy is not trained yet")
        return self._policy

    def drawn(self, n: int, rng: np.random.Generator) -> list[MPCProblem]:
        """`n` instances that the model's building might meet."""
        return [self._drawn(rng) for _ in range(n)]

    def _trained(self, config: PolicyConfig) -> Policy:
        """The network, trained by Adam with a rate that falls to nothing."""
        operator, solver = self.planning_operator, self.solver
        assert isinstance(solver, PolicySolver)
        problems = self.drawn(config.instances, np.random.default_rng([config.seed, 0]))
        with one_thread(), torch.random.fork_rng():  # networks this small are slower on several
            torch.manual_seed(config.seed)
            policy = Policy(operator, config.hidden)
            solver.train(policy, problems, config)
        return policy

    def _drawn(self, rng: np.random.Generator) -> MPCProblem:
        """An instance: levels that would do in drawn weather, then the free response, prices and bounds that ask it."""
        operator, n, step_s = self.planning_operator, self._n_steps, self.step_s
        (Z, A, _), M = operator.shape, len(self._layout.names.machines)
        time_s = rng.integers(0, round(DAY_S / step_s)) * step_s + step_s * np.arange(n + 1)
        hour, head = hour_of_day(time_s), operator.of_actuator(0)
        day = np.cos(2.0 * np.pi * (hour - 15.0) / 24.0)
        T_out = head.feature_mean[OUTDOOR] + head.feature_scale[OUTDOOR] * rng.normal() + rng.uniform(1.0, 5.0) * day
        solar = rng.uniform(0.0, 700.0) * np.maximum(np.cos(2.0 * np.pi * (hour - 12.0) / 24.0), 0.0) * rng.uniform()
        # Bounds: one band, or one that is set back for some hours of each day by as much as drawn.
        low_C, wide_K = rng.uniform(18.0, 22.0), rng.uniform(1.5, 5.0)
        back_K = rng.uniform(0.5, 8.0) * (rng.uniform() < 0.6)
        away = (hour - rng.uniform(0.0, 24.0)) % 24.0 < rng.uniform(4.0, 14.0)
        lower_C = np.tile(low_C - back_K * away, (Z, 1))
        upper_C = np.tile(low_C + wide_K + back_K * away, (Z, 1))
        price = 0.25 * np.ones(n + 1)
        if rng.uniform() < 0.5:
            price = np.repeat(0.05 + 0.4 * rng.uniform(size=n // 4 + 2), steps_in(HOUR_S, step_s))[: n + 1]
            price = np.resize(price, n + 1)
        # Levels that would do, from a day before until the end: by weather and sun, with a drift.
        u_min = np.array(self._layout.u_min)
        wanted = rng.uniform(u_min - 0.2, 0.9, size=A)[:, None] - rng.uniform(0.0, 0.3) * (
            day[:-1] + solar[:-1] / 500.0
        )
        wanted = wanted + np.cumsum(rng.normal(size=(A, n)), axis=1) * rng.uniform(0.0, 0.15) / np.sqrt(n)
        levels = np.clip(wanted, u_min[:, None], 1.0)
        heat = np.stack([own.heat_input(u, T_out[:-1]) for own, u in zip(operator.of_actuators, levels, strict=True)])
        steady = operator.steady_gains_K * heat[:, :1]
        forced_K = operator.driven(steady, heat).sum(axis=(1, 3))
        near_K = rng.uniform(0.0, 0.6, size=(Z, 1)) * rng.uniform() + rng.normal(scale=0.15, size=(Z, 1))
        heats = operator.signs[[operator.home.index(z) if z in operator.home else 0 for z in range(Z)]][:, None] > 0
        kept_C = np.where(heats, low_C + near_K, low_C + wide_K - near_K)
        # What there is of it now is not what would do: a plan begins anywhere.
        begun = steady * rng.uniform(0.7, 1.3, size=(1, A, 1)) + 0.2 * rng.normal() * operator.gains
        free_C = kept_C - forced_K
        boundary = Boundary(
            time_s, T_out, solar, np.zeros((Z, n + 1)), lower_C, upper_C, np.tile(price, (M, 1)), np.zeros((M, n + 1)),
            names=self._layout.names,
        )  # fmt: skip
        starts = np.concatenate([free_C[:, :1], free_C[:, :-1]], axis=1)
        features = feature_matrix(starts, T_out[:-1], solar[:-1], time_s[:-1])
        spread = rng.uniform(0.02, 0.5) * np.sqrt(np.arange(1, n + 1) / n)
        free = FreeForecast(np.array([0.1, 0.5, 0.9]), np.stack([free_C - spread, free_C, free_C + spread]))
        context = PredictionContext(self.model.operator, begun, free, features, boundary, names=self._layout.names)
        return self.instance(context, self._record(time_s[0], T_out[0], free_C[:, 0] + begun.sum(axis=(1, 2)), levels))

    def _record(self, now_s: float, T_out_C: float, T_zone_C: Array, levels: Array) -> Record:
        """A record of two steps at the levels (A, N) that a drawn instance begins with."""
        names, two = self._layout.names, np.ones(2)
        silent = np.full((len(names.machines), 2), np.nan)
        return Record(
            np.array([now_s - 2.0 * self.step_s, now_s - self.step_s, now_s]),
            np.repeat(T_zone_C[:, None], 3, axis=1),
            np.full(3, T_out_C),
            np.zeros(3),
            levels[:, :1] * two,
            silent,
            np.full((levels.shape[0], 2), np.nan),
            names=names,
        )


@dataclass(frozen=True)
class Moves:
    """The steps of a plan: the first control step of each (n,), how many it is of, and what the network looks ahead at.

    `seen` (n, L): numbers of the moves in which the leads end; `ahead` (n, L): control steps to the end of these.
    """

    firsts: NDArray[np.intp]
    lengths: NDArray[np.intp]
    seen: NDArray[np.intp]
    ahead: NDArray[np.intp]

    @classmethod
    def of(cls, shape: ProblemShape, step_s: float) -> Moves:
        """The moves of a shape whose control steps are of `step_s` seconds."""
        firsts, lengths = shape.first_steps, shape.lengths
        leads = np.maximum(1, np.round(np.array(_LEADS_H) * HOUR_S / step_s)).astype(np.intp)
        seen = shape.move_of_step[np.minimum(firsts[:, None] + leads - 1, shape.n_steps - 1)]
        return cls(firsts, lengths, seen, (firsts + lengths)[seen] - firsts[:, None])

    def mean(self, values: Array) -> Array:
        """Means of values of the control steps (rows, N) over each move, (n, rows)."""
        return np.asarray((np.add.reduceat(values, self.firsts, axis=1) / self.lengths).T)


@dataclass(frozen=True)
class Asked:
    """What B instances ask, as tensors, over n moves.

    `below_K`, `above_K` (B, n, Z): forced response at the end that keeps the lower and the upper bound; `drive`
    (B, n, A): of a level of 1; `cost` (B, n, A): of a level over its mean, less 1; `low`, `high` (B, n, A): bounds of
    levels; `forced_K` (B, Z, A, r): now.
    """

    below_K: Tensor
    above_K: Tensor
    drive: Tensor
    cost: Tensor
    low: Tensor
    high: Tensor
    forced_K: Tensor

    @classmethod
    def of(cls, operator: BuildingOperator, moves: Moves, problems: Sequence[MPCProblem]) -> Asked:
        """What problems ask of plans by `operator`."""
        rows: dict[str, list[Array]] = {name: [] for name in cls.__annotations__}
        for p in problems:
            m, full = p.machinery, np.repeat(p.machinery.u_max[:, None], p.n_steps, axis=1)
            cost = moves.mean(p.price_per_W[m.machine_of] * p.power_per_u_W + p.fixed_cost[m.machine_of])
            mean = np.abs(cost).mean(axis=0)
            comes = 1.0 if p.available is None else p.available
            low, high = p.level_bounds
            rows["below_K"].append(np.maximum.reduceat(p.lower_C - p.T_free_C, moves.firsts, axis=1).T)
            rows["above_K"].append(np.minimum.reduceat(p.upper_C - p.T_free_C, moves.firsts, axis=1).T)
            rows["drive"].append(moves.mean(operator.drive(full, p.features) * comes) / m.u_max)
            rows["cost"].append(cost / np.where(mean > 0.0, mean, 1.0) - 1.0)
            rows["low"].append(np.maximum.reduceat(low, moves.firsts, axis=1).T)
            rows["high"].append(np.minimum.reduceat(high, moves.firsts, axis=1).T)
            rows["forced_K"].append(p.forced_state_K)
        return cls(**{name: torch.from_numpy(np.stack(values)) for name, values in rows.items()})

    def part(self, which: NDArray[np.intp]) -> Asked:
        """Of the instances of these numbers."""
        return Asked(**{name: getattr(self, name)[which] for name in self.__annotations__})


class Policy(nn.Module):
    """Levels of a move from what the next hours need, as shares of what full level would bring by then."""

    def __init__(self, operator: BuildingOperator, hidden: int) -> None:
        super().__init__()
        Z, A, _ = operator.shape
        n_in = len(_LEADS_H) * (2 * Z + A)
        self.net = nn.Sequential(
            nn.Linear(n_in, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, A)
        ).double()

    def levels(self, responses: Responses, moves: Moves, asked: Asked) -> Tensor:
        """Levels (B, n, A): a rollout in which each move sees what the ones before have brought about."""
        need = torch.stack([asked.below_K[:, moves.seen], asked.above_K[:, moves.seen]], dim=2)  # (B, n, 2, L, Z)
        cost, span = asked.cost[:, moves.seen].flatten(2), asked.high - asked.low
        F, found = asked.forced_K, []
        for k in range(len(moves.firsts)):
            kept = torch.einsum("bzar,lzar->blz", F, responses.left[k])
            share = ((need[:, k] - kept[:, None]) / responses.full_K[k]).clamp(_LEAST, _MOST)
            chosen = torch.sigmoid(self.net(torch.cat([share.flatten(1), cost[:, k]], dim=1)))
            chosen = ((1.0 + 2.0 * _BEYOND) * chosen - _BEYOND).clamp(0.0, 1.0)
            u = asked.low[:, k] + span[:, k] * chosen
            found.append(u)
            F = responses.poles[k] * F + responses.gains[k] * (asked.drive[:, k] * u)[:, None, :, None]
        return torch.stack(found, dim=1)


class Responses(NamedTuple):
    """An operator over the moves of a plan: `poles`, `gains` (n, Z, A, r) of each, as of one step; of each and its
    leads (L), `left` (n, L, Z, A, r): what is left of F at their end, `full_K` (n, L, Z): what full level brings by
    then.
    """

    poles: Tensor
    gains: Tensor
    left: Tensor
    full_K: Tensor

    @classmethod
    def of(cls, operator: BuildingOperator, moves: Moves) -> Responses:
        """Those of an operator over moves."""
        poles, gains = operator.poles, operator.gains

        def brought(steps: NDArray[np.intp]) -> tuple[Array, Array]:
            left = poles ** steps[..., None, None, None]
            return left, gains * (1.0 - left) / (1.0 - poles)

        over, ahead = brought(moves.lengths), brought(moves.ahead)
        own = np.array([[home == z for home in operator.home] for z in range(len(operator.zones))])
        full_K = np.abs((ahead[1].sum(axis=-1) * own).sum(axis=-1))
        full_K = np.where(full_K > 0.0, full_K, 1.0)  # a zone without an actuator of its own
        return cls(*(torch.from_numpy(of) for of in (*over, ahead[0], full_K)))


class PolicySolver:
    """Answers instances by the policy of a controller; every answer is checked as any that is not shown to be best."""

    def __init__(self, owner: DPC, operator: BuildingOperator, shape: ProblemShape) -> None:
        self._owner, self._operator, self.model = owner, operator, PlanModel(operator, shape)
        self._moves = Moves.of(shape, operator.step_s)
        self._responses = Responses.of(operator, self._moves)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """The policy's levels, or `guess`, the plan before, where that costs less; both no more than off and full."""
        p = self.model.numbers(problem)
        if not np.isfinite(p).all():
            return failed("not started", 0, "the problem holds numbers that are not finite")
        asked = Asked.of(self._operator, self._moves, [problem])
        with torch.no_grad():
            u = self._owner.policy.levels(self._responses, self._moves, asked)[0].numpy().T
        if not np.isfinite(u).all():
            return failed("policy", 0, "the trained policy gave levels that are not finite")
        found = self.model.evaluate(p, self._by_steps(u))
        if guess is not None:
            found = min(found, self.model.evaluate(p, np.clip(guess, *problem.level_bounds)), key=lambda one: one.cost)
        answer = SolverAnswer(found.variables, None, "policy", 0, "levels of a trained policy")
        return checked(self.model, problem, p, answer, guess)

    def train(self, policy: Policy, problems: Sequence[MPCProblem], config: PolicyConfig) -> None:
        """Train a policy on instances by the gradient of their cost, as a share of what full level costs."""
        asked = Asked.of(self._operator, self._moves, problems)
        numbers = [self.model.numbers(problem) for problem in problems]
        full = np.repeat(problems[0].machinery.u_max[:, None], problems[0].n_steps, axis=1)
        costs = [float(np.abs(self.model.evaluate(p, full).energy_cost).sum()) for p in numbers]
        unit, batches = np.maximum(costs, 1e-9), max(1, len(problems) // _BATCH)
        optimiser = torch.optim.Adam(policy.parameters(), lr=_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs * batches)
        rng = np.random.default_rng([config.seed, 1])
        for _ in range(config.epochs):
            for which in np.array_split(rng.permutation(len(problems)), batches):
                u = policy.levels(self._responses, self._moves, asked.part(which))
                slopes = np.empty(u.shape)
                for row, (i, levels) in enumerate(zip(which, u.detach().numpy(), strict=True)):
                    _, by_step = self.model.slopes(numbers[i], self._by_steps(levels.T))
                    slopes[row] = by_step[:, self._moves.firsts].T / unit[i]
                optimiser.zero_grad()
                u.backward(torch.from_numpy(slopes / len(which)))
                optimiser.step()
                schedule.step()

    def _by_steps(self, u: Array) -> Array:
        """Levels of moves (A, n) at every control step."""
        return np.repeat(u, self._moves.lengths, axis=1)
