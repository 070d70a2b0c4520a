"""Heat of the circuits of one machine, where it is metered: what an open valve takes.

A level is a share of what water at the temperature of a heating curve gives to an emitter: more when it is cold
outdoors, less when the emitter is warm already. With u the level and T_e the temperature of the emitter in the room's
network, the heat is

    q = u (full + per_K (T_out − its mean) − loss (T_e − its mean))

For plans that is linearised about a usual level: the first two terms are what a level gives, and the last one is a
conductance of the emitter to its mean temperature, so that effects come sooner and stay smaller than those of heat that
is held. While the machine is at its limit, which goes with the weather, circuits take from each other: such steps say
nothing of a valve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.data.series import interpolated, lagged, step_means
from thermoforce_mpc.identification.effects.couplings import hourly
from thermoforce_mpc.identification.network.estimate import RoomRun
from thermoforce_mpc.identification.network.room import RoomNetwork
from thermoforce_mpc.model.machine.heat_capacity import kinds_for
from thermoforce_mpc.model.machine.load import LEVEL_EDGE, RESIDUAL_SCALE, TRUST_K, MachineLoad, error_of_a_step
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Level about which plans are linearised: that which holds a room over a season.
_USUAL_LEVEL = 0.3
# Share of the most heat of an hour in such weather from which the machine counts as at its limit. By judgement, as the
# number of steps.
_AT_LIMIT = 0.9
# Slopes that are tried: so many that two are a tenth of a per cent per K apart, since no record tells them finer.
_SLOPES = 41
# Steps from which the heat of a circuit is found: three hours of operation, by judgement.
_LEAST_STEPS = 12
# Prior of both slopes over the heat of full level, 1/K: water is 10 to 50 K warmer than its emitter, its excess goes
# with the load.
_PER_K, _PER_K_SD = 0.04, 0.03
# Least share of the heat at the mean outdoor temperature: where it is milder emitters are cooler, so that heat falls
# less than at one temperature of theirs.
_LEAST_SHARE = 0.5


@dataclass(frozen=True)
class Circuit:
    """Heat of a circuit: `load` while its emitter is at `emitter_C` °C, in units of the v that the network knows `full`
    at full level, and `per_K` less (1/K) for each K that the emitter is warmer, at the usual level.
    """

    load: MachineLoad
    full: float
    per_K: float
    emitter_C: float


def circuit_of(
    room: RoomNetwork,
    theta: Array,
    a: int,
    records: Sequence[Record],
    runs: Sequence[RoomRun],
    layout: Layout,
    heat_input: HeatInput,
) -> Circuit | None:
    """The circuit of actuator `a` of a room with parameters `theta` (p,), by `records` of the building and the same as
    `runs` of the room.

    `heat_input` is v of the runs. None where heat is not metered, its machine feeds nothing else, or too few steps
    tell.
    """
    from scipy.optimize import lsq_linear

    fed, sign = layout.fed_by(layout.machine_of[a]), layout.signs[a]
    if len(fed) < 2 or heat_input.heat is None or not records:
        return None
    k = layout.actuators_of(layout.home[a]).index(a)
    u, T_out_C = (np.concatenate(rows) for rows in ([r.u[a] for r in records], [r.T_out_C[:-1] for r in records]))
    v = sign * np.concatenate([r.heat_W[a] for r in records]) / heat_input.reference_W
    emitter_C = np.concatenate([_emitter_C(room, theta, k, run) for run in runs])
    rows = (u > LEVEL_EDGE) & np.isfinite(v) & ~_at_limit(records, fed, sign)
    if np.count_nonzero(rows) < _LEAST_STEPS:
        return None
    u, T_out_C, v, emitter_C = u[rows], T_out_C[rows], v[rows], emitter_C[rows]
    mean_C, usual_C = (float(u @ T / u.sum()) for T in (T_out_C, emitter_C))
    columns = np.column_stack([u, u * (T_out_C - mean_C), -sign * u * (emitter_C - usual_C)])
    priors = np.array([[sign * _PER_K, 1.0, 0.0], [-_PER_K, 0.0, 1.0]]) / _PER_K_SD

    def fitted(step_sd: float) -> Array:
        design, values = np.concatenate([columns / step_sd, priors]), np.concatenate([v / step_sd, np.zeros(2)])
        return np.asarray(lsq_linear(design, values, bounds=([_LEAST_SHARE, -np.inf, 0.0], np.inf)).x)

    found = fitted(error_of_a_step(v - columns @ fitted(RESIDUAL_SCALE), RESIDUAL_SCALE))
    full, outdoors, warmer = (float(value) for value in found)
    # The straight line ends where the least share is left.
    reach_K = (1.0 - _LEAST_SHARE) * full / max(abs(outdoors), 1e-9)
    low = max(float(T_out_C.min()) - TRUST_K, mean_C - reach_K if outdoors > 0.0 else -np.inf)
    high = min(float(T_out_C.max()) + TRUST_K, mean_C + reach_K if outdoors < 0.0 else np.inf)
    per_u = heat_input.reference_W * np.array([full - outdoors * mean_C, outdoors])
    load = MachineLoad((0.0, 0.0, float(per_u[0]), float(per_u[1])), (low, high), levels_seen=False)
    at_full = heat_input.with_law(load).reference_W / heat_input.reference_W
    return Circuit(load, at_full, _USUAL_LEVEL * warmer, usual_C)


def _emitter_C(room: RoomNetwork, theta: Array, k: int, run: RoomRun) -> Array:
    """Temperature of the room's `k`-th emitter in each step of a run, °C, by the readings and v."""
    C, H, heat = (room.value(theta, f"{name}_{k}") for name in ("C_emitter", "H_emitter", "heat"))
    T = interpolated(run.readings)
    steady_C = step_means(T) + room.signs[k] * heat / H * run.inputs[:-1, room.drive(k)]
    day = round(DAY_S / HOUR_S / run.step_h)
    first_C = float(steady_C[:day].mean())
    pole = float(np.exp(-H / C * run.step_h))
    at_ends = first_C + lagged(steady_C - first_C, pole)
    return step_means(at_ends)


