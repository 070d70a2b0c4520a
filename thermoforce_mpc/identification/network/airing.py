"""Steps in which air came into a room through a window, by its temperature.

People open windows for minutes, at the same hours every day, and in several rooms one after the other. As noise of the
size of every other step, a room's fall by a kelvin is best explained by whatever falls too: a neighbour that is aired
as well, by a door that is not there. In these steps the room has a variance of its own (an innovation outlier, Chen and
Liu 1993), so that they say where it was after and nothing of why. What follows, as the room warms again, counts.

Only jumps towards the outdoors are taken for air, and none in the hour after an actuator of the room does less: what
the network does not follow of people warms, and of an actuator that ends it looks like air.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.network.estimate import RoomFit, RoomRun, estimate_room, step_errors
from thermoforce_mpc.identification.network.room import OUTDOOR

# Error one step ahead from which air came in, in standard deviations: of normal errors, one a year of quarter hours.
_BEYOND = 4.0
# How often steps are looked for and the room is fitted again: what is aired hides smaller jumps until it is known.
_PASSES = 2
# How much less of its full level an actuator does, and so long after, h, the jump may be its own. By judgement: valves
# move by less from step to step, and warm air is gone within the hour. Tried on `bestest_air`, which has no windows: 1
# to 5 steps of its set-points, which are left out since, were taken for air (2026-11-30).
_LESS, _AFTER_H = 0.25, 1.0


def without_air(fit: RoomFit) -> RoomFit:
    """The fit of a room in which air that came in explains nothing else: `fit` itself where none came.

    Pairs, in which the weather cancels, tell no direction and stay as they are.
    """
    for _ in range(_PASSES):
        jumps = [_jumps_K2(fit, run) for run in fit.runs]
        if not any(np.any(of_run) for of_run in jumps):
            break
        aired = [
            replace(run, aired_K2=of_run + (0.0 if run.aired_K2 is None else run.aired_K2))
            for run, of_run in zip(fit.runs, jumps, strict=True)
        ]
        fit = estimate_room(fit.room, aired, fit)
    return fit


def _jumps_K2(fit: RoomFit, run: RoomRun) -> Array:
    """Likeliest variance of what came in, in the step from each reading on (N,), K²; 0 where nothing did."""
    jumps = np.zeros(run.readings.size)
    if run.pair:
        return jumps
    errors_K, variances_K2 = step_errors(fit, run)
    outdoors_K = run.inputs[:-1, OUTDOOR] - run.readings[1:]
    with np.errstate(invalid="ignore"):
        beyond = np.sign(outdoors_K) * errors_K[1:] > _BEYOND * np.sqrt(variances_K2[1:])
    beyond &= ~_less_is_done(fit, run)[:-1]
    jumps[:-1][beyond] = (errors_K**2 - variances_K2)[1:][beyond]
    return jumps


def _less_is_done(fit: RoomFit, run: RoomRun) -> NDArray[np.bool_]:
    """Whether an actuator of the room does less in a step than shortly before (N,)."""
    drives = run.inputs[:, [fit.room.drive(a) for a in range(len(fit.room.signs))]]
    less = np.zeros(len(drives), dtype=bool)
    for before in range(1, round(_AFTER_H / run.step_h) + 1):
        less[before:] |= np.any(drives[before:] < drives[:-before] - _LESS, axis=1)
    return less
