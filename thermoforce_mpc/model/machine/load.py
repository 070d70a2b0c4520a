"""Heat or electric power of a machine as a function of its level and the outdoor temperature, and its regression.

A machine with a fixed part while it runs has the load `on·(c0 + c1·T_out) + u·(c2 + c3·T_out)`. Below `lowest_level` a
mean level u is made by cycling, so the share of time it runs is `on = min(u / lowest_level, 1)`: 1.0 is a pure on/off
machine, with a load proportional to u; a small value is a modulating machine. Where the plan sets the temperature of
the water, a heat pump's power grows faster than the heat: a term `curve·u²`. An affine law is nonnegative on an
interval exactly if it is at both ends, so the unknowns of a regression are the end values, bounded below.

A machine of several actuators gives what they take together. Below a load ℓ, a share of its capacity, it cycles: with
the set S of actuators on it runs for f(S) = min(Σ_{a in S} w_a, 1) of the time, w_a = share_a / ℓ. On-times that begin
together are nested, so over a step it runs for ∫₀¹ f({a: on_a > τ}) dτ. That is the Lovász extension of f, convex in
the on-times because f is submodular (Lovász 1983; Bach 2013, Learning with Submodular Functions, prop. 3.6). By duality

    running  =  min_{θ ≥ 0}  θ + Σ_a w_a max(on_a − θ, 0)                                          θ: time at ℓ or above

Errors of 15-minute steps go on for hours. What a step counts with in each law that is fitted by least squares, and in
what else is (paths in `thermoforce_mpc`):

| law | in | a step counts with |
|---|---|---|
| power, its slope, return water | `model/machine/power.py` | `error_of_a_step` |
| other loads on a meter | `model/machine/other_load.py` | `error_of_a_step` |
| heat of circuits | `identification/network/circuits.py` | `error_of_a_step` |
| shares of valves by the power of their machine | `identification/effects/couplings.py` | `error_of_a_step` |
| pole and gain of the two-stage estimator | `identification/zones/two_stage.py` | `error_of_a_step` |
| heat over the level | `model/machine/heat_capacity.py` | 2 % of full heat that lasts for 3 h |
| free response by weather | `model/free_response/linear_weather.py` | errors that last a step, and a day |
| what a record tells against itself | `measurements/checks/common.py` | covariance of Newey and West |
| delay of what acts | `measurements/checks/timing.py` | nothing: the best of some is taken |
| effect of an hour of the day | `model/machine/blocked_hours.py` | one error a day |
| change of a machine since it was identified | `model/machine/change.py` | days, drawn again |
| maps of commands | `commands/loop.py` | days, drawn again |
| energy before and after a measure | `whatif/saving.py` | days, with their correlation |
| modes nearest to an operator, of no record | `identification/network/projection.py` | – |
| effects by pairs of runs | `identification/estimation/rest.py` | a fixed error: weather and people fall out |

Emitters, rooms and levels are in the likelihood of the network, whose states are disturbed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError

# A level in (LEVEL_EDGE, 1 − LEVEL_EDGE) is intermediate; outside it is off or full.
LEVEL_EDGE = 0.02
# Level from which full level counts as seen: the rest is extrapolated by a tenth. On two buildings 0.87 does the same
# (`python -m benchmarks.constants`, 2026-11-28).
NEARLY_FULL = 0.9
# Heat below this share of what the level stands for was not given: a machine is at its limit. Set with the changes per
# hour of `controllers.mpc.margins` on `house:3rooms:60` and `house:5rooms`, whose cold weeks they took from 4.65 to
# 0.19 and from 0.34 to 0.21 K·h (2026-11-22).
LACKING = 0.8
# Lower bound of the end values, W, above zero so that rounding cannot make a load negative.
LEAST_W = 1e-3
# Least share of steps with measured heat or power, so that they are those of usual days and not of a few.
MEASURED = 0.5
# Least number of intermediate samples to separate the fixed and the proportional part. By judgement, as the numbers of
# steps below.
_MIN_LEVELS = 3
_MIN_STEPS, LEAST_RUNNING = 10, 5
# Standard deviation of a step's error as a share of full load (dynamics inside the step, model error). By judgement.
RESIDUAL_SCALE = 0.02
# Extrapolation of the affine law beyond the outdoor temperatures of the data, K; beyond, its value is held. By
# judgement: probing of mild days is used on cold ones.
TRUST_K = 15.0


@dataclass(frozen=True)
class MachineLoad:
    """Load `on(u)·(c0 + c1·T) + u·(c2 + c3·T) + curve·u²`, W: common form of a machine's heat and electric power.

    `coefficients` are (c0, c1, c2, c3) in W, W/K, W, W/K. Outside `T_out_range_C` T_out is held at the nearer end,
    since an affine law may become negative. `levels_seen`: whether the data had intermediate levels, which separate c0
    from c2. `curve_W`: 0 but for the power of a machine whose water the plan sets. Raises `DataError` for a load that
    decreases in u at an end of the range, or a number that is not finite.
    """

    coefficients: tuple[float, float, float, float]
    T_out_range_C: tuple[float, float]
    lowest_level: float = 1.0
    levels_seen: bool = True
    curve_W: float = 0.0

    def __post_init__(self) -> None:
        low, high = self.T_out_range_C
        if not np.isfinite([*self.coefficients, low, high, self.lowest_level, self.curve_W]).all():
            raise DataError(f"load of the actuator is not finite: {self}")
        if self.curve_W < 0.0:
            raise DataError(f"load of the actuator bends downwards: {self.curve_W:g} W at full level")
        if not low <= high:
            raise DataError(f"outdoor range of the actuator is reversed: {low} to {high} °C")
        if not 0.0 < self.lowest_level <= 1.0:
            raise DataError(f"lowest level of the actuator is {self.lowest_level}, expected a value in (0, 1]")
        for T in (low, high):
            fixed, slope = self.parts(T)
            if fixed < 0 or slope < 0 or fixed + slope <= 0:
                raise DataError(
                    f"load of the actuator is not increasing in u at T_out = {T:g} °C "
                    f"(fixed part {fixed:g} W, proportional part {slope:g} W)"
                )

    def parts(self, T_out_C: Array | float) -> tuple[Array, Array]:
        """Return the fixed part while on and the part per unit of u at `T_out_C` °C, both W."""
        low, high = self.T_out_range_C
        T = np.minimum(np.maximum(T_out_C, low), high)
        c0, c1, c2, c3 = self.coefficients
        return np.asarray(c0 + c1 * T), np.asarray(c2 + c3 * T)

    def on_share(self, u: Array) -> Array:
        """Return the share of the step the machine runs, shape of `u`."""
        u = np.asarray(u, dtype=np.float64)
        return u if self.lowest_level == 1.0 else np.minimum(u / self.lowest_level, 1.0)

    def __call__(self, u: Array, T_out_C: Array) -> Array:
        """Return the load for `u` in [0, 1] at `T_out_C` °C (shapes broadcast), W."""
        fixed, per_u = self.parts(T_out_C)
        u = np.asarray(u, dtype=np.float64)
        return np.asarray(self.on_share(u) * fixed + u * per_u + self.curve_W * u**2)

    def slope_bounds(self) -> tuple[float, float]:
        """Return the smallest and largest ∂load/∂u over u in [0, 1] and the outdoor range, W."""
        slopes: list[float] = []
        for T in self.T_out_range_C:
            fixed, slope = self.parts(T)
            below = fixed / self.lowest_level + slope
            above = slope if self.lowest_level < 1.0 else below
            slopes += [float(below), float(above) + 2.0 * self.curve_W]
        return min(slopes), max(slopes)

    def at_lowest_level(self, lowest_level: float) -> MachineLoad:
        """The same with another lowest level; raises `DataError` below 1 if the data had no intermediate levels."""
        if lowest_level < 1.0 and not self.levels_seen:
            raise DataError(
                "the data have only off and full level, so the load at intermediate levels is unknown: "
                "probe with intermediate levels, or keep lowest_level at 1"
            )
        return replace(self, lowest_level=lowest_level)


def running_share(on: Array, weights: Array) -> Array:
    """Share (..., N) of each step that a machine runs for actuators whose on-times begin together.

    `on` (..., A, N): share of each step that each actuator is on; `weights` (A,): share of the time that the machine
    runs while only that actuator is on, in (0, 1].
    """
    order = np.argsort(-on, axis=-2, kind="stable")
    longest_first = np.take_along_axis(on, order, axis=-2)
    runs = np.minimum(np.cumsum(np.asarray(weights)[order], axis=-2), 1.0)
    # From the end of the next shorter on-time to its own, the machine runs for those on at least that long.
    shorter = np.concatenate([longest_first[..., 1:, :], np.zeros_like(longest_first[..., :1, :])], axis=-2)
    return np.asarray((runs * (longest_first - shorter)).sum(axis=-2))


@dataclass(frozen=True)
class Steps:
    """Usable steps: `u`, `T_out_C` °C, `load_W` W and whether the machine ran, all (n,); `kept`: mask on the input."""

    u: Array
    T_out_C: Array
    load_W: Array
    running: NDArray[np.bool_]
    kept: NDArray[np.bool_]


def usable_steps(u: Array, T_out_C: Array, load_W: Array, what: str) -> Steps:
    """The fully measured steps; raises `DataError` for fewer than 10, fewer than 5 that run, or no load in these."""
    u, T, y = (np.asarray(value, dtype=np.float64) for value in (u, T_out_C, load_W))
    kept = np.isfinite(u) & np.isfinite(T) & np.isfinite(y)
    if kept.sum() < _MIN_STEPS:
        raise DataError(f"{what}: only {int(kept.sum())} of {u.size} steps were measured, need at least {_MIN_STEPS}")
    u, T, y = u[kept], T[kept], y[kept]
    running = u > LEVEL_EDGE
    if running.sum() < LEAST_RUNNING:
        raise DataError(
            f"{what}: the actuator was on in {int(running.sum())} measured steps, need at least {LEAST_RUNNING}"
        )
    mean_W = float(np.mean(y[running]))
    if mean_W <= 0.0:
        raise DataError(f"{what}: its mean while the actuator was on is {mean_W:.4g} W: check the meter and its sign")
    return Steps(u, T, y, running, kept)


def levels_to_try(steps: Steps, lowest_level: float | None) -> list[float]:
    """Return the given lowest level, or 1 (on/off machine) and the lowest intermediate level in the data."""
    if lowest_level is not None:
        return [lowest_level]
    between = steps.running & (steps.u < 1.0 - LEVEL_EDGE)
    return [1.0] + ([float(np.min(steps.u[between]))] if between.sum() >= _MIN_LEVELS else [])


@dataclass(frozen=True)
class EndValues:
    """Affine laws of T_out on [`low_C`, `high_C`] by their end values; `middle_C` is the middle of the data."""

    low_C: float
    high_C: float
    middle_C: float

    @classmethod
    def around(cls, steps: Steps) -> EndValues:
        """Return the range of outdoor temperatures while running, extended by 15 K on both sides."""
        T = steps.T_out_C[steps.running]
        low, high = float(T.min()), float(T.max())
        return cls(low - TRUST_K, high + TRUST_K, 0.5 * (low + high))

    def weights(self, T_out_C: Array | float) -> Array:
        """Return the weights of the two end values at `T_out_C`, shape (…, 2); outside the range, of the nearer end."""
        share = (np.clip(T_out_C, self.low_C, self.high_C) - self.low_C) / (self.high_C - self.low_C)
        return np.stack([1.0 - share, share], axis=-1)

    def sloping(self, mean_per_K: float) -> Array:
        """Return slope − `mean_per_K` times the value in the middle, as weights of the end values, shape (2,)."""
        return np.array([-1.0, 1.0]) / (self.high_C - self.low_C) - mean_per_K * self.weights(self.middle_C)

    def load(self, ends_W: Array, lowest_level: float, curve_W: float = 0.0) -> MachineLoad:
        """Return the load with end values `ends_W` of its parts: (fixed, per u), or per u only for on/off machines."""
        laws = []
        for at_low, at_high in np.reshape(ends_W, (-1, 2)):
            slope = (at_high - at_low) / (self.high_C - self.low_C)
            laws.append((float(at_low - slope * self.low_C), float(slope)))
        fixed, per_u = laws if len(laws) == 2 else [(0.0, 0.0), *laws]
        return MachineLoad(
            coefficients=(*fixed, *per_u),
            T_out_range_C=(self.low_C, self.high_C),
            lowest_level=lowest_level,
            levels_seen=len(laws) == 2,
            curve_W=curve_W,
        )


# Largest correlation of the errors of two steps that is believed. By judgement: 8 h at 15 min.
_MOST_CORRELATED = 0.97


def error_of_a_step(error: Array, least: float) -> float:
    """Standard deviation that a step counts with, whose errors (n,) of a fit follow one another; at least `least`.

    Of n steps whose errors go on with correlation ρ from one to the next, n (1 − ρ) / (1 + ρ) tell anew (first-order
    autoregression). Taken as independent, steps of a few hours outvote any prior.
    """
    sd = rms(error) if error.size else 0.0
    if not sd > 0.0 or error.size < _MIN_STEPS:
        return max(sd, least)
    correlation = float(np.clip(np.mean(error[1:] * error[:-1]) / sd**2, 0.0, _MOST_CORRELATED))
    return max(sd, least) * float(np.sqrt((1.0 + correlation) / (1.0 - correlation)))


@dataclass(frozen=True)
class Quality:
    """Quality of a fit: `rmse_W` over `n_running` steps, with their errors `running_W`, `r2` over all `n_samples`."""

    rmse_W: float
    r2: float
    n_samples: int
    n_running: int
    running_W: Array = field(repr=False, compare=False)

    @property
    def step_W(self) -> float:
        """What each running step counts with, see `error_of_a_step`, W."""
        return error_of_a_step(self.running_W, 0.0)

    @classmethod
    def of(cls, fitted_W: Array, steps: Steps) -> Quality:
        """Return the quality of `fitted_W` (n,) against the measured load."""
        error = fitted_W - steps.load_W
        of_running = error[steps.running]
        variance = float(np.var(steps.load_W))
        return cls(
            rmse_W=rms(of_running),
            r2=1.0 - float(np.mean(error**2)) / variance if variance > 0 else float("nan"),
            n_samples=int(steps.u.size),
            n_running=int(steps.running.sum()),
            running_W=of_running,
        )
