"""The optimisation problem of one control step in numbers: input and output of every solver.

For zones z, actuators a and machines m, over steps k,

    minimise    Σ_k [ Σ_m price_mk · P_mk · Δt  +  Σ_z w_z · s_zk · Δt  +  Σ_a ε u_ak²  +  c · o_k · Δt ]  +  π · p
                −  Σ_za λ_za' F_za,N
    subject to  F_za,k+1 = A_za F_za,k + g_za m(x_ak) v(u_ak)     forced response of each pair (paper eq:operator)
                lower_zk − s_zk ≤ T_free,zk + Σ_a F_za,k ≤ upper_zk + s_zk,   s_zk ≥ 0,   u_min,a ≤ u_ak ≤ u_max,a
                P_mk = fixed_mk · on_mk + Σ_{a of m} (per_u_ak u_ak + per_u2_ak u_ak²)
                on_mk = max( min_{θ ≥ 0} θ + Σ_{a of m} w_a max(on_ak − θ, 0),  Σ_{a of m} share_a u_ak )
                on_ak = min(u_ak / lowest_a, 1)
                Σ_{a of m} share_a u_ak ≤ 1                      capacity of a machine
                Σ_m P_mk ≤ p_0 + p,   p ≥ 0                      p: peak power above the highest so far, p_0
                Σ_m P_mk ≤ cap_k + o_k,   o_k ≥ 0                soft power cap
                u_ak = v_aj for all steps k of move j            move blocking
                where levels below 0 cool: price and power of their own for −u_ak
                held levels: u_ak = 0 or at least lowest_a; of actuators that exclude one another one acts in a step

The free response T_free enters as fixed vectors. The slack s makes every instance feasible. λ is the value of the heat
stored in the building at the end of the horizon. A machine's actuators are on within the longest on-time; w_a is the
share of the time it runs while only actuator a is on (`model.machine.running`), and it runs at least as long as its
capacity asks. With one actuator on_m is that actuator's share.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from controllers.optimisation.machines import EquipmentLayout
from thermoforce_mpc.data import HOUR_S, J_PER_KWH, Array
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.running import running_share
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.features import N_FEATURES

# Unit of power in solvers, W; scales its constraints like the others.
POWER_UNIT_W = 1000.0


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of the objective on comfort violation, curvature and peak power.

    `comfort` currency/(K·h), one for all zones or (Z,); `curvature` currency per step and u², makes the optimum unique;
    `peak` currency per W of peak power of the building (mean over a step) above the highest so far.
    """

    comfort: float | Array
    curvature: float
    peak: float = 0.0


@dataclass(frozen=True)
class ProblemShape:
    """Structure shared by all instances, from which a solver is built once.

    `move_of_step` (N,) numbers the move each step belongs to (0 … n_moves − 1, nondecreasing): steps of one move share
    their levels. `machinery`: actuators and machines. `peak`: peak power is in the objective; `capped`: a power cap is.
    `held_steps`: number of first steps in which a held level is 0 or at least its lowest and exclusion holds (rounded
    up to whole moves); later steps are relaxed: actuators switch, and exclude one another in time. None: all steps.
    """

    move_of_step: NDArray[np.intp]
    machinery: EquipmentLayout = field(default_factory=EquipmentLayout.one)
    peak: bool = False
    capped: bool = False
    held_steps: int | None = None

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.move_of_step.size)

    @property
    def n_moves(self) -> int:
        """Number of moves."""
        return int(self.move_of_step[-1]) + 1

    @property
    def first_steps(self) -> NDArray[np.intp]:
        """The first step of each move, shape (n_moves,)."""
        return np.searchsorted(self.move_of_step, np.arange(self.n_moves))

    @property
    def n_held_moves(self) -> int:
        """Number of first moves that hold one of the first `held_steps` steps."""
        held_steps = self.n_steps if self.held_steps is None else min(self.held_steps, self.n_steps)
        return int(self.move_of_step[held_steps - 1]) + 1 if held_steps > 0 else 0

    @property
    def n_held(self) -> int:
        """Number of steps in those moves."""
        return int(np.searchsorted(self.move_of_step, self.n_held_moves))

    def check(self, operator: BuildingOperator) -> None:
        """Raise `ControllerConfigError` where the operator is not of these actuators."""
        if operator.actuators != self.machinery.actuators:
            raise ControllerConfigError(
                f"actuators of the operator are {', '.join(operator.actuators)}, of the machinery "
                f"{', '.join(self.machinery.actuators)}: they must be the same in the same order"
            )

    def needs_choices(self, operator: BuildingOperator) -> bool:
        """Whether a step holds a choice between off and on, which is not convex."""
        has_choice = [
            bool(at_least) or (heat is not None and heat.lowest_level < highest)
            for at_least, heat, highest in zip(
                self.machinery.held,
                (operator.of_actuator(a).heat_input.heat for a in range(len(operator.actuators))),
                self.machinery.u_max,
                strict=True,
            )
        ]
        return self.n_held > 0 and (any(has_choice) or bool(self.machinery.exclusive))

    def convex(self, operator: BuildingOperator) -> bool:
        """Whether power and heat are linear in u and on, so that the problem is a convex quadratic programme."""
        # With feedback the gain of an action depends on the actions before it.
        return not operator.of_actuator(0).feedback_active and not self.needs_choices(operator)


