"""Minimum of a smooth function of a few bounded variables, by BFGS (Nocedal and Wright 2006, chapter 6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numba import njit

from thermoforce_mpc.data import Array

_MAX_STEPS, _MAX_HALVINGS, _MAX_SWEEPS = 50, 30, 1000
# Step of a variable that is not taken any more: convergence is superlinear, so that this is about the error left.
_SETTLED = 1e-7
# Share of the decrease along the gradient that a step must reach, and relative rounding error of the function.
_ARMIJO, _ROUNDING = 1e-4, 1e-12


@dataclass(frozen=True)
class Point:
    """Value and gradient (n,) of the function at `at` (n,)."""

    at: Array
    value: float
    gradient: Array


_P = TypeVar("_P", bound=Point)


def minimised(evaluate: Callable[[Array], _P], start: _P, hessian: Array, low: Array, high: Array) -> _P:
    """Return the point of a local minimum with `low` ≤ x ≤ `high` (n,).

    Unlike scipy's methods with bounds it takes an estimate of the second derivatives: with a good one an evaluation is
    rarely taken twice for a step.

    Args:
        evaluate: the function.
        start: a point inside the bounds.
        hessian: positive definite estimate of the second derivatives there (n, n).
        low, high: bounds (n,).
    """
    here, B = start, hessian
    for _ in range(_MAX_STEPS):
        step = _bounded_step(B, here.gradient, low - here.at, high - here.at)
        there = _lower(evaluate, here, step)
        if there is None:
            break
        moved, turned = there.at - here.at, there.gradient - here.gradient
        if (bend := moved @ turned) > 0.0:
            pull = B @ moved
            B = B + np.outer(turned, turned / bend) - np.outer(pull, pull / (moved @ pull))
        here = there
    return here


def _lower(evaluate: Callable[[Array], _P], here: _P, step: Array) -> _P | None:
    """The point after the first of `step`, a half of it, … that lowers the function; None if the minimum is `here`."""
    for _ in range(_MAX_HALVINGS):
        if np.abs(step).max() <= _SETTLED:
            return None
        there = evaluate(here.at + step)
        if there.value <= here.value + _ARMIJO * (here.gradient @ step) + _ROUNDING * abs(here.value):
            return there
        step = 0.5 * step
    return None


@njit(cache=True)
def _bounded_step(B: Array, gradient: Array, low: Array, high: Array) -> Array:
    """The step (r,) of least gradient · step + ½ step · B step with `low` ≤ step ≤ `high`, by Gauss-Seidel sweeps."""
    step = np.zeros(gradient.size)
    for _ in range(_MAX_SWEEPS):
        largest = 0.0
        for i in range(step.size):
            wanted = step[i] - (gradient[i] + B[i] @ step) / B[i, i]
            wanted = min(max(wanted, low[i]), high[i])
            largest = max(largest, abs(wanted - step[i]))
            step[i] = wanted
        if largest <= _ROUNDING:
            break
    return step
