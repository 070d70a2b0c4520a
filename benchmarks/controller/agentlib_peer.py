"""The same MPC problem in AgentLib-MPC (RWTH Aachen), by its own backend: `pip install agentlib_mpc`."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.exported import step_function
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel

# Inputs that are given: the features of m(x), and what else differs between steps or instances.
_FEATURES = tuple(f"x{i}" for i in range(N_FEATURES))
_GIVEN = (*_FEATURES, "price", "T_free", "lower", "upper")


@contextmanager
def _quiet() -> Iterator[None]:
    """Without warnings: it calls what is deprecated in pydantic and CasADi."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


class AgentLibPeer:
    """Solves `MPCProblem`s of one zone, operator, horizon and set of weights by the casadi backend of AgentLib-MPC.

    Its models are differential equations: Euler's step of (F(k + 1) − F(k)) / Δt, in multiple shooting, is the step of
    the operator to the last bit. Level and slack are controls; bounds on the temperature at the end of a step constrain
    state and control at its start. Its tolerance, 1e-4 by default, is that of the others.

    Args:
        operator: the forced response, with its network in the model.
        example: an instance with the common horizon, step and weights.

    Raises:
        ConfigError: AgentLib-MPC is not installed.
    """

    def __init__(self, operator: OperatorParameters, example: MPCProblem) -> None:
        try:
            with _quiet():
                from agentlib_mpc.data_structures.mpc_datamodels import MPCVariable, VariableReference
                from agentlib_mpc.optimization_backends.casadi_.full import CasADiFullBackend
        except ImportError as error:
            raise ConfigError("AgentLib-MPC is not installed: pip install agentlib_mpc") from error
        logging.getLogger("agentlib_mpc").setLevel(logging.ERROR)
        self._variable = MPCVariable
        self._n, self._modes = example.n_steps, [f"F{i}" for i in range(operator.order)]

        class Backend(CasADiFullBackend):
            def model_from_config(self, model: dict[str, Any]) -> Any:
                return _model(operator, example)

        ipopt = {"tol": 1e-8, "acceptable_tol": 1e-8, "acceptable_iter": 0, "sb": "yes"}
        discretisation = {"method": "multiple_shooting", "integrator": "euler"}
        self._backend = Backend(
            {
                "model": {"type": "of this class"},
                "discretization_options": discretisation | {"time_step": example.step_s, "prediction_horizon": self._n},
                "solver": {"name": "ipopt", "options": {"ipopt": ipopt}},
                "results_file": "unused.csv",
                "save_results": False,
            }
        )
        names = VariableReference(states=self._modes, controls=["u", "slack"], inputs=list(_GIVEN))
        with _quiet():
            self._backend.setup_optimization(names)

    def solve(self, problem: MPCProblem) -> Array:
        """Solve one instance, with all that it does in a step; returns the only actuator's levels (N,)."""
        p, highest = problem, float(problem.machinery.u_max[0])
        price = p.price_per_W[0] * (p.power_fixed_W[0] + p.power_per_u_W[0] * highest) / highest
        courses = [*p.features[0].T, price, p.T_free_C[0], p.lower_C[0], p.upper_C[0]]
        given = {name: self._variable(name=name, value=list(of)) for name, of in zip(_GIVEN, courses, strict=True)}
        levels = {
            name: self._variable(name=name, value=0.0, lb=0.0, ub=most)
            for name, most in (("u", highest), ("slack", float("inf")))
        }
        state = {
            name: self._variable(name=name, value=float(now), lb=-float("inf"), ub=float("inf"))
            for name, now in zip(self._modes, np.atleast_1d(p.forced_state_K[0, 0]), strict=True)
        }
        with _quiet():
            found = self._backend.solve(0.0, {**given, **levels, **state})
        return np.asarray(found.df["variable"]["u"].dropna(), dtype=np.float64)[: self._n]


def _model(operator: OperatorParameters, example: MPCProblem) -> Any:
    """The operator with its costs and bounds as a model of AgentLib-MPC."""
    from agentlib_mpc.models.casadi_model import CasadiInput, CasadiModel, CasadiModelConfig, CasadiState

    modes, step_s = [f"F{i}" for i in range(operator.order)], example.step_s
    step = step_function(ThermalModel.single(operator), operator.step_s, part_load="held")
    comfort, curvature = float(example.comfort_price[0]), example.weights.curvature

    class Config(CasadiModelConfig):
        inputs: list[CasadiInput] = Field([CasadiInput(name=name, value=0.0) for name in ("u", "slack", *_GIVEN)])
        states: list[CasadiState] = Field([CasadiState(name=name, value=0.0) for name in modes])

    def setup_system(self: Any) -> Any:
        of = {name: getattr(self, name).sym for name in (*modes, "u", "slack", *_GIVEN)}
        F = ca.vertcat(*(of[name] for name in modes))
        after = step(F, of["u"], ca.vertcat(*(of[name] for name in _FEATURES)))
        for i, name in enumerate(modes):
            getattr(self, name).ode = (after[i] - F[i]) / step_s
        T = of["T_free"] + ca.sum1(after)
        self.constraints = [
            (-ca.inf, of["lower"] - T - of["slack"], 0.0),
            (-ca.inf, T - of["upper"] - of["slack"], 0.0),
        ]
        cost = of["price"] * of["u"] + comfort * of["slack"] + curvature * of["u"] ** 2
        # It sums them times the step.
        return self.create_combined_objective(self.create_sub_objective(expressions=cost / step_s, name="cost"))

    # It looks its configuration up among the names of a module, in which `Config` is not.
    return type("Model", (CasadiModel,), {"__annotations__": {"config": Config}, "setup_system": setup_system})()
