"""Variables of the statement: with bounds and rows for solvers, and what each is at levels that are given.

`at_least` is a slack with rows for a solver and a maximum at given levels. So one text is the programme that is solved,
the check of what a solver answers, and the rollout of any levels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from controllers.optimisation.statement.structure import Structure
from thermoforce_mpc.model.operator.casadi_export import gain_function
from thermoforce_mpc.model.operator.features import N_FEATURES

# Levels up to this do not act.
ACTS_ABOVE = 1e-6
# What a machine's share of running and the times that make it up can be at most; a bound that must not be active.
MOST_RUNNING = 2.0


@dataclass
class Algebra:
    """Variables `x` with bounds, and rows: 0 in `equal`, at least 0 in `above`.

    `u` (A, N): levels that are given, at which variables are `at_levels`; `given`: those of the user's `own` variables,
    whose sizes are by name. `required`: what must be at least 0 at given levels, and what it is.
    """

    u: ca.SX
    x: list[ca.SX] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    low: list[ca.SX] = field(default_factory=list)
    high: list[ca.SX] = field(default_factory=list)
    at_levels: list[ca.SX] = field(default_factory=list)
    own: dict[str, int] = field(default_factory=dict)
    given: list[ca.SX] = field(default_factory=list)
    equal: list[ca.SX] = field(default_factory=list)
    above: list[ca.SX] = field(default_factory=list)
    required: list[tuple[str, ca.SX]] = field(default_factory=list)

    def variable(self, name: str, at_levels: ca.SX, low: ca.SX | float = 0.0, high: ca.SX | float = ca.inf) -> ca.SX:
        """New variables, which are `at_levels` at given levels."""
        x = ca.SX.sym(name, *at_levels.shape)
        self.x.append(ca.vec(x))
        self.names += [name] * x.numel()
        self.at_levels.append(ca.vec(at_levels))
        for bounds, bound in ((self.low, low), (self.high, high)):
            bounds.append(ca.vec(ca.SX.ones(*x.shape) * bound))
        return x

    def own_variable(self, name: str, n: int, low: float, high: float) -> ca.SX:
        """New variables (1, n) of the user, between two bounds."""
        self.own[f"own {name}"] = n
        self.given.append(ca.SX.sym(name, 1, n))
        return self.variable(f"own {name}", self.given[-1], low, high)

    def at_given(self, *values: ca.SX) -> list[ca.SX]:
        """Variables and `values` at given levels, densely."""
        x, at_levels = ca.veccat(*self.x), ca.veccat(*self.at_levels)
        variables, found = ca.substitute_inplace([x], [at_levels], list(values))
        return [ca.densify(value) for value in (*variables, *found)]

    def levels(self, q: Mapping[str, ca.SX], s: Structure) -> tuple[ca.SX, ca.SX]:
        """Levels above and below 0, (A, N)."""
        of, cold = list(s.signed), ca.SX(s.A, s.N)
        v = self.variable("v", ca.fmax(self.u, 0.0) if of else self.u, q["least"], q["most"])
        if of:
            cold[of, :] = self.variable("cold", ca.fmax(-self.u[of, :], 0.0), 0.0, ca.repmat(-q["u_min"][of], 1, s.N))
        return v, cold

    def acting(self, q: Mapping[str, ca.SX], s: Structure, v: ca.SX, cold: ca.SX) -> ca.SX:
        """Whether actuators act, (chosen, first steps)."""
        of, early = list(s.chosen), slice(0, s.n_chosen)
        b = self.variable("b", v[of, early] + cold[of, early] > ACTS_ABOVE, 0.0, 1.0)
        for i, a in enumerate(s.chosen):
            self.require("", q["u_max"][a] * b[i, :] - v[a, early])
            if a in s.signed:
                self.require("", -q["u_min"][a] * b[i, :] - cold[a, early])
        return b

    def at_least(self, name: str, *bounds: ca.SX, high: ca.SX | float = ca.inf) -> ca.SX:
        """max(0, bounds); for a solver from above: it costs, so it is not more."""
        greatest = ca.SX.zeros(*bounds[0].shape)
        for bound in bounds:
            greatest = ca.fmax(greatest, bound)
        x = self.variable(name, greatest, 0.0, high)
        for bound in bounds:
            self.require("", x - bound)
        return x

    def highest(self, name: str, row: ca.SX) -> ca.SX:
        """The highest of a row, at least 0."""
        x = self.variable(name, ca.fmax(ca.mmax(row), 0.0))
        self.require("", x - row)
        return x

    def least(self, name: str, kinks: Sequence[ca.SX], objective: Callable[[ca.SX], ca.SX]) -> ca.SX:
        """Where a convex, piecewise linear objective is least: one of its kinks."""
        best, least = kinks[0], objective(kinks[0])
        for kink in kinks[1:]:
            value = objective(kink)
            best, least = ca.if_else(value < least, kink, best), ca.fmin(value, least)
        return self.variable(name, best, 0.0, MOST_RUNNING)

    def response(self, q: Mapping[str, ca.SX], s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Responses of the zones (Z, N), drives m·v (A, N) of `heat` v by difference equations, and slack (Z, N).

        m is a parameter unless it sees the response.

        The response is what is inside the comfort bounds, a variable between numbers, less what is below, plus what is
        above: where a zone has one group, comfort needs no rows. At given levels it is counted mode by mode.
        """
        modes, modes_drive = _mode_by_mode(q, s, heat)
        zones = _zones_of([z for z, _ in s.groups], s.Z)
        total, low, high = ca.mtimes(zones, modes), q["lower"] - q["T_free"], q["upper"] - q["T_free"]
        less, more = ca.fmax(low - total, 0.0), ca.fmax(total - high, 0.0)
        inside = self.variable("inside", total + less - more, low, ca.fmax(high, low))
        below, above = self.variable("below", less), self.variable("above", more)
        forced, drive = inside - below + above, heat if s.hidden else q["gain"] * heat
        y = forced
        if [z for z, _ in s.groups] != list(range(s.Z)):
            y = self.variable("y", modes, -ca.inf)
            self.equal.append(ca.vec(forced - ca.mtimes(zones, y)))
        if s.hidden:
            drive = self.variable("drive", modes_drive, -ca.inf)
            seen = ca.horzcat(ca.sum2(q["forced"]), y[:, :-1])
            gain = ca.horzcat(*(_gain(q, s, k, seen[0, k]) for k in range(s.N)))
            self.equal.append(ca.vec(drive - gain * heat))
        self.equal.append(ca.vec(_difference_equations(q, s, y, drive)))
        return forced, drive, below + above

    def require(self, what: str, row: ca.SX) -> None:
        """Rows that are at least 0; `what` they are, '' where given levels leave no choice."""
        self.above.append(ca.vec(row))
        if what:
            self.required.append((what, ca.mmin(row)))

    def equal_to_zero(self, what: str, row: ca.SX) -> None:
        """Rows that are 0."""
        self.equal.append(ca.vec(row))
        self.required.append((what, -ca.mmax(ca.fabs(row))))


