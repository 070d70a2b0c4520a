"""Total electric power as a function of the level: a fixed part while on and a part proportional to u, both with T_out.

P(u, T_out, T_return) = [on·(c0 + c1·T_out) + u·(c2 + c3·T_out)]·(1 + κ (T_return − reference)), the last factor or a
term in u² for warm water (`ReturnWater`). Without the fixed part the model underestimates the power at part load; on a
machine with speed-independent losses that costs a controller 25 % of the energy.

What heat costs at part load: by the laws of power and heat, or level by level as it was measured.

Where heat is not measured, it is estimated from the temperature instead. Level by level, costs stand on the model card,
with their uncertainty.

Warm water and electric power: a heat pump or condensing boiler takes more power per heat the warmer its water is.

Radiators follow the level within an hour. Power is then that of the level and a part u·w in the warmth w, the level
that the water follows over the time constant of the emitter; a level or a share of time that stays, which is what a
plan decides, has w = u: a part in u². Where that does not explain the power and the return water is measured, the power
has a factor 1 + κ (T_return − reference) instead; in predictions the return temperature is the zone temperature plus
the mean difference of the last day.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record, steps_in
from thermoforce_mpc.data.series import lagged, step_means
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
from thermoforce_mpc.model.machine.other_load import OtherLoad

# Times that are tried, s. A floor takes longer than the last but one: there no step of a plan warms its own water.
WATER_S = (0.25 * HOUR_S, 0.5 * HOUR_S, HOUR_S, 2.0 * HOUR_S, 6.0 * HOUR_S)
LONGEST_S = 2.0 * HOUR_S
# Share of the error of a power without it that may be left: else something else than the water makes most of it. By
# judgement, as the next.
MOST_LEFT = 0.6
# Error over that with the measured return water up to which it stands for that: a plan sees the level, not the water.
AS_GOOD = 1.5
# Warmth at which levels are compared: that of a machine that gives half its heat.
COMPARED_AT = 0.5
# Least number of running steps with a measured return temperature to identify κ. By judgement: five hours of operation.
_LEAST_STEPS = 20
# 1 K of lift changes a heat pump's efficiency by 2.3 % at a lift of 35 K (Staffell et al. 2012: 6.81 − 0.121 ΔT +
# 0.00063 ΔT²), partly through the heat instead of the power: half of it, and as much uncertain.
_PRIOR_PER_K, _PRIOR_SD_PER_K = 0.01, 0.01
# By judgement: twice what the law above gives, so that a short record cannot make the sign of water.
_BOUNDS_PER_K = (-0.02, 0.05)
# Extrapolation beyond the return temperatures of the data, K. By judgement.
_TRUST_K = 5.0


def warmth(u: Array, step_s: float, water_s: float) -> Array:
    """Mean over each step of the level that the water follows over `water_s`, (n,); it begins at the mean of `u`."""
    levels = np.nan_to_num(u)
    ends = lagged(levels, float(np.exp(-step_s / water_s)), float(levels.mean()))
    return step_means(ends)


def squares_of(histories: Sequence[Record], water_s: float) -> Array:
    """Level times warmth in each step of records of one actuator, (n,)."""
    return np.concatenate([h.u[0] * warmth(h.u[0], h.step_s, water_s) for h in histories])


@dataclass(frozen=True)
class ReturnWater:
    """Factor on electric power by return water temperature.

    `per_K`: κ, 1/K; `reference_C`: return temperature of the fitted load, °C; `range_C`: valid range, °C (held beyond);
    `above_zone_K`: mean difference of return and zone temperature while the machine runs, K.
    """

    per_K: float
    reference_C: float
    range_C: tuple[float, float]
    above_zone_K: float

    def factor(self, T_return_C: Array) -> Array:
        """Return the factor on the power at `T_return_C` °C; 1 if it is NaN (not measured)."""
        T = np.clip(T_return_C, *self.range_C)
        return np.where(np.isfinite(T), 1.0 + self.per_K * (T - self.reference_C), 1.0)

    def expected_C(self, history: Record, T_zone_C: Array) -> Array:
        """The expected return temperature with the zone at `T_zone_C` °C and the machine on, same shape, °C.

        The difference is that of the last day of `history` while running, or of the identification where there is none.
        """
        if history.n_steps:
            last_day = history.last(steps_in(DAY_S, history.step_s))
            above_K = above_zone(last_day.T_return_C[0], last_day.T_zone_C[0, :-1], last_day.u[0])
        else:
            above_K = float("nan")
        return np.asarray(T_zone_C + (above_K if np.isfinite(above_K) else self.above_zone_K))


def above_zone(T_return_C: Array, T_zone_C: Array, u: Array) -> float:
    """Return the mean of return − zone temperature over running steps, weighted by u, K; NaN without measurements."""
    weight = np.where(np.isfinite(T_return_C) & np.isfinite(T_zone_C) & (u > LEVEL_EDGE), u, 0.0)
    total = float(weight.sum())
    if not total > 0.0:
        return float("nan")
    return float((np.where(weight > 0.0, T_return_C - T_zone_C, 0.0) * weight).sum()) / total


def fit_return_water(
    T_return_C: Array, T_zone_C: Array, u: Array, quality_of: Callable[[Array], Quality], full_W: float
) -> ReturnWater | None:
    """Fit κ by least squares with a prior; None if too few running steps have a measured return temperature.

    `T_return_C`, `u` (n,): means over each step; `T_zone_C` (n,) at its start. `quality_of`: that of the load fitted
    with given factors (n,). A step counts as its error does, at least `RESIDUAL_SCALE` times `full_W`.
    """
    from scipy.optimize import minimize_scalar

    running = np.isfinite(T_return_C) & (u > LEVEL_EDGE)
    if running.sum() < _LEAST_STEPS:
        return None
    low, high = float(T_return_C[running].min()), float(T_return_C[running].max())
    reference = float(np.average(T_return_C[running], weights=u[running]))
    above_K = above_zone(T_return_C, T_zone_C, u)
    if not np.isfinite(above_K):
        return None

    def quality(per_K: float) -> Quality:
        return quality_of(water(per_K).factor(T_return_C))

    def water(per_K: float) -> ReturnWater:
        return ReturnWater(per_K, reference, (low - _TRUST_K, high + _TRUST_K), above_K)

    def fitted(step_W: float) -> float:
        def loss(per_K: float) -> float:
            found = quality(per_K)
            return found.n_running * (found.rmse_W / step_W) ** 2 + ((per_K - _PRIOR_PER_K) / _PRIOR_SD_PER_K) ** 2

        return float(minimize_scalar(loss, bounds=_BOUNDS_PER_K, method="bounded", options={"xatol": 1e-5}).x)

    least_W = RESIDUAL_SCALE * full_W
    return water(fitted(max(least_W, quality(fitted(least_W)).step_W)))


@dataclass(frozen=True)
class SlopePrior:
    """Prior of (1/load) · d load/d T_out: mean and standard deviation, 1/K.

    A few days of one season contain little information on it, and plans extend to colder or warmer days.
    """

    mean_per_K: float
    sd_per_K: float


POWER_SLOPE = SlopePrior(0.0, 0.015)
"""Electric power at a given speed hardly depends on the outdoor temperature: its efficiency does, by 2.3 % per K
(see above), but nearly all of that is heat."""


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
    foreign: OtherLoad | None = None
    water_s: float | None = None

    def metered(self, u: Array, time_s: Array, T_out_C: Array, T_return_C: Array | float = float("nan")) -> Array:
        """Return what the meter shows over steps that start at `time_s`, s since 1 January; others as `__call__`."""
        own = self(u, T_out_C, T_return_C)
        return own if self.foreign is None else own + self.foreign(time_s, T_out_C)

    def seen(self, u: Array, time_s: Array, T_out_C: Array, meter_W: Array) -> PowerModel:
        """Itself, or without the other load where the meter (n,) does not hold that any more, see `OtherLoad.there`."""
        gone = self.foreign is not None and time_s.size and not self.foreign.there(u, time_s, T_out_C, meter_W)[-1]
        return replace(self, foreign=None) if gone else self

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
        lambda factor: fit(factor=factor, squares=squares).quality,
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
    from scipy.linalg import block_diag

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
    from scipy.optimize import lsq_linear

    def fitted(scale_W: float) -> Array:
        rows = np.vstack([design / scale_W, prior])
        values = np.concatenate([load_W / scale_W, np.zeros(len(prior))])
        return np.asarray(lsq_linear(rows, values, bounds=(LEAST_W, np.inf)).x)

    first = fitted(RESIDUAL_SCALE * full_W)
    error = (design @ first - load_W)[running]
    return fitted(error_of_a_step(error, RESIDUAL_SCALE * full_W)) if len(prior) else first


# Excess of power per heat at half level from which a machine of several actuators is switched. Below it is what a few
# days of data leave uncertain: an exponent of a radiator that is wrong by 0.2 looks like a fixed part of 8 %.
SWITCH_FROM = 0.1
# Share of full power by which power jumps as a machine starts from which a fixed part is believed where heat is not
# metered: 0.064 to 0.126 of three generated heat pumps with a fixed loss, 0.000 to 0.005 of four machines without
# (houses 7, 11, 15 and 1, 5, 8 of seed 62110, 5 of 110629, 2026-11-29).
_LEAST_START = 0.03
# Excess of the cost of heat over that of full level, and over that of the cheapest level, up to which a lower one is
# taken all the same: it moves a room less. By judgement: as exact as the cost of heat is known (`_COST_SD` of
# `effects.level_laws`).
_SAME_AS_FULL, _SAME_AS_CHEAPEST = 0.03, 0.02
# Names on the model card (`ModelCard.uncertainty`).
_COST, _COST_SD = "cost_of_heat_at_level_", "cost_of_heat_sd_at_level_"
_HEAT, _HEAT_SD = "heat_per_level_at_level_", "heat_per_level_sd_at_level_"
# Share of full power by which a middle level is above the line from the lowest to full level where a machine is at its
# limit; a fixed part, and water that gets hotter, leave none. Power that a low level takes already: no fixed part is.
# By judgement.
_BENT, _FLAT = 0.1, 0.7
# Weight of full level, which is 1 by definition, in the fit of the shape.
_EXACT = 1e3


@dataclass(frozen=True)
class LevelCost:
    """Power per heat at `level` over that at full level (`cost`), heat per level likewise, and their deviations."""

    level: float
    cost: float
    cost_sd: float
    heat: float
    heat_sd: float

    def numbers(self) -> dict[str, float]:
        """As numbers for a model card."""
        at, values = f"{self.level:.3f}", (self.cost, self.cost_sd, self.heat, self.heat_sd)
        return {name + at: value for name, value in zip((_COST, _COST_SD, _HEAT, _HEAT_SD), values, strict=True)}

    def __str__(self) -> str:
        return (
            f"at level {self.level:.2f} heat costs {self.cost:.2f} ± {self.cost_sd:.2f} times as much as at full level"
        )


def level_costs(uncertainty: Mapping[str, float]) -> tuple[LevelCost, ...]:
    """Read costs from the numbers of a model card, by level; empty where there are none."""
    at = sorted(name.removeprefix(_COST) for name in uncertainty if name.startswith(_COST))
    names = (_COST, _COST_SD, _HEAT, _HEAT_SD)
    return tuple(LevelCost(float(level), *(uncertainty[name + level] for name in names)) for level in at)


def cheapest(costs: Sequence[LevelCost]) -> LevelCost | None:
    """The lowest of the levels at which heat costs about least; None: that is full level."""
    least = min([1.0 + _SAME_AS_FULL - _SAME_AS_CHEAPEST, *(one.cost for one in costs)])
    as_cheap = [one for one in costs if one.cost <= least + _SAME_AS_CHEAPEST]
    return min(as_cheap, key=lambda one: one.level, default=None)


def at_its_limit(costs: Sequence[LevelCost]) -> bool:
    """Whether power hardly rises above a middle level: a machine at a limit gives no more heat there either."""
    levels = [one.level for one in costs] + [1.0]
    power = [one.cost * one.heat * one.level for one in costs] + [1.0]
    flat = len(costs) > 0 and levels[0] < 0.5 and power[0] > _FLAT
    return flat or any(
        middle > np.interp(level, [levels[0], 1.0], [power[0], 1.0]) + _BENT
        for level, middle in zip(levels[1:-1], power[1:-1], strict=True)
    )


def start_share(costs: Sequence[LevelCost]) -> float:
    """The share of full power by which power jumps as the machine starts: that of the two lowest levels which were
    tried, their line drawn to level 0. Below 0 where power rises more than in proportion; 0 without a level.
    """
    if not costs:
        return 0.0
    tried = sorted((one.level, one.cost * one.heat * one.level) for one in costs)
    (u1, power1), (u2, power2) = [*tried, (1.0, 1.0)][:2]
    return (power1 * u2 - power2 * u1) / (u2 - u1)


@dataclass(frozen=True)
class PowerShape:
    """Power over the level, as shares of that at full level: `fixed` while on, `per_u` of u and `curve` of u²."""

    fixed: float
    per_u: float
    curve: float

    @classmethod
    def through(cls, costs: Sequence[LevelCost], heat: Sequence[float]) -> PowerShape:
        """The shape nearest to what heat costs, none of its parts below 0.

        `heat`: heat at each level of `costs`, as a share of that of full level, by the model that plans.
        """
        from scipy.optimize import nnls

        u = np.array([*(one.level for one in costs), 1.0])
        power = np.array([*(one.cost * share for one, share in zip(costs, heat, strict=True)), 1.0])
        weights = np.append(1.0 / u[:-1], _EXACT)
        parts, _ = nnls(weights[:, None] * np.stack([np.ones(u.size), u, u**2], axis=1), weights * power)
        return cls(*(parts / parts.sum()))

    def of(self, power: PowerModel) -> PowerModel:
        """A machine's power with this shape, and at full level as it is.

        What warm water takes is not in the shape, which compares levels in the same water, and is added to it.
        """
        load, water_W = power.load, power.load.curve_W if power.water_s else 0.0
        low, high = load.T_out_range_C
        (fixed_low, per_low), (fixed_high, per_high) = load.parts(low), load.parts(high)
        other_W = load.curve_W - (1.0 - COMPARED_AT) * water_W
        full_low, full_high = (float(x) + other_W for x in (fixed_low + per_low, fixed_high + per_high))
        curve_W = self.curve * min(full_low, full_high)
        slope = (full_high - full_low) / max(high - low, 1e-9)
        # What the part in u², which has no slope over the outdoor temperature, lacks is in the part per level.
        total = (full_low - curve_W - slope * low, slope)
        share = self.fixed / max(self.fixed + self.per_u, 1e-9)
        rest = 1.0 - share
        # A little of the part per level is left, so that rounding cannot make it negative.
        cold_W = min(COMPARED_AT * water_W, 0.99 * rest * (min(full_low, full_high) - curve_W))
        coefficients = (share * total[0], share * total[1], rest * total[0] - cold_W, rest * total[1])
        curve_W += cold_W / COMPARED_AT
        return replace(power, load=MachineLoad(coefficients, load.T_out_range_C, load.lowest_level, curve_W=curve_W))


@dataclass(frozen=True)
class PartLoad:
    """Shares of full power and full heat that do not depend on the level while the machine runs, in middling weather.

    `heat_fixed` is 0 where heat is not measured and counts as proportional to the level.
    """

    power_fixed: float
    heat_fixed: float

    @property
    def at_half(self) -> float:
        """Power per heat at half level over that at full level."""
        return self.at(0.5)

    def at(self, level: float) -> float:
        """Power per heat at `level` over that at full level."""
        more = 1.0 / level - 1.0
        return (1.0 + more * self.power_fixed) / (1.0 + more * self.heat_fixed)

    def __str__(self) -> str:
        return (
            f"{100 * self.power_fixed:.0f} % of full power and {100 * self.heat_fixed:.0f} % of full heat are a fixed "
            f"part while on, and heat takes {self.at_half:.2f} times as much power at half level as at full level"
        )


def part_load(power: PowerModel, heat: MachineLoad | None) -> PartLoad | None:
    """Return the part load of a machine; None if the power law was fitted to off and full level only."""
    law = power.load
    if not law.levels_seen:
        return None
    T = 0.5 * sum(law.T_out_range_C)
    fixed, per_u = (float(part) for part in law.parts(T))
    heat_fixed = 0.0
    if heat is not None and heat.levels_seen:
        heat_on, heat_per_u = (float(part) for part in heat.parts(T))
        heat_fixed = heat_on / (heat_on + heat_per_u)
    return PartLoad(fixed / (fixed + per_u), heat_fixed)


def fixed_part(
    power: PowerModel, heat: MachineLoad | None, costs: Sequence[LevelCost], *, shared: bool
) -> PartLoad | None:
    """What the laws say of part load, where they show a fixed part for which a machine is switched at full level.

    `costs`: what heat costs at levels that were tried; `shared`: the machine feeds other actuators too, whose levels
    say what it costs.
    """
    laws = part_load(power, heat)
    if laws is None or laws.at_half <= 1.0 + SWITCH_FROM:
        return None
    if shared or not costs:
        return laws
    # The meter knows a fixed part that a few days do not leave uncertain; the heat of a level from temperatures is
    # known to a tenth at best, and the water of the steps at part load was cooler where it is a factor of power.
    # A law of power that bends down to full level looks like a fixed part too, without a start.
    guessed = heat is None and not at_its_limit(costs)
    started = guessed and start_share(costs) > _LEAST_START
    return laws if cheapest(costs) and (started or power.water) else None
