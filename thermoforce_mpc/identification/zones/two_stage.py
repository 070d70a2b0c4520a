"""Two-stage estimator of the paper (section 'Identification under feedback confounding').

First stage: steps with the actuator off are passive and give (a, c, d, e) of paper eq:arx by least squares under
physical box constraints. Second stage: with these fixed, the residual of the steps with the actuator on is regressed on
the drive, and the gain clipped to its physical sign. The model is of order 1. Pairs, if any, correct pole and gain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.data.series import rms, step_means
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H, Effect, RegressionData
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData, fold_of
from thermoforce_mpc.model.free_response.rc import INPUTS, RcParameters
from thermoforce_mpc.model.machine.load import error_of_a_step
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator

# Least steps of each stage, for its four and one parameters: six a parameter, so that errors average out.
MIN_OFF_STEPS = 24
MIN_ON_STEPS = 6
# Scaling of the first stage's four columns to equal size: W/m² are a thousand times larger than their effect in K;
# rounding is what it saves.
SCALE = np.array([1.0, 1.0, 1e-3, 1.0])
# What a model of first order does not follow in a step, and the temperature before the first reading, K. By judgement:
# the paper's estimate, which `two_stage` is, has none of its own.
_LEAST_SD_K = 0.02
_START_SD_K = 10.0
# Bound of e, the constant gains from ground and people, K/h. By judgement.
_CONSTANT_K_PER_H = 3.0


@dataclass(frozen=True)
class TwoStageFit:
    """Parameters of paper eq:arx with standard errors.

    `a` 1, `c` K/K, `d` K per W/m², `e` K and `g` K per step of `step_s` s; `a_sd` and `g_sd` are standard errors of the
    first and second stage, with errors that follow one another (`error_of_a_step`); `n_off` and `n_on` steps used;
    `rmse_K` of the one-step residual over all steps.
    """

    a: float
    c: float
    d: float
    e: float
    g: float
    a_sd: float
    g_sd: float
    n_off: int
    n_on: int
    rmse_K: float
    step_s: float
    sign: int
    heat_input: HeatInput

    def operator(self) -> OperatorParameters:
        """Return the forced part, order 1 with m = 1."""
        return linear_operator(
            np.array([self.a]), np.array([self.g]), step_s=self.step_s, sign=self.sign, heat_input=self.heat_input
        )

    @property
    def log_tau(self) -> Array:
        """ln(τ/h) (1,)."""
        return np.log([-self.step_s / HOUR_S / np.log(self.a)])

    @property
    def slope(self) -> Array:
        """Slope of the step response (1,), K/h, in the direction of the sign."""
        return np.abs([self.g]) / (1.0 - self.a) / np.exp(self.log_tau)

    @property
    def sd_K(self) -> Array:
        """Standard deviations of the step response at `STEP_RESPONSE_H`: those of a and g are of different steps."""
        n = np.maximum(np.round(np.array(STEP_RESPONSE_H) * HOUR_S / self.step_s), 1.0)
        by_g = (1.0 - self.a**n) / (1.0 - self.a)
        by_a = abs(self.g) * (by_g - n * self.a ** (n - 1.0)) / (1.0 - self.a)
        return np.hypot(by_g * self.g_sd, by_a * self.a_sd)

    def free_model(self) -> RcParameters:
        """Return the free part, one mode (paper eq:free-evol)."""
        weights = np.zeros((1, len(INPUTS)))
        weights[0, :3] = self.c, self.d, self.e
        return RcParameters(
            poles=np.array([self.a]),
            weights=weights,
            step_s=self.step_s,
            process_K2=np.array([[max(self.rmse_K, _LEAST_SD_K) ** 2]]),
            start_K2=np.array([[_START_SD_K**2]]),
        )


def fit_two_stage(
    runs: Sequence[Record],
    *,
    heat_input: HeatInput = IDENTITY,
    sign: int = 1,
    u_off: float = 0.02,
    time_constant_h: tuple[float, float] = (1.0, 240.0),
) -> TwoStageFit:
    """Estimate eq:arx from runs with one step.

    Args:
        runs: recorded runs; steps without a measured temperature at both ends are omitted.
        heat_input: v(u, T_out) that drives F; the paper uses the identity.
        sign: +1 heating, −1 cooling: the gain is clipped to it.
        u_off: level up to which a step counts as off.
        time_constant_h: bounds of the pole as time constants, h.

    Raises:
        DataError: too few off or on steps, or different step lengths; gives numbers and what to do.
    """
    T, rise, T_out, solar, u = _columns(runs)
    on = u > u_off
    n_off = int((~on).sum())
    if n_off < MIN_OFF_STEPS or on.sum() < MIN_ON_STEPS:
        raise DataError(
            f"two-stage: {n_off} steps with the actuator off (u ≤ {u_off:g}; need {MIN_OFF_STEPS}) and "
            f"{int(on.sum())} on (need {MIN_ON_STEPS}): record periods of both, or use the joint estimator"
        )
    passive = fit_passive(runs, u_off=u_off, time_constant_h=time_constant_h)
    residual = rise - (-(1.0 - passive.a) * T + passive.c * T_out + passive.d * solar + passive.e)
    drive = heat_input(u, T_out)
    power = float(drive[on] @ drive[on])
    gain = float(drive[on] @ residual[on]) / power
    clipped = sign * max(sign * gain, 0.0)
    return replace(
        passive,
        g=clipped,
        g_sd=error_of_a_step(residual[on] - gain * drive[on], 0.0) / math.sqrt(power),
        n_on=int(on.sum()),
        rmse_K=rms(residual - clipped * drive),
        sign=sign,
        heat_input=heat_input,
    )


def fit_passive(
    runs: Sequence[Record], *, u_off: float = np.inf, time_constant_h: tuple[float, float] = (1.0, 240.0)
) -> TwoStageFit:
    """The first stage alone, on the steps with a level up to `u_off`: by default as if the actuator did nothing.

    Raises:
        DataError: different step lengths.
    """
    from scipy.optimize import lsq_linear

    T, rise, T_out, solar, u = _columns(runs)
    step_s = runs[0].step_s
    off = u <= u_off
    design = np.stack([-T[off], T_out[off], solar[off], np.ones(int(off.sum()))], axis=1)
    low, high = first_stage_bounds(step_s, time_constant_h)
    solution = lsq_linear(design * SCALE, rise[off], bounds=(low / SCALE, high / SCALE)).x * SCALE
    loss, c, d, e = (float(value) for value in solution)
    error, n = design @ solution - rise[off], max(1, int(off.sum()))
    # Of four parameters.
    unbiased = math.sqrt(n / max(1, n - 4))
    a_sd = unbiased * error_of_a_step(error, 0.0) * math.sqrt(np.linalg.pinv(design.T @ design)[0, 0])
    rmse_K = math.sqrt(float(error @ error) / n)
    return TwoStageFit(1.0 - loss, c, d, e, 0.0, a_sd, 0.0, int(off.sum()), 0, rmse_K, step_s, 1, IDENTITY)


def first_stage_bounds(step_s: float, time_constant_h: tuple[float, float]) -> tuple[Array, Array]:
    """Return lower and upper bounds (4,) of (1 − a, c, d, e) in T(t+1) − T(t) = c T_out + d I + e − (1 − a) T."""
    low_loss, high_loss = (1.0 - np.exp(-step_s / HOUR_S / tau) for tau in reversed(time_constant_h))
    constant = _CONSTANT_K_PER_H * step_s / HOUR_S
    return np.array([low_loss, 0.0, 0.0, -constant]), np.array([high_loss, high_loss, np.inf, constant])


def _columns(runs: Sequence[Record]) -> tuple[Array, Array, Array, Array, Array]:
    """Return T, its rise, mean T_out, mean solar and u of each step with both ends measured, (steps,) each."""
    if len(steps := {run.step_s for run in runs}) != 1:
        raise DataError(f"two-stage: the runs have steps of {sorted(steps)} s; resample them to one step")
    parts = []
    for run in runs:
        T = run.T_zone_C[0]
        kept = np.isfinite(T[:-1]) & np.isfinite(T[1:])
        T_out, solar = step_means(run.T_out_C), step_means(run.solar_W_m2)
        parts.append((T[:-1][kept], np.diff(T)[kept], T_out[kept], solar[kept], run.u[0, kept]))
    T, rise, T_out, solar, u = (np.concatenate(part) for part in zip(*parts, strict=True))
    return T, rise, T_out, solar, u


def two_stage_estimate(data: ZoneData) -> Estimate:
    """The two stages as the estimate of a zone, judged on held-out rows of pairs if there are any, else of runs.

    Raises:
        DataError: there are no runs, or too few off or on steps.
    """
    if not data.runs:
        raise DataError("method two_stage needs single runs, none were given; for pairs only use method joint")
    fit, judged = fit_two_stage(data.runs, heat_input=data.heat_input, sign=data.sign), data
    if data.pairs:
        judged = replace(data, runs=())

    def fold(name: str) -> Fold:
        heat_input = data.heat_input_of(name)
        regressions = judged.of_fold(name, heat_input)
        seen = [e.histories[0].slice(0, int(e.rows[e.seen - 1])) for e in regressions if not e.is_pair and e.seen]
        runs = seen or data.runs
        return _fold(regressions, fit_two_stage(runs, heat_input=heat_input, sign=fit.sign), runs)

    everything, unjudged, before = _fold(judged.of_fold("whole", data.heat_input), fit, data.runs), "", None
    try:
        last = fold("training")
    except DataError as error:
        last = _fold(judged.of_fold("training", data.heat_input), fit, data.runs)
        unjudged = f"it cannot be judged without its held-out rows: {error}"
    with suppress(DataError):  # there is no earlier part then
        before = fold("earlier")
    scores = {
        "one_step_rmse_K": fit.rmse_K,
        "off_steps": fit.n_off,
        "on_steps": fit.n_on,
        "acts_log_odds": 0.5 * (fit.g / fit.g_sd) ** 2,
    }
    effect = Effect(everything.log_tau, everything.gains, fit.sd_K)
    return Estimate(everything, last, before, [effect], scores, unjudged=unjudged)


def _fold(regressions: Sequence[RegressionData], fit: TwoStageFit, runs: Sequence[Record]) -> Fold:
    alone = fit_passive(runs).free_model()
    return fold_of(regressions, fit.log_tau, fit.slope, fit.sign, fit.heat_input, fit.free_model(), alone)
