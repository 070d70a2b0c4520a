"""What the statement of a plan depends on besides numbers, by which its functions are built once, and its equations.

Responses of zones are difference equations: comfort depends on the sum y = Σ F_i of the r modes of a pair only, with

    Π_i (1 − a_i q⁻¹) y_k  =  Σ_i g_i Π_{j≠i} (1 − a_j q⁻¹) d_k,        q⁻¹ y_k = y_{k−1},

for a drive d_k = m(x_k) v(u_k). Pairs of one zone with the same poles obey it together, with the sum of their right
sides: one variable and one equation a step for all actuators of a zone instead of r of each for every pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from controllers.checks import ControllerConfigError
from controllers.optimisation.problem import ProblemShape
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OperatorParameters


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


def groups_of(operator: BuildingOperator, *, power_couples: bool) -> list[PoleGroup]:
    """Return the pairs of each zone by poles; `power_couples`: whether power couples the zones of a step."""
    by_poles: dict[tuple[int, tuple[float, ...]], dict[int, OperatorParameters]] = {}
    for z, a, pair in operator.each():
        by_poles.setdefault((z, tuple(pair.poles.tolist())), {})[a] = pair
    groups = []
    for (z, key), pairs_of in by_poles.items():
        of, poles = np.array(list(pairs_of), dtype=np.intp), np.zeros(operator.shape[2])
        acting = np.any([pair.acting for pair in pairs_of.values()], axis=0)
        poles[: len(key)] = np.where(acting, key, 0.0)
        groups.append(PoleGroup(z, of, of, poles, operator.gains[z, of]))
    # Minimum degree orders a full pattern by time, and one with a few cross-effects so that it fills up: at 20 zones
    # the factorisation takes up to three times as long. So actuators without an effect get numerators of 0; buildings
    # without cross-effects, and sparse ones in which power couples nothing, are faster as they are.
    Z, A, _ = operator.shape
    pairs = sum(group.actuators.size for group in groups)
    if len(groups) > Z or pairs <= max(Z, A) or not (power_couples or pairs > 0.25 * Z * A):
        return groups
    return [_filled(group, A) for group in groups]


def _filled(group: PoleGroup, A: int) -> PoleGroup:
    gains = np.zeros((A, group.poles.size))
    gains[group.actuators] = group.gains
    return replace(group, actuators=np.arange(A), gains=gains)


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
    temperature; 0: it does not. `stored`: heat at the end has a price. `terms`, `step_s`: further terms of the user,
    and the length of a step for them, s.
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
    stored: bool = True
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
        exchange=shape.exchange,
        curved=shape.curved and bool(shape.peak or shape.capped or shape.exchange or shape.terms),
        hidden=operator.of_actuator(0).hidden_bias.size if feedback else 0,
        stored=shape.stored,
        terms=shape.terms,
        step_s=operator.step_s if shape.terms else 0.0,
    )


def _numbers(flags: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(flags))