def _at_limit(runs: Sequence[Record], fed: Sequence[int], sign: int) -> NDArray[np.bool_]:
    """Steps (n,) in which a machine gives about the most that it was seen to give in such weather.

    The most is a straight line over the outdoor temperature: of those that no hour is above, and whose slope a boiler
    or a heat pump may have, the one that is lowest in the mean weather.
    """
    together_W = [np.abs(run.heat_W[list(fed)]).sum(axis=0) for run in runs]
    T_out_C = [step_means(run.T_out_C) for run in runs]
    W, of_hours_C = (
        np.concatenate([hourly(steps, run.step_s) for steps, run in zip(of_runs, runs, strict=True)])
        for of_runs in (together_W, T_out_C)
    )
    metered, of_steps_C = np.isfinite(W), np.concatenate(T_out_C)
    if not metered.any():
        return np.zeros(of_steps_C.size, dtype=bool)
    mean_C, (slope, sd) = float(of_steps_C.mean()), kinds_for(sign)[0].slope
    per_K = np.linspace(0.0, slope + np.copysign(2.0 * sd, slope), _SLOPES)
    ends_K = np.array([of_steps_C.min(), of_steps_C.max()]) - mean_C
    per_K = per_K[(1.0 + np.outer(per_K, ends_K)).min(axis=1) >= _LEAST_SHARE]
    most_W = np.max(W[metered] / (1.0 + np.outer(per_K, of_hours_C[metered] - mean_C)), axis=1)
    lowest = int(np.argmin(most_W))
    of_steps_W = most_W[lowest] * (1.0 + per_K[lowest] * (of_steps_C - mean_C))
    return np.asarray(np.concatenate(together_W) > _AT_LIMIT * of_steps_W)
