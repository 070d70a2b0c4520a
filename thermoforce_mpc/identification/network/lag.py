"""Whether a zone sensor reads its room late, from records of the building, and the rooms' temperatures then.

The room's network is fitted without and with one state more, which reads the room with a time constant (`RoomNetwork`).
What that gains in posterior, with the width of what is left open, are the log odds: no sensor is taken as late without
a reason. Emitter and sensor are two lags in a row, which a record of warm air tells apart by little: searches begin
both at the fit without a lag and at a quick emitter with a slow sensor, and the likelier one counts. How late a sensor
is that is late is another question, with a prior of its own and all likely lags looked at (`_how_late`).

A mean level does not say where in its step the heat came, which passes for a lag. Where a machine that switches within
its steps explains a record better than levels that are held, the sensor must be late by that too, and by no more than
some days: it may have switched more than once in a step, of which a long record would tell ever more surely. A lag that
is shorter than what is left open is none.
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
from thermoforce_mpc.identification.network.room import LAG, ROOM, Prior, RoomNetwork
from thermoforce_mpc.model.late_sensor import LIKELY, LateSensor
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Days that such a record weighs at most, by judgement; how far levels are from off, from full and
# from each other at least where a machine may have been switched, by judgement too. Of 28 days of own control at steps
# of 15 min a house whose heat pump switches 47 times a day has log odds of 57 and of 4.6 by these, with a sensor that
# is late by 15 min 452 and 94 (620001:0, 2026-11-30).
_WEIGHED_DAYS, _PART = 5.0, 0.02
# How long parts of steps are, h, and least number of them: short beside lags of some minutes. With halves of 15 min an
# ideal sensor has log odds of 6.4, with quarters 5.2; late ones 0.2 less (620001:0, 620001:7, 913377:1,
# 2026-11-30).
_PART_H, _LEAST_PARTS = 1.0 / 16.0, 2
HOW_LATE = Prior(10.0 / 60.0, 0.5)
"""How late a sensor is that is late, h: 4 to 23 min in 90 %, from an open one to a thick case, by judgement.
`SENSOR_LAG` is what any sensor may be, and says whether one is late."""
# Lags at which the posterior is looked at, h, each 1.6 times the one before, in how many parts between the least and
# the most, and what share of the likelihood counts for it: emitter and sensor change places in a network that is wrong.
# By all of it 13 of 15 true lags of 10 and 20 min were in their bands, by half 14 (three days of probing, 913377 and
# 620001, 2026-11-30).
_LAGS_H, _FINE, _COUNTS = np.geomspace(2.5, 60.0, 8) / 60.0, 400, 0.5
# How far off the lag is besides, standard deviation, h: one node for air and surfaces reads warm air up to 5.6 min
# early (conductances of EN ISO 13790). Without it 2 of 4 lags of own control were in their bands (913377, 2026-11-30).
_ONE_NODE_H = 3.0 / 60.0
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
    """The fit with a sensor that is late by the likely time, and what is known of it, where it is likely; else None."""
    without, fit, probability = _compared(room, runs)
    if probability <= LIKELY:
        return None
    lag_h = fit.room.value(fit.theta, LAG)
    switched = [_switched(run, room) for run in runs]
    moved = any(there is not run for there, run in zip(switched, runs, strict=True))
    if moved and float(searched(room, switched, without.scaled).fun) < without.value:
        # A machine may have been switched several times in a step: when heat came is known to a quarter of it.
        if lag_h <= 0.25 * max(run.step_h for run in runs):
            return None
        probability = _compared(room, _weighed(switched))[-1]
        if probability <= LIKELY:
            return None
    fit, lag_h, sd = _how_late(fit)
    lag_s = HOUR_S * lag_h
    return fit, LateSensor(lag_s, lag_s * sd, probability)


def _how_late(fit: RoomFit) -> tuple[RoomFit, float, float]:
    """The fit with the likely lag held, that lag, h, and the standard deviation of its logarithm.

    By the posterior along the lag with the rest fitted at each of `_LAGS_H`, from either side: emitter and sensor may
    change places, so that it has several maxima, and the curvature at one says little of how late the sensor is.
    """
    from scipy.interpolate import PchipInterpolator

    log_h, n = np.log(_LAGS_H), len(_LAGS_H)
    weighed, rest = _weighed(fit.runs, _COUNTS), np.delete(fit.scaled, fit.room.place[LAG])
    values, there = np.full(n, np.inf), np.tile(rest, (n, 1))
    upwards = range(n)
    for start, order in ((rest, upwards), (np.zeros_like(rest), upwards), (rest, upwards[::-1])):
        at = start
        for k in order:
            best = searched(replace(fit.room, lag_h=float(_LAGS_H[k])), weighed, at)
            at = best.x
            if float(best.fun) < values[k]:
                values[k], there[k] = float(best.fun), at
    fine = np.linspace(log_h[0], log_h[-1], _FINE)
    half = PchipInterpolator(log_h, values)(fine) + 0.5 * ((fine - np.log(HOW_LATE.median)) / HOW_LATE.log_sd) ** 2
    likely = np.exp(half.min() - half)
    likely /= likely.sum()
    mean = float(likely @ fine)
    lag_h = float(np.exp(mean))
    sd = float(np.hypot(np.sqrt(likely @ (fine - mean) ** 2), _ONE_NODE_H / lag_h))
    room = replace(fit.room, lag_h=lag_h)
    best = searched(room, fit.runs, there[np.argmin(np.abs(log_h - mean))])
    return RoomFit(room, room.mean + room.sd * best.x, float(best.fun), fit.runs), lag_h, sd


def _weighed(runs: Sequence[RoomRun], share: float = 1.0) -> list[RoomRun]:
    """Runs that weigh no more than some days in all, and a `share` of that."""
    days = sum((len(run.readings) - 1) * run.step_h for run in runs) / 24.0
    return [replace(run, weight=share * min(1.0, _WEIGHED_DAYS / days)) for run in runs]


def _compared(room: RoomNetwork, runs: Sequence[RoomRun]) -> tuple[RoomFit, RoomFit, float]:
    """The fit without a lag, the one with it, and the probability of the lag."""
    from scipy.special import expit

    without = estimate_room(room, runs, most_starts=1)
    fit = _with_lag(room, runs, without)
    probability = float(expit(_log_odds(without.value, fit)))
    if probability <= LIKELY:
        return without, fit, probability
    # The fit without a lag may have missed its best.
    without = min(without, estimate_room(room, runs), key=lambda one: one.value)
    without_lag = min(without.value, float(searched(room, runs, np.delete(fit.scaled, fit.room.place[LAG])).fun))
    return without, fit, float(expit(_log_odds(without_lag, fit)))


def _with_lag(room: RoomNetwork, runs: Sequence[RoomRun], without: RoomFit) -> RoomFit:
    """The best fit with a lag."""
    with_lag = replace(room, late=True)
    place = with_lag.place[LAG]
    slow = np.zeros(with_lag.sd.size)
    slow[place] = _SLOW_SENSOR
    slow[[with_lag.place[f"C_emitter_{a}"] for a in range(len(room.signs))]] = _QUICK_EMITTER
    best = min(
        (searched(with_lag, runs, start) for start in (np.insert(without.scaled, place, 0.0), slow)),
        key=lambda result: float(result.fun),
    )
    return RoomFit(with_lag, with_lag.mean + with_lag.sd * best.x, float(best.fun), runs)


def _switched(run: RoomRun, room: RoomNetwork) -> RoomRun:
    """A run in parts of steps: a level between off and full is full level at the end of its step that is next to the
    higher level; the run itself where there is nothing of the kind.
    """
    drives = [room.drive(a) for a in range(len(room.signs))]
    levels = run.inputs[:-1, drives]
    before, after = np.concatenate([levels[:1], levels[:-1]]), np.concatenate([levels[1:], levels[-1:]])
    part = (levels > _PART) & (levels < 1.0 - _PART) & (np.abs(before - after) > _PART)
    if not part.any():
        return run
    parts = max(_LEAST_PARTS, round(run.step_h / _PART_H))
    inputs = np.repeat(run.inputs, parts, axis=0)[: parts * len(levels) + 1]
    for k in range(parts):
        at_first, at_last = (np.clip(parts * levels - j, 0.0, 1.0) for j in (k, parts - 1 - k))
        inputs[k:-1:parts, drives] = np.where(part, np.where(before > after, at_first, at_last), levels)
    readings = np.full(len(inputs), np.nan)
    readings[::parts] = run.readings
    return replace(run, inputs=inputs, readings=readings, step_h=run.step_h / parts)


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
