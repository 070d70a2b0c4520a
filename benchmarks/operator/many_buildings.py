"""The paper's two-stage estimator for many buildings in one batch; results agree with `two_stage.fit_two_stage`.

Identifying a stock of buildings one by one is dominated by the overhead of each small regression. Here the sums over
time are computed for all buildings together. The box-constrained regression of the first stage is solved by enumerating
all active sets: the optimum of a convex problem is the best of the admissible candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.series import step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.zones.two_stage import (
    MIN_OFF_STEPS,
    MIN_ON_STEPS,
    SCALE,
    TwoStageFit,
    first_stage_bounds,
)
from thermoforce_mpc.model.machine.load import error_of_a_step
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

# Tolerance of the box for rounding, as a share of the bound.
_ROUNDING = 1e-9


def fit_two_stage_many(
    runs: Sequence[Record],
    *,
    actuators: Sequence[HeatInput] | None = None,
    sign: int = 1,
    u_off: float = 0.02,
    time_constant_h: tuple[float, float] = (1.0, 240.0),
) -> list[TwoStageFit]:
    """Estimate eq:arx for every run, one building each; see `two_stage.fit_two_stage` for the estimator.

    Args:
        runs: one run per building, of any lengths, all with the same step.
        actuators: v(u, T_out) of each building; the identity by default.
        sign: +1 heating, −1 cooling, for all buildings.
        u_off: control up to which a step counts as off.
        time_constant_h: box of the pole as time constants, h.

    Returns:
        One fit per run, in their order.

    Raises:
        DataError: no runs, different step lengths, or too few off or on steps; the message names the building.
    """
    if not runs:
        raise DataError("two-stage: no runs given")
    steps = {run.step_s for run in runs}
    if len(steps) != 1:
        raise DataError(f"two-stage: the runs have steps of {sorted(steps)} s; resample them to one step")
    step_s = steps.pop()
    actuators = actuators or [IDENTITY] * len(runs)
    (T, rise, T_out, solar, u, drive), kept = _stacked(runs, actuators)
    off, on = kept & (u <= u_off), kept & (u > u_off)
    for name, found, needed in (("off", off, MIN_OFF_STEPS), ("on", on, MIN_ON_STEPS)):
        few = np.flatnonzero(found.sum(axis=1) < needed)
        if few.size:
            raise DataError(
                f"two-stage: building {few[0]} has {int(found[few[0]].sum())} steps with the actuator {name} "
                f"(need {needed}; {few.size} such buildings): record stretches of both, or use the joint estimator"
            )
    design = np.stack([-T, T_out, solar, np.ones_like(T)], axis=-1) * SCALE
    masked = design * off[..., None]
    normal, moment = masked.transpose(0, 2, 1) @ masked, (masked.transpose(0, 2, 1) @ rise[..., None])[..., 0]
    low, high = first_stage_bounds(step_s, time_constant_h)
    scaled = box_minimisers(normal, moment, low / SCALE, high / SCALE)
    predicted = (design @ scaled[..., None])[..., 0]
    solution = scaled * SCALE
    n_off, n_on = off.sum(axis=1), on.sum(axis=1)
    off_sd = np.array([error_of_a_step((predicted - rise)[i, off[i]], 0.0) for i in range(len(runs))])
    inverse = np.linalg.pinv(normal, hermitian=True)[:, 0, 0]
    a_sd = off_sd * np.sqrt(n_off / np.maximum(1, n_off - 4) * inverse) * SCALE[0]

    residual = rise - predicted
    power = (drive**2 * on).sum(axis=1)
    gain = (drive * residual * on).sum(axis=1) / power
    error = residual - gain[:, None] * drive
    clipped = sign * np.maximum(sign * gain, 0.0)
    rmse = np.sqrt((((residual - clipped[:, None] * drive) * kept) ** 2).sum(axis=1) / kept.sum(axis=1))
    return [
        TwoStageFit(
            a=float(1.0 - solution[i, 0]),
            c=float(solution[i, 1]),
            d=float(solution[i, 2]),
            e=float(solution[i, 3]),
            g=float(clipped[i]),
            a_sd=float(a_sd[i]),
            g_sd=error_of_a_step(error[i, on[i]], 0.0) / float(np.sqrt(power[i])),
            n_off=int(n_off[i]),
            n_on=int(n_on[i]),
            rmse_K=float(rmse[i]),
            step_s=step_s,
            sign=sign,
            heat_input=actuators[i],
        )
        for i in range(len(runs))
    ]


def _stacked(runs: Sequence[Record], actuators: Sequence[HeatInput]) -> tuple[Array, NDArray[np.bool_]]:
    """T, its rise, mean T_out and solar, u, drive (6, buildings, steps; zeros at gaps of T) and mask of valid steps."""
    n = max(run.n_steps for run in runs)
    sampled = np.full((3, len(runs), n + 1), np.nan)
    u = np.zeros((len(runs), n))
    for i, run in enumerate(runs):
        m = run.n_steps
        sampled[0, i, : m + 1] = run.T_zone_C[0]
        sampled[1, i, : m + 1] = run.T_out_C
        sampled[2, i, : m + 1] = run.solar_W_m2
        u[i, :m] = run.u[0]
    T, weather = sampled[0], sampled[1:]
    kept = np.isfinite(T[:, :-1]) & np.isfinite(T[:, 1:])
    T_out, solar = step_means(weather)
    drive = u.copy()
    for i, heat_input in enumerate(actuators):
        if heat_input != IDENTITY:
            drive[i] = heat_input(u[i], T_out[i])
    return np.where(kept, np.stack([T[:, :-1], np.diff(T), T_out, solar, u, drive]), 0.0), kept


def box_minimisers(normal: Array, moment: Array, low: Array, high: Array) -> Array:
    """Minimisers (b, p) of x'Nx − 2m'x in a box by enumeration of active sets; `normal` (b, p, p), `moment` (b, p)."""
    b, p = moment.shape
    best: Array = np.asarray(np.linalg.solve(normal, moment[..., None])[..., 0], dtype=np.float64)
    outside = np.flatnonzero(((best < low) | (best > high)).any(axis=1))
    if outside.size < b:  # only solutions outside of the box need the search
        if outside.size:
            best[outside] = box_minimisers(normal[outside], moment[outside], low, high)
        return best
    best, value = np.zeros((b, p)), np.full(b, np.inf)
    room = _ROUNDING * np.maximum(np.abs(np.where(np.isfinite(low), low, 0)), np.where(np.isfinite(high), high, 0))
    for where in product((0, 1, 2), repeat=p):  # free, at the lower bound, at the upper bound
        fixed = np.where(np.array(where) == 1, low, np.where(np.array(where) == 2, high, 0.0))
        if not np.isfinite(fixed).all():
            continue
        free = np.flatnonzero(np.array(where) == 0)
        x = np.broadcast_to(fixed, (b, p)).copy()
        if free.size:
            rest = (moment - (normal @ fixed))[:, free]
            x[:, free] = np.linalg.solve(normal[:, free[:, None], free], rest[..., None])[..., 0]
        x_box = np.clip(x, low, high)
        cost = np.einsum("bi,bij,bj->b", x_box, normal, x_box) - 2.0 * (x_box * moment).sum(axis=1)
        better = (np.abs(x - x_box) <= room).all(axis=1) & (cost < value)
        best[better], value[better] = x_box[better], cost[better]
    return best
