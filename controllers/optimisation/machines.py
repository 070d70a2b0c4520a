"""Actuators of a building and the machines that feed them, as a plan sees them: what all its instances share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from thermoforce_mpc.data import Array


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
            low, high, lowest, m = self.u_min[a], self.u_max[a], self.lowest_level[a], self.machine_of[a]
            problem, needed = "", f"its lowest level must be the highest, {high:g}"
            if not (low <= 0.0 < high and lowest > 0.0 and self.share[a] >= 0.0):
                problem = (
                    f"levels from {low:g} to {high:g}, lowest level {lowest:g}, share {self.share[a]:g}: expected "
                )
                problem += "u_min ≤ 0 < u_max, lowest > 0 ≤ share"
            elif low < 0.0 and lowest < high:
                problem = f"a level that heats and cools (from {low:g}) does not switch below {lowest:g}: {needed}"
            elif self.stepped[a] and self.shared[m]:
                problem = f"it shares machine {self.machines[m]}, so it cannot hold levels above {lowest:g}: {needed}"
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
