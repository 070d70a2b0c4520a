"""Two readings of the statement: variables and rows for solvers, or expressions of levels that are given.

`at_least` is a slack with rows in one and a maximum in the other. So one text is the programme that is solved, the
check of what a solver answers, and the rollout of any levels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from controllers.optimisation.statement.structure import Structure
from thermoforce_mpc.model.operator.casadi_export import gain_from

# Levels up to this do not act.
ACTS_ABOVE = 1e-6


@dataclass
class Lifted:
    """Variables `x` with bounds, and rows: 0 in `equal`, at least 0 in `above`."""

    x: list[ca.SX] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    own: dict[str, tuple[float, float]] = field(default_factory=dict)
    equal: list[ca.SX] = field(default_factory=list)
    above: list[ca.SX] = field(default_factory=list)

    def variable(self, name: str, rows: int, columns: int) -> ca.SX:
        """New variables."""
        x = ca.SX.sym(name, rows, columns)
        self.x.append(ca.vec(x))
        self.names += [name] * x.numel()
        return x

    def own_variable(self, name: str, n: int, low: float, high: float) -> ca.SX:
        """New variables (1, n) of the user, between two bounds."""
        self.own[f"own {name}"] = (low, high)
        return self.variable(f"own {name}", 1, n)

    def levels(self, s: Structure) -> tuple[ca.SX, ca.SX]:
        """Levels above and below 0, (A, N)."""
        v, cold = self.variable("v", s.A, s.N), ca.SX(s.A, s.N)
        if s.signed:
            cold[list(s.signed), :] = self.variable("cold", len(s.signed), s.N)
        return v, cold

    def acting(self, q: Mapping[str, ca.SX], s: Structure, v: ca.SX, cold: ca.SX) -> ca.SX:
        """Whether actuators act, (chosen, first steps)."""
        b, early = self.variable("b", len(s.chosen), s.n_chosen), slice(0, s.n_chosen)
        for i, a in enumerate(s.chosen):
            self.require("", q["u_max"][a] * b[i, :] - v[a, early])
            if a in s.signed:
                self.require("", -q["u_min"][a] * b[i, :] - cold[a, early])
        return b

    def at_least(self, name: str, *bounds: ca.SX) -> ca.SX:
        """max(0, bounds), from above: it costs, so it is not more."""
        x = self.variable(name, *bounds[0].shape)
        for bound in bounds:
            self.require("", x - bound)
        return x

    def highest(self, name: str, row: ca.SX) -> ca.SX:
        """The highest of a row, at least 0."""
        x = self.variable(name, 1, 1)
        self.require("", x - row)
        return x

    def least(self, name: str, kinks: Sequence[ca.SX], objective: Callable[[ca.SX], ca.SX]) -> ca.SX:
        """Where a convex, piecewise linear objective is least."""
        return self.variable(name, *kinks[0].shape)

    def response(self, q: Mapping[str, ca.SX], s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Responses of the zones (Z, N), drives m·v (A, N) of `heat` v by difference equations, and slack (Z, N).

        The response is what is inside the comfort bounds, a variable between numbers, less what is below, plus what is
        above: where a zone has one group, comfort needs no rows.
        """
        inside, below, above = (self.variable(name, s.Z, s.N) for name in ("inside", "below", "above"))
        forced, drive = inside - below + above, heat
        zones = [z for z, _ in s.groups]
        y = forced
        if zones != list(range(s.Z)):
            y = self.variable("y", len(s.groups), s.N)
            self.equal.append(ca.vec(forced - ca.mtimes(_zones_of(zones, s.Z), y)))
        if s.hidden:
            drive = self.variable("drive", s.A, s.N)
            seen = ca.horzcat(ca.sum2(q["forced"]), y[:, :-1])
            gain = ca.horzcat(*(gain_from(q, q["before"][:, k], seen[0, k]) for k in range(s.N)))
            self.equal.append(ca.vec(drive - gain * heat))
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
        self.equal.append(ca.vec(left - right))
        return forced, drive, below + above

    def require(self, what: str, row: ca.SX) -> None:
        """Rows that are at least 0."""
        self.above.append(ca.vec(row))

    def equal_to_zero(self, what: str, row: ca.SX) -> None:
        """Rows that are 0."""
        self.equal.append(ca.vec(row))


