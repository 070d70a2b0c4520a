"""Trained operator as CasADi functions: the same equations with constant weights and exact derivatives."""

from __future__ import annotations

from functools import cache, cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import N_FEATURES, ZONE, OperatorParameters

Expression = TypeVar("Expression", ca.SX, ca.MX)


def on_load_expression(load: MachineLoad, u: Expression, T_out_C: Expression, on: Expression | None) -> Expression:
    """`load(u, T_out)` in W as an expression (elementwise), for delivered heat, which has no term in u².

    `on`: share of the step in which the machine is on, by default that of a level that is held.
    """
    low, high = load.T_out_range_C
    T = ca.fmin(ca.fmax(T_out_C, low), high)
    c0, c1, c2, c3 = load.coefficients
    # At lowest_level 1 the load is linear in u, without a kink for the solver.
    if on is None:
        on = u if load.lowest_level == 1.0 else ca.fmin(u / load.lowest_level, 1.0)
    return on * (c0 + c1 * T) + u * (c2 + c3 * T)


def heat_input_expression(
    heat_input: HeatInput, u: Expression, T_out_C: Expression, on: Expression | None = None
) -> Expression:
    """Return v(u, T_out) as an expression (elementwise); `on` as in `on_load_expression`."""
    if heat_input.heat is None:
        if heat_input.per_K == 0.0:
            return u
        low, high = heat_input.T_out_range_C
        return u * (1.0 + heat_input.per_K * (ca.fmin(ca.fmax(T_out_C, low), high) - heat_input.reference_C))
    return on_load_expression(heat_input.heat, u, T_out_C, on) / heat_input.reference_W


@cache
def gain_function(hidden: int, n: int = 1) -> ca.Function:
    """Return m(x) (paper eq:mod): `x` (4, n) in physical units, `network` → m (1, n), in [1 − γ, 1 + γ].

    All that is exported or planned over calls this function. `network` (6 H + 10,), H = `hidden`: weights and biases of
    the hidden units (4 H, column by column, and H), those of the output (H and 1), γ, mean and scale of the features.
    """
    # Products of matrices are four times as fast for many columns as one scalar after the other.
    kind: Any = ca.SX if n == 1 else ca.MX
    x, network = kind.sym("x", N_FEATURES, n), kind.sym("network", network_size(hidden))
    sizes = [N_FEATURES * hidden, hidden, hidden, 1, 1, N_FEATURES, N_FEATURES]
    ends = np.cumsum([0, *sizes]).tolist()
    weight, bias, output, output_bias, gamma, mean, scale = ca.vertsplit(network, ends)
    bias, mean, scale = (ca.repmat(column, 1, n) for column in (bias, mean, scale))
    units = ca.tanh(ca.mtimes(ca.reshape(weight, hidden, N_FEATURES), (x - mean) / scale) + bias)
    m = 1.0 + gamma * ca.tanh(ca.mtimes(output.T, units) + output_bias)
    return ca.Function("modulation", [x, network], [m], ["x", "network"], ["m"])


def network_size(hidden: int) -> int:
    """Number of `gain_function`'s weights and constants."""
    return (N_FEATURES + 2) * hidden + 2 + 2 * N_FEATURES


def network_of(params: OperatorParameters, hidden: int) -> Array:
    """Return `gain_function`'s `network` with `hidden` units, at least as many as the operator has; others add 0."""
    more = hidden - params.hidden_bias.size
    weight = np.pad(params.hidden_weight, ((0, more), (0, 0)))
    bias, output = (np.pad(values, (0, more)) for values in (params.hidden_bias, params.output_weight))
    rest = [params.output_bias, params.gamma, *params.feature_mean, *params.feature_scale]
    return np.concatenate([weight.ravel(order="F"), bias, output, rest])


