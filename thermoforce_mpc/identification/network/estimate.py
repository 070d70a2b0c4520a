"""Largest posterior of a room's network given its records, and its curvature.

Half the negative log posterior is that of the one-step prediction errors of all runs (`filtering`) and of the priors
(`room`). Prediction errors of a model in which a disturbance is heat in the state are free of what a control loop did
with the disturbance; a disturbance added to the output is not (Ljung 1999, chapter 13).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.network.filtering import FilteredRun, likelihood, prediction_errors
from thermoforce_mpc.identification.network.room import ENVELOPE, OUTDOOR, ROOM, STRUCTURE, SUN_ON_SENSOR, RoomNetwork

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

# Before the first reading, K: the room is about what it reads, its structure and emitters may be elsewhere. A third
# more for emitters changes what the card says by 3 % at most. The structure's and the envelope's are by judgement, when
# networks were first fitted to generated houses (2026-11-25).
_START_SD_K = {ROOM: 1.0, STRUCTURE: 2.0, ENVELOPE: 5.0}
_EMITTER_START_SD_K = 5.0
# What a few nodes do not follow from one reading to the next, K: without it, readings of a simulator without noise make
# a level that answers within its step be taken for an effect at once. A third more changes what the card says by 8 % on
# a drawn house, cost by 0.16 % (`benchmarks.constants`, 2026-11-28).
_MODEL_SD_K = 0.02
# Search: the longest step that is trusted and the first one, in prior standard deviations; the gain expected of a step
# at which it ends, nats; most steps; the largest slope by a standard deviation at which one near a fit ends, nats.
_MOST_STEP, _FIRST_STEP, _LEAST_GAIN, _MOST_STEPS, _FLAT = 2.0, 1.0, 1e-4, 200, 1e-2
# Starts, in prior standard deviations of a parameter. By judgement: more heat, and a lighter structure, are the other
# likely maxima of generated houses (2026-11-25).
_STARTS: tuple[dict[str, float], ...] = ({}, {"heat_0": 1.0}, {"C_structure": 0.7})
# Shares of the expected gain below which a step is refused, and shorter ones, or from which longer ones, are trusted.
# The usual shares of trust regions (Nocedal and Wright 2006, 4.1).
_REFUSED, _SHORTER, _LONGER = 0.1, 0.25, 0.75
# Least cosine between what a curvature missed and the way at which it is corrected (Nocedal and Wright 2006, 6.2).
_LEAST_ALONG = 1e-8
# Step of differences, in prior standard deviations, or of a parameter and at least: about the cube root of the rounding
# of what is differenced (Nocedal and Wright 2006, 8.1).
DIFFERENCE = 1e-4


@dataclass(frozen=True)
class RoomRun:
    """What a room read and what acted on it, at one step.

    Attributes:
        inputs: of each step, those of `RoomNetwork`, the last one repeated (N, m).
        readings: °C (N,); NaN is a gap.
        step_h: h.
        rounding_K2: variance of the rounding of a reading, K².
        on_sensor: what the sun adds to the readings per K of `SUN_ON_SENSOR` (N,), where that is a parameter.
        pair: whether it is the difference of two runs in the same weather, in which disturbances cancel but for a
            small share.
        weight: how much of its log likelihood counts, from 0 to 1: less where the network is surely wrong in what the
            record would otherwise tell ever more exactly (power posterior, Miller and Dunson 2019).
        aired_K2: variance of the room's temperature by air that came in, in each step (N,), K²; None: not looked for.
    """

    inputs: Array
    readings: Array
    step_h: float
    rounding_K2: float = 0.0
    pair: bool = False
    on_sensor: Array | None = None
    weight: float = 1.0
    aired_K2: Array | None = None

    @property
    def noise_share(self) -> float:
        """Variance of the disturbances in this run, as a share of that in a run by itself."""
        return _PAIR_SHARE**2 if self.pair else 1.0

    @property
    def air_K(self) -> Array:
        """Likeliest change of the room's temperature by air that came in, in each step (N − 1,), K."""
        if self.aired_K2 is None:
            return np.zeros(self.readings.size - 1)
        outdoors = np.where(self.inputs[:-1, OUTDOOR] < self.readings[1:], -1.0, 1.0)
        return np.asarray(outdoors * np.sqrt(self.aired_K2[:-1]))

    def reading_K2(self, sensor_K2: float) -> float:
        """Variance of a reading: that of its sensor, of its rounding, and of what a few nodes do not follow."""
        return sensor_K2 + self.rounding_K2 + _MODEL_SD_K**2


# Share of the disturbances that is left in the difference of two runs. By judgement: two runs of one weather share most
# of it.
_PAIR_SHARE = 0.1