def every_step(n_steps: int) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step` without move blocking."""
    return np.arange(n_steps)


def blocked_moves(n_steps: int, step_s: float, free_h: float, hold_h: float) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step`: every step of the first `free_h` hours is a move, later ones hold for `hold_h`."""
    free = min(n_steps, max(1, round(free_h * HOUR_S / step_s)))
    hold = max(1, round(hold_h * HOUR_S / step_s))
    later = free + np.arange(n_steps - free) // hold
    return np.concatenate([np.arange(free), later]).astype(np.intp)


@dataclass(frozen=True, eq=False)
class Cooling:
    """Cooling by levels below 0: price and power over −u of each actuator, `price_per_kWh`, `power_per_u_W` (A, N)."""

    price_per_kWh: Array
    power_per_u_W: Array


@dataclass(frozen=True, eq=False)
class PowerCap:
    """Soft cap of the building's power: `limit_W` (N,), and price of energy above it, currency/kWh."""

    limit_W: Array
    price_per_kWh: float


@dataclass(frozen=True, eq=False)
class MPCProblem:
    """Numbers of one instance over N steps: Z zones, A actuators, M machines, r modes per pair.

    `forced_state_K` (Z, A, r): initial F. `features` (Z, N, 4): raw features at the start of each step.
    (Z, N): `T_free_C`, `lower_C`, `upper_C` at the end of each step (margins already inside). Over each step:
    `price_per_kWh` and `power_fixed_W` (while running) of each machine (M, N), `power_per_u_W` of each actuator (A, N).
    `machinery`: levels, machines and capacities. `terminal_price_per_K` (Z, A, r): value of one kelvin of each mode at
    the end, currency/K; `peak_so_far_W`: highest mean power of the building over a step so far. `cooling`: what levels
    below 0 cost; None where there are none. `power_cap`: None without one. `held_steps` as in `ProblemShape`: after
    them an actuator runs for the share u / u_max of a step. `power_per_u2_W` (A, N): power over u², where it grows
    faster than heat; None where it does not, as with peak price, cap, choices and Ipopt, which take it as linear.
    `capacity` (M, N): what the actuators of a machine may take together, in the unit of their shares; None: 1.

    A shared machine's fixed part and power over u² earn nothing while the price is negative.

    Raises:
        DataError: an array has another shape; says which.
    """

    forced_state_K: Array
    features: Array
    T_free_C: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    power_fixed_W: Array
    power_per_u_W: Array
    step_s: float
    machinery: EquipmentLayout
    weights: Weights
    terminal_price_per_K: Array
    peak_so_far_W: float = 0.0
    cooling: Cooling | None = None
    power_cap: PowerCap | None = None
    held_steps: int | None = None
    power_per_u2_W: Array | None = None
    capacity: Array | None = None

    def __post_init__(self) -> None:
        Z, n = self.T_free_C.shape if np.ndim(self.T_free_C) == 2 else (-1, -1)
        (A, M), r = self.machinery.shape, np.shape(self.forced_state_K)[-1]
        expected: list[tuple[str, NDArray[Any] | float, tuple[int, ...]]] = [
            ("T_free_C", self.T_free_C, (Z, n)),
            ("lower_C", self.lower_C, (Z, n)),
            ("upper_C", self.upper_C, (Z, n)),
            ("features", self.features, (Z, n, N_FEATURES)),
            ("forced_state_K", self.forced_state_K, (Z, A, r)),
            ("terminal_price_per_K", self.terminal_price_per_K, (Z, A, r)),
            ("price_per_kWh", self.price_per_kWh, (M, n)),
            ("power_fixed_W", self.power_fixed_W, (M, n)),
            ("power_per_u_W", self.power_per_u_W, (A, n)),
        ]
        if self.cooling is not None:
            expected += [
                ("cooling.price_per_kWh", self.cooling.price_per_kWh, (A, n)),
                ("cooling.power_per_u_W", self.cooling.power_per_u_W, (A, n)),
            ]
        if self.power_cap is not None:
            expected.append(("power_cap.limit_W", self.power_cap.limit_W, (n,)))
        if self.power_per_u2_W is not None:
            expected.append(("power_per_u2_W", self.power_per_u2_W, (A, n)))
            if self.weights.peak or self.power_cap is not None:
                raise DataError("MPC problem: with a peak price or a power cap, power is linear in u")
        if self.capacity is not None:
            expected.append(("capacity", self.capacity, (M, n)))
        if np.ndim(self.weights.comfort):
            expected.append(("weights.comfort", self.weights.comfort, (Z,)))
        for name, value, shape in expected:
            if np.shape(value) != shape:
                raise DataError(
                    f"MPC problem of {Z} zones, {A} actuators and {M} machines over {n} steps: {name} has shape "
                    f"{np.shape(value)}, expected {shape}"
                )
        if self.cooling is None and self.machinery.signed.size:
            raise DataError("MPC problem: levels below 0 need price and power of cooling")

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.T_free_C.shape[-1])

    @cached_property
    def price_per_W(self) -> Array:
        """Cost of one watt of each machine held over each step, currency/W, shape (M, N)."""
        return np.asarray(self.price_per_kWh * self.step_s / J_PER_KWH, dtype=np.float64)

    @cached_property
    def fixed_cost(self) -> Array:
        """Cost of each machine's fixed part over each step while it runs, currency, shape (M, N)."""
        cost = self.price_per_W * self.power_fixed_W
        shared = self.machinery.shared
        return np.where(shared[:, None], np.maximum(cost, 0.0), cost) if shared.any() else np.asarray(cost)

    @cached_property
    def curve_cost(self) -> Array:
        """Energy cost over each step per unit of u², currency, shape (A, N), or (1, 1) where power has no such part."""
        if self.power_per_u2_W is None:
            return np.zeros((1, 1))
        return np.asarray(np.maximum(self.price_per_W, 0.0)[self.machinery.machine_of] * self.power_per_u2_W)

    @property
    def cooling_cost_per_u(self) -> Array:
        """Energy cost of cooling over each step per unit of −u, currency, shape (A, N); 0 without cooling."""
        if self.cooling is None:
            return np.zeros(self.power_per_u_W.shape)
        return np.asarray(self.cooling.price_per_kWh * self.cooling.power_per_u_W * self.step_s / J_PER_KWH)

    @cached_property
    def comfort_price(self) -> Array:
        """Cost of one kelvin of violation at the end of one step, currency/K, shape (Z,)."""
        return np.ones(self.T_free_C.shape[0]) * self.weights.comfort * (self.step_s / HOUR_S)

    @property
    def cap_price_per_W(self) -> float:
        """Cost of one watt above the power cap over one step, currency/W; 0 without one."""
        return 0.0 if self.power_cap is None else self.power_cap.price_per_kWh * self.step_s / J_PER_KWH

    @cached_property
    def _runs_at(self) -> Array:
        return self.machinery.switched_at(self.n_steps, self.held_steps)

    def _heating(self, u: Array) -> Array:
        return np.maximum(u, 0.0) if self.machinery.signed.size else u

    def on_share(self, u: Array) -> Array:
        """Share of each step that each actuator is on with a level above 0: `u` (..., A, N) → (..., A, N)."""
        return np.asarray(np.minimum(self._heating(u) / self._runs_at, 1.0))

    def running(self, u: Array) -> Array:
        """Share of each step that each machine runs for levels `u` (..., A, N), shape (..., M, N)."""
        m = self.machinery
        on, loads = self.on_share(u), m.share[:, None] * self._heating(u) if m.share.any() else None
        if len(m.machines) == 1 and len(m.actuators) == 1:
            return on if loads is None else np.maximum(on, loads)
        running = []
        for number in range(len(m.machines)):
            fed = m.machine_of == number
            needed = running_share(on[..., fed, :], m.runs_for[fed]) if fed.sum() > 1 else on[..., fed, :][..., 0, :]
            running.append(needed if loads is None else np.maximum(needed, loads[..., fed, :].sum(axis=-2)))
        return np.stack(running, axis=-2)

    def power_W(self, u: Array) -> Array:
        """Mean electric power of each machine over each step for levels `u` (..., A, N), W, shape (..., M, N)."""
        heating = self._heating(u)
        per_u = self.power_per_u_W * heating
        if self.cooling is not None:
            per_u = per_u + self.cooling.power_per_u_W * np.maximum(-u, 0.0)
        if self.power_per_u2_W is not None:
            per_u = per_u + self.power_per_u2_W * heating**2
        return np.asarray(self.power_fixed_W * self.running(u) + self.machinery.fed_by @ per_u)

    def energy_cost(self, u: Array) -> Array:
        """Cost of energy of the building over each step for levels `u` (..., A, N), currency, shape (..., N)."""
        heating = self._heating(u)
        per_u = self.price_per_W[self.machinery.machine_of] * self.power_per_u_W * heating
        if self.cooling is not None:
            per_u = per_u + self.cooling_cost_per_u * np.maximum(-u, 0.0)
        if self.power_per_u2_W is not None:
            per_u = per_u + self.curve_cost * heating**2
        return np.asarray((self.fixed_cost * self.running(u)).sum(axis=-2) + per_u.sum(axis=-2))

    def forced_K(self, operator: BuildingOperator, u: Array) -> Array:
        """Forced response of each zone at the end of each step for levels `u` (..., A, N), K, shape (..., Z, N)."""
        return np.asarray(self.modes_K(operator, u).sum(axis=(-3, -1)), dtype=np.float64)

    def modes_K(self, operator: BuildingOperator, u: Array) -> Array:
        """Forced state of every pair at the end of each step for levels `u` (..., A, N), K, shape (..., Z, A, N, r)."""
        return operator.rollout(self.forced_state_K, u, self.features)

    def slack_K(self, T_zone_C: Array) -> Array:
        """Violation of the comfort bounds at the end of each step, K, shape as `T_zone_C` (..., Z, N)."""
        below, above = self.lower_C - T_zone_C, T_zone_C - self.upper_C
        return np.maximum(np.maximum(below, above), 0.0)

    def cost(self, operator: BuildingOperator, u: Array) -> Array:
        """Objective for levels `u` (..., A, N), currency, shape (...,)."""
        return self.cost_under(u, self.modes_K(operator, u))

    def cost_under(self, u: Array, modes: Array) -> Array:
        """Objective for levels `u` (..., A, N) with forced states `modes` (..., Z, A, N, r), K; currency, (...,)."""
        slack = self.slack_K(compose(self.T_free_C, modes.sum(axis=(-3, -1))))
        cost = self.energy_cost(u).sum(axis=-1) + slack.sum(axis=-1) @ self.comfort_price
        cost = cost + self.weights.curvature * (u**2).sum(axis=(-2, -1))
        if self.weights.peak or self.power_cap is not None:
            power = self.power_W(u).sum(axis=-2)
            cost = cost + self.weights.peak * np.maximum(power.max(axis=-1) - self.peak_so_far_W, 0.0)
            if self.power_cap is not None:
                over = np.maximum(power - self.power_cap.limit_W, 0.0)
                cost = cost + self.cap_price_per_W * over.sum(axis=-1)
        terminal_value = (modes[..., -1, :] * self.terminal_price_per_K).sum(axis=(-3, -2, -1))
        return np.asarray(cost - terminal_value, dtype=np.float64)

    def finite(self) -> bool:
        """Whether every number of the instance is finite."""
        arrays = [
            self.forced_state_K, self.features, self.T_free_C, self.lower_C, self.upper_C, self.price_per_kWh,
            self.power_fixed_W, self.power_per_u_W, self.terminal_price_per_K, np.asarray(self.weights.comfort),
            np.array([self.peak_so_far_W, self.cap_price_per_W]),
        ]  # fmt: skip
        if self.cooling is not None:
            arrays += [self.cooling.price_per_kWh, self.cooling.power_per_u_W]
        if self.power_cap is not None:
            arrays.append(self.power_cap.limit_W)
        if self.power_per_u2_W is not None:
            arrays.append(self.power_per_u2_W)
        if self.capacity is not None:
            arrays.append(self.capacity)
        return bool(np.isfinite(np.concatenate([array.ravel() for array in arrays])).all())

    def unfit(self, u: Array) -> str:
        """Why `u` are no levels (A, N) to act on: another shape, not finite, or out of bounds; or ''."""
        m = self.machinery
        if np.shape(u) != (len(m.actuators), self.n_steps):
            return f"the solver gave levels of shape {np.shape(u)}, expected {(len(m.actuators), self.n_steps)}"
        if not np.isfinite(u).all():
            return "the solver gave levels that are not finite"
        low, high = u.min(axis=-1), u.max(axis=-1)
        for a in np.flatnonzero((low < m.u_min - _BOUND_TOLERANCE) | (high > m.u_max + _BOUND_TOLERANCE)):
            return f"u of {m.actuators[a]} leaves its bounds (from {low[a]:.4g} to {high[a]:.4g})"
        return ""

    def outside(self, u: Array) -> str:
        """What of levels `u` (A, N) leaves bounds, capacity or exclusion by more than a solver's tolerance, or ''."""
        m, unfit = self.machinery, self.unfit(u)
        if unfit:
            return unfit
        if m.share.any():
            demand = m.fed_by @ (m.share[:, None] * self._heating(u))
            load = (demand if self.capacity is None else demand / self.capacity).max(axis=-1)
            for number in np.flatnonzero(load > 1.0 + _BOUND_TOLERANCE):
                return f"u asks {load[number]:.4g} times the capacity of {m.machines[number]}"
        held_steps = self.n_steps if self.held_steps is None else self.held_steps
        for group in m.exclusive:
            acts = (np.abs(u[list(group), :held_steps]) > _BOUND_TOLERANCE).sum(axis=0)
            names = ", ".join(m.actuators[a] for a in group)
            if (acts > 1).any():
                return f"{names} act together in step {int(np.argmax(acts > 1))}, but exclude one another"
            later = u[list(group), held_steps:]
            ends = np.where(later < 0.0, m.u_min[list(group), None], m.u_max[list(group), None])
            if later.size and (later / ends).sum(axis=0).max() > 1.0 + _BOUND_TOLERANCE:
                return f"{names} act for longer than a step together, but exclude one another"
        return ""


def convex_relaxation(problem: MPCProblem) -> MPCProblem:
    """The problem with the power replaced by its convex envelope in u: every actuator switches at `u_max`."""
    return replace(problem, held_steps=0)


# Largest violation of u_min ≤ u ≤ u_max accepted as a solver's bound relaxation.
_BOUND_TOLERANCE = 1e-6
