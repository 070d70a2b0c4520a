"""The MPC problem as a sparse programme with constant structure: its variables, rows, and the numbers of an instance.

Where levels are relaxed or in blocks, power and heat are proportional to u and the modulation m(x) does not depend on
the decisions, so the problem is a quadratic programme. The r modes of a pair are eliminated: comfort depends on their
sum y = Σ F_i only, which obeys one difference equation of order r, the transfer function of the modes,

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k u_k,        q⁻¹ y_k = y_{k−1},

with d_k = m(x_k) v(1, T_out,k). Pairs of one zone with the same poles obey it together, with the sum of their right
sides: one variable and one equation per step for all actuators of a zone instead of r of each for every pair.

Levels below 0: u = v − n with n ≥ 0 of its own price. An optimum with both positive does not exist while neither heat
nor cold has a negative price, see `Formulation.problem`. Choices in the first moves: b = 1 if an actuator is on; a held
level has lowest · b ≤ v ≤ u_max · b, and power and heat, affine in the level, have their fixed parts times b.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import POWER_UNIT_W, MPCProblem, ProblemShape
from controllers.optimisation.qp_backends import QPData
from controllers.optimisation.qp_terms import Entries, Index, SparsePattern, entries, groups_of, joined, nothing
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator

# Of parts that a programme has not.
_NONE = np.zeros((0, 0))


@dataclass(frozen=True)
class Drive:
    """Drive of the modes by each actuator over each step, (A, N): `per_u` · u + `onset` while a held level is on."""

    per_u: Array
    onset: Array


class SparseQP:
    """The programme of one operator and shape.

    Variables: moves v (A, moves), responses y (groups of pairs, N), slack s (Z, N), cooling moves n (signed actuators,
    moves), peak power, power above the cap (N), running share of shared machines (machines, moves), choices b
    (actuators with choices, first moves), and of shared machines that cycle at part load the time θ above it (machines,
    moves) and the longer on-times of actuators with less load (actuators, moves). `choices` are the numbers of b.
    """

    def __init__(self, operator: BuildingOperator, shape: ProblemShape) -> None:
        shape.check(operator)
        self.operator, self.shape = operator, shape
        machinery = shape.machinery
        A, n, m = len(machinery.actuators), shape.n_steps, shape.n_moves
        Z = len(operator.zones)
        self._step, self._move = np.arange(n), shape.move_of_step
        power_couples = bool(shape.peak or shape.capped or machinery.shared.any())
        self._groups = groups_of(operator, n, power_couples=power_couples)
        G = len(self._groups)
        self._signed = machinery.signed
        self._shared = np.flatnonzero(machinery.shared)
        self._alone = ~machinery.shared[machinery.machine_of]
        # Only where levels are choices does a step hold one: without held moves there are none.
        self._h = shape.n_held_moves if shape.needs_choices(operator) else 0
        self._held = machinery.held if self._h else np.zeros(A, dtype=bool)
        self._choice_actuators = (
            np.flatnonzero(self._held | machinery.excluded) if self._h else np.zeros(0, dtype=np.intp)
        )
        for a, name in enumerate(machinery.actuators if self._h else ()):
            heat = operator.of_actuator(a).heat_input.heat
            lowest = min(machinery.lowest_level[a], machinery.u_max[a])
            if heat is not None and not np.isclose(min(heat.lowest_level, machinery.u_max[a]), lowest):
                raise ControllerConfigError(
                    f"actuator {name}: its heat is known for a lowest level of {heat.lowest_level:g}, not {lowest:g}"
                )

        sizes = [A * m, G * n, Z * n, self._signed.size * m, int(shape.peak), n if shape.capped else 0]
        sizes += [self._shared.size * m, self._choice_actuators.size * self._h]
        # Where together they exceed the load at which the machine cycles, but not each of them alone.
        runs_for, fed_by = machinery.runs_for, machinery.fed_by[self._shared]
        self._splits = self._shared[(fed_by @ runs_for > 1.0) & (fed_by @ (runs_for < 1.0) > 0.0)]
        self._partial = np.flatnonzero((runs_for < 1.0) & np.isin(machinery.machine_of, self._splits))
        sizes += [self._splits.size * m, self._partial.size * m]
        ends = np.cumsum(sizes)
        numbers = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        self.n_variables = int(ends[-1])
        self._v, self._y, self._s = numbers[0].reshape(A, m), numbers[1].reshape(G, n), numbers[2].reshape(Z, n)
        self._n, self._peak, self._over = numbers[3].reshape(self._signed.size, m), numbers[4], numbers[5]
        self._runs, self.choices = numbers[6].reshape(self._shared.size, m), numbers[7]
        self._b = self.choices.reshape(self._choice_actuators.size, self._h)
        self._theta = numbers[8].reshape(self._splits.size, m)
        self._excess = numbers[9].reshape(self._partial.size, m)

        # Share of a step that an actuator runs per unit of v, (A, moves); 0 where the choice b says it.
        lowest = np.broadcast_to(machinery.switched_at(n, shape.n_held if self._h else 0), (A, n))[:, shape.first_steps]
        per_v = np.maximum(1.0 / lowest, np.where(self._alone, machinery.share, 0.0)[:, None])
        self._held_moves = self._held[:, None] & (np.arange(m) < self._h)
        self._on_per_v = np.where(self._held_moves, 0.0, per_v)
        self._held_in = self._held_moves[:, self._move]
        self._on_per_u, self._any_held = self._on_per_v[:, self._move], bool(self._held_moves.any())
        self._firsts, self._full = shape.first_steps, np.repeat(machinery.u_max[:, None], n, axis=1)
        # Moves and slack are contiguous.
        self._v_at, self._s_at = slice(0, A * m), slice(int(self._s[0, 0]), int(self._s[-1, -1]) + 1)

        self._dynamics_entries = self._dynamics()
        self._A = SparsePattern(self._dynamics_entries.rows, self._dynamics_entries.columns, (G * n, self.n_variables))
        poles, gains = operator.poles, operator.gains
        self._faded = poles**n
        self._remaining = gains[..., None] * poles[..., None] ** (n - 1 - self._step)

        self._bounds_entries, self._low, self._high = self._bounds()
        self._G = SparsePattern(
            self._bounds_entries.rows, self._bounds_entries.columns, (self._low.size, self.n_variables)
        )
        # Without prices of power the inequalities are the same in every instance.
        self._G_constant = self._G.filled(self._bounds_entries.factor)
        x_low, x_high = np.zeros(self.n_variables), np.full(self.n_variables, np.inf)
        x_low[self._y] = -np.inf
        x_high[self._v] = np.minimum(
            machinery.u_max, 1.0 / np.maximum(np.where(self._alone, machinery.share, 0.0), 1e-9)
        )[:, None]
        x_high[self._n] = -machinery.u_min[self._signed, None]
        # What they need is at most 1; the bound only matters where running costs nothing, and must not be active.
        x_high[self._runs] = x_high[self._theta] = x_high[self._excess] = 2.0
        x_high[self.choices] = 1.0
        self._x_low, self._x_high = x_low, x_high
        self._counts = np.bincount(self._move, minlength=m).astype(np.float64)
        self._quadratic = sparse.csc_matrix(sparse.diags(np.ones(self.n_variables)))

    def _dynamics(self) -> Entries:
        """Difference equations of the responses, row by row; numbers of the instance: 1, drive per u, onset."""
        (A, _), n, step, move = self.shape.machinery.shape, self.shape.n_steps, self._step, self._move
        order = self.operator.shape[2]
        parts: list[Entries] = []
        for g, group in enumerate(self._groups):
            for lag in range(min(order, n - 1) + 1):
                now, then = g * n + step[lag:], step[: n - lag]
                parts.append(entries(now, self._y[g, then], group.denominator[lag], 0))
                if lag == order:
                    continue
                of, numerator = group.actuators, group.numerators[:, lag, None]
                of_drive = 1 + of[:, None] * n + then
                parts.append(entries(now, self._v[of][:, move[then]], -numerator, of_drive))
                for i, a in enumerate(self._signed):
                    if a in of:
                        at = np.flatnonzero(of == a)
                        parts.append(entries(now, self._n[i, move[then]], numerator[at], of_drive[at]))
                for i, a in enumerate(self._choice_actuators):
                    if a in of and self._held[a]:
                        at, early = np.flatnonzero(of == a), move[then] < self._h
                        of_choice = entries(
                            now[early],
                            self._b[i, move[then][early]],
                            -numerator[at],
                            A * n + of_drive[at][:, early],
                        )
                        parts.append(of_choice)
        return joined(parts) if parts else nothing()

    def _bounds(self) -> tuple[Entries, Array, Array]:
        """Inequalities: comfort first, then power, then constants. Numbers of the instance: 1, then power parts."""
        shape, machinery, n, m = self.shape, self.shape.machinery, self.shape.n_steps, self.shape.n_moves
        Z, step = self._s.shape[0], self._step
        parts: list[Entries] = []
        # y_k + s_k ≥ lower_k − T_free,k and y_k − s_k ≤ upper_k − T_free,k.
        of_zone = np.array([group.zone for group in self._groups], dtype=np.intp)
        for first, sign in ((0, 1.0), (Z * n, -1.0)):
            if of_zone.size:
                parts.append(entries(first + of_zone[:, None] * n + step, self._y, 1.0, 0))
            parts.append(entries(first + np.arange(Z * n), self._s.ravel(), sign, 0))
        rows = 2 * Z * n
        if shape.peak:
            parts += [entries(rows + step, self._peak, 1.0, 0), self._power(rows)]
            rows += n
        if shape.capped:
            parts += [entries(rows + step, self._over, 1.0, 0), self._power(rows)]
            rows += n
        low, high = [np.full(rows, -np.inf)], [np.full(rows, np.inf)]
        # Rows of the capacity of each machine that several share.
        self._limited: list[tuple[int, slice]] = []

        def row(columns: list[Index], factors: list[float], at_least: float, at_most: float) -> None:
            """A row for each of the columns side by side: Σ factor · column between the two."""
            nonlocal rows
            count = np.size(columns[0])
            parts.extend(entries(rows + np.arange(count), c, f, 0) for c, f in zip(columns, factors, strict=True))
            low.append(np.full(count, at_least))
            high.append(np.full(count, at_most))
            rows += count

        for i, number in enumerate(self._shared):
            fed = np.flatnonzero(machinery.machine_of == number)
            shares, moves = machinery.share[fed].tolist(), [self._v[a] for a in fed]
            if any(shares):
                self._limited.append((int(number), slice(rows, rows + m)))
                row(moves, shares, -np.inf, 1.0)
                row([self._runs[i], *moves], [1.0, *(-share for share in shares)], 0.0, np.inf)
            self._run_rows(i, fed, row)
        later = np.arange(self._h, m)
        for group in machinery.exclusive:
            if self._h:
                row([self._b[self._choice_actuators == a][0] for a in group], [1.0] * len(group), -np.inf, 1.0)
            columns = [self._v[a, later] for a in group] + [
                self._n[self._signed == a][0, later] for a in group if a in self._signed
            ]
            ends = [machinery.u_max[a] for a in group] + [-machinery.u_min[a] for a in group if a in self._signed]
            if later.size:
                row(columns, [1.0 / float(end) for end in ends], -np.inf, 1.0)
        early = np.arange(self._h)
        for b, a in zip(self._b, self._choice_actuators, strict=True):
            row([self._v[a, early], b], [1.0, -float(machinery.u_max[a])], -np.inf, 0.0)
            if self._held[a]:
                row([self._v[a, early], b], [1.0, -float(machinery.lowest_level[a])], 0.0, np.inf)
            if a in self._signed:
                row([self._n[self._signed == a][0, early], b], [1.0, float(machinery.u_min[a])], -np.inf, 0.0)
        return joined(parts), np.concatenate(low), np.concatenate(high)

    def _run_rows(self, i: int, fed: Index, row: Callable[[list[Index], list[float], float, float], None]) -> None:
        """Rows by which shared machine `i` runs for the on-times of the actuators it feeds, by `row`."""
        runs_for, any_held = self.shape.machinery.runs_for, self._held_moves.any(axis=0)
        for moves in (np.flatnonzero(any_held), np.flatnonzero(~any_held)):
            if not moves.size:
                continue
            runs, on = self._runs[i, moves], {a: self._on_column(a, moves) for a in fed}
            split = np.flatnonzero(self._splits == self._shared[i])
            if not split.size and float(runs_for[fed].sum()) <= 1.0:
                row(
                    [runs, *(x for x, _ in on.values())],
                    [1.0, *(-runs_for[a] * f for a, (_, f) in on.items())],
                    0.0,
                    np.inf,
                )
            elif not split.size:
                for x, factor in on.values():
                    row([runs, x], [1.0, -factor], 0.0, np.inf)
            else:
                theta, partial = self._theta[split[0], moves], [a for a in fed if runs_for[a] < 1.0]
                excess = {a: self._excess[np.flatnonzero(self._partial == a)[0], moves] for a in partial}
                for a, (x, factor) in on.items():
                    above = [excess[a]] if a in excess else []
                    row([theta, *above, x], [1.0, *(1.0 for _ in above), -factor], 0.0, np.inf)
                row([runs, theta, *excess.values()], [1.0, -1.0, *(-float(runs_for[a]) for a in partial)], 0.0, np.inf)

    def _on_column(self, a: int, moves: Index) -> tuple[Index, float]:
        """Column whose value times the factor is the share of `moves` that actuator `a` is on."""
        if self._held_moves[a, moves[0]]:
            return self._b[self._choice_actuators == a][0][moves], 1.0
        return self._v[a, moves], float(self._on_per_v[a, moves[0]])

    def _power(self, first_row: int) -> Entries:
        """Minus the building's power over each step, in rows from `first_row`; in the order of `_power_parts`."""
        n, step, move = self.shape.n_steps, self._step, self._move
        (A, _), S, H = self.shape.machinery.shape, self._signed.size, self._shared.size
        rows, parts = (
            first_row + step,
            [entries(first_row + step, self._v[:, move], -1.0, 1 + np.arange(A)[:, None] * n + step)],
        )
        at = 1 + A * n
        if S:
            parts.append(entries(rows, self._n[:, move], -1.0, at + np.arange(S)[:, None] * n + step))
        at += S * n
        if H:
            parts.append(entries(rows, self._runs[:, move], -1.0, at + np.arange(H)[:, None] * n + step))
        at += H * n
        if self._h:
            early = np.flatnonzero(move < self._h)
            of = at + self._choice_actuators[:, None] * n + early
            parts.append(entries(rows[early], self._b[:, move[early]], -1.0, of))
        return joined(parts)

    def _power_parts(self, p: MPCProblem) -> tuple[Array, Array, Array, Array]:
        """Power, W, per unit of v (A, N), n (signed, N), running share (shared, N) and choice (A, N)."""
        machinery = self.shape.machinery
        fixed = np.where(self._alone[:, None], p.power_fixed_W[machinery.machine_of], 0.0)
        per_v = p.power_per_u_W + fixed * self._on_per_u
        per_n = np.zeros((0, 1)) if p.cooling is None else p.cooling.power_per_u_W[self._signed]
        return per_v, per_n, p.power_fixed_W[self._shared], np.where(self._held_in, fixed, 0.0)

    def _power_numbers(self, p: MPCProblem) -> Array:
        """1, then the parts of the power in the order of `_power`, in `POWER_UNIT_W`."""
        return np.concatenate([np.ones(1), *(part.ravel() / POWER_UNIT_W for part in self._power_parts(p))])

    def power(self, p: MPCProblem) -> sparse.csc_matrix:
        """The building's power over each step as a linear map of the variables, `POWER_UNIT_W`, (N, variables)."""
        minus_power = self._power(0)
        values = -minus_power.factor * self._power_numbers(p)[minus_power.of]
        return sparse.csc_matrix(
            (values, (minus_power.rows, minus_power.columns)), shape=(self.shape.n_steps, self.n_variables)
        )

    def drive(self, p: MPCProblem) -> Drive:
        """Drive of the modes at the features of an instance."""
        machinery = self.shape.machinery
        highest = machinery.u_max[:, None]
        full = self.operator.drive(self._full, p.features)
        per_u = full / highest
        if not self._any_held:
            return Drive(per_u, _NONE)
        lowest = np.minimum(machinery.lowest_level, 0.5 * machinery.u_max)[:, None]
        lowest = np.where(self._held[:, None], machinery.lowest_level[:, None], lowest)
        at_lowest = self.operator.drive(np.broadcast_to(lowest, full.shape), p.features)
        slope = (full - at_lowest) / (highest - lowest)
        return Drive(np.where(self._held_in, slope, per_u), np.where(self._held_in, full - slope * highest, 0.0))

    def modes(self, p: MPCProblem, drive: Drive, u: Array) -> Array:
        """Forced states (Z, A, N, r) of levels `u` (A, N), K, by rollout of every pair."""
        driven = drive.per_u * u
        if self._any_held:
            driven = driven + drive.onset * p.on_share(u)
        return self.operator.driven(p.forced_state_K, driven)

    def as_solved(self, p: MPCProblem) -> MPCProblem:
        """The instance with the relaxation of this programme."""
        held_steps = self.shape.n_held if self._h else 0
        relaxed = self.shape.machinery.held.any() or self.shape.machinery.exclusive
        return replace(p, held_steps=held_steps) if relaxed else p

    def levels(self, x: Array) -> Array:
        """Levels u (A, N) of a solution."""
        moves = x[: self._v.size].reshape(self._v.shape).copy()
        if self._signed.size:
            moves[self._signed] -= x[self._n]
        for b, a in zip(self._b, self._choice_actuators, strict=True):
            # What a solver leaves of an actuator that is off, or lacks of its lowest level.
            is_on = x[b] > 0.5
            lowest = self.shape.machinery.lowest_level[a] if self._held[a] else -np.inf
            moves[a, : self._h] = np.where(is_on, np.maximum(moves[a, : self._h], lowest), 0.0)
        return moves[:, self._move]

    def rounded(self, x: Array) -> Array:
        """Choices (in the order of `choices`) near a solution `x` of the relaxation in which they need not be whole."""
        machinery, on = self.shape.machinery, np.zeros(self._b.shape)
        for b, a in enumerate(self._choice_actuators):
            level = x[self._v[a, : self._h]] / machinery.u_max[a]
            for i in np.flatnonzero(self._signed == a):
                level = np.maximum(level, x[self._n[i, : self._h]] / -machinery.u_min[a])
            lowest = machinery.lowest_level[a] / machinery.u_max[a] if self._held[a] else 0.5
            on[b] = np.where(level >= 0.5 * lowest, 1.0 + level, 0.0)
        for group in machinery.exclusive if self._h else ():
            rows = np.flatnonzero(np.isin(self._choice_actuators, group))
            on[rows] = np.where(on[rows] < on[rows].max(axis=0), 0.0, on[rows])
        return np.asarray(np.minimum(on, 1.0).ravel())

    def numbers(self, p: MPCProblem, drive: Drive) -> QPData:
        """The numbers of one instance."""
        machinery, n, firsts = self.shape.machinery, self.shape.n_steps, self._firsts
        values = np.concatenate([[1.0], drive.per_u.ravel(), drive.onset.ravel()])
        dynamics = self._dynamics_entries
        A = self._A.filled(dynamics.factor * values[dynamics.of])
        b = np.zeros(len(self._groups) * n)
        for g, group in enumerate(self._groups):
            # The first r equations contain the free decay of the initial modes.
            begin = group.begin @ p.forced_state_K[group.zone, group.pairs].sum(axis=0)
            b[g * n : g * n + begin.size] = begin

        fixed_cost = p.fixed_cost
        alone = self._alone[:, None] * fixed_cost[machinery.machine_of]
        cost_v = p.price_per_W[machinery.machine_of] * p.power_per_u_W + alone * self._on_per_u
        cost_b = np.where(self._held_in, alone, 0.0) if self._any_held else _NONE
        cost_n = p.cooling_cost_per_u[self._signed] if self._signed.size else _NONE
        terminal_price = p.terminal_price_per_K
        if terminal_price.any():
            # Terminal value of the heat added by the moves.
            worth = np.einsum("zar,zarn->an", terminal_price, self._remaining)
            cost_v = cost_v - worth * drive.per_u
            cost_b = cost_b - worth * drive.onset if self._any_held else cost_b
            cost_n = cost_n + (worth * drive.per_u)[self._signed] if self._signed.size else cost_n
        linear = np.zeros(self.n_variables)
        linear[self._v_at] = np.add.reduceat(cost_v, firsts, axis=1).ravel()
        linear[self._s_at] = np.repeat(p.comfort_price, n)
        if self._signed.size:
            linear[self._n] = np.add.reduceat(cost_n, firsts, axis=1)
        if self.shape.peak:
            linear[self._peak] = p.weights.peak * POWER_UNIT_W
        if self.shape.capped:
            linear[self._over] = p.cap_price_per_W * POWER_UNIT_W
        if self._shared.size:
            linear[self._runs] = np.add.reduceat(fixed_cost[self._shared], firsts, axis=1)
        if self._any_held:
            linear[self._b] = np.add.reduceat(cost_b, firsts, axis=1)[self._choice_actuators, : self._h]

        low, high = self._low, self._high
        comfort = p.T_free_C.size
        low[:comfort], high[comfort : 2 * comfort] = (p.lower_C - p.T_free_C).ravel(), (p.upper_C - p.T_free_C).ravel()
        row = 2 * comfort
        if self.shape.peak:
            low[row : row + n] = -p.peak_so_far_W / POWER_UNIT_W
            row += n
        if self.shape.capped and p.power_cap is not None:
            low[row : row + n] = -p.power_cap.limit_W / POWER_UNIT_W
        for number, of_capacity in self._limited:
            most = np.ones(n) if p.capacity is None else p.capacity[number]
            high[of_capacity] = np.minimum.reduceat(most, firsts)
        if self.shape.peak or self.shape.capped:
            G = self._G.filled(self._bounds_entries.factor * self._power_numbers(p)[self._bounds_entries.of])
        else:
            G = self._G_constant
        curvature = np.zeros(self.n_variables)
        of_moves = 2.0 * p.weights.curvature * self._counts
        curvature[self._v_at] = np.tile(of_moves, self._v.shape[0])
        if p.power_per_u2_W is not None:
            curvature[self._v_at] += 2.0 * np.add.reduceat(p.curve_cost, firsts, axis=1).ravel()
        if self._signed.size:
            curvature[self._n] = of_moves
        # Scale by the largest linear coefficient, so that tolerances do not depend on the currency.
        unit = float(np.abs(linear).max()) or 1.0
        self._quadratic.data[:] = curvature / unit
        constant = -float((terminal_price * self._faded * p.forced_state_K).sum())  # independent of the moves
        return QPData(self._quadratic, linear / unit, A, b, G, low, high, self._x_low, self._x_high, unit, constant)