@dataclass(frozen=True)
class RoomFit:
    """A room's network with its most likely parameters θ (p,) given `runs`; `value`: half the negative log posterior
    there, up to a constant.
    """

    room: RoomNetwork
    theta: Array
    value: float
    runs: Sequence[RoomRun]

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance of θ (p, p) by the curvature (Laplace)."""
        return self.covariance_at(self.theta)

    @cached_property
    def spread(self) -> Array:
        """Posterior covariance of `scaled` (p, p)."""
        return self.covariance / np.outer(self.room.sd, self.room.sd)

    def covariance_at(self, theta: Array) -> Array:
        """Posterior covariance of θ (p, p) by the curvature at some θ (p,)."""
        # What the record does not know stays at its prior: no direction is surer than the data or less than the prior.
        z = self._in_sds(theta)
        slope = _scaled(self.room, self.runs, z)[1]
        sizes, directions = np.linalg.eigh(_curvature(self.room, self.runs, z, slope))
        half = self.room.sd[:, None] * directions / np.sqrt(np.maximum(sizes, 1.0))
        return np.asarray(half @ half.T)

    def posterior(self, theta: Array) -> tuple[float, Array]:
        """Half the negative log posterior at θ (p,) up to a constant, and its gradient (p,).

        Infinite, without a slope, where rates are beyond numbers.
        """
        value, slope = _scaled(self.room, self.runs, self._in_sds(theta))
        return value, slope / self.room.sd

    def without(self, actuator: int) -> RoomFit:
        """The best fit as if `actuator` did nothing; its `value` less that of this one: the log odds that it acts."""
        runs = [replace(run, inputs=_without(run.inputs, self.room.drives(actuator))) for run in self.runs]
        best = searched(self.room, runs, self.scaled)
        return RoomFit(self.room, self.room.mean + self.room.sd * best.x, float(best.fun), runs)

    def reading_K2(self, theta: Array) -> float:
        """Variance of a reading at θ (p,)."""
        _, _, reading = self.room.noise(theta, self.runs[0].step_h)
        return self.runs[0].reading_K2(reading)

    @property
    def surely_wrong(self) -> bool:
        """Whether runs count with less than all of their likelihood, see `RoomRun.weight`."""
        return any(run.weight < 1.0 for run in self.runs)

    @property
    def air_K2(self) -> float:
        """Variance of the room's temperature in a step by air that came in, in the mean of the runs that may tell."""
        of_runs = [run.aired_K2 for run in self.runs if run.aired_K2 is not None]
        return float(np.concatenate(of_runs).mean()) if of_runs else 0.0

    @property
    def scaled(self) -> Array:
        """θ in prior standard deviations from its mean (p,)."""
        return self._in_sds(self.theta)

    def _in_sds(self, theta: Array) -> Array:
        return np.asarray((theta - self.room.mean) / self.room.sd)


def start_K2(room: RoomNetwork, stationary: Array) -> Array:
    """Variances of the states (n,) before the first reading; those of the disturbances are `stationary`."""
    nodes = [_START_SD_K.get(state, _EMITTER_START_SD_K) ** 2 for state in range(room.disturbances.start)]
    return np.concatenate([nodes, stationary, [_START_SD_K[ROOM] ** 2] * room.late])


def posterior(room: RoomNetwork, theta: Array, runs: Sequence[RoomRun]) -> tuple[float, Array]:
    """Half the negative log posterior at θ (p,) up to a constant, and its gradient (p,)."""
    from scipy.linalg import expm

    equations, n = room.equations(theta), room.n_states
    value, gradient = room.prior(theta)
    sensor = room.place.get(SUN_ON_SENSOR, -1)
    for step_h in dict.fromkeys(run.step_h for run in runs):
        by_step, held, integral, A, B = _over_a_step(equations.matrix, step_h)
        by_A, by_B = np.zeros(A.shape), np.zeros(B.shape)
        noise = Q, stationary, reading = room.noise(theta, step_h)
        for run in (run for run in runs if run.step_h == step_h):
            half, slopes = likelihood(_filtered_run(room, theta, run, A, B, noise))
            counts, part = run.weight, run.weight * run.noise_share
            if run.on_sensor is not None:
                gradient[sensor] -= counts * run.on_sensor @ slopes.readings
            value += counts * half
            by_A += counts * slopes.A
            by_B += counts * slopes.B
            by_stationary = part * stationary * slopes.P0[room.disturbances]
            gradient = gradient + room.noise_slopes(Q, part * slopes.Q, by_stationary, counts * reading * slopes.R)
        # The derivative of an exponential is a block of one twice as large (Van Loan 1978).
        twice = np.zeros((4 * n, 4 * n))
        twice[: 2 * n, : 2 * n] = twice[2 * n :, 2 * n :] = held.T
        twice[:n, 2 * n : 3 * n], twice[:n, 3 * n :] = by_A, by_B @ by_step[:, n:].T
        by_states = expm(twice)[:n, 2 * n : 3 * n]
        by_matrix = step_h * np.concatenate([by_states, integral.T @ by_B], axis=1)
        gradient = gradient + room.slopes(theta, equations, by_matrix)
    return value, gradient


