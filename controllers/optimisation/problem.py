"""The numbers of one instance of the problem (`statement.problem_statement`), and what its instances share.

Actuators of a building and the machines that feed them, as a plan sees them: what all its instances share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from thermoforce_mpc.data import HOUR_S, Array, cost_per_W, steps_in
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.parameters import N_FEATURES, ZONE


@dataclass(frozen=True, eq=False)
class EquipmentLayout:
    """A actuators and M machines. Names, machines and groups are those of a `Layout`, which checks them.

    Of each actuator (A,): `u_max`, highest level; `u_min`, lowest, below 0 where one signed level heats and cools;
    `lowest_level`, below which it switches, on at that level (`u_max` or more: always, or power and heat are
    proportional to the level); `machine_of`; `share` of its machine's capacity that it takes at level 1 (0: not
    limited): the sum over the actuators of a machine of share · u is at most 1 (`MPCProblem.capacity`: another limit by
    step).

    `cycles_below` (M,): load below which a machine that feeds several cycles, as a share of its capacity; 0: it runs in
    full as long as the longest of them acts (`model.machine.load`). `exclusive`: groups of actuators (their numbers)
    of which at most one may act in a step.

    Raises:
        ControllerConfigError: levels do not fit together; names the actuator.
    """

    actuators: tuple[str, ...]
    machines: tuple[str, ...]
    u_max: Array
    lowest_level: Array
    u_min: Array
    machine_of: NDArray[np.intp]
    share: Array
    cycles_below: tuple[float, ...] = ()
    exclusive: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        A = len(self.actuators)
        for name in ("u_max", "lowest_level", "u_min", "share", "machine_of"):
            kind = np.intp if name == "machine_of" else np.float64
            value = np.array(getattr(self, name), dtype=kind)
            if value.shape != (A,) or not np.isfinite(value).all():
                raise ControllerConfigError(f"{name} of {A} actuators: found {value.tolist()}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for a, actuator in enumerate(self.actuators):
            low, high, lowest_level, m = self.u_min[a], self.u_max[a], self.lowest_level[a], self.machine_of[a]
            problem, needed = "", f"its lowest level must be the highest, {high:g}"
            if not (low <= 0.0 < high and lowest_level > 0.0 and self.share[a] >= 0.0):
                levels = f"levels from {low:g} to {high:g}, lowest level {lowest_level:g}, share {self.share[a]:g}"
                problem = f"{levels}: expected u_min ≤ 0 < u_max, lowest > 0 ≤ share"
            elif low < 0.0 and lowest_level < high:
                problem = (
                    f"a level that heats and cools (from {low:g}) does not switch below {lowest_level:g}: {needed}"
                )
            elif self.stepped[a] and self.shared[m]:
                which = f"it shares machine {self.machines[m]}"
                problem = f"{which}, so it cannot hold levels above {lowest_level:g}: {needed}"
            if problem:
                raise ControllerConfigError(f"actuator {actuator}: {problem}")

    @staticmethod
    def one(u_max: float = 1.0, lowest_level: float = 1.0, u_min: float = 0.0) -> EquipmentLayout:
        """One machine with one actuator."""
        unit = np.ones(1)
        return EquipmentLayout(
            ("actuator",),
            ("machine",),
            u_max * unit,
            lowest_level * unit,
            u_min * unit,
            np.zeros(1, np.intp),
            0.0 * unit,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Actuators A, machines M."""
        return len(self.actuators), len(self.machines)

    @cached_property
    def stepped(self) -> NDArray[np.bool_]:
        """Whether each actuator holds levels above its lowest and switches below it, (A,)."""
        return np.asarray(self.lowest_level < self.u_max)

    @cached_property
    def excluded(self) -> NDArray[np.bool_]:
        """Whether each actuator is in a group of which one may act, (A,)."""
        return np.isin(np.arange(len(self.actuators)), [a for group in self.exclusive for a in group])

    @cached_property
    def signed(self) -> NDArray[np.intp]:
        """Numbers of the actuators with levels below 0."""
        return np.flatnonzero(self.u_min < 0.0)

    @cached_property
    def shared(self) -> NDArray[np.bool_]:
        """Whether each machine feeds more than one actuator, (M,)."""
        return np.asarray(np.bincount(self.machine_of, minlength=len(self.machines)) > 1)

    @cached_property
    def runs_for(self) -> Array:
        """Share of the time that its machine runs while only that actuator is on, (A,)."""
        below = np.array(self.cycles_below or [0.0] * len(self.machines))[self.machine_of]
        load = self.share * self.u_max
        cycles = self.shared[self.machine_of] & (load > 0.0) & (below > load)
        return np.where(cycles, load / np.where(cycles, below, 1.0), 1.0)

    @cached_property
    def fed_by(self) -> Array:
        """Incidence (M, A): 1 where the machine feeds the actuator."""
        return np.asarray(self.machine_of == np.arange(len(self.machines))[:, None], dtype=np.float64)


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

    `move_of_step` (N,) numbers the move each step belongs to (0 … n_moves − 1, nondecreasing): a move is one step of
    the programme, with one level, the means of its steps, and their tightest comfort bound at its end. `machinery`:
    actuators and machines. `peak`: peak power is in the objective; `capped`: a power cap is; `exchange`: what is bought
    costs more than what is fed in.
    `chosen_steps`: number of first steps in which it is decided which of actuators that exclude one another acts
    (rounded up to whole moves); later they share steps in time. None: all steps.
    `curved`: power has a part in u², which a price of peak power and a cap must see. `terms`: further terms of the
    user, see `controllers.optimisation.statement.terms`.
    """

    move_of_step: NDArray[np.intp]
    machinery: EquipmentLayout = field(default_factory=EquipmentLayout.one)
    peak: bool = False
    capped: bool = False
    chosen_steps: int | None = None
    curved: bool = False
    terms: tuple[Callable[..., None], ...] = ()
    exchange: bool = False

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.move_of_step.size)

    @property
    def n_moves(self) -> int:
        """Number of moves."""
        return int(self.move_of_step[-1]) + 1

    def in_moves(self, u: Array) -> Array:
        """Levels (A, N), each move at the mean of its steps."""
        means = np.add.reduceat(u, self.first_steps, axis=-1) / self.lengths
        return np.asarray(means[..., self.move_of_step])

    @cached_property
    def first_steps(self) -> NDArray[np.intp]:
        """The first step of each move, shape (n_moves,)."""
        return np.searchsorted(self.move_of_step, np.arange(self.n_moves))

    @cached_property
    def lengths(self) -> NDArray[np.intp]:
        """Number of steps of each move, shape (n_moves,)."""
        return np.bincount(self.move_of_step)

    @property
    def n_chosen_moves(self) -> int:
        """Number of first moves that hold one of the first `chosen_steps` steps."""
        chosen_steps = self.n_steps if self.chosen_steps is None else min(self.chosen_steps, self.n_steps)
        return int(self.move_of_step[chosen_steps - 1]) + 1 if chosen_steps > 0 else 0

    @property
    def by_steps(self) -> ProblemShape:
        """The same where every control step is a move."""
        chosen_steps = int(np.searchsorted(self.move_of_step, self.n_chosen_moves))
        return replace(self, move_of_step=every_step(self.n_steps), chosen_steps=chosen_steps)

    @property
    def needs_choices(self) -> bool:
        """Whether a step holds a choice between actuators, which is not convex."""
        return self.n_chosen_moves > 0 and bool(self.machinery.exclusive)


def every_step(n_steps: int) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step` without move blocking."""
    return np.arange(n_steps)


