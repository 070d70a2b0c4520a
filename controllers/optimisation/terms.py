"""Further terms of the problem, written by the user in CasADi (`controller.options.terms`)."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca

from controllers.checks import ControllerConfigError

if TYPE_CHECKING:
    from controllers.optimisation.algebra import Direct, Lifted


@dataclass
class PlanExpressions:
    """What a term may use, as CasADi expressions over N steps, and what it adds.

    Attributes:
        u: levels (A, N), in [0, 1].
        T_zone_C: temperatures at the end of each step (Z, N), °C.
        power_W: electric power of each machine over each step (M, N), W.
        slack_K: violation of the comfort bounds at the end of each step (Z, N), K.
        last_u: levels of the step before the first (A,).
        step_s: length of a step, s.
    """

    algebra: Lifted | Direct
    u: ca.SX
    T_zone_C: ca.SX
    power_W: ca.SX
    slack_K: ca.SX
    last_u: ca.SX
    step_s: float
    cost: ca.SX = field(default_factory=lambda: ca.SX(0))

    def variable(self, name: str, n: int, low: float, high: float) -> ca.SX:
        """A decision of your own, (1, n), between two bounds."""
        return self.algebra.own_variable(name, n, low, high)

    def add_cost(self, expression: ca.SX) -> None:
        """Add a scalar to the objective, currency."""
        self.cost += ca.sum1(ca.vec(expression))

    def require(self, expression: ca.SX, what: str = "a term of yours") -> None:
        """Require that every element is at least 0; where it cannot be, there is no plan and the fallback acts."""
        self.algebra.require(what, expression)

    def equal(self, expression: ca.SX, what: str = "a term of yours") -> None:
        """Require that every element is 0."""
        self.algebra.equal_to_zero(what, expression)


def load_terms(where: str | None) -> tuple[Callable[[PlanExpressions], None], ...]:
    """The function of the user at `file.py:function`; nothing for None.

    Raises:
        ControllerConfigError: the file cannot be read, or holds no such function; says why.
    """
    return () if where is None else (_function(where),)


@cache
def _function(where: str) -> Callable[[PlanExpressions], None]:
    key, (file, _, name) = "controller.options.terms", where.rpartition(":")
    path = Path(file)
    if not file or not path.is_file():
        raise ControllerConfigError(f"{key}: {where!r}: no such file; expected path/to/file.py:function")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the file raises
        raise ControllerConfigError(f"{key}: {path} raised {type(error).__name__}: {error}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise ControllerConfigError(f"{key}: {path} has no function {name!r}")
    found: Callable[[PlanExpressions], None] = function
    return found
