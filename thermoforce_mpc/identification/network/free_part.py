"""The free part of a room's network as parallel modes: its response to the weather, and what disturbs it.

Walls to measured neighbours are left out: without heat, rooms of one house cool together. In the eigenvectors of the
network each mode goes on by itself, and the temperature is their sum.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.identification.network.estimate import RoomFit, start_K2
from thermoforce_mpc.identification.network.room import ROOM
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters

# What actuators did before a record began moves all nodes alike, K.
_BEFORE_SD_K = 20.0
# Least share of a mode in the temperature that counts.
_SEEN = 1e-9


def free_part(fit: RoomFit) -> RcParameters | None:
    """The free response of a room at the step of its runs, exact in weather that is constant in a step; None where it
    was fitted to pairs alone, which say nothing of it.
    """
    if all(run.pair for run in fit.runs):
        return None
    room, theta, step_h = fit.room, fit.theta, fit.runs[0].step_h
    n, nodes = room.n_states, len(room.nodes)
    matrix = room.equations(theta).matrix
    F, G = matrix[:, :n].copy(), matrix[:, n : n + len(INPUTS)]
    for j in range(room.neighbours):
        F[ROOM, ROOM] += room.value(theta, f"wall_{j}") / room.value(theta, "C_room")
    rates, vectors = np.linalg.eig(F)
    modes = (np.linalg.inv(vectors) * vectors[ROOM][:, None]).real
    seen = np.abs(vectors[ROOM]) > _SEEN
    rates, modes = rates.real[seen], modes[seen]
    poles = np.exp(rates * step_h)
    process, stationary, _ = room.noise(theta, step_h)
    start = np.diag(start_K2(room, stationary))
    start[:nodes, :nodes] += _BEFORE_SD_K**2
    return RcParameters(
        poles,
        (modes @ G) * np.expm1(rates * step_h)[:, None] / rates[:, None],
        step_h * HOUR_S,
        modes @ np.diag(process) @ modes.T,
        modes @ start @ modes.T,
        float(np.sqrt(fit.reading_K2)),
    )
