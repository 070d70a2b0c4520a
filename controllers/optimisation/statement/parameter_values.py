"""The numbers of the statement's parameters: those of an operator, and those of an instance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.statement.algebra import PoleGroup, Structure, difference_equation
from controllers.optimisation.statement.problem_statement import gain_sizes, parameter_sizes
from thermoforce_mpc.data import Array, cost_per_W
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import ExportedGain, network_of
from thermoforce_mpc.model.operator.parameters import OUTDOOR

# Half of the least width of a comfort band: solvers keep away from bounds that meet.
_HALF_BAND_K = 1e-3


class Numbers:
    """Packs instances of one operator and shape into the vector of the parameters of a structure.

    `hidden`: units of its gains, 0 where these do not depend on features. Parameters that are theirs come last, `n_own`
    of the structure's own before them; a structure whose gain sees the plan has them itself.
    """

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, groups: list[PoleGroup], s: Structure) -> None:
        self._operator, self._shape, self._groups, self._s = operator, shape, groups, s
        machinery = shape.machinery
        heads = operator.of_actuators
        seen = any(head.constant_modulation is None for head in heads)
        self.hidden = max(head.hidden_bias.size for head in heads) if seen else 0
        self._gains = [ExportedGain(head, s.N) for head in heads]
        self._z, self._a = (np.array(numbers, dtype=np.intp) for numbers in zip(*s.pairs, strict=True))
        poles, gains_ = operator.poles, operator.gains
        self._firsts, self._lengths = shape.first_steps, np.array(s.lengths)
        self._by_steps = self._firsts.size == shape.n_steps
        alone = ~machinery.shared[machinery.machine_of]
        self._lasts = self._firsts + self._lengths - 1
        each = [[difference_equation(g.poles, g.gains, kind) for g in groups] for kind in s.kinds]
        sizes = np.array(sorted(set(s.lengths)))[:, None, None]
        pole, gain = poles[self._z, self._a], gains_[self._z, self._a]
        self._denominators = np.array([[left for left, _ in of_kind] for of_kind in each])
        self._constant = {
            "denominator": np.concatenate(list(self._denominators[:, :, 1:]), axis=1),
            "numerator": np.concatenate([np.concatenate([right for _, right in k], axis=1) for k in each]),
            "poles": np.concatenate(list(pole**sizes), axis=1),
            "gains": np.concatenate(list(gain * (1.0 - pole**sizes) / (1.0 - pole)), axis=1),
            "share": machinery.share,
            "runs_for": machinery.runs_for,
            "u_max": machinery.u_max,
            "u_min": machinery.u_min,
            "lowest_level": machinery.lowest_level,
            "on_per_v": np.maximum(1.0 / machinery.lowest_level, np.where(alone, machinery.share, 0.0)),
        }
        places, self._places, at = parameter_sizes(s), {}, 0
        self.n_own = sum(rows * columns for rows, columns in places.values())
        if self.hidden:
            places |= gain_sizes(s, self.hidden)
            self._constant["network"] = np.stack([network_of(head, self.hidden) for head in heads], axis=-1)
        for name, (rows, columns) in places.items():
            self._places[name] = (at, rows, columns)
            at += rows * columns
        self._last: tuple[MPCProblem, Array] | None = None
        self._vector = np.zeros(at)
        self._write(self._vector, self._constant)

    def _write(self, vector: Array, values: Mapping[str, Array | float]) -> None:
        for name, value in values.items():
            at, rows, columns = self._places[name]
            vector[at : at + rows * columns].reshape(columns, rows)[:] = np.asarray(value).reshape(rows, columns).T

    def part(self, vector: Array, name: str) -> Array:
        """One of the parameters in the vector of all, in the order of its columns."""
        at, rows, columns = self._places[name]
        return vector[at : at + rows * columns]

    def beside(self, vector: Array, power_W: Array) -> Array:
        """The vector with `power_W` (control steps,) on the meter beside what levels take."""
        out, beside_W = vector.copy(), self._mean(power_W[None])[0]
        for name in ("reached", "surplus", "limit"):
            self.part(out, name)[:] -= beside_W
        return out

    def of(self, p: MPCProblem) -> Array:
        """The parameters of an instance; those of the last one are kept, since it is asked several times in a step.

        Raises `DataError` where it does not fit the shape: in its steps, or by a part in u² in peak, cap or exchange.
        """
        last = self._last
        if last is None or last[0] is not p:
            self._last = last = p, self._packed(p)
        return last[1]

    def _packed(self, p: MPCProblem) -> Array:
        s, machine_of = self._s, self._shape.machinery.machine_of
        if p.power_per_u2_W is not None and (s.peak or s.capped or s.exchange or s.terms) and not s.curved:
            raise DataError("MPC problem: power has a part in u², which its shape (`curved`) does not say")
        if p.n_steps != self._shape.n_steps:
            raise DataError(f"MPC problem: {p.n_steps} steps, but the shape has {self._shape.n_steps}")
        drive, sag = self._drive(p)
        price_of = p.price_per_W[machine_of]
        bend_W = np.zeros(drive.shape) if p.power_per_u2_W is None else p.power_per_u2_W
        per_u_W, fixed_W, fixed_cost = self._switching(p, bend_W)
        # Where energy earns, over a step of the plan, nothing sags: it would pay to give less heat for more power.
        heat_cost = self._sum(price_of * per_u_W)
        low_K, high_K = self._inside(p)
        values: dict[str, Array | float] = {
            "begin": self._begin(p.forced_state_K),
            "forced": p.forced_state_K[self._z, self._a],
            "drive": self._mean(drive),
            "sag": np.where(heat_cost < 0.0, 0.0, self._mean(sag)),
            "per_u": self._mean(per_u_W),
            "heat_cost": heat_cost,
            "bend": self._mean(bend_W),
            "bend_cost": self._sum(np.maximum(price_of, 0.0) * bend_W),
            "T_free": p.T_free_C[:, self._lasts],
            "lower": p.T_free_C[:, self._lasts] + low_K,
            "upper": p.T_free_C[:, self._lasts] + high_K,
            "fixed": self._mean(fixed_W),
            "fixed_cost": self._sum(fixed_cost),
            "comfort": p.comfort_price,
            "weights": np.array([p.weights.curvature, p.weights.peak, p.cap_price_per_W]),
            "reached": np.full((1, s.N), p.peak_so_far_W),
        }
        capacity = np.ones(p.power_fixed_W.shape) if p.capacity is None else p.capacity
        values["capacity"] = self._least(capacity)
        values["least"], values["most"] = self._reach(p)
        if p.cooling is not None:
            values["cold_power"] = self._mean(p.cooling.power_per_u_W)
            values["cold_cost"] = self._sum(p.cooling_cost_per_u)
        if p.exchange is not None:
            others_W = self._mean(p.exchange.others_W[None])
            values["reached"] = p.peak_so_far_W - others_W
            values["surplus"] = np.maximum(-others_W, 0.0)
            values["dearer"] = self._sum(cost_per_W(p.exchange.dearer_per_kWh[None], p.step_s))
        if p.power_cap is not None:
            values["limit"] = self._mean(p.power_cap.limit_W[None])
        if p.last_u is not None:
            values["last_u"] = p.last_u
        x = [self._mean(p.features[home].T) for home in self._operator.home]
        if self.hidden:
            values["features"] = np.concatenate(x)
        if not s.hidden:
            values["gain"] = np.stack(
                [np.broadcast_to(gain(of.T), s.N) for gain, of in zip(self._gains, x, strict=True)]
            )
        vector = self._vector.copy()
        self._write(vector, values)
        vector.setflags(write=False)
        return vector

    def _reach(self, p: MPCProblem) -> tuple[Array, Array]:
        """Least and largest level above 0 of each step of the plan, (A, N): the tightest of its control steps."""
        low, high = p.level_bounds
        most = self._least(high)
        return np.minimum(self._most(np.maximum(low, 0.0)), most), most

    def _sum(self, values: Array) -> Array:
        """Sums over the control steps of each step of the plan: (rows, control steps) → (rows, N)."""
        return values if self._by_steps else np.add.reduceat(values, self._firsts, axis=1)

    def _mean(self, values: Array) -> Array:
        return values if self._by_steps else self._sum(values) / self._lengths

    def _least(self, values: Array) -> Array:
        return values if self._by_steps else np.minimum.reduceat(values, self._firsts, axis=1)

    def _most(self, values: Array) -> Array:
        return values if self._by_steps else np.maximum.reduceat(values, self._firsts, axis=1)

    def _inside(self, p: MPCProblem) -> tuple[Array, Array]:
        """Least and largest forced response at the end of each step of the plan within comfort, K, (Z, N).

        They are the tightest of its control steps; where these cross or meet, about the middle.
        """
        low_K, high_K = self._most(p.lower_C - p.T_free_C), self._least(p.upper_C - p.T_free_C)
        middle_K = 0.5 * (low_K + high_K)
        return np.minimum(low_K, middle_K - _HALF_BAND_K), np.maximum(high_K, middle_K + _HALF_BAND_K)

    def _begin(self, forced_K: Array) -> Array:
        """Right sides of the first equations by what the modes (Z, A, r) are now: (groups, r)."""
        s, rows = self._s, np.zeros((len(self._groups), self._s.r))
        ends = np.cumsum(self._lengths[: s.r])
        kind_of = [s.kinds.index(window) for window in s.windows[: s.r]]
        for g, group in enumerate(self._groups):
            free = group.poles ** ends[:, None] @ forced_K[group.zone, group.pairs].sum(axis=0)
            for k, kind in enumerate(kind_of):
                rows[g, k] = self._denominators[kind, g, : k + 1] @ free[k::-1]
        return rows

    def _switching(self, p: MPCProblem, bend_W: Array) -> tuple[Array, Array, Array]:
        """Power per level (A, control steps) and of the fixed parts (M, control steps), W, and the cost of these.

        At its lowest level l a stepped actuator draws fixed + per_u l + bend l², and below it its share of that. The
        envelope is convex as long as fixed ≤ bend l², else l is below the level of least power per heat: what is more
        then counts in proportion to the level.
        """
        machinery = self._shape.machinery
        per_u_W, fixed_W, fixed_cost = p.power_per_u_W, p.power_fixed_W, p.fixed_cost
        if not machinery.stepped.any():
            return per_u_W, fixed_W, fixed_cost
        per_u_W, fixed_W, fixed_cost = per_u_W.copy(), fixed_W.copy(), fixed_cost.copy()
        for a in np.flatnonzero(machinery.stepped):
            m, lowest_level = machinery.machine_of[a], machinery.lowest_level[a]
            kept_W = np.minimum(fixed_W[m], bend_W[a] * lowest_level**2)
            per_u_W[a] += bend_W[a] * lowest_level + (fixed_W[m] - kept_W) / lowest_level
            fixed_W[m], fixed_cost[m] = kept_W, p.price_per_W[m] * kept_W
        return per_u_W, fixed_W, fixed_cost

    def _drive(self, p: MPCProblem) -> tuple[Array, Array]:
        """Heat v per level, and what of it each level above the lowest lacks, (A, control steps)."""
        A, machinery, n = self._s.A, self._shape.machinery, p.n_steps
        drive, sag = np.zeros((A, n)), np.zeros((A, n))
        for a, home in enumerate(self._operator.home):
            pair, features = self._operator.of_actuator(a), p.features[home]
            T_out_C = features[:, OUTDOOR]
            highest, lowest_level = float(machinery.u_max[a]), float(machinery.lowest_level[a])
            full = pair.heat_input(np.full(n, highest), T_out_C)
            drive[a] = full / highest
            if machinery.stepped[a]:
                at_lowest = pair.heat_input(np.full(n, lowest_level), T_out_C)
                slope = (full - at_lowest) / (highest - lowest_level)
                drive[a] = at_lowest / lowest_level
                sag[a] = np.maximum(drive[a] - slope, 0.0)
        comes = 1.0 if p.available is None else p.available
        return drive * comes, sag * comes
