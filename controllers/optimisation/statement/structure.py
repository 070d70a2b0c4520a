"""What the statement of a plan depends on besides numbers: the key by which its functions are built once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from thermoforce_mpc.model.operator.building import BuildingOperator


@dataclass(frozen=True)
class Structure:
    """Z zones, A actuators, M machines, modes of order r; everything else refers to their numbers.

    Attributes:
        lengths: number of control steps of each of the N steps of the plan, (N,).
        pairs: zone and actuator of every pair with an effect.
        groups: zone and actuators of the pairs that share a response, see `difference_equations.groups_of`.
        machine_of: machine of each actuator, (A,).
        limited: machines with a capacity.
        part_load: of each shared machine that cycles below a load: its number, the actuators that alone take less, and
            whether all together take more.
        signed: actuators with levels below 0.
        stepped: actuators that hold levels above their lowest and switch below it.
        exclusive: groups of actuators of which one acts at a time.
        chosen: actuators in them, which of them act is decided in the first `n_chosen` steps.
        peak, capped, curved: a price of peak power, a power cap, and whether the power in them, or in a term of the
            user, has a part in u².
        hidden: hidden units of the gain where it sees the predicted temperature; 0: the gain is a number.
        terms, step_s: further terms of the user, and the length of a step for them, s.
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
    operator: BuildingOperator,
    shape: ProblemShape,
    groups: tuple[tuple[int, tuple[int, ...]], ...],
) -> Structure:
    """The structure of the problems of an operator and a shape.

    Raises:
        ControllerConfigError: the operator is not of these actuators, or its heat is known for another lowest level.
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
        lowest = min(machinery.lowest_level[a], machinery.u_max[a])
        if heat is not None and not np.isclose(min(heat.lowest_level, machinery.u_max[a]), lowest):
            raise ControllerConfigError(
                f"actuator {name}: its heat is known for a lowest level of {heat.lowest_level:g}, not {lowest:g}"
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
        curved=shape.curved and bool(shape.peak or shape.capped or shape.terms),
        hidden=operator.of_actuator(0).hidden_bias.size if feedback else 0,
        terms=shape.terms,
        step_s=operator.step_s if shape.terms else 0.0,
    )


def _numbers(flags: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(flags))