def step_errors(fit: RoomFit, run: RoomRun) -> tuple[Array, Array]:
    """Errors of a run's readings one step ahead (N,), K, and their variances (N,), K²; NaN in gaps."""
    _, _, _, A, B = _over_a_step(fit.room.equations(fit.theta).matrix, run.step_h)
    noise = fit.room.noise(fit.theta, run.step_h)
    return prediction_errors(_filtered_run(fit.room, fit.theta, run, A, B, noise))


def _over_a_step(matrix: Array, step_h: float) -> tuple[Array, Array, Array, Array, Array]:
    """The matrix (F, G) over a step, that whose exponential is taken, its integral, and A and B of a step.

    The exponential of the states' part over a step, and its integral, in which the inputs are linear (Van Loan 1978):
    14 rows instead of 27 with the inputs among nine rooms.
    """
    from scipy.linalg import expm

    n, by_step = len(matrix), matrix * step_h
    held = np.zeros((2 * n, 2 * n))
    held[:n, :n], held[:n, n:] = by_step[:, :n], np.eye(n)
    transition = expm(held)
    A, integral = np.ascontiguousarray(transition[:n, :n]), transition[:n, n:]
    return by_step, held, integral, A, integral @ by_step[:, n:]


def _filtered_run(
    room: RoomNetwork, theta: Array, run: RoomRun, A: Array, B: Array, noise: tuple[Array, Array, float]
) -> FilteredRun:
    """A run as the filter takes it at θ (p,), with `A` and `B` of a step and the `noise` of one, see `RoomNetwork`."""
    (Q, stationary, reading), share = noise, run.noise_share
    x0, P0 = np.zeros(room.n_states), start_K2(room, share * stationary)
    temperatures = np.ones(room.n_states, dtype=bool)
    temperatures[room.disturbances] = False
    if run.pair:
        P0[temperatures] = 0.0
    else:
        x0[temperatures] = float(run.readings[np.isfinite(run.readings)][0])
    readings = run.readings.copy()  # one that may be written to: others would be compiled for once more
    if run.on_sensor is not None:
        readings -= run.on_sensor * theta[room.place[SUN_ON_SENSOR]]
    return FilteredRun(A, B, share * Q, run.reading_K2(reading), x0, P0, run.inputs, readings, run.aired_K2, room.seen)


def estimate_room(
    room: RoomNetwork, runs: Sequence[RoomRun], before: RoomFit | None = None, most_starts: int | None = None
) -> RoomFit:
    """The largest posterior of a room's parameters, searched from several starts, or from a fit to fewer runs.

    `most_starts`: no more than these.
    """
    starts = []
    for shifts in _STARTS:
        start = np.zeros(room.sd.size)
        for name in shifts.keys() & room.place.keys():
            start[room.place[name]] = shifts[name]
        starts.append(start)
    if before is not None and before.room.place == room.place:
        starts = [np.asarray((before.theta - room.mean) / room.sd)]
    best = min((searched(room, runs, start) for start in starts[:most_starts]), key=lambda result: float(result.fun))
    return RoomFit(room, room.mean + room.sd * best.x, float(best.fun), runs)


def gain_of_one_more(room: RoomNetwork, runs: Sequence[RoomRun], start: Array, spread: Array) -> tuple[float, float]:
    """What the last parameter of `room` gains where the others were fitted without it, nats, and its value there.

    `start` (p,): the fit, and 0; `spread` (p − 1, p − 1): covariance of the fit. By the slope and curvature there
    (score test, Rao 1948): two evaluations in the place of a search. The value is in prior standard deviations.
    """
    slope = _scaled(room, runs, start)[1]
    unit = np.zeros(start.size)
    unit[-1] = DIFFERENCE
    column = (_scaled(room, runs, start + unit)[1] - slope) / DIFFERENCE
    with_others = column[:-1]
    curvature = float(column[-1] - with_others @ spread @ with_others)
    if not curvature > 0.0:
        return np.inf, 0.0
    return float(0.5 * slope[-1] ** 2 / curvature), float(-slope[-1] / curvature)


