"""A trained policy in the place of a solver, and the controller that is built with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from controllers.checks import ControllerConfigError
from controllers.dpc.config import DPCConfig
from controllers.dpc.policy import Policy, drive_parts, lead_steps, load_policy, operator_sha256
from controllers.mpc.controller import ThermoForceMPC, at_step
from controllers.optimisation.evaluation import Evaluator
from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.solution import Solution, checked_solution, failed
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel


class PolicySolver:
    """Levels of a policy in closed loop with the operator over the horizon; checked as a solver's are."""

    def __init__(self, policy: Policy, operator: BuildingOperator, shape: ProblemShape) -> None:
        self._policy, self.operator, self._pair = policy, operator, operator.of_actuator(0)
        self._model = Evaluator(operator, shape).by_steps

    def solve(self, problem: MPCProblem, guess: Array | None = None) -> Solution:
        """The policy's levels; beyond the horizon the last step is taken to go on. `guess` is not used."""
        policy, reach = self._policy, int(lead_steps(self._policy.step_s)[-1])
        fixed, per_u = drive_parts(self._pair, problem.features[0])
        full_W = problem.power_fixed_W[0] + problem.power_per_u_W[0]
        relative = problem.price_per_kWh[0] * full_W / np.maximum(np.abs(fixed + per_u), 1e-9)
        ahead = np.stack([problem.T_free_C[0], problem.lower_C[0], problem.upper_C[0]])
        u = policy.levels(
            problem.forced_state_K[0, 0],
            self._pair,
            (fixed, per_u),
            np.pad(ahead, ((0, 0), (0, reach)), mode="edge"),
            np.pad(relative, (0, reach), mode="edge"),
        )[None]
        if not np.isfinite(u).all():
            return failed("policy", problem.n_steps, "the policy gave levels that are not finite")
        p = self._model.numbers(problem)
        cost = self._model.evaluate(problem, p, u).cost
        return checked_solution(self._model, problem, p, u, cost, "policy", problem.n_steps)


class DPC(ThermoForceMPC):
    """The MPC with a trained policy in the place of its solver; forecast, checks, actuation, watch, fallback stay."""

    def __init__(
        self,
        model: ThermalModel,
        config: DPCConfig | None = None,
        *,
        policy: Policy | None = None,
        progress: Callable[[int, float], None] | None = None,
        name: str = "dpc",
    ) -> None:
        """Take the policy given, read the one that `config` names, or train one (about a minute).

        Raises:
            ControllerConfigError: the model has several zones, actuators or machines, or signed levels, or the policy
                was trained for another model, step or actuation.
            ArtifactError: the policy's folder cannot be used.
        """
        config = config or DPCConfig()
        config.check()
        if not model.names.single:
            raise ControllerConfigError(
                f"dpc controls one zone with one actuator; the model has {len(model.names.zones)} zones and "
                f"{len(model.names.actuators)} actuators: use thermoforce_mpc"
            )
        if model.layout.lowest[0] < 0.0:
            raise ControllerConfigError("dpc does not heat and cool by room set-points: use thermoforce_mpc")
        self._policy = policy or (load_policy(Path(config.policy)) if config.policy else None)
        self._progress, self._model_at_step = progress, at_step(model, config)[0]
        super().__init__(model, config, solver=self._policy_solver, name=name)
        self._check()

    @property
    def policy(self) -> Policy:
        """The policy."""
        assert self._policy is not None  # trained with the planners, if none was given
        return self._policy

    @property
    def actuation_in_words(self) -> str:
        """How the actuator is run, and where the policy comes from."""
        return (
            f"{super().actuation_in_words}; policy of {self.policy.iterations} iterations, loss {self.policy.loss:.3f}"
        )

    def _policy_solver(self, operator: BuildingOperator, shape: ProblemShape) -> PolicySolver:
        """The policy in the place of a solver; trained for the first operator, that of the model, if none was given."""
        if shape.terms:
            raise ControllerConfigError("controller.options.terms: dpc trains without them; use thermoforce_mpc")
        if self._policy is None:
            from controllers.dpc.training import train_policy

            assert isinstance(self.config, DPCConfig)
            self._policy = train_policy(
                self._model_at_step.actuator(0),
                self._actuators.each[0],
                self.config,
                self.step_s,
                self._layout.floor_area_m2[0],
                self._progress,
            )
        return PolicySolver(self._policy, operator, shape)

    def _check(self) -> None:
        """Raise `ControllerConfigError` for a policy of another operator, step or actuation."""
        actuation = self._actuators.each[0]
        policy = self.policy
        wrong = []
        if policy.operator_sha256 != operator_sha256(self.planning_operator.of_actuator(0)):
            wrong.append("another model")
        if policy.step_s != self.step_s:
            wrong.append(f"steps of {policy.step_s:g} s instead of {self.step_s:g} s")
        if (policy.highest, policy.lowest) != (actuation.highest, actuation.lowest_level):
            wrong.append(f"levels {policy.lowest:g} to {policy.highest:g}, not {actuation.in_words}")
        if wrong:
            raise ControllerConfigError(
                f"controller.options.policy: the policy was trained for {' and '.join(wrong)}: train it again"
            )
