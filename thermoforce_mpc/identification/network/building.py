"""Rooms joined to one network of the building: what each actuator does to each zone, and how sure that is.

Each room is estimated with its neighbours' measured temperatures as inputs. Joined, a wall or door has one conductance
(`joint`). With C the capacities and L the conductances, C dx/dt = −L x + b v, and L is symmetric:
C^{-1/2} L C^{-1/2} has real positive eigenvalues λ_k, so that step responses are sums of 1 − exp(−λ_k t).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record
from thermoforce_mpc.data.series import interpolated, step_means
from thermoforce_mpc.identification.effects.level_laws import LevelLaw
from thermoforce_mpc.identification.network.airing import without_air
from thermoforce_mpc.identification.network.circuits import Circuit
from thermoforce_mpc.identification.network.estimate import DIFFERENCE, RoomFit, RoomRun, estimate_room
from thermoforce_mpc.identification.network.joint import JointPosterior
from thermoforce_mpc.identification.network.room import BETWEEN, EMITTER, Law, RoomNetwork, neighbours_of
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Times after a step to full level at which responses are compared, h: steps of a plan at first, then as exponentials
# need them, each at most twice the one before.
RESPONSE_H = np.array(
    [0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 36.0, 48.0, 72.0, 96.0, 144.0, 240.0]
)
"""Times after a step to full level at which responses are compared, h."""
# Relative standard deviation of any effect by what a few nodes are not (surfaces, layers, water),
# and of what comes over these hours besides, through layers of structure and envelope that are one node each: of 40
# generated houses after 7 and 10 days of probing, the error beyond what their parameters explain. A third more changes
# bands by 13 and 2 %, cost by 0.15 % at most (`benchmarks.constants`, 2026-11-28).
_STRUCTURE_SD, _LAYERS_H = 0.045, 12.0
# And that of what an actuator does to other rooms where the network is surely wrong in what its records tell
# (`RoomRun.weight`). Of 440 such effects of 12 drawn houses in ordinary operation (seeds 31001 to 31005 and 11903,
# 30 November 2026) logarithms err by 0.45 (RMS) however much the parameters say, 0.07 to 0.67 (by thirds 0.52, 0.46,
# 0.35): a multiple of that was too wide where it is large, too narrow where it is small. Of the variance after 48 h
# 90 % is common to what one actuator does to all others. With 0.25 bands of 90 % hold 0.92 of these effects, with 0.34
# 0.95.
_ACROSS_SD = 0.25
# A part of a run with fewer readings says nothing. By judgement.
_LEAST_READINGS = 8


@dataclass(frozen=True)
class NetworkInputs:
    """What acts in a building: `layout`, v of each actuator (A,), what is not known of it (A,), and whether it acts on
    other zones than its own.
    """

    layout: Layout
    heat_inputs: Sequence[HeatInput]
    laws: Sequence[Sequence[LevelLaw]]
    across: bool = True

    def neighbours(self, zone: int) -> Sequence[int]:
        """The measured neighbours of a zone."""
        return neighbours_of(zone, len(self.layout.floor_area_m2)) if self.across else ()

    def room(self, zone: int) -> RoomNetwork:
        """The network of one zone."""
        home, area = self.layout.actuators_of(zone), self.layout.floor_area_m2[zone]
        inputs = [self.heat_inputs[a] for a in home]
        heat = [heat_input.reference_W / area if heat_input.law is not None else np.nan for heat_input in inputs]
        laws = tuple(Law(k, law.name, law.mean, law.sd) for k, a in enumerate(home) for law in self.laws[a])
        return RoomNetwork(tuple(self.layout.signs[a] for a in home), tuple(heat), len(self.neighbours(zone)), laws)

    def inputs(self, record: Record, zone: int) -> Array:
        """Inputs of a room in each step (n, m), see `RoomNetwork`: v is that of the heat that was measured, else of
        levels.
        """
        drives, phi, T_out_C = [], [], record.T_out_C[:-1]
        for a in self.layout.actuators_of(zone):
            heat_input, heat_W = self.heat_inputs[a], self.layout.signs[a] * record.heat_W[a]
            drive = heat_input(record.u[a], T_out_C)
            if heat_input.law is not None:
                drive = np.where(np.isfinite(heat_W), heat_input.of_meter(heat_W, T_out_C), drive)
            drives.append(drive)
            phi += [law.phi(record.u[a], T_out_C) for law in self.laws[a]]
        of_steps = [step_means(interpolated(record.T_zone_C[j])) for j in self.neighbours(zone)]
        weather = weather_inputs(record.time_s, record.T_out_C, record.solar_W_m2)
        return np.column_stack([weather, *of_steps, *drives, *phi])


@dataclass(frozen=True)
class RcNetwork:
    """Nodes of all rooms: capacities `C` (s,) Wh/K, conductances `L` (s, s) W/K, `heat` (s, A + 8) W of full level of
    each actuator and of a unit of each of `INPUTS`, and which nodes the `rooms` are (Z,).
    """

    C: Array
    L: Array
    heat: Array
    rooms: NDArray[np.intp]

    @cached_property
    def modes(self) -> tuple[Array, Array]:
        """Rates λ (s,), 1/h, and Φ (s, s), K: with T = Φ y and heat q, dy/dt = −λ y + Φᵀ q."""
        root = 1.0 / np.sqrt(self.C)
        rates, modes = np.linalg.eigh(self.L * np.outer(root, root))
        return np.maximum(rates, 1e-9), modes * root[:, None]


@dataclass(frozen=True)
class BuildingFit:
    """Fits of the `rooms` of a building (Z,), and what is known of its `circuits` by actuator.

    `sizes` (Z,): of the rooms as multiples of their mean, for those whose floor area is not known; None: alike.
    """

    layout: Layout
    rooms: tuple[RoomFit, ...]
    circuits: Mapping[int, Circuit] = field(default_factory=dict)
    sizes: Array | None = None

    @cached_property
    def responses(self) -> Array:
        """Step responses of each zone to full level (v = 1) of each actuator at `RESPONSE_H`, (Z, A, T) K."""
        return self._steps(self.thetas)

    @cached_property
    def joint(self) -> JointPosterior:
        """What all rooms know together."""
        return JointPosterior(self.rooms, self.area_m2)

    @cached_property
    def thetas(self) -> list[Array]:
        """Most likely θ of each room (Z,), by `joint`."""
        return self.joint.thetas(self.joint.free)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of what each actuator does to each zone, (Z, A, T, T) K²."""
        return self._covariance(self.responses, self._slopes) + self._across

    @property
    def together(self) -> tuple[Array, Array]:
        """What all actuators at full level do to each zone together, (Z, T) K, and its covariance, (Z, T, T) K².

        Each counts in the direction of its sign. What the record does not tell apart is known of their sum.
        """
        signs = np.asarray(self.layout.signs, dtype=np.float64)
        whole = np.einsum("a,zat->zt", signs, self.responses)[:, None]
        slopes = np.einsum("a,zati->zti", signs, self._slopes)[:, None]
        return whole[:, 0], self._covariance(whole, slopes)[:, 0] + self._across.sum(axis=1)

    def _covariance(self, mean: Array, slopes: Array) -> Array:
        """Covariance (Z, A, T, T) K² of responses `mean` (Z, A, T) with `slopes` (Z, A, T, K) as of `_slopes`."""
        slow = mean * -np.expm1(-RESPONSE_H / _LAYERS_H)
        covariance = sum(np.einsum("zat,zas->zats", part, part) for part in (mean, slow)) * _STRUCTURE_SD**2
        of_slopes = self.joint.covariance[np.ix_(self.joint.positive, self.joint.positive)]
        return np.asarray(covariance + slopes @ of_slopes @ np.swapaxes(slopes, -1, -2))

    @property
    def _across(self) -> Array:
        """Covariance by `_ACROSS_SD` of what each actuator does to each zone, (Z, A, T, T) K²; 0 on its own one."""
        home, zones = np.asarray(self.layout.home), np.arange(len(self.rooms))
        wrong = np.array([fit.surely_wrong for fit in self.rooms])
        part = _ACROSS_SD * self.responses * (wrong[:, None] & (home != zones[:, None]))[..., None]
        return np.einsum("zat,zas->zats", part, part)

    @cached_property
    def _slopes(self) -> Array:
        """Derivatives of the responses by the positive parameters of all rooms that are free, (Z, A, T, K)."""
        joint = self.joint
        return _jacobian(lambda free: self._steps(joint.thetas(free)), joint.free, joint.positive)

    @property
    def longest_h(self) -> float:
        """Longest time constant of the building, h."""
        return float(1.0 / self.network.modes[0].min())

    def without(self, zone: int, actuator: int) -> BuildingFit:
        """The building with the best fit of a room as if one of its actuators did nothing."""
        rooms = list(self.rooms)
        rooms[zone] = rooms[zone].without(actuator)
        return replace(self, rooms=tuple(rooms))

    @cached_property
    def network(self) -> RcNetwork:
        """The network of all rooms at their most likely parameters."""
        return self._network(self.thetas)

    @property
    def area_m2(self) -> Array:
        """Floor area of each zone (Z,), m²; where one is not known, its size times the mean of the others, or 1."""
        area = np.asarray(self.layout.floor_area_m2, dtype=np.float64)
        sizes = np.ones(area.size) if self.sizes is None else self.sizes
        return np.where(np.isfinite(area), area, sizes * (np.nanmean(area) if np.isfinite(area).any() else 1.0))

    def _steps(self, thetas: Sequence[Array]) -> Array:
        """`responses` at θ of each room."""
        network = self._network(thetas)
        rates, modes = network.modes
        weights = (modes.T @ network.heat[:, : len(self.layout.home)]) / rates[:, None]
        rising = -np.expm1(-np.outer(rates, RESPONSE_H))
        return np.asarray(np.einsum("zm,ma,mt->zat", modes[network.rooms], weights, rising))

    def _network(self, thetas: Sequence[Array]) -> RcNetwork:
        A, area = len(self.layout.home), self.area_m2
        begins = np.concatenate([[0], np.cumsum([len(fit.room.nodes) for fit in self.rooms])]).astype(int)
        C, L, heat = np.zeros(begins[-1]), np.zeros((begins[-1], begins[-1])), np.zeros((begins[-1], A + len(INPUTS)))

        def joined(i: int, j: int, conductance: float) -> None:
            L[i, i] += conductance
            L[j, j] += conductance
            L[i, j] -= conductance
            L[j, i] -= conductance

        for z, (fit, theta) in enumerate(zip(self.rooms, thetas, strict=True)):
            room, first = fit.room, begins[z]
            value = {name: room.value(theta, name) for name in room.names}
            C[first : begins[z + 1]] = [area[z] * value[name] for name in room.nodes]
            # Columns of the room's inputs: the weather and its own actuators.
            columns = {i: A + i for i in range(len(INPUTS))}
            columns |= {room.drive(k): a for k, a in enumerate(self.layout.actuators_of(z))}
            for link in room.links:
                node, conductance = first + link.node, area[z] * value[link.conductance]
                if link.other >= 0:
                    joined(node, first + link.other, conductance)
                elif link.from_input in columns:
                    L[node, node] += conductance
                    heat[node, columns[link.from_input]] += conductance * link.factor
            for source in room.sources:
                if source.from_input in columns:
                    size = area[z] * source.factor * float(np.prod([value[name] for name in source.names]))
                    size *= float(theta[room.place[source.signed]]) if source.signed else 1.0
                    heat[first + source.node, columns[source.from_input]] += size
        for a, circuit in self.circuits.items():
            z, constant = self.layout.home[a], A + INPUTS.index("constant")
            k = self.layout.actuators_of(z).index(a)
            node = begins[z] + EMITTER + k
            loss = area[z] * self.rooms[z].room.value(thetas[z], f"heat_{k}") * circuit.per_K
            L[node, node] += loss
            heat[node, constant] += loss * circuit.emitter_C
            heat[:, a] *= circuit.full
        for z, (fit, theta) in enumerate(zip(self.rooms, thetas, strict=True)):
            for k, other in enumerate(neighbours_of(z, len(thetas))[:z] if fit.room.neighbours else ()):
                for name, (node, _) in BETWEEN.items():
                    conductance = area[z] * fit.room.value(theta, f"{name}_{k}")
                    joined(begins[z] + node, begins[other] + node, conductance)
        return RcNetwork(C, L, heat, begins[:-1])


