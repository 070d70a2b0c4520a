"""The numbers of the statement's parameters: those of an operator, and those of an instance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from controllers.optimisation.problem import MPCProblem, ProblemShape
from controllers.optimisation.statement import parameter_sizes
from controllers.optimisation.structure import Structure
from controllers.optimisation.transfer import Group
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.casadi_export import ExportedGain, before_gain, gain_weights
from thermoforce_mpc.model.operator.features import OUTDOOR


class Numbers:
    """Packs instances of one operator and shape into the vector of the parameters of a structure."""

    def __init__(self, operator: BuildingOperator, shape: ProblemShape, groups: list[Group], s: Structure) -> None:
        self._operator, self._shape, self._groups, self._s = operator, shape, groups, s
        machinery = shape.machinery
        self._gains = [ExportedGain(operator.of_actuator(a), s.N) for a in range(s.A)]
        self._z, self._a = (np.array(numbers, dtype=np.intp) for numbers in zip(*s.pairs, strict=True))
        poles, gains_ = operator.poles, operator.gains
        self._remaining = gains_[..., None] * poles[..., None] ** (s.N - 1 - np.arange(s.N))
        self._faded = poles**s.N
        alone = ~machinery.shared[machinery.machine_of]
        self._share_alone = np.where(alone, machinery.share, 0.0)[:, None]
        self._constant = {
            "denominator": np.array([group.denominator for group in groups]),
            "numerator": np.concatenate([group.numerators for group in groups]).T,
            "poles": poles[self._z, self._a],
            "gains": gains_[self._z, self._a],
            "share": machinery.share,
            "runs_for": machinery.runs_for,
            "u_max": machinery.u_max,
            "u_min": machinery.u_min,
            "lowest": machinery.lowest_level,
            **(gain_weights(operator.of_actuator(0)) if s.hidden else {}),
        }
        self._places, at = {}, 0
        for name, (rows, columns) in parameter_sizes(s).items():
            self._places[name] = (at, rows, columns)
            at += rows * columns
        self._vector = np.zeros(at)
        self._write(self._vector, self._constant)

    def _write(self, vector: Array, values: Mapping[str, Array | float]) -> None:
        for name, value in values.items():
            at, rows, columns = self._places[name]
            vector[at : at + rows * columns].reshape(columns, rows)[:] = np.reshape(value, (rows, columns)).T

    def part(self, vector: Array, name: str) -> Array:
        """One of the parameters in the vector of all, in the order of its columns."""
        at, rows, columns = self._places[name]
        return vector[at : at + rows * columns]

    def of(self, p: MPCProblem, held_steps: int | None) -> Array:
        """The parameters of an instance whose levels are held in the first `held_steps` steps (None: in all).

        Raises:
            DataError: the instance has a part in u² in its peak power or cap, but not its shape.
        """
        s, machinery, machine_of = self._s, self._shape.machinery, self._shape.machinery.machine_of
        if p.power_per_u2_W is not None and (s.peak or s.capped or s.terms) and not s.curved:
            raise DataError("MPC problem: power has a part in u², which its shape (`curved`) does not say")
        if p.n_steps != s.N:
            raise DataError(f"MPC problem: {p.n_steps} steps, but the shape has {s.N}")
        drive, onset = self._drive(p, held_steps)
        worth = np.einsum("zar,zarn->an", p.terminal_price_per_K, self._remaining)
        price_of = p.price_per_W[machine_of]
        bend_W = np.zeros((s.A, s.N)) if p.power_per_u2_W is None else p.power_per_u2_W
        switched_at = machinery.switched_at(s.N, held_steps)
        values = {
            "begin": np.array([g.begin @ p.forced_state_K[g.zone, g.pairs].sum(axis=0) for g in self._groups]),
            "forced": p.forced_state_K[self._z, self._a],
            "drive": drive,
            "onset": onset,
            "on_per_v": np.broadcast_to(np.maximum(1.0 / switched_at, self._share_alone), (s.A, s.N)),
            "worth": worth,
            "kept": float((p.terminal_price_per_K * self._faded * p.forced_state_K).sum()),
            "per_u": p.power_per_u_W,
            "heat_cost": price_of * p.power_per_u_W,
            "bend": bend_W,
            "bend_cost": np.maximum(price_of, 0.0) * bend_W,
            "T_free": p.T_free_C,
            "lower": p.lower_C,
            "upper": p.upper_C,
            "fixed": p.power_fixed_W,
            "fixed_cost": p.fixed_cost,
            "capacity": self._capacity(p),
            "comfort": p.comfort_price,
            "weights": np.array([p.weights.curvature, p.weights.peak, p.cap_price_per_W]),
            "reached": p.peak_so_far_W,
        }
        if p.cooling is not None:
            values |= {"cold_power": p.cooling.power_per_u_W, "cold_cost": p.cooling_cost_per_u}
        if p.power_cap is not None:
            values["limit"] = p.power_cap.limit_W
        if p.last_u is not None:
            values["last_u"] = p.last_u
        if s.hidden:
            values["before"] = before_gain(self._operator.of_actuator(0), p.features[0])
        vector = self._vector.copy()
        self._write(vector, values)
        return vector

    def _drive(self, p: MPCProblem, held_steps: int | None) -> tuple[Array, Array]:
        """Drive of the modes per level, and while a held level is on, (A, N) each; with the gain where it is known."""
        s, machinery = self._s, self._shape.machinery
        drive, onset = np.zeros((s.A, s.N)), np.zeros((s.A, s.N))
        n_held = s.N if held_steps is None else held_steps
        for a, home in enumerate(self._operator.home):
            pair, features = self._operator.of_actuator(a), p.features[home]
            m, T_out_C = (1.0 if s.hidden else self._gains[a](features)), features[:, OUTDOOR]
            highest = float(machinery.u_max[a])
            full = pair.heat_input(np.full(s.N, highest), T_out_C)
            drive[a] = m * full / highest
            if machinery.held[a] and n_held:
                lowest = float(machinery.lowest_level[a])
                slope = (full - pair.heat_input(np.full(s.N, lowest), T_out_C)) / (highest - lowest)
                first = slice(0, n_held)
                drive[a, first], onset[a, first] = (m * slope)[first], (m * (full - slope * highest))[first]
        return drive, onset

    def _capacity(self, p: MPCProblem) -> Array:
        """Capacity of each machine over each step (M, N); over a move the least of its steps."""
        if p.capacity is None:
            return np.ones((self._s.M, self._s.N))
        return np.minimum.reduceat(p.capacity, self._s.first_steps, axis=1)[:, list(self._s.move_of_step)]
