"""Further terms of the problem, written by the user in CasADi (`controller.options.terms`, `ThermoForceMPC.terms`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from controllers.checks import ControllerConfigError, message_of
from thermoforce_mpc.scenario.own_code import line_in, own_code

if TYPE_CHECKING:
    from controllers.optimisation.statement.algebra import Algebra

_KEY = "controller.options.terms"
# Slopes of a term's rows up to this are left as they are: terms in °C, kW and shares have less, joules beside watts a
# step's 900 and more.
_STEEP = 100.0
# Expressions that are 0 or 1: a constraint is an expression that is at least 0, or 0.
_COMPARISONS = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}


@dataclass
class PlanExpressions:
    """What a term may use, as CasADi expressions (SX) over N steps, and what it adds.

    `u`: levels (A, N), in [0, 1], below 0 where they cool; at the end of each step `T_zone_C` (Z, N), °C, and `slack_K`
    (Z, N), violation of the comfort bounds; `power_W` (M, N): mean electric power of each machine; `last_u` (A,):
    measured levels of the step before the first, 0 where not known; `step_s`: length of a step, s.
    """

    algebra: Algebra
    u: ca.SX
    T_zone_C: ca.SX
    power_W: ca.SX
    slack_K: ca.SX
    last_u: ca.SX
    step_s: float
    cost: ca.SX = field(default_factory=lambda: ca.SX(0))
    n_added: int = 0

    def variable(self, name: str, n: int, low: float, high: float) -> ca.SX:
        """A decision of your own, (1, n), between two bounds; `Plan.own` has its values by `name`."""
        if f"own {name}" in self.algebra.own:
            raise ValueError(f"variable {name!r}: there is one of this name already")
        if not (int(n) == n > 0 and low <= high):
            raise ValueError(f"variable {name!r}: {n} values from {low} to {high}; expected one or more, low ≤ high")
        return self.algebra.own_variable(name, int(n), float(low), float(high))

    def add_cost(self, expression: ca.SX) -> None:
        """Add the sum of the elements to the objective, currency."""
        self.cost += ca.sum1(ca.vec(self._checked(expression, "add_cost")))

    def require(self, expression: ca.SX, what: str = "a term of yours") -> None:
        """Require that every element is at least 0; where it cannot be, there is no plan and the fallback acts."""
        self.algebra.require(what, self._scaled(self._checked(expression, "require")))

    def equal(self, expression: ca.SX, what: str = "a term of yours") -> None:
        """Require that every element is 0."""
        self.algebra.equal_to_zero(what, self._scaled(self._checked(expression, "equal")))

    def _scaled(self, row: ca.SX) -> ca.SX:
        """The same rows with slopes of at most `_STEEP`, where they are linear: joules beside watts stop solvers."""
        row = ca.densify(ca.vec(row))
        x = ca.veccat(*self.algebra.x)
        slopes = ca.jacobian(row, x)
        if ca.depends_on(slopes, x):
            return row
        steepest = [ca.mmax(ca.fabs(slopes[i, :])) for i in range(row.numel())]
        return ca.vertcat(*(row[i] / ca.fmax(1.0, slope / _STEEP) for i, slope in enumerate(steepest)))

    def _checked(self, expression: object, method: str) -> ca.SX:
        if not isinstance(expression, ca.SX | ca.DM | float | int | np.ndarray):
            raise ValueError(f"{method}: expected an expression of CasADi's SX, got {type(expression).__name__}")
        row = ca.SX(expression)
        elements: list[Any] = row.nonzeros()  # SX of one element each
        if method != "add_cost" and any(element.op() in _COMPARISONS for element in elements):
            raise ValueError(f"{method}: a comparison is 0 or 1; give the difference, as require(0.5 - u) for u ≤ 0.5")
        if any(element.is_constant() and not np.isfinite(float(element)) for element in elements):
            raise ValueError(f"{method}: the expression is not finite")
        foreign = self._foreign(row)
        if foreign:
            raise ValueError(f"{method}: unknown symbols {', '.join(foreign)}; decisions are made by variable()")
        self.n_added += 1
        return row

    def _foreign(self, row: ca.SX) -> list[str]:
        of_plan = ca.veccat(self.u, self.T_zone_C, self.power_W, self.slack_K, self.last_u, *self.algebra.x)
        known = {symbol.element_hash() for symbol in ca.symvar(of_plan)}
        return sorted({str(symbol) for symbol in ca.symvar(row) if symbol.element_hash() not in known})


Terms = tuple[Callable[[PlanExpressions], None], ...]


@dataclass(frozen=True)
class Term:
    """A function of the user; an error in it is told with `where` it stands: key, file and name."""

    function: Callable[[PlanExpressions], object]
    where: str

    def __call__(self, plan: PlanExpressions) -> None:
        """Let the function add what it adds; raises `ControllerConfigError` where it raised, returned something or
        added nothing.
        """
        before, code = plan.n_added, getattr(self.function, "__code__", None)
        try:
            returned = self.function(plan)
        except Exception as error:  # whatever a function of the user raises
            raise ControllerConfigError(
                f"{self.where}{line_in(getattr(code, 'co_filename', None), error)}: {message_of(error)}"
            ) from error
        if returned is not None or plan.n_added == before:
            raise ControllerConfigError(
                f"{self.where}: {'returned something' if returned is not None else 'added nothing'}; a term adds by "
                "plan.add_cost(…), plan.require(…) or plan.equal(…) and returns None"
            )


def load_terms(where: str | None) -> Terms:
    """The function of the user at `file.py:function`, relative to the working directory; nothing for None.

    Raises `ControllerConfigError` where the file cannot be read, or holds no such function; says why.
    """
    if where is None:
        return ()
    return (Term(own_code(where, _KEY, ControllerConfigError), f"{_KEY}: {where}"),)


def of_controller(functions: Iterable[Callable[[PlanExpressions], None]]) -> Terms:
    """The functions that a controller's `terms` gave, each with where it stands."""
    found = tuple(functions)
    for function in found:
        if not callable(function):
            raise ControllerConfigError(f"terms(): expected functions of a plan, got {type(function).__name__}")
    return tuple(f if isinstance(f, Term) else Term(f, f"terms(): {_place(f)}") for f in found)


def _place(function: Callable[..., object]) -> str:
    code = getattr(function, "__code__", None)
    name = getattr(function, "__qualname__", type(function).__name__)
    return name if code is None else f"{code.co_filename}:{name}"
