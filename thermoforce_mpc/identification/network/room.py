"""A room as a thermal network: what its parameters mean, their priors, and its equations.

The room's air and furniture (T), the structure inside (s), the envelope (w), and the emitter (e) of each of its
actuators are nodes with a heat capacity C; conductances H join them, the outdoor air (o) and the neighbours (j): their
air through doors (d), their structures through walls (v). What is not measured is heat that enters the room, an
Ornstein-Uhlenbeck process on each of three time scales (Bacher and Madsen 2011 have one). Everything is per m² of
floor, so that the priors suit any size; a room alone takes a neighbour's structure to be as warm as its sensor:

    C_room dT/dt = H_s (T_s − T) + H_o (T_o − T) + Σ H_dj (T_j − T) + H_e (T_e − T) + sun + gains + disturbances
    C_s  dT_s/dt = H_s (T − T_s) + H_w (T_w − T_s) + Σ H_vj (T_j − T_s) + sun + a share of the heat
    C_w  dT_w/dt = H_w (T_s − T_w) + H_wo (T_o − T_w)
    C_e  dT_e/dt = H_e (T − T_e) + heat v

A sensor that is late reads another state, τ dT_r/dt = T − T_r; one that is not reads T.
Heat that reaches a node warms no other at once and cools none, at any values: the matrix is Metzler. Every rate is a
product of powers of positive parameters, so that it is linear in their logarithms, and of one that has a sign where
there is one: of the daily waves of the gains, and of what a level gives more or less than in proportion.

Priors of a room's parameters, per m² of its floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.estimation.regression import DISTURBANCE_H
from thermoforce_mpc.model.free_response.rc import INPUTS


class Prior(NamedTuple):
    """Log-normal: median, and standard deviation of the logarithm."""

    median: float
    log_sd: float


# Per m² of floor. Capacities Wh/K: air, furniture and the first centimetre of surfaces; EN ISO 13790 table 12 has 22
# (very light) to 103 (very heavy) for the structure, to which the envelope's outer half adds; an emitter holds from 1
# (convector) to 30 (screed). Conductances W/K: EN ISO 13790 has 9.1 W/m²K to about 3 m² of structure, in series with
# the surfaces' 3.45; windows, air change and walls lose 0.5 to 4 in all. Heat of an actuator at full level, W; sun, m²
# of aperture; gains, W.
ROOM_PRIORS: dict[str, Prior] = {
    "C_room": Prior(18.0, 0.5),
    "C_structure": Prior(60.0, 0.6),
    "H_structure": Prior(10.0, 0.6),
    "H_outdoors": Prior(1.0, 0.7),
    "C_envelope": Prior(15.0, 1.0),
    "H_envelope": Prior(2.0, 0.9),
    "H_envelope_outdoors": Prior(1.0, 0.9),
    "H_neighbours": Prior(0.1, 1.5),
    "sun": Prior(0.04, 1.0),
    "sun_structure": Prior(0.04, 1.0),
    "gains": Prior(4.0, 0.7),
}
EMITTER_PRIORS: dict[str, Prior] = {
    "heat": Prior(60.0, 0.7),
    "C_emitter": Prior(6.0, 1.2),
    "H_emitter": Prior(6.0, 0.8),
    "heat_structure": Prior(0.15, 1.0),
}
# Metered heat over floor area says the heat of full level but for the meter and the area. By judgement (2026-11-25), as
# the standard deviations below.
METERED_LOG_SD = 0.15
# Of all measured neighbours, between which the medians are divided: inside walls and floors of 1 to 2 m² and, without
# both films, 1.4 to 4 W/m²K (EN ISO 6946); air through a door or two, 5 W/K closed and up to 100 open (Brown and
# Solvason 1962).
WALLS = Prior(3.5, 1.0)
DOORS = Prior(1.5, 1.0)
# Standard deviations: disturbances W/m², process noise of room and structure K per √h, a reading K.
NOISE: dict[str, Prior] = {
    **{f"disturbance_{hours:g}h": Prior(2.0, 0.8) for hours in DISTURBANCE_H},
    "room_noise": Prior(0.06, 0.8),
    "structure_noise": Prior(0.04, 0.8),
    "reading": Prior(0.03, 0.7),
}
# How late a sensor reads, h, most likely a little. Of 39 drawn houses, whose sensors lag by up to 15 min, medians from
# 3 to 5 min leave the same error of the room's temperature within 3 % (three days of probing, 2026-11-30).
SENSOR_LAG = Prior(4.0 / 60.0, 0.7)
# Sun through one facade, m² of aperture, more or less than by that on the horizontal; on a sensor in full sun, K.
FACADE_SD, SENSOR_SD_K = 0.02, 3.0
# Sun by the side of the house and daily wave of the gains, W/m²; by their signed weight in `INPUTS`.
WAVES: dict[str, float] = {"solar_cosine": 0.02, "solar_sine": 0.02, "daily_cosine": 1.5, "daily_sine": 1.5}


ROOM, STRUCTURE, ENVELOPE, EMITTER = 0, 1, 2, 3
"""States: room, structure, envelope, then the emitters (the nodes), then the disturbances."""
BETWEEN = {"door": (ROOM, DOORS), "wall": (STRUCTURE, WALLS)}
"""What joins two rooms: between which of their nodes, and the prior of all of a room."""
SUN_ON_SENSOR = "sun_on_sensor"
"""Parameter: how much too high a sensor reads in full sun on its facade, K."""
LAG = "sensor_lag"
"""Parameter: time constant of a late sensor, h."""
# Temperature of the ground and of unheated rooms that were not measured, °C: between that of the ground and the rooms'.
# 16 changes what the card says by 1 % (`benchmarks.constants`, 2026-11-28).
_NEIGHBOURS_C = 12.0

OUTDOOR, SUN, _ONE = (INPUTS.index(name) for name in ("outdoor", "solar", "constant"))
"""Inputs: outdoor temperature °C, irradiance W/m²."""


class Law(NamedTuple):
    """What an actuator gives besides its drive v: c φ, with an input φ and a Gaussian prior of c."""

    actuator: int
    name: str
    mean: float
    sd: float


class Link(NamedTuple):
    """A conductance between a node and another one or, times `factor`, the temperature of an input."""

    node: int
    conductance: str
    other: int = -1
    from_input: int = -1
    factor: float = 1.0


class HeatSource(NamedTuple):
    """Heat of an input into a node: `factor`, positive parameters, and a signed one where it is named."""

    node: int
    from_input: int
    names: tuple[str, ...]
    factor: float = 1.0
    signed: str = ""


class _Terms(NamedTuple):
    """Rates (t,) of (F, G): powers of θ's positive part (t, p), factor (t,), place in θ of a signed parameter or −1
    (t,), row and column (t,).
    """

    powers: Array
    factors: Array
    signed: NDArray[np.intp]
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]


@dataclass(frozen=True)
class Equations:
    """dx/dt = F x + G inputs at some parameters: the matrix (F, G) (n, n + m), 1/h, and each of its rates (t,), 1/h
    per unit of its signed parameter.
    """

    matrix: Array
    rates: Array


@dataclass(frozen=True)
class RoomNetwork:
    """Structure of a room's network with K actuators and N measured neighbours.

    Attributes:
        signs: +1 for an actuator that heats, −1 for one that cools (K,).
        heat_W_m2: heat of each at full level, W per m² of floor, NaN where it was not measured (K,).
        neighbours: number of measured neighbours N.
        laws: what the actuators give besides (L,).
        facades: number of facades through which the sun comes in.
        sensor: whether the sun may shine on the sensor, see `estimate.Run.on_sensor`.
        late: whether the sensor may read the room late, by a state of its own.
        lag_h: its time constant, h, where that is no parameter; None: it is one, `LAG`.

    Parameters θ: logarithms of the positive ones, `names`, then the `signed` ones.
    Inputs: those of `rc.INPUTS`, the neighbours' temperatures (N,) °C, v of the actuators (K,), φ of the laws (L,), sun
    on the facades W/m².
    """

    signs: tuple[int, ...] = (1,)
    heat_W_m2: tuple[float, ...] = (float("nan"),)
    neighbours: int = 0
    laws: tuple[Law, ...] = ()
    facades: int = 0
    sensor: bool = False
    late: bool = False
    lag_h: float | None = None

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """Priors of the positive parameters by name."""
        priors = dict(ROOM_PRIORS)
        for name, (_, (median, log_sd)) in BETWEEN.items():
            priors |= {f"{name}_{j}": Prior(median / self.neighbours, log_sd) for j in range(self.neighbours)}
        for a, heat in enumerate(self.heat_W_m2):
            priors |= {f"{name}_{a}": prior for name, prior in EMITTER_PRIORS.items()}
            if np.isfinite(heat):
                priors[f"heat_{a}"] = Prior(heat, METERED_LOG_SD)
        return priors | NOISE | ({LAG: SENSOR_LAG} if self.late and self.lag_h is None else {})

    @cached_property
    def signed(self) -> dict[str, tuple[float, float]]:
        """Prior mean and standard deviation of the signed parameters by name."""
        laws = {_name_of(law): (law.mean, law.sd) for law in self.laws}
        facades = {f"{name}_{i}": (0.0, FACADE_SD) for i in range(self.facades) for name in ("facade", "facade_inside")}
        sensor = {SUN_ON_SENSOR: (0.0, SENSOR_SD_K)} if self.sensor else {}
        return {name: (0.0, sd) for name, sd in WAVES.items()} | laws | facades | sensor

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the positive parameters."""
        return tuple(self.priors)

    @cached_property
    def place(self) -> dict[str, int]:
        """Where each parameter stands in θ."""
        return {name: i for i, name in enumerate((*self.names, *self.signed))}

    @cached_property
    def mean(self) -> Array:
        """Prior mean of θ (p,)."""
        return np.append(
            np.log([prior.median for prior in self.priors.values()]), [mean for mean, _ in self.signed.values()]
        )

    @cached_property
    def sd(self) -> Array:
        """Prior standard deviation of θ (p,)."""
        return np.append([prior.log_sd for prior in self.priors.values()], [sd for _, sd in self.signed.values()])

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

    @cached_property
    def n_states(self) -> int:
        """Number of states n."""
        return self.disturbances.stop + self.late

    @cached_property
    def disturbances(self) -> slice:
        """States of the disturbances, W/m²."""
        return slice(len(self.nodes), len(self.nodes) + len(DISTURBANCE_H))

    @property
    def seen(self) -> int:
        """The state that is read: the room, or what a late sensor shows of it, the last."""
        return self.n_states - 1 if self.late else ROOM

    @cached_property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return self.drive(len(self.signs)) + len(self.laws) + self.facades

    def drive(self, actuator: int) -> int:
        """Which input the level of `actuator` is."""
        return len(INPUTS) + self.neighbours + actuator

    def drives(self, actuator: int) -> list[int]:
        """Which inputs are its level and what its laws make of it."""
        first = self.drive(len(self.signs))
        return [self.drive(actuator), *(first + i for i, law in enumerate(self.laws) if law.actuator == actuator)]

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """Heat capacity of each node, in the order of the states."""
        return ("C_room", "C_structure", "C_envelope", *(f"C_emitter_{a}" for a in range(len(self.signs))))

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """The conductances."""
        return (
            Link(ROOM, "H_structure", STRUCTURE),
            Link(STRUCTURE, "H_envelope", ENVELOPE),
            *(Link(ROOM, f"H_emitter_{a}", EMITTER + a) for a in range(len(self.signs))),
            Link(ROOM, "H_outdoors", from_input=OUTDOOR),
            Link(ENVELOPE, "H_envelope_outdoors", from_input=OUTDOOR),
            Link(ROOM, "H_neighbours", from_input=_ONE, factor=_NEIGHBOURS_C),
            *(
                Link(node, f"{name}_{j}", from_input=len(INPUTS) + j)
                for name, (node, _) in BETWEEN.items()
                for j in range(self.neighbours)
            ),
        )

    @cached_property
    def sources(self) -> tuple[HeatSource, ...]:
        """The heat of sun, people and actuators."""
        sources = [
            HeatSource(ROOM, SUN, ("sun",)),
            HeatSource(STRUCTURE, SUN, ("sun_structure",)),
            HeatSource(ROOM, _ONE, ("gains",)),
            *(HeatSource(ROOM, INPUTS.index(name), (), signed=name) for name in WAVES),
        ]
        for a, sign in enumerate(self.signs):
            signed = ["", *(_name_of(law) for law in self.laws if law.actuator == a)]
            for drive, name in zip(self.drives(a), signed, strict=True):
                sources.append(HeatSource(EMITTER + a, drive, (f"heat_{a}",), sign, name))
                sources.append(HeatSource(STRUCTURE, drive, (f"heat_{a}", f"heat_structure_{a}"), sign, name))
        for i in range(self.facades):
            sun = self.n_inputs - self.facades + i
            sources += [
                HeatSource(ROOM, sun, (), signed=f"facade_{i}"),
                HeatSource(STRUCTURE, sun, (), signed=f"facade_inside_{i}"),
            ]
        return tuple(sources)

    @cached_property
    def _terms(self) -> _Terms:
        rates: list[tuple[Array, float, int, int, int]] = []
        n = self.n_states

        def rate(row: int, column: int, names: tuple[str, ...], factor: float = 1.0, signed: str = "") -> None:
            power = np.zeros(len(self.names))
            for name in names:
                power[self.place[name]] += 1.0
            if row < len(self.nodes) or self.lag_h is None:
                power[self.place[self.nodes[row] if row < len(self.nodes) else LAG]] -= 1.0
            else:
                factor /= self.lag_h
            rates.append((power, factor, self.place[signed] if signed else -1, row, column))

        for link in self.links:
            names = (link.conductance,)
            rate(link.node, link.node, names, -1.0)
            if link.other < 0:
                rate(link.node, n + link.from_input, names, link.factor)
                continue
            rate(link.node, link.other, names)
            rate(link.other, link.node, names)
            rate(link.other, link.other, names, -1.0)
        for source in self.sources:
            rate(source.node, n + source.from_input, source.names, source.factor, source.signed)
        for state in range(n)[self.disturbances]:
            rate(ROOM, state, ())
        if self.late:
            rate(self.seen, ROOM, ())
            rate(self.seen, self.seen, (), -1.0)
        return _Terms(*(np.array(column) for column in zip(*rates, strict=True)))

    def equations(self, theta: Array) -> Equations:
        """The equations at θ (p,)."""
        terms = self._terms
        rates = terms.factors * np.exp(terms.powers @ theta[: len(self.names)])
        matrix = np.zeros((self.n_states, self.n_states + self.n_inputs))
        np.add.at(matrix, (terms.rows, terms.columns), rates * np.where(terms.signed < 0, 1.0, theta[terms.signed]))
        states = np.arange(self.n_states)[self.disturbances]
        matrix[states, states] = -1.0 / np.array(DISTURBANCE_H)
        return Equations(matrix, rates)

    def slopes(self, theta: Array, equations: Equations, by_matrix: Array) -> Array:
        """Derivatives (p,) by θ of a function with derivatives `by_matrix` (n, n + m) by the matrix."""
        terms, out = self._terms, np.zeros(theta.size)
        by_term = equations.rates * by_matrix[terms.rows, terms.columns]
        has_sign = terms.signed >= 0
        np.add.at(out, terms.signed[has_sign], by_term[has_sign])
        out[: len(self.names)] = terms.powers.T @ (by_term * np.where(has_sign, theta[terms.signed], 1.0))
        return out

    def value(self, theta: Array, name: str) -> float:
        """A positive parameter."""
        return float(np.exp(theta[self.place[name]]))

    def noise(self, theta: Array, step_h: float) -> tuple[Array, Array, float]:
        """Variances of the process noise in a step (n,), of the stationary disturbances (d,), and of a reading."""
        values = {name: self.value(theta, name) ** 2 for name in NOISE}
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


def _name_of(law: Law) -> str:
    return f"{law.name}_{law.actuator}"


def neighbours_of(zone: int, zones: int) -> Sequence[int]:
    """The other zones, in the order of a room's neighbours."""
    return [other for other in range(zones) if other != zone]
