"""A room as a thermal network: what its parameters mean, their priors, and its equations.

The room's air and furniture (T), the structure inside (s), the envelope (w), and the emitter (e) of each of its
actuators are nodes with a heat capacity C; conductances H join them, the outdoor air (o) and the neighbours (j). What
is not measured is heat that enters the room, an Ornstein-Uhlenbeck process on each of three time scales (Bacher and
Madsen 2011 have one). Everything is per m² of floor, so that the priors suit any size:

    C_room dT/dt = H_s (T_s − T) + H_o (T_o − T) + Σ H_j (T_j − T) + H_e (T_e − T) + sun + gains + disturbances
    C_s  dT_s/dt = H_s (T − T_s) + H_w (T_w − T_s) + sun + a share of the heat
    C_w  dT_w/dt = H_w (T_s − T_w) + H_wo (T_o − T_w)
    C_e  dT_e/dt = H_e (T − T_e) + heat v

Heat that reaches a node warms no other at once and cools none, at any values: the matrix is Metzler. Every rate is a
product of powers of positive parameters, so that it is linear in their logarithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.free_response.rc import INPUTS

ROOM, STRUCTURE, ENVELOPE, EMITTER = 0, 1, 2, 3
"""States: room, structure, envelope, then the emitters, then the disturbances."""
DISTURBANCE_H = (1.0, 6.0, 48.0)
"""Time constants of the disturbances, h."""
# Temperature of neighbours that were not measured, and of the ground, °C.
_NEIGHBOURS_C = 20.0


class Prior(NamedTuple):
    """Log-normal: median, and standard deviation of the logarithm."""

    median: float
    log_sd: float


# Per m² of floor. Capacities Wh/K: air, furniture and the first centimetre of surfaces; EN ISO 13790 table 12 has 22
# (very light) to 103 (very heavy) for the structure, to which the envelope's outer half adds; an emitter holds from 1
# (convector) to 30 (screed). Conductances W/K: EN ISO 13790 has 9.1 W/m²K to about 3 m² of structure, in series with
# the surfaces' 3.45; windows, air change and walls lose 0.5 to 4 in all. Heat of an actuator at full level, W; sun, m²
# of aperture; gains, W.
_ROOM: dict[str, Prior] = {
    "C_room": Prior(18.0, 0.5),
    "C_structure": Prior(60.0, 0.6),
    "H_structure": Prior(10.0, 0.6),
    "H_outdoors": Prior(1.0, 0.7),
    "C_envelope": Prior(15.0, 1.0),
    "H_envelope": Prior(2.0, 0.9),
    "H_envelope_outdoors": Prior(1.0, 0.9),
    "H_neighbours": Prior(0.1, 1.8),
    "sun": Prior(0.04, 1.0),
    "sun_structure": Prior(0.04, 1.0),
    "gains": Prior(4.0, 0.7),
}
_EMITTER: dict[str, Prior] = {
    "heat": Prior(60.0, 0.7),
    "C_emitter": Prior(6.0, 1.2),
    "H_emitter": Prior(6.0, 0.8),
    "heat_structure": Prior(0.15, 1.0),
}
# Metered heat over floor area says the heat of full level but for the meter and the area.
_METERED_LOG_SD = 0.15
# Of a measured neighbour: walls between rooms that touch, and nearly nothing between those that do not.
_WALL = Prior(0.2, 1.5)
# Standard deviations: disturbances W/m², process noise of room and structure K per √h, a reading K.
_NOISE: dict[str, Prior] = {
    **{f"disturbance_{hours:g}h": Prior(2.0, 0.8) for hours in DISTURBANCE_H},
    "room_noise": Prior(0.06, 0.8),
    "structure_noise": Prior(0.04, 0.8),
    "reading": Prior(0.03, 0.7),
}
# Sun by the side of the house and daily wave of the gains, W/m²; by their signed weight in `INPUTS`.
_WAVES: dict[str, float] = {"solar_cosine": 0.02, "solar_sine": 0.02, "daily_cosine": 1.5, "daily_sine": 1.5}
_OUTDOOR, _SUN, _ONE = (INPUTS.index(name) for name in ("outdoor", "solar", "constant"))


@dataclass(frozen=True)
class Equations:
    """dx/dt = F x + G inputs at some parameters: the matrix (F, G) (n, n + m), 1/h, and each of its rates (t,)."""

    matrix: Array
    rates: Array


@dataclass(frozen=True)
class Room:
    """Structure of a room's network with K actuators and N measured neighbours.

    Attributes:
        signs: +1 for an actuator that heats, −1 for one that cools (K,).
        heat_W_m2: heat of each at full level, W per m² of floor, NaN where it was not measured (K,).
        neighbours: number of measured neighbours N.

    Parameters θ: logarithms of the positive ones, `names`, then the signed weights of the daily waves.
    Inputs: those of `rc.INPUTS`, the neighbours' temperatures (N,) °C, and v of the actuators (K,).
    """

    signs: tuple[int, ...] = (1,)
    heat_W_m2: tuple[float, ...] = (float("nan"),)
    neighbours: int = 0

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """Priors of the positive parameters by name."""
        priors = dict(_ROOM)
        priors |= {f"wall_{j}": _WALL for j in range(self.neighbours)}
        for a, heat in enumerate(self.heat_W_m2):
            priors |= {f"{name}_{a}": prior for name, prior in _EMITTER.items()}
            if np.isfinite(heat):
                priors[f"heat_{a}"] = Prior(heat, _METERED_LOG_SD)
        return priors | _NOISE

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the positive parameters."""
        return tuple(self.priors)

    @cached_property
    def place(self) -> dict[str, int]:
        """Where each positive parameter stands in θ."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def mean(self) -> Array:
        """Prior mean of θ (p,)."""
        return np.append(np.log([prior.median for prior in self.priors.values()]), np.zeros(len(_WAVES)))

    @cached_property
    def sd(self) -> Array:
        """Prior standard deviation of θ (p,)."""
        return np.append([prior.log_sd for prior in self.priors.values()], list(_WAVES.values()))

    def prior(self, theta: Array) -> tuple[float, Array]:
        """Half the negative log prior at θ (p,) up to a constant, and its gradient.

        That of heat is on what an actuator gives in all, to its emitter and to the structure.
        """
        away, shares = (theta - self.mean) / self.sd, {}
        for a in range(len(self.signs)):
            heat, structure = self.place[f"heat_{a}"], self.place[f"heat_structure_{a}"]
            away[heat] += np.log1p(np.exp(theta[structure])) / self.sd[heat]
            shares[heat, structure] = 1.0 / (1.0 + np.exp(-theta[structure]))
        gradient = away / self.sd
        for (heat, structure), share in shares.items():
            gradient[structure] += away[heat] / self.sd[heat] * share
        return 0.5 * float(away @ away), gradient

    @property
    def n_states(self) -> int:
        """Number of states n."""
        return EMITTER + len(self.signs) + len(DISTURBANCE_H)

    @property
    def disturbances(self) -> slice:
        """States of the disturbances, W/m²."""
        return slice(self.n_states - len(DISTURBANCE_H), self.n_states)

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return len(INPUTS) + self.neighbours + len(self.signs)

    def drive(self, actuator: int) -> int:
        """Which input the level of `actuator` is."""
        return len(INPUTS) + self.neighbours + actuator

    @cached_property
    def _terms(self) -> tuple[Array, NDArray[np.intp], NDArray[np.intp], Array]:
        """Powers of θ's positive part (t, p), row and column in (F, G) (t,), and factor (t,) of each rate."""
        powers: list[Array] = []
        rows: list[int] = []
        columns: list[int] = []
        factors: list[float] = []
        n = self.n_states

        def rate(row: int, column: int, factor: float, *up: str, over: str) -> None:
            power = np.zeros(len(self.names))
            for name in up:
                power[self.place[name]] += 1.0
            power[self.place[over]] -= 1.0
            powers.append(power)
            rows.append(row)
            columns.append(column)
            factors.append(factor)

        def joined(row: int, column: int, conductance: str, capacity: str, factor: float = 1.0) -> None:
            rate(row, column, factor, conductance, over=capacity)
            rate(row, row, -1.0, conductance, over=capacity)

        joined(ROOM, STRUCTURE, "H_structure", "C_room")
        joined(STRUCTURE, ROOM, "H_structure", "C_structure")
        joined(ROOM, n + _OUTDOOR, "H_outdoors", "C_room")
        joined(STRUCTURE, ENVELOPE, "H_envelope", "C_structure")
        joined(ENVELOPE, STRUCTURE, "H_envelope", "C_envelope")
        joined(ENVELOPE, n + _OUTDOOR, "H_envelope_outdoors", "C_envelope")
        joined(ROOM, n + _ONE, "H_neighbours", "C_room", _NEIGHBOURS_C)
        for j in range(self.neighbours):
            joined(ROOM, n + len(INPUTS) + j, f"wall_{j}", "C_room")
        rate(ROOM, n + _SUN, 1.0, "sun", over="C_room")
        rate(STRUCTURE, n + _SUN, 1.0, "sun_structure", over="C_structure")
        rate(ROOM, n + _ONE, 1.0, "gains", over="C_room")
        for a, sign in enumerate(self.signs):
            emitter, drive = EMITTER + a, n + self.drive(a)
            joined(ROOM, emitter, f"H_emitter_{a}", "C_room")
            joined(emitter, ROOM, f"H_emitter_{a}", f"C_emitter_{a}")
            rate(emitter, drive, sign, f"heat_{a}", over=f"C_emitter_{a}")
            rate(STRUCTURE, drive, sign, f"heat_{a}", f"heat_structure_{a}", over="C_structure")
        for state in range(n)[self.disturbances]:
            rate(ROOM, state, 1.0, over="C_room")
        return np.array(powers), np.array(rows), np.array(columns), np.array(factors)

    @cached_property
    def _waves(self) -> NDArray[np.intp]:
        """Columns of the daily waves in (F, G)."""
        return np.array([self.n_states + INPUTS.index(name) for name in _WAVES])

    def equations(self, theta: Array) -> Equations:
        """The equations at θ (p,)."""
        powers, rows, columns, factors = self._terms
        rates = factors * np.exp(powers @ theta[: len(self.names)])
        matrix = np.zeros((self.n_states, self.n_states + self.n_inputs))
        np.add.at(matrix, (rows, columns), rates)
        states = np.arange(self.n_states)[self.disturbances]
        matrix[states, states] = -1.0 / np.array(DISTURBANCE_H)
        matrix[ROOM, self._waves] += theta[len(self.names) :] / self.value(theta, "C_room")
        return Equations(matrix, rates)

    def slopes(self, theta: Array, equations: Equations, by_matrix: Array) -> Array:
        """Derivatives (p,) by θ of a function with derivatives `by_matrix` (n, n + m) by the matrix."""
        powers, rows, columns, _ = self._terms
        by_waves = by_matrix[ROOM, self._waves] / self.value(theta, "C_room")
        out = np.append(powers.T @ (equations.rates * by_matrix[rows, columns]), by_waves)
        out[self.place["C_room"]] -= by_waves @ theta[len(self.names) :]
        return out

    def value(self, theta: Array, name: str) -> float:
        """A positive parameter."""
        return float(np.exp(theta[self.place[name]]))

    def noise(self, theta: Array, step_h: float) -> tuple[Array, Array, float]:
        """Variances of the process noise in a step (n,), of the stationary disturbances (d,), and of a reading."""
        values = {name: self.value(theta, name) ** 2 for name in _NOISE}
        stationary = np.array([values[f"disturbance_{hours:g}h"] for hours in DISTURBANCE_H])
        Q = np.zeros(self.n_states)
        Q[ROOM], Q[STRUCTURE] = step_h * values["room_noise"], step_h * values["structure_noise"]
        Q[self.disturbances] = -np.expm1(-2.0 * step_h / np.array(DISTURBANCE_H)) * stationary
        return Q, stationary, values["reading"]

    def noise_slopes(self, Q: Array, by_Q: Array, by_stationary: Array, by_reading: float) -> Array:
        """Derivatives (p,) by θ from those by the logarithms of the variances: each is the square of a parameter."""
        out = np.zeros(self.mean.size)
        of_Q = 2.0 * by_Q * Q
        out[self.place["room_noise"]], out[self.place["structure_noise"]] = of_Q[ROOM], of_Q[STRUCTURE]
        out[[self.place[f"disturbance_{hours:g}h"] for hours in DISTURBANCE_H]] = (
            of_Q[self.disturbances] + 2.0 * by_stationary
        )
        out[self.place["reading"]] = 2.0 * by_reading
        return out


def neighbours_of(zone: int, zones: int) -> Sequence[int]:
    """The other zones, in the order of a room's neighbours."""
    return [other for other in range(zones) if other != zone]
