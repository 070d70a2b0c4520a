"""The MPC problem of a building of several zones with one shared machine in do-mpc (Fiedler et al. 2023)."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from benchmarks.controller.do_mpc_peer import load_do_mpc, quiet_do_mpc
from controllers.optimisation.problem import POWER_UNIT_W, MPCProblem
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator


class DoMpcBuilding:
    """Solves `MPCProblem`s of one operator, horizon, machinery and set of weights through do-mpc's own interface.

    As `DoMpcPeer` with the gain worked out beforehand. The modes of every pair are states, as in
    `controllers.optimisation.problem`; levels, slacks, the machine's share of running and the power above the cap are
    inputs.

    Args:
        operator: the forced response.
        example: an instance with the common horizon, step, machinery and weights: one machine that feeds all actuators
            and has a fixed part, levels from 0, a power cap, neither peak price nor value of heat at the end.
        modes_shared: all actuators share the modes of a zone, as our programme finds out by itself: states are one set
            of modes per zone. All pairs of a zone must have the same time constants.

    Raises:
        ConfigError: do-mpc is not installed.
        DataError: the operator or the instance is none of these.
    """

    def __init__(self, operator: BuildingOperator, example: MPCProblem, *, modes_shared: bool) -> None:
        machinery, (Z, A, r) = example.machinery, operator.shape
        poles = operator.poles.max(axis=1)
        apart = any(not np.array_equal(pair.poles, poles[z]) for z, _, pair in operator.each())
        if (
            len(machinery.machines) > 1
            or np.any(machinery.runs_for < 1.0)
            or machinery.stepped.any()
            or machinery.signed.size
            or machinery.exclusive
            or example.power_cap is None
            or example.weights.peak
            or (modes_shared and apart)
        ):
            raise DataError("do-mpc: this operator or problem is not of the kind that is written here")
        do_mpc = load_do_mpc()
        self._operator, self._n, self._modes_shared = operator, example.n_steps, modes_shared
        model = do_mpc.model.Model("discrete", "SX")
        sizes = {"drive": A, "price": 1, "fixed": 1, "per_u": A, "cap": 1, "T_free": Z, "lower": Z, "upper": Z}
        for kind, name, size in (
            ("_x", "F", Z * r if modes_shared else Z * A * r),
            ("_u", "u", A),
            ("_u", "slack", Z),
            ("_u", "on", 1),
            ("_u", "over", 1),
            ("_tvp", "given", sum(sizes.values())),
        ):
            model.set_variable(kind, name, shape=(size, 1))
        # States by zone, then actuator where modes are not shared, then mode.
        each = operator.gains[:, :, :, None] * np.eye(A)[None, :, None, :]
        gain = ca.sparsify(ca.DM((each.sum(axis=1) if modes_shared else each).reshape(-1, A)))
        decay = ca.DM((poles if modes_shared else operator.poles).ravel())
        total = ca.sparsify(ca.DM(np.kron(np.eye(Z), np.ones((1, r if modes_shared else A * r)))))

        def given() -> dict[str, ca.SX]:
            ends = np.cumsum([0, *sizes.values()])
            parts = ca.vertsplit(model.tvp["given"], ends.tolist())
            return dict(zip(sizes, parts, strict=True))

        def after() -> ca.SX:
            return decay * model.x["F"] + gain @ (given()["drive"] * model.u["u"])

        model.set_rhs("F", after())
        with quiet_do_mpc():
            model.setup()  # setup replaces the symbols
        u, slack, on, over = (model.u[name] for name in ("u", "slack", "on", "over"))
        g = given()
        power = g["fixed"] * on + ca.dot(g["per_u"], u)
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = self._n
        mpc.settings.t_step = example.step_s
        mpc.settings.state_discretization = "discrete"
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.tol": 1e-8}
        above = POWER_UNIT_W * example.cap_price_per_W
        cost = g["price"] * power + ca.dot(ca.DM(example.comfort_price), slack) + above * over
        mpc.set_objective(mterm=ca.SX(0), lterm=cost + example.weights.curvature * ca.sumsqr(u))
        mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = 0.0, machinery.u_max
        mpc.bounds["lower", "_u", "slack"] = mpc.bounds["lower", "_u", "on"] = mpc.bounds["lower", "_u", "over"] = 0.0
        T, load = g["T_free"] + total @ after(), ca.dot(ca.DM(machinery.share), u)
        for name, at_most_0 in (
            ("cold", g["lower"] - T - slack),
            ("hot", T - g["upper"] - slack),
            ("runs", u / ca.DM(machinery.lowest_level) - on),
            ("runs as loaded", load - on),
            ("capacity", load - 1.0),
            ("cap", power - g["cap"] - over),
        ):
            mpc.set_nl_cons(name, at_most_0, ub=0.0)
        self._template = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda now: self._template)
        with quiet_do_mpc():
            mpc.setup()
        self.mpc: Any = mpc
        self._guessed = False

    def solve(self, problem: MPCProblem) -> Array:
        """Solve one instance, with all set-up that do-mpc needs per step; returns the levels (A, N)."""
        p = problem
        if p.power_cap is None:
            raise DataError("do-mpc: the problem has no power cap")
        full = p.machinery.u_max[:, None] * np.ones((1, self._n))
        drive = self._operator.drive(full, p.features) / full
        kilo = 1.0 / POWER_UNIT_W
        price, limit = POWER_UNIT_W * p.price_per_W, kilo * p.power_cap.limit_W[None]
        rows = (drive, price, kilo * p.power_fixed_W, kilo * p.power_per_u_W, limit, p.T_free_C, p.lower_C, p.upper_C)
        given = np.concatenate(rows)
        for k in range(self._n + 1):
            self._template["_tvp", k, "given"] = given[:, min(k, self._n - 1)]
        state = (p.forced_state_K.sum(axis=1) if self._modes_shared else p.forced_state_K).reshape(-1, 1)
        self.mpc.x0 = state
        if not self._guessed:
            self.mpc.set_initial_guess()
            self._guessed = True
        with quiet_do_mpc():
            self.mpc.make_step(state)
        return np.array([move.full().ravel() for move in self.mpc.opt_x_num["_u", :, 0, "u"]]).T