def _scaled(room: RoomNetwork, runs: Sequence[RoomRun], z: Array) -> tuple[float, Array]:
    """`posterior` at z (p,), θ in prior standard deviations from its mean, and its gradient by z.

    Infinite, without a slope, where rates are beyond numbers: a search does not step there.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        value, gradient = posterior(room, room.mean + room.sd * z, runs)
    return (value, gradient * room.sd) if np.isfinite(value) else (np.inf, np.zeros_like(z))


def _curvature(room: RoomNetwork, runs: Sequence[RoomRun], z: Array, slope: Array) -> Array:
    """Second derivatives of half the negative log posterior at z (p,), (p, p), where its gradient is `slope` (p,)."""
    slopes = [_scaled(room, runs, z + unit)[1] - slope for unit in np.eye(z.size) * DIFFERENCE]
    curvature = np.array(slopes) / DIFFERENCE
    return np.asarray(0.5 * (curvature + curvature.T))


def searched(room: RoomNetwork, runs: Sequence[RoomRun], start: Array, spread: Array | None = None) -> OptimizeResult:
    """The largest posterior from a start (p,), in prior standard deviations from the mean.

    By Newton's steps within a trusted distance (Conn, Gould and Toint 2000): curvatures differ by a factor of 10⁴ from
    one direction to the next, in which a search by slopes alone ends far from where they vanish. A curvature costs as
    much as p slopes: it is computed at the start and where the search would end, and corrected by the slopes on the
    way. Near another largest posterior, of covariance `spread` (p, p), the curvature is that one's to begin with, and
    learned from the slopes (BFGS).
    """
    from scipy.optimize import OptimizeResult, minimize

    if spread is not None:
        options = {"hess_inv0": spread, "gtol": _FLAT, "maxiter": _MOST_STEPS}
        return minimize(lambda z: _scaled(room, runs, z), start, jac=True, method="BFGS", options=options)
    at, (value, slope), trusted = start, _scaled(room, runs, start), _FIRST_STEP
    curvature, learned = _curvature(room, runs, at, slope), False
    for _ in range(_MOST_STEPS):
        sizes, directions = np.linalg.eigh(curvature)
        slopes = slope @ directions
        step = _step(sizes, slopes, trusted)
        expected = -float(slopes @ step + 0.5 * sizes @ step**2)
        if expected < _LEAST_GAIN:
            if not learned:
                break
            # What misled may have shortened what is trusted too.
            curvature, learned, trusted = _curvature(room, runs, at, slope), False, max(trusted, _FIRST_STEP)
            continue
        moved = directions @ step
        lower, slope_there = _scaled(room, runs, at + moved)
        share, length = (value - lower) / expected, float(np.linalg.norm(step))
        if share < _SHORTER:
            trusted = 0.25 * length
        elif share > _LONGER and length > 0.99 * trusted:
            trusted = min(2.0 * trusted, _MOST_STEP)
        accepted = share > _REFUSED
        if accepted or (learned and np.isfinite(lower)):
            curvature, learned = _corrected(curvature, moved, slope_there - slope), True
        if accepted:
            at, value, slope = at + moved, lower, slope_there
    return OptimizeResult(x=at, fun=value)


def _corrected(curvature: Array, moved: Array, change: Array) -> Array:
    """A curvature (p, p) that explains how a slope changed on the way (p,), by the symmetric correction of rank one
    (Nocedal and Wright 2006, 6.2), which learns negative curvature too.
    """
    missed = change - curvature @ moved
    along = float(missed @ moved)
    if abs(along) < _LEAST_ALONG * float(np.linalg.norm(missed) * np.linalg.norm(moved)):
        return curvature
    return np.asarray(curvature + np.outer(missed, missed) / along)


def _step(sizes: Array, slopes: Array, longest: float) -> Array:
    """The step of at most a length to the least value of a quadratic, by its directions (p,): their curvatures and
    slopes.
    """
    least = max(0.0, -float(sizes[0]))
    if sizes[0] > 0.0 and _length(slopes / sizes) <= longest:
        return np.asarray(-slopes / sizes)
    # More curvature makes it shorter.
    low, high = least, least + _length(slopes) / longest
    for _ in range(60):
        middle, before = 0.5 * (low + high), (low, high)
        low, high = (middle, high) if _length(slopes / (sizes + middle)) > longest else (low, middle)
        if (low, high) == before:  # no number is between them
            break
    return np.asarray(-slopes / (sizes + high))


def _length(vector: Array) -> float:
    """What `np.linalg.norm` gives, in a fifth of its time on so few numbers: searches ask for it many times a step."""
    return math.sqrt(vector @ vector)


def _without(inputs: Array, drives: list[int]) -> Array:
    inputs = inputs.copy()
    inputs[:, drives] = 0.0
    return inputs