def _mode_by_mode(q: Mapping[str, ca.SX], s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Responses of the groups and drives m·v (A, N) of `heat` v (paper eq:operator)."""
    forced, columns, drives = q["forced"], [], []
    actuators = [a for _, a in s.pairs]
    of_group = [s.groups.index(next(g for g in s.groups if g[0] == z and a in g[1])) for z, a in s.pairs]
    sums, sizes = _zones_of(of_group, len(s.groups)), sorted(set(s.lengths))
    for k in range(s.N):
        drive = (_gain(q, s, k, ca.sum2(forced)) if s.hidden else q["gain"][:, k]) * heat[:, k]
        of = slice(s.r * sizes.index(s.lengths[k]), s.r * sizes.index(s.lengths[k]) + s.r)
        forced = q["poles"][:, of] * forced + q["gains"][:, of] * ca.repmat(drive[actuators], 1, s.r)
        columns.append(ca.mtimes(sums, ca.sum2(forced)))
        drives.append(drive)
    return ca.horzcat(*columns), ca.horzcat(*drives)


def _gain(q: Mapping[str, ca.SX], s: Structure, k: int, forced: ca.SX) -> ca.SX:
    """m(x) of step k with the predicted temperature, T − F and `forced`, in x."""
    return gain_function(s.hidden)(q["features"][:, k] + ca.vertcat(forced, ca.SX(N_FEATURES - 1, 1)), q["network"])


def _difference_equations(q: Mapping[str, ca.SX], s: Structure, y: ca.SX, drive: ca.SX) -> ca.SX:
    """What is 0 where the responses y of the groups follow the drives, (groups, N)."""
    late = [drive]
    for _ in range(1, s.r):
        late.append(ca.horzcat(ca.SX(s.A, 1), late[-1][:, :-1]))
    kind_of = [s.kinds.index(window) for window in s.windows]
    right = ca.horzcat(q["begin"], ca.SX(len(s.groups), max(s.N - s.r, 0)))[:, : s.N]
    left, shifted = y, y
    for i in range(s.r):
        for kind in range(len(s.kinds)):
            of = [k for k in range(s.N) if kind_of[k] == kind]
            right[:, of] += ca.mtimes(_numerator(q, s, kind * s.r + i), late[i][:, of])
        shifted = ca.horzcat(ca.SX(len(s.groups), 1), shifted[:, :-1])
        left += q["denominator"][:, [kind * s.r + i for kind in kind_of]] * shifted
    return left - right


def _zones_of(numbers: Sequence[int], count: int) -> ca.SX:
    """Incidence (count, n): 1 where a row's number is that of the column."""
    out = ca.SX(count, len(numbers))
    for column, number in enumerate(numbers):
        out[number, column] = 1.0
    return out


def _numerator(q: Mapping[str, ca.SX], s: Structure, i: int) -> ca.SX:
    """Coefficients of the i-th lag of the drives, (groups, A)."""
    out, at = ca.SX(len(s.groups), s.A), 0
    for g, (_, actuators) in enumerate(s.groups):
        out[g, list(actuators)] = q["numerator"][i, at : at + len(actuators)]
        at += len(actuators)
    return out