class ExportedGain:
    """m(x) over a horizon by the exported function."""

    def __init__(self, params: OperatorParameters, n_steps: int) -> None:
        self._constant = params.constant_modulation
        if self._constant is None:
            hidden = params.hidden_bias.size
            self._function, self._network = Buffered(gain_function(hidden, n_steps)), network_of(params, hidden)

    def __call__(self, features: Array) -> Array | float:
        """Return m(x) at `features` (N, 4), (N,); the constant where no feature enters it."""
        if self._constant is not None:
            return self._constant
        return self._function(features.ravel(), self._network)[0].copy()


class Buffered:
    """A function that is evaluated into arrays of its own, without copies; one call at a time.

    `function`: that one; `places`: the numbers of its inputs by name.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function, self.places = function, {name: i for i, name in enumerate(function.name_in())}
        self._sizes = [function.nnz_in(i) for i in range(function.n_in())]
        self._out = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        self._buffer, self._run = function.buffer()
        for i, out in enumerate(self._out):
            self._buffer.set_res(i, memoryview(out))  # type: ignore[call-arg,arg-type]

    def __call__(self, *arguments: Array) -> list[NDArray[np.float64]]:
        """Return the nonzeros of every output, which the next call overwrites."""
        kept = [np.ascontiguousarray(argument, dtype=np.float64) for argument in arguments]
        for i, argument in enumerate(kept):
            if argument.size != self._sizes[i]:
                raise ValueError(f"argument {i} has {argument.size} numbers, expected {self._sizes[i]}")
            self._buffer.set_arg(i, memoryview(argument))  # type: ignore[call-arg,arg-type]
        self._run()
        return self._out

    def named(self, **arguments: Array) -> dict[str, NDArray[np.float64]]:
        """The same by names of inputs, of which others are 0, and of outputs."""
        out = self(*(arguments.get(name, self._zeros[name]) for name in self.places))
        return dict(zip(self.function.name_out(), out, strict=True))

    @cached_property
    def _zeros(self) -> dict[str, Array]:
        return {name: np.zeros(self._sizes[i]) for name, i in self.places.items()}

    @property
    def stats(self) -> dict[str, Any]:
        """What a solver says of its last call."""
        return dict(self._buffer.stats())


def modulation_function(params: OperatorParameters) -> ca.Function:
    """Return `m(x)` (paper eq:mod): x (4,) in physical units → scalar; use `.map(N)` for a horizon."""
    x = ca.SX.sym("x", N_FEATURES)
    return ca.Function("modulation", [x], [modulation_of(params, x)], ["x"], ["m"])


def modulation_of(params: OperatorParameters, x: ca.SX) -> ca.SX:
    """Return m(x) of `x` (4,) in physical units as an expression."""
    hidden = params.hidden_bias.size
    return gain_function(hidden)(x, ca.DM(network_of(params, hidden)))


def advanced(params: OperatorParameters, F: ca.SX, x: ca.SX, v: ca.SX) -> ca.SX:
    """Return F(t+1) (r,) K (paper eq:operator) of F (r,) K, `x` (4,) with T − F in it and the input `v`."""
    seen = ca.vertcat(x[ZONE] + ca.sum1(F), x[ZONE + 1 :]) if params.feedback_active else x
    return ca.DM(params.poles) * F + ca.DM(params.gains) * modulation_of(params, seen) * v


def rolled_out(step: ca.Function, n_steps: int) -> ca.Function:
    """Return a step as a function of a horizon.

    Inputs F0 (r,) K, the levels of the step (n_steps,) each, X (4, n_steps) with x_t of each step in its column;
    outputs `modes` (r, n_steps) K at the end of each step and `forced` (1, n_steps) K, their sum.
    """
    names = step.name_in()[1:-1]
    F0, X = ca.SX.sym("F0", step.size1_in(0)), ca.SX.sym("X", N_FEATURES, n_steps)
    levels = [ca.SX.sym(name, n_steps) for name in names]
    columns, F = [], F0
    for t in range(n_steps):
        F = step(F, *(level[t] for level in levels), X[:, t])
        columns.append(F)
    modes, inputs = ca.horzcat(*columns), ["F0", *names, "X"]
    return ca.Function("forced_rollout", [F0, *levels, X], [modes, ca.sum1(modes)], inputs, ["modes", "forced"])
