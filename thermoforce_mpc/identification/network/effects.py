"""The network of a building from its records: each room with its neighbours as inputs, then all of them joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record
from thermoforce_mpc.data.series.gaps import interpolated
from thermoforce_mpc.identification.effects.level_laws import LevelLaw
from thermoforce_mpc.identification.network.building import BuildingFit
from thermoforce_mpc.identification.network.estimate import Run, estimate_room
from thermoforce_mpc.identification.network.room import Law, Room, neighbours_of
from thermoforce_mpc.model.free_response.rc import weather_inputs
from thermoforce_mpc.model.operator.heat_input import HeatInput

# A part of a run with fewer readings says nothing.
_LEAST_READINGS = 8


@dataclass(frozen=True)
class Actuators:
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

    def room(self, zone: int) -> Room:
        """The network of one zone."""
        home, area = self.layout.actuators_of(zone), self.layout.floor_area_m2[zone]
        inputs = [self.heat_inputs[a] for a in home]
        heat = [heat_input.reference_W / area if heat_input.law is not None else np.nan for heat_input in inputs]
        laws = tuple(Law(k, law.name, law.mean, law.sd) for k, a in enumerate(home) for law in self.laws[a])
        return Room(tuple(self.layout.signs[a] for a in home), tuple(heat), len(self.neighbours(zone)), laws)

    def drives(self, record: Record, zone: int) -> list[Array]:
        """v of the actuators of a zone, of the heat that was measured, else of the level; then φ of their laws."""
        drives, phi, T_out_C = [], [], record.T_out_C[:-1]
        for a in self.layout.actuators_of(zone):
            heat_input, heat_W = self.heat_inputs[a], self.layout.signs[a] * record.heat_W[a]
            drive = heat_input(record.u[a], T_out_C)
            if heat_input.law is not None:
                drive = np.where(np.isfinite(heat_W), heat_input.of_meter(heat_W, T_out_C), drive)
            drives.append(drive)
            phi += [law.phi(record.u[a], T_out_C) for law in self.laws[a]]
        return [*drives, *phi]


def building_fit(
    actuators: Actuators, rooms: Sequence[Sequence[Run]], before: BuildingFit | None = None
) -> BuildingFit:
    """The network of a building from the runs of each of its zones (Z,), as of `room_run`.

    `before`: a fit to fewer runs, from which to search.
    """
    fits = []
    for z, runs in enumerate(rooms):
        read = [run for run in runs if np.isfinite(run.readings).sum() >= _LEAST_READINGS]
        fits.append(estimate_room(actuators.room(z), read, before.rooms[z] if before else None))
    return BuildingFit(actuators.layout, tuple(fits))


def room_run(record: Record, zone: int, actuators: Actuators, grid_K: float, less: Record | None = None) -> Run:
    """A record of the building as a run of one of its zones, whose sensor reads in steps of `grid_K` K.

    With `less`, the other record of a pair, their difference, in which the weather cancels.
    """
    inputs, readings = _inputs(record, zone, actuators), record.T_zone_C[zone]
    if less is not None:
        inputs, readings = inputs - _inputs(less, zone, actuators), readings - less.T_zone_C[zone]
    inputs = np.concatenate([inputs, inputs[-1:]])
    return Run(inputs, np.ascontiguousarray(readings), record.step_s / HOUR_S, grid_K**2 / 12.0, less is not None)


def _inputs(record: Record, zone: int, actuators: Actuators) -> Array:
    """Inputs of a room in each step (n, m), see `Room`."""
    weather = weather_inputs(record.time_s, record.T_out_C, record.solar_W_m2)
    others = [_mean_of_step(record.T_zone_C[j]) for j in actuators.neighbours(zone)]
    return np.column_stack([weather, *others, *actuators.drives(record, zone)])


def _mean_of_step(values: Array) -> Array:
    """Means of the samples at both ends of each step (n,); gaps are bridged."""
    values = interpolated(values)
    return np.asarray(0.5 * (values[:-1] + values[1:]))