@dataclass
class Direct:
    """Expressions of levels `u` (A, N) that are given, by name; `required`: what must be at least 0, and what it is."""

    u: ca.SX
    own: dict[str, ca.SX] = field(default_factory=dict)
    values: dict[str, ca.SX] = field(default_factory=dict)
    required: list[tuple[str, ca.SX]] = field(default_factory=list)

    def own_variable(self, name: str, n: int, low: float, high: float) -> ca.SX:
        """Variables (1, n) of the user: given too."""
        self.own[f"own {name}"] = ca.SX.sym(name, 1, n)
        return self.own[f"own {name}"]

    def _keep(self, name: str, value: ca.SX) -> ca.SX:
        # Names that appear again are further rows.
        self.values[name] = ca.vertcat(self.values[name], value) if name in self.values else value
        return value

    def levels(self, s: Structure) -> tuple[ca.SX, ca.SX]:
        """Levels above and below 0, (A, N)."""
        cold = ca.SX(s.A, s.N)
        if s.signed:
            of = list(s.signed)
            cold[of, :] = self._keep("cold", ca.fmax(-self.u[of, :], 0.0))
        return self._keep("v", ca.fmax(self.u, 0.0) if s.signed else self.u), cold

    def acting(self, q: Mapping[str, ca.SX], s: Structure, v: ca.SX, cold: ca.SX) -> ca.SX:
        """Whether actuators act, (chosen, first steps)."""
        acts = v[list(s.chosen), : s.n_chosen] + cold[list(s.chosen), : s.n_chosen] > ACTS_ABOVE
        return self._keep("b", acts)

    def at_least(self, name: str, *bounds: ca.SX) -> ca.SX:
        """max(0, bounds)."""
        found = ca.SX.zeros(*bounds[0].shape)
        for bound in bounds:
            found = ca.fmax(found, bound)
        return self._keep(name, found)

    def highest(self, name: str, row: ca.SX) -> ca.SX:
        """The highest of a row, at least 0."""
        return self._keep(name, ca.fmax(ca.mmax(row), 0.0))

    def least(self, name: str, kinks: Sequence[ca.SX], objective: Callable[[ca.SX], ca.SX]) -> ca.SX:
        """Where a convex, piecewise linear objective is least: one of its kinks."""
        best, least = kinks[0], objective(kinks[0])
        for kink in kinks[1:]:
            value = objective(kink)
            best, least = ca.if_else(value < least, kink, best), ca.fmin(value, least)
        return self._keep(name, best)

    def response(self, q: Mapping[str, ca.SX], s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Responses of the zones (Z, N), drives m·v (A, N) of `heat` v, mode by mode (paper eq:operator), and slack."""
        forced, columns, drives = q["forced"], [], []
        actuators = [a for _, a in s.pairs]
        of_group = [s.groups.index(next(g for g in s.groups if g[0] == z and a in g[1])) for z, a in s.pairs]
        sums, sizes = _zones_of(of_group, len(s.groups)), sorted(set(s.lengths))
        for k in range(s.N):
            drive = heat[:, k]
            if s.hidden:
                drive = gain_from(q, q["before"][:, k], ca.sum2(forced)) * drive
            of = slice(s.r * sizes.index(s.lengths[k]), s.r * sizes.index(s.lengths[k]) + s.r)
            forced = q["poles"][:, of] * forced + q["gains"][:, of] * ca.repmat(drive[actuators], 1, s.r)
            columns.append(ca.mtimes(sums, ca.sum2(forced)))
            drives.append(drive)
        y = self._keep("y", ca.horzcat(*columns))
        total = ca.mtimes(_zones_of([z for z, _ in s.groups], s.Z), y)
        low, high = q["lower"] - q["T_free"], q["upper"] - q["T_free"]
        below, above = (self._keep("below", ca.fmax(low - total, 0.0)), self._keep("above", ca.fmax(total - high, 0.0)))
        self._keep("inside", total + below - above)
        return total, self._keep("drive", ca.horzcat(*drives)), below + above

    def require(self, what: str, row: ca.SX) -> None:
        """What must be at least 0."""
        self.required.append((what, ca.mmin(row)))

    def equal_to_zero(self, what: str, row: ca.SX) -> None:
        """What must be 0."""
        self.required.append((what, -ca.mmax(ca.fabs(row))))


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
