"""Total electric power as a function of the level: a fixed part while on and a part proportional to u, both with T_out.

P(u, T_out, T_return) = [on·(c0 + c1·T_out) + u·(c2 + c3·T_out)]·(1 + κ (T_return − reference)), the last factor or a
term in u² for warm water (`water.py`). Without the fixed part the model underestimates the power at part load; on a
machine with speed-independent losses that costs a controller 25 % of the energy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.model.machine.foreign_load import ForeignLoad
from thermoforce_mpc.model.machine.load import (
    LEAST_RUNNING,
    LEAST_W,
    LEVEL_EDGE,
    RESIDUAL_SCALE,
    EndValues,
    MachineLoad,
    Quality,
    Steps,
    error_of_a_step,
    levels_to_try,
    running_share,
    usable_steps,
)
from thermoforce_mpc.model.machine.water import (
    AS_GOOD,
    LONGEST_S,
    MOST_LEFT,
    WATER_S,
    ReturnWater,
    fit_return_water,
    squares_of,
)


@dataclass(frozen=True)
class SlopePrior:
    """Prior of (1/load) · d load/d T_out: mean and standard deviation, 1/K.

    A few days of one season contain little information on it, and plans extend to colder or warmer days.
    """

    mean_per_K: float
    sd_per_K: float


POWER_SLOPE = SlopePrior(0.0, 0.015)
"""Electric power at a given speed hardly depends on the outdoor temperature."""


@dataclass(frozen=True)
class LoadFit:
    """Fitted load and its quality."""

    load: MachineLoad
    quality: Quality


@dataclass(frozen=True)
class PowerModel:
    """Electric power P(u, T_out, T_return) in W with the quality of its fit; `load.coefficients` are (c0 … c3).

    `water`: dependence on the return water temperature; None if that was not measured. `cooling`: load over −u at
    levels below 0, where levels are signed; `load` then holds above 0. The level of a machine that feeds several is
    what they take together, as a share of its capacity; below `load.lowest_level` it cycles (`running_share`).
    `foreign`: what else is on its meter, which is in none of these. `water_s`: time over which the water follows the
    level, s, where the part in u² is that of warm water; else None.
    """

    load: MachineLoad
    rmse_W: float = float("nan")
    r2: float = float("nan")
    source: str = "given"
    water: ReturnWater | None = None
    cooling: MachineLoad | None = None
    foreign: ForeignLoad | None = None
    water_s: float | None = None

    def metered(self, u: Array, time_s: Array, T_out_C: Array, T_return_C: Array | float = float("nan")) -> Array:
        """Return what the meter shows over steps that start at `time_s`, s since 1 January; others as `__call__`."""
        own = self(u, T_out_C, T_return_C)
        return own if self.foreign is None else own + self.foreign(time_s, T_out_C)

    def __call__(self, u: Array, T_out_C: Array, T_return_C: Array | float = float("nan")) -> Array:
        """Return the mean electric power over a step for `u` in [0, 1] at `T_out_C` and `T_return_C` °C, W.

        Shapes broadcast. A NaN return temperature is replaced by that of the fit. With `cooling`, u may be below 0.
        """
        if self.cooling is not None:
            return self.load(np.maximum(u, 0.0), T_out_C) + self.cooling(np.maximum(-np.asarray(u), 0.0), T_out_C)
        return np.asarray(self.load(u, T_out_C) * self._factor(T_return_C))

    def of_actuators(self, u: Array, weights: Array, T_out_C: Array) -> Array:
        """Return the mean power of a machine for levels `u` (A, N) of its actuators, in [0, 1], W, shape (N,).

        `weights` (A,): what each takes of the capacity at level 1. On-times begin together.
        """
        fixed, per_u = self.parts(T_out_C)
        runs = running_share(u, np.minimum(np.asarray(weights) / self.load.lowest_level, 1.0))
        linear = fixed * runs + per_u * np.minimum(weights @ u, 1.0)
        return np.asarray(linear + self.load.curve_W * (weights @ np.asarray(u) ** 2))

    def parts(self, T_out_C: Array, T_return_C: Array | float = float("nan")) -> tuple[Array, Array]:
        """Return the fixed part while on and the part per unit of u, both W; see `MachineLoad.parts`."""
        fixed, per_u = self.load.parts(T_out_C)
        factor = self._factor(T_return_C)
        return np.asarray(fixed * factor), np.asarray(per_u * factor)

    def curve_W(self, T_return_C: Array | float = float("nan")) -> Array:
        """Return the part per unit of u², W; see `MachineLoad`."""
        return np.asarray(self.load.curve_W * self._factor(T_return_C))

    def at_lowest_level(self, lowest_level: float) -> PowerModel:
        """Return the same machine with another lowest level, see `MachineLoad.at_lowest_level`."""
        return replace(self, load=self.load.at_lowest_level(lowest_level))

    @property
    def coefficients(self) -> tuple[float, float, float, float]:
        """(c0, c1, c2, c3) in W, W/K, W, W/K."""
        return self.load.coefficients

    def _factor(self, T_return_C: Array | float) -> Array:
        T_return = np.asarray(T_return_C, dtype=np.float64)
        return np.ones_like(T_return) if self.water is None else self.water.factor(T_return)


def fit_power(
    histories: Sequence[Record],
    *,
    lowest_level: float | None = None,
    running: Sequence[tuple[float, Array]] | None = None,
    squares: Array | None = None,
) -> PowerModel:
    """Fit the power model to the measured power of records; see `fit_load` for arguments and errors.

    Where warm water explains most of what level and weather leave over, it is in the part in u², which plans see; else,
    where it is measured, in a factor of the return water.
    """
    u, T_out, power, T_return, T_zone = (
        np.concatenate(rows)
        for rows in zip(
            *((h.u[0], h.T_out_C[:-1], h.power_W[0], h.T_return_C[0], h.T_zone_C[0, :-1]) for h in histories),
            strict=True,
        )
    )
    fit = partial(
        fit_load, u, T_out, power, what="electric power", lowest_level=lowest_level, slope=POWER_SLOPE, running=running
    )

    def modelled(best: LoadFit, water: ReturnWater | None, water_s: float | None = None) -> PowerModel:
        quality = best.quality
        source = f"fitted to {quality.n_samples} steps"
        return PowerModel(best.load, quality.rmse_W, quality.r2, source, water, water_s=water_s)

    plain = fit(squares=squares)
    full_W = float(np.nanmax(power))
    water = fit_return_water(
        T_return,
        T_zone,
        u,
        lambda factor: fit(factor=factor, squares=squares).quality.rmse_W ** 2 * plain.quality.n_running,
        full_W=full_W,
    )
    best = plain if water is None else fit(factor=water.factor(T_return), squares=squares)
    if squares is None and running is None:
        warm = {time_s: fit(squares=squares_of(histories, time_s)) for time_s in WATER_S}
        water_s = min(warm, key=lambda time_s: warm[time_s].quality.rmse_W)
        most_W = min(MOST_LEFT * plain.quality.rmse_W, AS_GOOD * best.quality.rmse_W)
        if water_s <= LONGEST_S and warm[water_s].quality.rmse_W <= most_W:
            return modelled(warm[water_s], None, water_s)
    return modelled(best, water)


def fit_both_directions(histories: Sequence[Record], heating: Array, cooling: Array) -> PowerModel:
    """Fit the power of a machine that heats and cools, perhaps one zone while another, each proportional to its level.

    `heating`, `cooling` (n,): summed levels over the n steps of all records. A direction that they hardly have takes
    the law of the other, which `source` says: a few winter days do not show cooling, and a plan for them hardly needs
    it. Raises `DataError` where neither direction was on in enough measured steps.
    """
    T_out, power = (
        np.concatenate([values(h) for h in histories]) for values in (lambda h: h.T_out_C[:-1], lambda h: h.power_W[0])
    )
    measured = np.isfinite(heating) & np.isfinite(cooling) & np.isfinite(T_out) & np.isfinite(power)
    sides = {"heating": np.where(measured, heating, math.nan), "cooling": np.where(measured, cooling, math.nan)}
    used = [name for name, level in sides.items() if np.sum(level > LEVEL_EDGE) >= LEAST_RUNNING]
    steps = {name: usable_steps(sides[name], T_out, power, f"power of {name}") for name in used or sides}
    ends = {name: EndValues.around(side) for name, side in steps.items()}
    design = np.hstack([side.u[:, None] * ends[name].weights(side.T_out_C) for name, side in steps.items()])
    load_W = power[measured]
    full = float(np.max(load_W))
    prior = [end_values.sloping(POWER_SLOPE.mean_per_K) / (POWER_SLOPE.sd_per_K * full) for end_values in ends.values()]
    both = (heating + cooling)[measured]
    solution = _with_prior(design, load_W, block_diag(*prior), full, both > LEVEL_EDGE)
    loads = {
        name: end_values.load(solution[2 * i : 2 * i + 2], 1.0) for i, (name, end_values) in enumerate(ends.items())
    }
    quality = Quality.of(design @ solution, Steps(both, T_out[measured], load_W, both > LEVEL_EDGE, measured))
    source = f"fitted to {quality.n_samples} steps"
    if len(loads) == 1:
        source += f" of {used[0]}; the other direction was hardly used and is taken to cost as much"
    first = next(iter(loads.values()))
    return PowerModel(
        loads.get("heating", first), quality.rmse_W, quality.r2, source, cooling=loads.get("cooling", first)
    )


def fit_load(
    u: Array,
    T_out_C: Array,
    load_W: Array,
    *,
    what: str,
    lowest_level: float | None = None,
    slope: SlopePrior | None = None,
    factor: Array | None = None,
    running: Sequence[tuple[float, Array]] | None = None,
    squares: Array | None = None,
) -> LoadFit:
    """Fit a `MachineLoad` by least squares, both parts nonnegative over its outdoor range.

    `u` (n,): mean level over each step, in [0, 1]; `T_out_C` (n,) at its start; `load_W` (n,): mean over it, NaN if
    missing; `what`: its name for messages. `lowest_level`: as of `fit_heat`. `slope`: prior of the dependence on T_out.
    `factor` (n,): known factor on the load. `running`: lowest levels to try instead, each with the share of each step
    that the machine runs (n,). `squares` (n,): mean square of the level over each step, where the load may grow faster
    than it. Raises `DataError` as `usable_steps`.
    """
    steps = usable_steps(u, T_out_C, load_W, what)
    times = np.ones(steps.u.size) if factor is None else np.asarray(factor, dtype=np.float64)[steps.kept]
    if running is None:
        runs = [(lowest, np.minimum(steps.u / lowest, 1.0)) for lowest in levels_to_try(steps, lowest_level)]
    else:
        runs = [(lowest, share[steps.kept]) for lowest, share in running]
    bent = None if squares is None else np.asarray(squares, dtype=np.float64)[steps.kept]
    fits = [_fit_at(steps, times, lowest, on, slope, bent) for lowest, on in runs]
    return min(fits, key=lambda fit: fit.quality.rmse_W)


def _fit_at(
    steps: Steps, times: Array, lowest_level: float, on: Array, slope: SlopePrior | None, squares: Array | None
) -> LoadFit:
    ends = EndValues.around(steps)
    on, level = times * on, times * steps.u
    carriers = [on, level] if lowest_level < 1.0 else [level]
    design = np.concatenate([c[:, None] * ends.weights(steps.T_out_C) for c in carriers], axis=1)
    bends = np.zeros((steps.u.size, 0)) if squares is None else (times * squares)[:, None]
    design = np.hstack([design, bends])
    full = float(np.max(steps.load_W[steps.running]))
    prior = np.empty((0, design.shape[1]))
    if slope is not None:
        # Prior of the slope, scaled by the size of the load.
        per_part = slope.sd_per_K * full / len(carriers)
        flat = np.kron(np.eye(len(carriers)), ends.sloping(slope.mean_per_K)) / per_part
        prior = np.hstack([flat, np.zeros((len(carriers), bends.shape[1]))])
    solution = _with_prior(design, steps.load_W, prior, full, steps.running)
    parts = 2 * len(carriers)
    curve_W = float(solution[parts:].sum())
    return LoadFit(ends.load(solution[:parts], lowest_level, curve_W), Quality.of(design @ solution, steps))


def _with_prior(design: Array, load_W: Array, prior: Array, full_W: float, running: NDArray[np.bool_]) -> Array:
    """Coefficients (k,) of a load by least squares, around `prior` (rows of mean 0 and standard deviation 1).

    A step counts as its error does: what the record did not span, such as cold weather, stays at the prior.
    """

    def fitted(scale_W: float) -> Array:
        rows = np.vstack([design / scale_W, prior])
        values = np.concatenate([load_W / scale_W, np.zeros(len(prior))])
        return np.asarray(lsq_linear(rows, values, bounds=(LEAST_W, np.inf)).x)

    first = fitted(RESIDUAL_SCALE * full_W)
    error = (design @ first - load_W)[running]
    return fitted(error_of_a_step(error, RESIDUAL_SCALE * full_W)) if len(prior) else first
