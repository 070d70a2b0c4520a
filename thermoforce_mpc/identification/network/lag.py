"""Whether a zone sensor reads its room late, from records of the building, and the rooms' temperatures then.

The room's network is fitted without and with one state more, which reads the room with a time constant (`RoomNetwork`).
What that gains in posterior, with the width of what is left open, are the log odds: no sensor is taken as late without
a reason. Emitter and sensor are two lags in a row, which a record of warm air tells apart by little: searches begin
both at the fit without a lag and at a quick emitter with a slow sensor, and the likelier one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import Pair, resolution_K
from thermoforce_mpc.identification.network.building import NetworkInputs, room_run
from thermoforce_mpc.identification.network.estimate import RoomFit, RoomRun, estimate_room, searched
from thermoforce_mpc.identification.network.room import LAG, ROOM, RoomNetwork
from thermoforce_mpc.model.late_sensor import LIKELY, LateSensor
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Where the second search begins, in prior standard deviations of sensor and emitters. By judgement: the other likely
# maximum of drawn houses with warm air (2026-11-30).
_SLOW_SENSOR, _QUICK_EMITTER = 1.5, -1.0


def rooms_in_time(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    layout: Layout,
    heat_inputs: Sequence[HeatInput],
    config: IdentificationConfig,
) -> tuple[list[Record], list[Pair], dict[int, LateSensor]]:
    """Runs and pairs with the temperatures of the room where its sensor is likely late, and that sensor, by zone.

    Not looked for without runs, in a zone without an actuator, and where a signed level heats and cools: such levels
    are means of what the building's own loops made of the readings. Nor in rooms beside each other: what is smooth
    there and not known to the network passes for a late reading. In houses of rooms lived by their own thermostats 9 of
    9 ideal sensors were late with log odds of 20 to 99, truly late ones with 44 to 372 (`house:3rooms:10407000`,
    10407004 and 52711001, 2026-11-30); with heat meters 5 of 6 ideal ones.
    """
    untouched: tuple[list[Record], list[Pair], dict[int, LateSensor]] = list(runs), list(pairs), {}
    home = layout.actuators_of(0)
    if not runs or not config.late_sensor or len(layout.floor_area_m2) > 1:
        return untouched
    if not home or any(heat_inputs[a].u_min < 0.0 for a in home):
        return untouched
    inputs = NetworkInputs(layout, heat_inputs, [()] * len(heat_inputs))
    grid_K = resolution_K([run.part(0, [home[0]], [layout.machine_of[home[0]]]) for run in runs])
    found = late_sensor(inputs.room(0), [room_run(run, 0, inputs, grid_K) for run in runs])
    if found is None:
        return untouched
    fit, late = found

    def read_in_time(record: Record) -> Record:
        return replace(record, T_zone_C=record.T_zone_C + _not_read_K(fit, room_run(record, 0, inputs, grid_K)))

    both = [replace(pair, a=read_in_time(pair.a), b=read_in_time(pair.b)) for pair in pairs]
    return [read_in_time(run) for run in runs], both, {0: late}


def late_sensor(room: RoomNetwork, runs: Sequence[RoomRun]) -> tuple[RoomFit, LateSensor] | None:
    """The fit with a sensor that is late and what is known of it, where it is likely; else None."""
    from scipy.special import expit

    without, with_lag = estimate_room(room, runs, most_starts=1), replace(room, late=True)
    place = with_lag.place[LAG]
    slow = np.zeros(with_lag.sd.size)
    slow[place] = _SLOW_SENSOR
    slow[[with_lag.place[f"C_emitter_{a}"] for a in range(len(room.signs))]] = _QUICK_EMITTER
    best = min(
        (searched(with_lag, runs, start) for start in (np.insert(without.scaled, place, 0.0), slow)),
        key=lambda result: float(result.fun),
    )
    fit = RoomFit(with_lag, with_lag.mean + with_lag.sd * best.x, float(best.fun), runs)
    if _log_odds(without.value, fit) <= np.log(LIKELY / (1.0 - LIKELY)):
        return None
    # The fit without a lag may have missed its best.
    without_lag = min(without.value, estimate_room(room, runs).value)
    without_lag = min(without_lag, float(searched(room, runs, np.delete(best.x, place)).fun))
    probability = float(expit(_log_odds(without_lag, fit)))
    if probability <= LIKELY:
        return None
    lag_s = HOUR_S * with_lag.value(fit.theta, LAG)
    return fit, LateSensor(lag_s, lag_s * float(np.sqrt(fit.covariance[place, place])), probability)


def _log_odds(without: float, fit: RoomFit) -> float:
    """Log evidence of a lag, from half the negative log posteriors `without` it and of the `fit` with it."""
    place = fit.room.place[LAG]
    return without - fit.value + 0.5 * float(np.log(fit.spread[place, place]))


def _not_read_K(fit: RoomFit, run: RoomRun) -> Array:
    """What the sensor has yet to read of what the room's actuators did (N,), K, from the steady state of a day."""
    from scipy.linalg import expm

    room, n = fit.room, fit.room.n_states
    drives = [i for a in range(len(room.signs)) for i in room.drives(a)]
    matrix, u = room.equations(fit.theta).matrix, run.inputs[:, drives]
    by_step = np.zeros((2 * n, 2 * n))
    by_step[:n, :n], by_step[:n, n:] = run.step_h * matrix[:, :n], np.eye(n)
    held = expm(by_step)
    A, B = held[:n, :n], run.step_h * held[:n, n:] @ matrix[:, n:][:, drives]
    states = np.empty((len(u), n))
    states[0] = np.linalg.solve(np.eye(n) - A, B @ u[: max(1, round(24.0 / run.step_h))].mean(axis=0))
    for t, moved in enumerate(u[:-1] @ B.T):
        states[t + 1] = A @ states[t] + moved
    return np.asarray(states[:, ROOM] - states[:, room.seen])
