"""Functions of the statement, built once for each structure: kept in the process, and on disk for the next one."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.optimisation.statement.algebra import Algebra
from controllers.optimisation.statement.function_store import stored
from controllers.optimisation.statement.problem_statement import Stated, parameter_sizes, state
from controllers.optimisation.statement.structure import Structure

# Structures kept in the process.
_MOST = 64


@dataclass(frozen=True)
class Check:
    """`function`: (u, own, p) → cost, energy cost (1, N), power (M, N), forced response (Z, N), slack (Z, N), running
    (M, N), least of each of what is `required`, the parts of the cost (`PARTS`), and all variables of the programme.
    `own`: how many the user's own are, by name.
    """

    function: ca.Function
    required: tuple[str, ...]
    own: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Functions:
    """The programme of a structure.

    `bounds`: p → least and largest values of the variables. `local`: (x, p, multipliers) → objective, gradient, second
    derivatives of the Lagrangian, equations and their Jacobian, inequalities and theirs. `rows`: (x, p) → objective and
    rows, for Ipopt; a solver is used by one at a time (`busy`). `names` of the variables in their order; `n_equal`:
    number of equations. `convex`: no derivative depends on variables or multipliers.
    """

    bounds: ca.Function
    local: ca.Function
    rows: ca.Function
    names: tuple[str, ...]
    n_equal: int
    convex: bool
    solvers: dict[str, ca.Function] = field(default_factory=dict)
    busy: threading.Lock = field(default_factory=threading.Lock)

    @cached_property
    def places(self) -> dict[str, NDArray[np.intp]]:
        """Numbers of the variables of each name."""
        names = np.array(self.names)
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(self.names)}

    def ipopt(self, options: Mapping[str, Any]) -> ca.Function:
        """Ipopt on the statement, with constant derivatives where they are."""
        constant = ("jac_c_constant", "jac_d_constant", "hessian_constant") if self.convex else ()
        options = {**options, **dict.fromkeys(constant, "yes")}
        key = json.dumps(options, sort_keys=True)
        if key not in self.solvers:
            x, p = (ca.SX.sym(name, self.rows.size1_in(i)) for i, name in enumerate(("x", "p")))
            f, g = self.rows(x, p)
            self.solvers[key] = ca.nlpsol(
                "plan", "ipopt", {"x": x, "p": p, "f": f, "g": g}, {"print_time": False, "ipopt": options}
            )
        return self.solvers[key]


@lru_cache(_MOST)
def check_of(s: Structure) -> Check:
    """The check of a structure: from disk, or built."""
    facts, (function,) = stored(s, "check", lambda: _build_check(s))
    return Check(function, **facts)


@lru_cache(_MOST)
def functions_of(s: Structure) -> Functions:
    """The programme of a structure: from disk, or built."""
    facts, (bounds, local, rows) = stored(s, "programme", lambda: _build_programme(s))
    return Functions(bounds, local, rows, **facts)


def _build_check(s: Structure) -> tuple[dict[str, Any], list[ca.Function]]:
    plan, alg, p = _stated(s)
    required, parts = ca.vertcat(*(least for _, least in alg.required)), ca.vertcat(*plan.parts.values())
    over_steps = (plan.energy, plan.power, plan.forced, plan.slack, plan.running)
    x, *values = alg.at_given(plan.cost, *over_steps, required, parts)
    facts = {"required": tuple(what for what, _ in alg.required), "own": alg.own}
    return facts, [ca.Function("check", [alg.u, ca.veccat(*alg.given), p], [*values, x])]


def _build_programme(s: Structure) -> tuple[dict[str, Any], list[ca.Function]]:
    plan, alg, p = _stated(s)
    f, x, equal, above = plan.cost, ca.veccat(*alg.x), ca.veccat(*alg.equal), ca.veccat(*alg.above)
    rows = ca.vertcat(equal, above)
    m = ca.SX.sym("m", rows.numel())
    A, G = ca.jacobian(equal, x), ca.jacobian(above, x)
    linear = not ca.depends_on(ca.veccat(A, G), x)
    H, gradient = ca.hessian(f if linear else f + ca.dot(m, rows), x)
    facts = {
        "names": tuple(alg.names),
        "n_equal": equal.numel(),
        "convex": linear and not ca.depends_on(ca.vec(H), x),
    }
    outputs = [f, gradient if linear else ca.gradient(f, x), H, equal, A, above, G]
    bounds = ca.Function("bounds", [p], [ca.densify(ca.veccat(*each)) for each in (alg.low, alg.high)])
    return facts, [bounds, ca.Function("local", [x, p, m], outputs), ca.Function("rows", [x, p], [f, rows])]


def _stated(s: Structure) -> tuple[Stated, Algebra, ca.SX]:
    """The statement, its variables and its parameters."""
    q = {name: ca.SX.sym(name, *size) for name, size in parameter_sizes(s).items()}
    alg = Algebra(ca.SX.sym("u", s.A, s.N))
    return state(alg, q, s), alg, ca.veccat(*q.values())
