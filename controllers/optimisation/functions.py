"""Functions of the statement, built once for each structure: kept in the process, and on disk for the next one."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.optimisation.algebra import Direct, Lifted
from controllers.optimisation.function_store import load, save
from controllers.optimisation.statement import parameter_sizes, stated
from controllers.optimisation.structure import Structure

_KEPT: dict[Structure, Functions] = {}
# Structures kept in the process.
_MOST = 64


@dataclass(frozen=True)
class Variables:
    """Variables by name in their order.

    `own`: bounds of the user's own. `n_equal`: number of equations. `required`, `values`: what the check says must be
    at least 0, and names of the variables that it gives. `convex`: no derivative depends on variables or multipliers.
    """

    names: tuple[str, ...]
    own: Mapping[str, tuple[float, float]]
    n_equal: int
    required: tuple[str, ...]
    values: tuple[str, ...]
    convex: bool

    @cached_property
    def places(self) -> dict[str, NDArray[np.intp]]:
        """Numbers of the variables of each name."""
        names = np.array(self.names)
        return {name: np.flatnonzero(names == name) for name in dict.fromkeys(self.names)}


@dataclass(frozen=True, eq=False)
class Functions:
    """What is built from the statement of a structure.

    `local`: (x, p, multipliers) → objective, gradient, second derivatives of the Lagrangian, equations and their
    Jacobian, inequalities and theirs. `check`: (u, own, p) → cost, energy cost (1, N), power (M, N), forced response
    (Z, N), slack (Z, N), running (M, N), least of each requirement; then the variables over the steps. `rows`:
    (x, p) → objective and rows, for Ipopt; a solver is used by one at a time (`busy`).
    """

    variables: Variables
    local: ca.Function
    check: ca.Function
    rows: ca.Function
    solvers: dict[str, ca.Function] = field(default_factory=dict)
    busy: threading.Lock = field(default_factory=threading.Lock)

    def ipopt(self, options: Mapping[str, Any]) -> ca.Function:
        """Ipopt on the statement, with constant derivatives where they are."""
        constant = ("jac_c_constant", "jac_d_constant", "hessian_constant") if self.variables.convex else ()
        options = {**options, **dict.fromkeys(constant, "yes")}
        key = json.dumps(options, sort_keys=True)
        if key not in self.solvers:
            x, p = (ca.SX.sym(name, self.rows.size1_in(i)) for i, name in enumerate(("x", "p")))
            f, g = self.rows(x, p)
            self.solvers[key] = ca.nlpsol(
                "plan", "ipopt", {"x": x, "p": p, "f": f, "g": g}, {"print_time": False, "ipopt": options}
            )
        return self.solvers[key]


def functions_of(s: Structure) -> Functions:
    """The functions of a structure: from the process, from disk, or built."""
    found = _KEPT.pop(s, None)
    if found is None:
        stored = load(s)
        if stored:
            local, check, rows = stored[1]
            found = Functions(Variables(**stored[0]), local, check, rows)
        else:
            found = build(s)
            save(s, vars(found.variables), (found.local, found.check, found.rows))
        while len(_KEPT) >= _MOST:
            _KEPT.pop(next(iter(_KEPT)), None)
    _KEPT[s] = found
    return found


def build(s: Structure) -> Functions:
    """Build the functions of a structure."""
    q = {name: ca.SX.sym(name, *size) for name, size in parameter_sizes(s).items()}
    p, lifted = ca.veccat(*q.values()), Lifted()
    f = stated(lifted, q, s).cost
    x, equal, above = ca.veccat(*lifted.x), ca.veccat(*lifted.equal), ca.veccat(*lifted.above)
    rows = ca.vertcat(equal, above)
    m = ca.SX.sym("m", rows.numel())
    A, G = ca.jacobian(equal, x), ca.jacobian(above, x)
    linear = not ca.depends_on(ca.veccat(A, G), x)
    H, gradient = ca.hessian(f if linear else f + ca.dot(m, rows), x)
    convex = linear and not ca.depends_on(ca.vec(H), x)
    if not linear:
        gradient = ca.gradient(f, x)

    u = ca.SX.sym("u", s.A, s.N)
    direct = Direct(u)
    plan = stated(direct, q, s.by_steps)
    required = ca.vertcat(*(least for _, least in direct.required))
    checked = [plan.cost, plan.energy, plan.power, plan.forced, plan.slack, plan.running, required]
    checked = [ca.densify(value) for value in (*checked, *direct.values.values())]
    what, values = tuple(what for what, _ in direct.required), tuple(direct.values)
    variables = Variables(tuple(lifted.names), lifted.own, equal.numel(), what, values, convex)
    return Functions(
        variables,
        ca.Function("local", [x, p, m], [f, gradient, H, equal, A, above, G]),
        ca.Function("check", [u, ca.veccat(*direct.own.values()), p], checked),
        ca.Function("rows", [x, p], [f, rows]),
    )