def building_fit(
    actuators: NetworkInputs,
    rooms: Sequence[Sequence[RoomRun]],
    before: BuildingFit | None = None,
    *,
    aired: bool = True,
) -> BuildingFit:
    """The network of a building from the runs of each of its zones (Z,), as of `room_run`.

    `before`: a fit to fewer runs, from which to search; `aired`: air may have come in through windows. That is not
    looked for in a zone whose levels are signed: its own loops move such a room within a step in ways that the network
    does not follow, and 4 of 288 steps of `bestest_air`, which has no windows, were taken for air (2026-11-30).
    """
    fits, layout = [], actuators.layout
    for z, runs in enumerate(rooms):
        read = [run for run in runs if np.isfinite(run.readings).sum() >= _LEAST_READINGS]
        fit = estimate_room(actuators.room(z), read, before.rooms[z] if before else None)
        by_loops = any(actuators.heat_inputs[a].u_min < 0.0 for a in layout.actuators_of(z))
        fits.append(without_air(fit) if aired and not by_loops else fit)
    return BuildingFit(actuators.layout, tuple(fits))


def room_run(
    record: Record,
    zone: int,
    actuators: NetworkInputs,
    grid_K: float,
    less: Record | None = None,
    weight: float = 1.0,
) -> RoomRun:
    """A record of the building as a run of one of its zones, whose sensor reads in steps of `grid_K` K.

    With `less`, the other record of a pair, their difference, in which the weather cancels. `weight`: see `RoomRun`.
    """
    inputs, readings = actuators.inputs(record, zone), record.T_zone_C[zone]
    if less is not None:
        inputs, readings = inputs - actuators.inputs(less, zone), readings - less.T_zone_C[zone]
    inputs = np.concatenate([inputs, inputs[-1:]])
    return RoomRun(
        inputs,
        np.ascontiguousarray(readings),
        record.step_s / HOUR_S,
        grid_K**2 / 12.0,
        less is not None,
        weight=weight,
    )


def _jacobian(function: Callable[[Array], Array], at: Array, places: NDArray[np.intp]) -> Array:
    """Derivatives (..., K) of a function's values (...) by the parameters at `places` (K,), by central differences."""
    columns = []
    for i in places:
        step = np.zeros(at.size)
        step[i] = DIFFERENCE * max(1.0, abs(float(at[i])))
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[i]))
    return np.stack(columns, axis=-1)