def blocked_moves(n_steps: int, step_s: float, free_h: float, hold_h: float) -> NDArray[np.intp]:
    """`ProblemShape.move_of_step`: every step of the first `free_h` hours is a move, later ones hold for `hold_h`."""
    free = min(n_steps, steps_in(free_h * HOUR_S, step_s))
    hold = steps_in(hold_h * HOUR_S, step_s)
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
class Exchange:
    """What the meter of the building sees: `others_W` (N,), power of what is not planned less own generation.

    `dearer_per_kWh` (N,): what a kWh that is bought costs more than one that is fed in earns; prices of machines are
    those of what is fed in.
    """

    others_W: Array
    dearer_per_kWh: Array


@dataclass(frozen=True, eq=False)
class MPCProblem:
    """Numbers of one instance over N steps: Z zones, A actuators, M machines, r modes per pair.

    `forced_state_K` (Z, A, r): initial F. `features` (Z, N, 4): raw features at the start of each step.
    (Z, N): `T_free_C`, `lower_C`, `upper_C` at the end of each step (margins already inside). Over each step:
    `price_per_kWh` and `power_fixed_W` (while running) of each machine (M, N), `power_per_u_W` of each actuator (A, N).
    `machinery`: levels, machines and capacities.
    `peak_so_far_W`: highest mean power of the building over a step so far. `cooling`: what levels below 0 cost; None
    where there are none. `power_cap`, `exchange`: None without one.
    `power_per_u2_W` (A, N): power over u², where it grows faster than heat; None where it does not. `capacity` (M, N):
    what the actuators of a machine may take together, in the unit of their shares; None: 1. `last_u` (A,): levels of
    the step before, for terms of the user. `available` (A, N): share of each step in which a level gives heat; None:
    all of it. `least_u`, `most_u` (A, N): levels that can be brought about in each step, inside those of `machinery`;
    None: all of them.

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
    peak_so_far_W: float = 0.0
    cooling: Cooling | None = None
    power_cap: PowerCap | None = None
    exchange: Exchange | None = None
    power_per_u2_W: Array | None = None
    capacity: Array | None = None
    last_u: Array | None = None
    available: Array | None = None
    least_u: Array | None = None
    most_u: Array | None = None

    def __post_init__(self) -> None:
        Z, n = self.T_free_C.shape if np.ndim(self.T_free_C) == 2 else (-1, -1)
        (A, M), r = self.machinery.shape, np.shape(self.forced_state_K)[-1]
        zones, machines, actuators = (Z, n), (M, n), (A, n)
        of_weights = (Z,) if np.ndim(self.weights.comfort) else ()
        for part, names, shape in (
            ("", ("T_free_C", "lower_C", "upper_C"), zones),
            ("", ("price_per_kWh", "power_fixed_W", "capacity"), machines),
            ("", ("power_per_u_W", "power_per_u2_W", "available", "least_u", "most_u"), actuators),
            ("", ("forced_state_K",), (Z, A, r)),
            ("", ("features",), (*zones, N_FEATURES)),
            ("", ("last_u",), (A,)),
            ("weights", ("comfort",), of_weights),
            ("cooling", ("price_per_kWh", "power_per_u_W"), actuators),
            ("power_cap", ("limit_W",), (n,)),
            ("exchange", ("others_W", "dearer_per_kWh"), (n,)),
        ):
            of = getattr(self, part) if part else self
            for name in names if of is not None else ():
                value = getattr(of, name)
                if value is not None and np.shape(value) != shape:
                    raise DataError(
                        f"MPC problem of {Z} zones, {A} actuators and {M} machines over {n} steps: "
                        f"{'.'.join(filter(None, [part, name]))} has shape {np.shape(value)}, expected {shape}"
                    )
        if (self.lower_C > self.upper_C + BOUND_TOLERANCE).any():
            raise DataError("MPC problem: a lower comfort bound is above the upper one")
        if self.cooling is None and self.machinery.signed.size:
            raise DataError("MPC problem: levels below 0 need price and power of cooling")

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.T_free_C.shape[-1])

    @cached_property
    def T_now_C(self) -> Array:
        """Zone temperatures now by the model, °C, shape (Z,)."""
        return np.asarray(self.features[:, 0, ZONE] + self.forced_state_K.sum(axis=(1, 2)), dtype=np.float64)

    @cached_property
    def price_per_W(self) -> Array:
        """Cost of one watt of each machine held over each step, currency/W, shape (M, N)."""
        return np.asarray(cost_per_W(self.price_per_kWh, self.step_s), dtype=np.float64)

    @cached_property
    def fixed_cost(self) -> Array:
        """Cost of each machine's fixed part over each step while it runs, currency, shape (M, N)."""
        cost = self.price_per_W * self.power_fixed_W
        return np.where(self.machinery.shared[:, None], np.maximum(cost, 0.0), cost)

    @cached_property
    def level_bounds(self) -> tuple[Array, Array]:
        """Lowest and highest level of each actuator in each step, (A, N) each."""
        whole, m = np.ones((1, self.n_steps)), self.machinery
        low = m.u_min[:, None] * whole if self.least_u is None else self.least_u
        high = m.u_max[:, None] * whole if self.most_u is None else self.most_u
        return low, np.maximum(low, high)

    def in_moves(self, shape: ProblemShape) -> MPCProblem:
        """The same with what can be brought about in the steps of each move on average: it has one level.

        What commands bring changes within an hour by more than from the least to the most of them, so that no level
        lies within each step's bounds.
        """
        least_u, most_u = (None if u is None else shape.in_moves(u) for u in (self.least_u, self.most_u))
        return replace(self, least_u=least_u, most_u=most_u)

    @property
    def cooling_cost_per_u(self) -> Array:
        """Energy cost of cooling over each step per unit of −u, currency, shape (A, N); 0 without cooling."""
        if self.cooling is None:
            return np.zeros(self.power_per_u_W.shape)
        return np.asarray(cost_per_W(self.cooling.price_per_kWh * self.cooling.power_per_u_W, self.step_s))

    @cached_property
    def comfort_price(self) -> Array:
        """Cost of one kelvin of violation at the end of one step, currency/K, shape (Z,)."""
        return np.ones(self.T_free_C.shape[0]) * self.weights.comfort * (self.step_s / HOUR_S)

    @property
    def cap_price_per_W(self) -> float:
        """Cost of one watt above the power cap over one step, currency/W; 0 without one."""
        return 0.0 if self.power_cap is None else float(cost_per_W(self.power_cap.price_per_kWh, self.step_s))

    def unfit(self, u: Array) -> str:
        """Why `u` are no levels (A, N) to act on: another shape, not finite, or out of bounds; or ''."""
        m = self.machinery
        if np.shape(u) != (len(m.actuators), self.n_steps):
            return f"the solver gave levels of shape {np.shape(u)}, expected {(len(m.actuators), self.n_steps)}"
        if not np.isfinite(u).all():
            return "the solver gave levels that are not finite"
        low, high = self.level_bounds
        for a in np.flatnonzero(((u < low - BOUND_TOLERANCE) | (u > high + BOUND_TOLERANCE)).any(axis=-1)):
            return f"u of {m.actuators[a]} leaves its bounds (from {u[a].min():.4g} to {u[a].max():.4g})"
        return ""


# Largest violation of u_min ≤ u ≤ u_max accepted: Ipopt relaxes bounds by 1e-8 of 1, others keep them to their
# tolerance of 1e-7.
BOUND_TOLERANCE = 1e-6
