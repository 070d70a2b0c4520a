"""Variables of the statement: with bounds and rows for solvers, and what each is at levels that are given.

`at_least` is a slack with rows for a solver and a maximum at given levels. So one text is the programme that is solved,
the check of what a solver answers, and the rollout of any levels.

What the statement of a plan depends on besides numbers, by which its functions are built once, and its equations.

Responses of zones are difference equations: comfort depends on the sum y = Σ F_i of the r modes of a pair only, with

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k,        q⁻¹ y_k = y_{k−1},

for a drive d_k = m(x_k) v(u_k). Pairs of one zone with the same poles obey it together, with the sum of their right
sides: one variable and one equation a step for all actuators of a zone instead of r of each for every pair.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import gain_function
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OperatorParameters


@dataclass(frozen=True)
class PoleGroup:
    """Pairs of a zone with the same poles.

    `pairs`: their actuators; `actuators`: those of the equation. `poles` (r,), 0 of modes that have no gain in any of
    them: the equation is of lower order without them. `gains` (actuators, r).
    """

    zone: int
    pairs: NDArray[np.intp]
    actuators: NDArray[np.intp]
    poles: Array
    gains: Array


def groups_of(operator: BuildingOperator, n_steps: int, *, power_couples: bool) -> list[PoleGroup]:
    """Return the pairs of each zone by poles, for plans of `n_steps`, in which power couples the levels of a step."""
    by_poles: dict[tuple[int, tuple[float, ...]], dict[int, OperatorParameters]] = {}
    for z, a, pair in operator.each():
        by_poles.setdefault((z, tuple(pair.poles.tolist())), {})[a] = pair
    groups = []
    for (z, key), pairs_of in by_poles.items():
        of, poles = np.array(list(pairs_of), dtype=np.intp), np.zeros(operator.shape[2])
        acting = np.any([pair.acting for pair in pairs_of.values()], axis=0)
        poles[: len(key)] = np.where(acting, key, 0.0)
        groups.append(PoleGroup(z, of, of, poles, operator.gains[z, of]))
    # Minimum degree orders a full pattern by time, and may order one with some cross-effects so that it fills up: such
    # a factorisation takes up to twice as long, or half. So actuators without an effect get numerators of 0 where that
    # takes fewer operations; buildings without cross-effects are faster as they are.
    Z, A, r = operator.shape
    as_is = tuple(tuple(int(a) for a in group.actuators) for group in groups)
    filled = (tuple(range(A)),) * Z
    if len(groups) > Z or sum(map(len, as_is)) <= max(Z, A) or as_is == filled:
        return groups
    size = (A, r, n_steps, power_couples)
    if _operations(as_is, *size) <= _operations(filled, *size):
        return groups
    return [_filled(group, A) for group in groups]


def _filled(group: PoleGroup, A: int) -> PoleGroup:
    gains = np.zeros((A, group.poles.size))
    gains[group.actuators] = group.gains
    return replace(group, actuators=np.arange(A), gains=gains)


@lru_cache(64)
def _operations(groups: tuple[tuple[int, ...], ...], A: int, r: int, n_steps: int, power_couples: bool) -> float:
    """Operations of a factorisation of the equations of groups of such actuators, in the order of minimum degree.

    Ratios of two patterns are those of PIQP's time within a fifth (rooms on a ring,
    10 and 20, with 1 to 4 neighbours, 2026-11-28).
    """
    lags = np.arange(r + 1)
    own = np.stack([A + np.arange(len(groups)), np.arange(len(groups))])  # column and row of a step's responses
    acts = np.array([(a, g) for g, actuators in enumerate(groups) for a in actuators]).T
    power = np.stack([np.arange(A), np.full(A, len(groups))])[:, : A if power_couples else 0]
    n_columns, n_rows = A + len(groups), len(groups) + 1
    entries = []
    for one, most in ((own, r + 1), (acts, r), (power, 1)):  # elements of a step, and their lags
        step, lag, at = np.meshgrid(np.arange(n_steps), lags[:most], np.arange(one.shape[1]), indexing="ij")
        known = step >= lag
        rows = n_columns * n_steps + step * n_rows + one[1, at]
        entries.append(np.stack([rows[known], ((step - lag) * n_columns + one[0, at])[known]]))
    row, column = np.concatenate(entries, axis=1)
    size = (n_columns + n_rows) * n_steps
    every = np.arange(size)
    pattern = ca.Sparsity.triplet(
        size, size, np.concatenate([row, column, every]).tolist(), np.concatenate([column, row, every]).tolist()
    )
    factor, _ = pattern.ldl(True)
    return float((np.bincount(np.array(factor.row()), minlength=size).astype(float) ** 2).sum())


def difference_equation(poles: Array, gains: Array, window: Sequence[int]) -> tuple[Array, Array]:
    """The difference equation of y = Σ F_i over the last r steps, which may differ in length.

    With G the modes before them and L_j the length of the first j, y_j = Σ_i a_i^L_j G_i + what the drives add. The
    weights w_j for which Σ_j w_j a_i^L_j = 0 for every mode eliminate G.

    `poles` (r,): a_i, 0 of modes that are left out; `gains` (actuators, r): g_i; `window` (r,): lengths of the steps in
    control steps, the latest last. Returns coefficients of y and its lags (r + 1,), the first of them 1, and of the
    drives and their lags (r, actuators).
    """
    acts = poles > 0.0
    if not acts.all():  # the earliest lags do not enter
        idle = (0, int(np.count_nonzero(~acts)))
        left, right = difference_equation(poles[acts], gains[:, acts], window[idle[1] :])
        return np.pad(left, idle), np.pad(right, (idle, (0, 0)))
    r, lengths = poles.size, np.array(window)
    ends = np.concatenate([[0], np.cumsum(lengths)])
    faded = poles[:, None] ** ends
    if len(set(window)) == 1:  # exact, however near the poles are
        weights = np.poly(faded[:, 1])[::-1]
    else:
        weights = np.append(np.linalg.lstsq(faded[:, :r], -faded[:, r], rcond=None)[0], 1.0)
    numerator = np.zeros((r, len(gains)))
    for i in range(1, r + 1):
        added = gains * (1.0 - poles ** lengths[i - 1]) / (1.0 - poles)
        for j in range(i, r + 1):
            numerator[r - i] += weights[j] * added @ poles ** (ends[j] - ends[i])
    return np.asarray(weights[::-1], dtype=np.float64), numerator


@dataclass(frozen=True)
class Structure:
    """Z zones, A actuators, M machines, modes of order r; everything else refers to their numbers.

    `lengths` (N,): number of control steps of each of the N steps of the plan. `pairs`: zone and actuator of every pair
    with an effect; `groups`: zone and actuators of those that share a response (`groups_of`). `machine_of` (A,).
    `limited`: machines with a capacity; `part_load`: of each shared machine that cycles below a load its number, the
    actuators that alone take less, and whether all together take more.

    Actuators that are `signed`, with levels below 0; `stepped`, which hold levels above their lowest and switch below
    it; in `exclusive` groups of which one acts at a time, and `chosen`, those in them: which act is decided in the
    first `n_chosen` steps. `peak`, `capped`, `exchange`, `curved`: a price of peak power, a power cap, a price of what
    is bought that differs from that of what is fed in, and whether the power in
    them, or in a term of the user, has a part in u². `hidden`: hidden units of the gain where it sees the predicted
    temperature; 0: it does not. `terms`, `step_s`: further terms of the user, and the length of a step for
    them, s.
    """

    Z: int
    A: int
    M: int
    r: int
    lengths: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    groups: tuple[tuple[int, tuple[int, ...]], ...]
    machine_of: tuple[int, ...]
    limited: tuple[int, ...] = ()
    part_load: tuple[tuple[int, tuple[int, ...], bool], ...] = ()
    signed: tuple[int, ...] = ()
    stepped: tuple[int, ...] = ()
    exclusive: tuple[tuple[int, ...], ...] = ()
    chosen: tuple[int, ...] = ()
    n_chosen: int = 0
    peak: bool = False
    capped: bool = False
    exchange: bool = False
    curved: bool = False
    hidden: int = 0
    terms: tuple[Callable[..., None], ...] = ()
    step_s: float = 0.0

    @property
    def N(self) -> int:
        """Number of steps."""
        return len(self.lengths)

    @cached_property
    def windows(self) -> tuple[tuple[int, ...], ...]:
        """Lengths of each step and the r − 1 before it, the latest last; those before the first are 1."""
        padded = (1,) * (self.r - 1) + self.lengths
        return tuple(padded[k : k + self.r] for k in range(self.N))

    @cached_property
    def kinds(self) -> tuple[tuple[int, ...], ...]:
        """The windows that differ."""
        return tuple(dict.fromkeys(self.windows))

    def fed_by(self, machine: int) -> list[int]:
        """Actuators that a machine feeds."""
        return [a for a in range(self.A) if self.machine_of[a] == machine]


def structure_of(
    operator: BuildingOperator, shape: ProblemShape, groups: tuple[tuple[int, tuple[int, ...]], ...]
) -> Structure:
    """The structure of the problems of an operator and a shape.

    Raises `ControllerConfigError` where the operator is not of these actuators, or its heat is for another lowest
    level.
    """
    machinery, (Z, A, r) = shape.machinery, operator.shape
    if operator.actuators != machinery.actuators:
        raise ControllerConfigError(
            f"actuators of the operator are {', '.join(operator.actuators)}, of the machinery "
            f"{', '.join(machinery.actuators)}: they must be the same in the same order"
        )
    h = shape.n_chosen_moves if shape.needs_choices else 0
    for a, name in enumerate(machinery.actuators):
        heat = operator.of_actuator(a).heat_input.heat
        lowest_level = min(machinery.lowest_level[a], machinery.u_max[a])
        if heat is not None and not np.isclose(min(heat.lowest_level, machinery.u_max[a]), lowest_level):
            raise ControllerConfigError(
                f"actuator {name}: its heat is known for a lowest level of {heat.lowest_level:g}, not {lowest_level:g}"
            )
    part_load = []
    for m in np.flatnonzero(machinery.shared):
        runs_for = np.where(machinery.machine_of == m, machinery.runs_for, 1.0)
        if (runs_for < 1.0).any():
            together = runs_for[machinery.machine_of == m].sum()
            part_load.append((int(m), _numbers(runs_for < 1.0), bool(together > 1.0)))
    feedback = operator.of_actuator(0).feedback_active
    return Structure(
        Z,
        A,
        len(machinery.machines),
        r,
        tuple(int(n) for n in shape.lengths),
        tuple((z, a) for z, a, _ in operator.each()),
        groups,
        tuple(int(m) for m in machinery.machine_of),
        limited=_numbers(machinery.fed_by @ machinery.share > 0.0),
        part_load=tuple(part_load),
        signed=_numbers(machinery.u_min < 0.0),
        stepped=_numbers(machinery.stepped),
        exclusive=machinery.exclusive,
        chosen=_numbers(machinery.excluded) if h else (),
        n_chosen=h,
        peak=shape.peak,
        capped=shape.capped,
        exchange=shape.exchange,
        curved=shape.curved and bool(shape.peak or shape.capped or shape.exchange or shape.terms),
        hidden=operator.of_actuator(0).hidden_bias.size if feedback else 0,
        terms=shape.terms,
        step_s=operator.step_s if shape.terms else 0.0,
    )


def _numbers(flags: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(flags))


# Levels up to this do not act: rounding of solvers.
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

    def response(self, q: Mapping[str, ca.SX], s: Structure, heat: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Responses of the zones (Z, N) to `heat` v (A, N) by difference equations, and slack (Z, N).

        The gain m is a parameter unless it sees the response.

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
        return forced, below + above

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
