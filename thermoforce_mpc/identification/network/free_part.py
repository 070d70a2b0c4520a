"""The free response of a zone by the network of its building: to the weather, and to what disturbs its rooms.

In the modes of the network every part goes on by itself, y(t + 1) = a y(t) + …, and the temperature is their sum. A
disturbance d of rate δ drives a mode of rate λ: y − b d / (λ − δ) then goes on as the mode, the rest as d does.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.regression import DISTURBANCE_H
from thermoforce_mpc.identification.network.building import BuildingFit
from thermoforce_mpc.identification.network.estimate import start_K2
from thermoforce_mpc.identification.network.room import ROOM
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters

# What actuators did before a record began moves all nodes alike, K. By judgement: nothing is known.
_BEFORE_SD_K = 20.0
# Least standard deviation of a mode at the start, K: what is less is not seen.
_LEAST_SD_K = 1e-3
# Least distance of the rates of a mode and of a disturbance, 1/h: nearer, their quotient is rounding.
_APART = 1e-6


def free_part(building: BuildingFit, zone: int) -> RcParameters | None:
    """The free response of a zone at the step of its runs, exact in weather that is constant in a step.

    None where the zone was fitted to pairs alone, which say nothing of it.
    """
    step_h = next((run.step_h for run in building.rooms[zone].runs if not run.pair), None)
    if step_h is None:
        return None
    network, slow = building.network, 1.0 / np.array(DISTURBANCE_H)
    rates, modes = network.modes
    here = modes[network.rooms[zone]]
    by_state = _by_state(building, zone)
    process, start = _variances(building, step_h)
    start_covariance = (by_state * start) @ by_state.T
    alike = by_state[:, : rates.size].sum(axis=1)
    start_covariance += _BEFORE_SD_K**2 * np.outer(alike, alike)
    weights = (
        here[:, None] * (modes.T @ network.heat[:, -len(INPUTS) :]) * (-np.expm1(-rates * step_h) / rates)[:, None]
    )
    seen = np.diag(start_covariance) > _LEAST_SD_K**2
    return RcParameters(
        np.exp(-np.concatenate([rates, slow]) * step_h)[seen],
        np.concatenate([weights, np.zeros((slow.size, len(INPUTS)))])[seen],
        step_h * HOUR_S,
        ((by_state * process) @ by_state.T)[np.ix_(seen, seen)],
        start_covariance[np.ix_(seen, seen)],
        float(np.sqrt(building.rooms[zone].reading_K2(building.thetas[zone]))),
    )


def _by_state(building: BuildingFit, zone: int) -> Array:
    """Modes (s + 3,) of the zone, K, per unit of each state: of the nodes (s,), K, then of the disturbances, W/m², of
    all rooms (3 Z,), those of one time scale together.
    """
    network = building.network
    rates, modes = network.modes
    here, heated, s = modes[network.rooms[zone]], modes[network.rooms].T * building.area_m2, rates.size
    blocks = [np.concatenate([here[:, None] * modes.T * network.C, np.zeros((len(DISTURBANCE_H), s))])]
    for i, hours in enumerate(DISTURBANCE_H):
        apart = rates - 1.0 / hours
        apart = np.where(np.abs(apart) < _APART, _APART, apart)
        driven = here[:, None] * heated / apart[:, None]
        blocks.append(np.concatenate([-driven, np.eye(len(DISTURBANCE_H))[:, [i]] * driven.sum(axis=0)]))
    return np.concatenate(blocks, axis=1)


def _variances(building: BuildingFit, step_h: float) -> tuple[Array, Array]:
    """Variances of what disturbs the states of `_by_state` in a step, and of the states at the start."""
    process, start, disturbed, stationary = [], [], [], []
    for fit, theta in zip(building.rooms, building.thetas, strict=True):
        Q, variances, _ = fit.room.noise(theta, step_h)
        nodes = fit.room.disturbances.start
        Q[ROOM] += fit.air_K2  # air will come in again, nobody knows when
        process.append(Q[:nodes])
        start.append(start_K2(fit.room, variances)[:nodes])
        disturbed.append(Q[nodes:])
        stationary.append(variances)
    return (
        np.concatenate([*process, np.array(disturbed).T.ravel()]),
        np.concatenate([*start, np.array(stationary).T.ravel()]),
    )
