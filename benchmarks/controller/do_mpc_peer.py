"""The same MPC problem in do-mpc (Fiedler et al. 2023), written as in its documentation."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from controllers.optimisation.problem import MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.exported import step_function
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel

# Time-varying parameters: quantities that differ between steps or instances.
_TIME_VARYING = ("price", "T_free", "lower", "upper")


def load_do_mpc() -> Any:
    """Import do-mpc; raises `ConfigError` if it is not installed."""
    try:
        with warnings.catch_warnings():  # it warns about missing optional packages
            warnings.simplefilter("ignore")
            import do_mpc
    except ImportError as error:
        raise ConfigError("do-mpc is not installed: pip install -e '.[bench]'") from error
    return do_mpc


@contextmanager
def quiet_do_mpc() -> Iterator[None]:
    """Context without irrelevant warnings of do-mpc (numpy deprecations on CasADi types; missing rterm)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        warnings.filterwarnings("ignore", "rterm was not set")
        yield


class DoMpcPeer:
    """Solves `MPCProblem`s of one zone, operator, horizon and set of weights through do-mpc's own interface.

    The modes of the operator are discrete states, level and slack are inputs, everything else that varies is a
    time-varying parameter. Bounds on the temperature at the end of a step constrain state and input at its start.

    Args:
        operator: the forced response.
        example: an instance with the common horizon, step and weights.
        gain_beforehand: precompute the gain of each step and pass it as a parameter (possible since it does not depend
            on the decisions); otherwise the model contains the operator with its network.

    Raises:
        ConfigError: do-mpc is not installed.
    """

    def __init__(self, operator: OperatorParameters, example: MPCProblem, *, gain_beforehand: bool) -> None:
        do_mpc = load_do_mpc()
        self._operator, self._n, self._gain_beforehand = operator, example.n_steps, gain_beforehand
        model = do_mpc.model.Model("discrete", "SX")
        modes = [f"F{i}" for i in range(operator.order)]
        given = ["drive"] if gain_beforehand else [f"x{i}" for i in range(N_FEATURES)]
        self._varying = [*given, *_TIME_VARYING]
        for kind, names in (("_x", modes), ("_u", ["u", "slack"]), ("_tvp", self._varying)):
            for name in names:
                model.set_variable(kind, name)
        step = step_function(ThermalModel.single(operator), operator.step_s, part_load="held")

        def after() -> list[ca.SX]:
            if gain_beforehand:
                heat = model.tvp["drive"] * model.u["u"]
                return [
                    a * model.x[f] + g * heat for a, g, f in zip(operator.poles, operator.gains, modes, strict=True)
                ]
            F, x = ca.vertcat(*[model.x[f] for f in modes]), ca.vertcat(*[model.tvp[name] for name in given])
            return list(ca.vertsplit(step(F, model.u["u"], x)))

        for name, value in zip(modes, after(), strict=True):
            model.set_rhs(name, value)
        with quiet_do_mpc():
            model.setup()  # setup replaces the symbols
        u, slack = model.u["u"], model.u["slack"]
        price, T_free, lower, upper = (model.tvp[name] for name in _TIME_VARYING)
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = self._n
        mpc.settings.t_step = example.step_s
        mpc.settings.state_discretization = "discrete"
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.tol": 1e-8}
        comfort, curvature = float(example.comfort_price[0]), example.weights.curvature
        mpc.set_objective(mterm=ca.SX(0), lterm=price * u + comfort * slack + curvature * u**2)
        mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = 0.0, float(example.machinery.u_max[0])
        mpc.bounds["lower", "_u", "slack"] = 0.0
        T = T_free + sum(after())
        mpc.set_nl_cons("cold", lower - T - slack, ub=0.0)
        mpc.set_nl_cons("hot", T - upper - slack, ub=0.0)
        self._template = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda now: self._template)
        with quiet_do_mpc():
            mpc.setup()
        self.mpc = mpc
        self._guessed = False

    def solve(self, problem: MPCProblem) -> Array:
        """Solve one instance, with all set-up that do-mpc needs per step; returns the only actuator's levels (N,)."""
        p, highest = problem, float(problem.machinery.u_max[0])
        full, features = np.full(self._n, highest), p.features[0]
        drive = self._operator.drive(full, features) / highest
        given = [drive] if self._gain_beforehand else list(features.T)
        price = p.price_per_W[0] * (p.power_fixed_W[0] + p.power_per_u_W[0] * highest) / highest
        values = np.stack([*given, price, p.T_free_C[0], p.lower_C[0], p.upper_C[0]], axis=1)
        for k in range(self._n + 1):
            row = values[min(k, self._n - 1)]
            for name, value in zip(self._varying, row, strict=True):
                self._template["_tvp", k, name] = value
        state = np.asarray(p.forced_state_K[0, 0]).reshape(-1, 1)
        self.mpc.x0 = state
        if not self._guessed:
            self.mpc.set_initial_guess()
            self._guessed = True
        with quiet_do_mpc():
            self.mpc.make_step(state)
        moves = self.mpc.opt_x_num["_u", :, 0]
        return np.array([float(move[0]) for move in moves])


def without_extras(problem: MPCProblem) -> MPCProblem:
    """The problem as implemented in do-mpc: without peak cost."""
    return replace(problem, weights=replace(problem.weights, peak=0.0))
