"""The MPC problem as a parametric NLP over the exported CasADi operator, built once and solved by Ipopt (reference)."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from controllers.checks import ControllerConfigError
from controllers.optimisation.machines import EquipmentLayout
from controllers.optimisation.problem import POWER_UNIT_W, MPCProblem, ProblemShape, convex_relaxation
from controllers.optimisation.solution import Solution, accept_suboptimal, checked_solution, failed
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import step_function
from thermoforce_mpc.model.operator.features import N_FEATURES
from thermoforce_mpc.scenario.settings import StrictModel

# Statuses with which Ipopt reports an optimum, to its tolerance or to a looser one; any other is a failed solve.
_OPTIMAL, _ACCEPTED = "Solve_Succeeded", {"Solve_Succeeded", "Solved_To_Acceptable_Level"}


class IpoptConfig(StrictModel):
    """Options of Ipopt."""

    max_iterations: int = Field(200, ge=1, description="iterations before a solve counts as failed")
    tolerance: float = Field(1e-8, gt=0, description="Ipopt's overall tolerance")
    max_seconds: float = Field(
        20.0, gt=0, description="wall time before a solve counts as failed, s; after it no other start is tried"
    )


class IpoptSolver:
    """Solves `MPCProblem`s of one operator and shape with Ipopt.

    Held levels are planned as if an actuator switched below its lowest level, as `MPCProblem.cost` counts them.

    Raises:
        ControllerConfigError: actuators exclude one another, or the operator is not of these actuators.
    """

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, config: IpoptConfig) -> None:
        """Build the NLP once."""
        shape.check(operator)
        machinery = shape.machinery
        if machinery.exclusive:
            raise ControllerConfigError(
                "solver ipopt: actuators that exclude one another are a choice; use solver: auto or milp"
            )
        self.operator, self.shape = operator, shape
        (A, M), (Z, _, r) = machinery.shape, operator.shape
        n, m, S, pairs = shape.n_steps, shape.n_moves, machinery.signed, list(operator.each())
        # Power is linear in u without a kink inside the range; the dynamics are linear if also heat is and the gain
        # does not depend on the decisions. Only then are the derivatives constant.
        linear = not machinery.held.any()
        linear_dynamics = replace(shape, held_steps=None).convex(operator)
        v, cold = ca.SX.sym("v", A, m), ca.SX.sym("cold", S.size, m)
        F, slack = ca.SX.sym("F", len(pairs) * r, n), ca.SX.sym("slack", Z, n)
        peak, over = ca.SX.sym("peak", int(shape.peak)), ca.SX.sym("over", 1, n if shape.capped else 0)
        shared = np.flatnonzero(machinery.shared)
        runs = ca.SX.sym("runs", shared.size, m)
        runs_for = machinery.runs_for
        theta, excess = ca.SX.sym("theta", shared.size, m), ca.SX.sym("excess", A if shared.size else 0, m)
        parameters = {
            "F_now": ca.SX.sym("F_now", len(pairs) * r),
            "features": ca.SX.sym("features", Z * N_FEATURES, n),
            **{name: ca.SX.sym(name, Z, n) for name in ("T_free", "lower", "upper")},
            **{name: ca.SX.sym(name, M, n) for name in ("price_W", "fixed", "fixed_cost", "capacity")},
            **{name: ca.SX.sym(name, A, n) for name in ("per_u", "cold_power", "cold_cost")},
            "comfort": ca.SX.sym("comfort", Z),
            "weights": ca.SX.sym("weights", 3),
            "terminal": ca.SX.sym("terminal", len(pairs) * r),
            "reached": ca.SX.sym("reached"),
            "limit": ca.SX.sym("limit", 1, n),
        }
        of_step = shape.move_of_step.tolist()
        heat = v[:, of_step]
        cool = ca.SX.zeros(A, n)
        cool[S.tolist(), :] = cold[:, of_step]
        u, steps = heat - cool, [step_function(pair) for *_, pair in pairs]
        dynamics, forced = [], [ca.SX.zeros(1, n)] * Z
        for number, (z, a, _) in enumerate(pairs):
            rows, first = slice(number * r, (number + 1) * r), N_FEATURES * operator.home[a]
            forced[z] = forced[z] + ca.sum1(F[rows, :])
            for k in range(n):
                before = parameters["F_now"][rows] if k == 0 else F[rows, k - 1]
                x = parameters["features"][first : first + N_FEATURES, k]
                dynamics.append(F[rows, k] - steps[number](before, u[a, k], x))
        T = parameters["T_free"] + ca.vertcat(*forced)
        constraints = [ca.vec(T + slack - parameters["lower"]), ca.vec(parameters["upper"] - T + slack)]

        power, energy = ca.SX.zeros(1, n), ca.SX.zeros(1, n)
        on = [_on_share(heat[a, :], machinery, a) for a in range(A)]
        for number in range(M):
            fed = np.flatnonzero(machinery.machine_of == number).tolist()
            loads = sum(float(machinery.share[a]) * heat[a, :] for a in fed)
            if number in shared:
                runs_m = runs[int(np.flatnonzero(shared == number)[0]), of_step]
                reached = theta[int(np.flatnonzero(shared == number)[0]), of_step]
                beyond = {a: excess[a, of_step] for a in fed}
                constraints += [ca.vec(reached + beyond[a] - on[a]) for a in fed]
                constraints += [ca.vec(runs_m - reached - sum(float(runs_for[a]) * beyond[a] for a in fed))]
                constraints += [ca.vec(runs_m - loads)]
            else:
                runs_m = on[fed[0]]
            if machinery.share[fed].any():
                constraints.append(ca.vec(parameters["capacity"][number, :] - loads))
            power += parameters["fixed"][number, :] * runs_m
            energy += parameters["fixed_cost"][number, :] * runs_m
            for a in fed:
                power += parameters["per_u"][a, :] * heat[a, :] + parameters["cold_power"][a, :] * cool[a, :]
                energy += parameters["price_W"][number, :] * parameters["per_u"][a, :] * heat[a, :]
                energy += parameters["cold_cost"][a, :] * cool[a, :]
        weights = parameters["weights"]
        objective = ca.sum2(energy) + ca.dot(parameters["comfort"], ca.sum2(slack)) + weights[0] * ca.sumsqr(u)
        objective -= ca.dot(parameters["terminal"], F[:, n - 1])
        if shape.peak:
            objective += weights[1] * POWER_UNIT_W * peak
            constraints.append(ca.vec(peak + (parameters["reached"] - power) / POWER_UNIT_W))
        if shape.capped:
            objective += weights[2] * POWER_UNIT_W * ca.sum2(over)
            constraints.append(ca.vec(over + (parameters["limit"] - power) / POWER_UNIT_W))
        decisions = [v, cold, F, slack, peak, over, runs, theta, excess]
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": config.max_iterations,
                "tol": config.tolerance,
                "max_wall_time": config.max_seconds,
                "jac_c_constant": "yes" if linear_dynamics else "no",
                "jac_d_constant": "yes" if linear or not (shape.peak or shape.capped or shared.size) else "no",
                "hessian_constant": "yes" if linear and linear_dynamics else "no",
            },
        }
        nlp = {
            "x": ca.veccat(*decisions),
            "p": ca.veccat(*parameters.values()),
            "f": objective,
            "g": ca.veccat(*dynamics, *constraints),
        }
        self._solver = ca.nlpsol("thermoforce_mpc", "ipopt", nlp, options)
        self._order, self._pairs, self._max_seconds = list(parameters), pairs, config.max_seconds
        zeros, free = np.zeros, np.full(len(pairs) * r * n, np.inf)
        sizes = [variable.numel() for variable in (slack, peak, over, runs, theta, excess)]
        self._lbx = np.concatenate([zeros(A * m + S.size * m), -free, zeros(sum(sizes))])
        self._ubx = np.concatenate(
            [np.tile(machinery.u_max, m), np.tile(-machinery.u_min[S], m), free, np.full(sum(sizes), np.inf)]
        )
        inequalities = sum(variable.numel() for variable in constraints)
        self._lbg = zeros(free.size + inequalities)
        self._ubg = np.concatenate([zeros(free.size), np.full(inequalities, np.inf)])
        # A kink makes the power concave in u, so local optima are possible. Its convex envelope on [0, u_max] is the
        # straight line; that problem has one optimum, which is used as a second initial guess.
        on_off = operator.map(lambda pair: replace(pair, heat_input=pair.heat_input.at_lowest_level(1.0)))
        straight = replace(
            shape, machinery=replace(machinery, lowest_level=np.maximum(machinery.lowest_level, machinery.u_max))
        )
        self._relaxed = None if linear else IpoptSolver(on_off, straight, config)

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """Solve one instance from `guess` (A, N). On failure `ok` is False and `problem` has the reason.

        Where a start from `guess` fails, it is thrown away, and the solver starts cold.
        """
        began = time.monotonic()
        highest = self.shape.machinery.u_max[:, None]
        cold = np.broadcast_to(0.3 * highest, problem.power_per_u_W.shape)
        guesses = [cold if guess is None else guess]
        if self._relaxed:
            relaxed = self._relaxed.solve(convex_relaxation(problem), guess)
            guesses += [relaxed.u] if relaxed.ok else []
        if guess is not None:
            guesses.append(cold)
        solutions: list[Solution] = []
        for number, start in enumerate(guesses):
            late = time.monotonic() - began > self._max_seconds
            solved = any(solution.ok and solution.optimal for solution in solutions)
            if solutions and (late or (solved and guess is not None and number == len(guesses) - 1)):
                break
            solutions.append(self._solve_from(problem, start, guess))
        good = [solution for solution in solutions if solution.ok]
        if not good:
            return solutions[0]
        optimal = [solution for solution in good if solution.optimal]
        return min(optimal or good, key=lambda solution: float(problem.cost(self.operator, solution.u)))

    def _solve_from(self, problem: MPCProblem, u_guess: Array, previous: Array | None) -> Solution:
        """Solve from one guess (A, N); `previous`: the plan of the step before, which an iterate must not exceed."""
        p = problem
        if not p.finite():
            return failed("not started", 0, "the problem holds numbers that are not finite")
        cold, n = p.cooling, p.n_steps
        numbers = {
            "F_now": self._of_pairs(p.forced_state_K),
            "features": p.features.transpose(0, 2, 1).reshape(-1, n),
            "T_free": p.T_free_C,
            "lower": p.lower_C,
            "upper": p.upper_C,
            "price_W": p.price_per_W,
            "fixed": p.power_fixed_W,
            "fixed_cost": p.fixed_cost,
            "capacity": np.ones(p.power_fixed_W.shape) if p.capacity is None else p.capacity,
            "per_u": p.power_per_u_W,
            "cold_power": np.zeros(p.power_per_u_W.shape) if cold is None else cold.power_per_u_W,
            "cold_cost": p.cooling_cost_per_u,
            "comfort": p.comfort_price,
            "weights": np.array([p.weights.curvature, p.weights.peak, p.cap_price_per_W]),
            "terminal": self._of_pairs(p.terminal_price_per_K),
            "reached": np.array([p.peak_so_far_W]),
            "limit": np.zeros(n) if p.power_cap is None else p.power_cap.limit_W,
        }
        result = self._solver(
            x0=self._complete(p, u_guess),
            p=np.concatenate([numbers[name].ravel(order="F") for name in self._order]),
            lbx=self._lbx,
            ubx=self._ubx,
            lbg=self._lbg,
            ubg=self._ubg,
        )
        stats = self._solver.stats()
        status, iterations = str(stats["return_status"]), int(stats["iter_count"])
        modes_of = partial(p.modes_K, self.operator)
        x, machinery = np.asarray(result["x"], dtype=np.float64).ravel(), self.shape.machinery
        (A, _), S, m = machinery.shape, machinery.signed, self.shape.n_moves
        moves = x[: A * m].reshape(m, A).T.copy()
        moves[S] -= x[A * m : (A + S.size) * m].reshape(m, S.size).T
        u = moves[:, self.shape.move_of_step]
        if status not in _ACCEPTED:
            return accept_suboptimal(p, modes_of, u, previous, failed(status, iterations, f"Ipopt ended with {status}"))
        solution = checked_solution(p, modes_of, u, float(result["f"]), status, iterations)
        return solution if status == _OPTIMAL else replace(solution, optimal=False, problem=f"Ipopt: {status}")

    def _of_pairs(self, values: Array) -> Array:
        """Values (Z, A, ...) of the pairs with an effect one after another."""
        return np.concatenate([values[z, a].ravel() for z, a, _ in self._pairs])

    def _complete(self, problem: MPCProblem, u: Array) -> Array:
        """Initial guess for all variables, consistent with the first level of `u` (A, N) in each move."""
        shape = self.shape
        moves = u[:, shape.first_steps]
        u = moves[:, shape.move_of_step]
        F = problem.modes_K(self.operator, u)
        slack = problem.slack_K(problem.T_free_C + F.sum(axis=(1, 3)))
        power = problem.power_W(u).sum(axis=0)
        runs = problem.running(u)[np.flatnonzero(shape.machinery.shared)]
        variables = [np.maximum(moves, 0.0), np.maximum(-moves[shape.machinery.signed], 0.0)]
        # States of a pair, one step after another.
        variables.append(np.stack([F[z, a].T for z, a, _ in self._pairs]).reshape(-1, u.shape[1]))
        variables.append(slack)
        if shape.peak:
            variables.append(np.array([max(power.max() - problem.peak_so_far_W, 0.0) / POWER_UNIT_W]))
        if shape.capped and problem.power_cap is not None:
            variables.append(np.maximum(power - problem.power_cap.limit_W, 0.0) / POWER_UNIT_W)
        variables.append(runs[:, shape.first_steps])
        if shape.machinery.shared.any():
            on = problem.on_share(u)[:, shape.first_steps]
            variables += [np.zeros(runs[:, shape.first_steps].shape), on]
        return np.concatenate([variable.ravel(order="F") for variable in variables])


def _on_share(heat: ca.SX, machinery: EquipmentLayout, a: int) -> ca.SX:
    """Share of each step that actuator `a` is on, as an expression of its levels; more where its machine asks."""
    alone = not machinery.shared[machinery.machine_of[a]]
    slope = max(1.0 / machinery.lowest_level[a], machinery.share[a] if alone else 0.0)
    return ca.fmin(slope * heat, 1.0) if machinery.held[a] else slope * heat
