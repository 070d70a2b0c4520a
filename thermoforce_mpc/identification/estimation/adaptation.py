"""Online adaptation of gain, time constants and delivered heat to slow changes of the building.

Every block of `block_h` hours, the residual of the zone temperature after weather, drift and the state before the block
is regressed on the forced response to the block's actions (error of the gain) and on its derivative with respect to the
time constants (error of the time constants): the joint estimator's likelihood, linearised around the operator in use.
Blocks are combined recursively with exponential forgetting. Forgetting applies only when a block is informative, so
that weeks without excitation neither wind up nor widen the estimate (Åström and Wittenmark, Adaptive Control, on
estimator wind-up).

The gain stays within a band around the identified one, poles within their bounds, and an operator whose certificate
fails is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.linalg import cho_factor, cho_solve

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.likelihood import residuals
from thermoforce_mpc.identification.estimation.regression import run_regression
from thermoforce_mpc.model.forced_history import forced_history, heat_drive
from thermoforce_mpc.model.gaps import WEATHER, bridged
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.rollout import driven_rollout
from thermoforce_mpc.model.zone_model import ZoneModel
from thermoforce_mpc.scenario.settings import StrictModel

# Level above which a step counts as on, and least hours on to compare measured heat with the map.
_ON, _LEAST_ON_H = 0.02, 0.5
# Relative standard deviation of a block's measured heat against the map for an unchanged machine.
_HEAT_SD = 0.05
# Step of the derivative with respect to ln τ.
_DERIVATIVE_STEP = 0.01
# Least share of measured temperatures, levels and weather in a block.
_LEAST_MEASURED = 0.8


class AdaptationConfig(StrictModel):
    """Options of the online adaptation."""

    enabled: bool = Field(False, description="adapt the operator online")
    block_h: float = Field(12.0, ge=3, le=168, description="length of a block, h")
    forgetting_days: float = Field(10.0, gt=0, description="time constant of exponential forgetting, days")
    gain_sd: float = Field(0.15, gt=0, le=1, description="prior relative standard deviation of the gain")
    time_constant_sd: float = Field(0.05, gt=0, le=1, description="the same for time constants")
    gain_bounds: tuple[float, float] = Field(
        (0.5, 1.5), description="bounds of the gain as factors of the identified gain"
    )
    disturbance_scale: float = Field(
        0.4, gt=0, le=2, description="disturbances as a fraction of those assumed in identification"
    )
    least_information: float = Field(
        0.1, gt=0, lt=1, description="least share of the gain's prior variance that a block must remove to be used"
    )

    @model_validator(mode="after")
    def _check_gain_bounds(self) -> AdaptationConfig:
        low, high = self.gain_bounds
        if not 0 < low <= 1 <= high:
            raise ValueError(f"gain_bounds must be positive and include 1, got {self.gain_bounds}")
        return self


Outcome = Literal["updated", "not informative", "not measured", "refused"]


@dataclass(frozen=True)
class AdaptationStep:
    """Result of one block that ended at `time_s`.

    `information` is the share of the gain's prior variance the block can remove; `gain`, `time_constants` and `heat`
    are factors on the identified values after the block; `gain_sd` is the gain's relative standard deviation.
    """

    time_s: float
    outcome: Outcome
    information: float
    gain: float
    time_constants: float
    heat: float
    gain_sd: float


@dataclass(frozen=True)
class AdaptationState:
    """State of the adaptation in a run: the `model` in use and the results of all blocks (`steps`).

    `log_factors` (2,) are the logarithms of the factors on the identified gain and time constants, with `covariance`
    (2, 2); `log_heat` and `heat_variance` the same for the delivered heat. The next block begins at `done_s`, s.
    """

    model: ZoneModel
    log_factors: Array
    covariance: Array
    log_heat: float
    heat_variance: float
    done_s: float | None = None
    steps: tuple[AdaptationStep, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.log_factors, self.covariance):
            array.setflags(write=False)

    @property
    def factors(self) -> tuple[float, float, float]:
        """Logarithms of the factors on gain, time constants and heat: all of what `model` differs in."""
        return float(self.log_factors[0]), float(self.log_factors[1]), self.log_heat

    @property
    def adapted(self) -> bool:
        """Whether `model` is another than the identified one."""
        return any(self.factors)

    def noted(self, time_s: float, outcome: Outcome, information: float) -> AdaptationState:
        """Return this state with the result of a block that ended at `time_s` appended."""
        gain, slower = np.exp(self.log_factors)
        step = AdaptationStep(
            time_s=time_s,
            outcome=outcome,
            information=information,
            gain=float(gain),
            time_constants=float(slower),
            heat=float(np.exp(self.log_heat)),
            gain_sd=float(np.sqrt(self.covariance[0, 0])),
        )
        return replace(self, steps=(*self.steps, step))


class OnlineAdaptation:
    """Recursive estimator of the adaptation; call `update` every step, it computes when a block is complete."""

    def __init__(
        self,
        model: ZoneModel,
        config: AdaptationConfig | None = None,
        identification: IdentificationConfig | None = None,
        n_steps: int = 48,
    ) -> None:
        """Start from an identified model.

        Args:
            model: identified model; its free part and power model do not change.
            config: options.
            identification: sizes of disturbances and sensor noise; default: `IdentificationConfig()`.
            n_steps: steps of the horizon over which an adapted operator must be certified.
        """
        self.config, self._n_steps = config or AdaptationConfig(), n_steps
        c = self.config
        assumed = identification or IdentificationConfig()
        self._assumed = assumed.model_copy(
            update={"disturbance_sd_K": tuple(c.disturbance_scale * sd for sd in assumed.disturbance_sd_K)}
        )
        self._identified = model
        self._least = np.diag([c.gain_sd**2, c.time_constant_sd**2])

    def update(self, state: AdaptationState | None, history: Record) -> AdaptationState:
        """Return the state after all complete new blocks of `history`.

        Args:
            state: result of the last update of this run; None at its start.
            history: record of the run so far, or of its latest days; earlier blocks are not used again.

        Raises:
            DataError: the weather was never measured, see `thermoforce_mpc.model.gaps`.
        """
        if state is None:
            state = self.started()
        if not self.config.enabled or history.n_steps == 0:
            return state
        n = max(2, round(self.config.block_h * HOUR_S / history.step_s))
        done_s = float(history.time_s[0]) if state.done_s is None else state.done_s
        while True:
            first = int(np.searchsorted(history.time_s, done_s - 0.5 * history.step_s))
            if first + n > history.n_steps:
                return replace(state, done_s=done_s)
            state = self._after_block(state, history, first, first + n)
            done_s = float(history.time_s[first + n])

    def started(self) -> AdaptationState:
        """Return the state at the start of a run: the model as identified."""
        return AdaptationState(self._identified, np.zeros(2), self._least.copy(), 0.0, self.config.gain_sd**2)

    def rescaled(self, state: AdaptationState, gain: float, heat: float) -> AdaptationState | None:
        """Return `state` with its gain times `gain` and heat `heat` times the identified; None if not certified.

        Both stay within `gain_bounds`; where heat is not modelled, `heat` has no effect.
        """
        low, high = self.config.gain_bounds
        log_factors = self._bounded(state.log_factors + np.array([np.log(gain), 0.0]))
        log_heat = float(np.log(np.clip(heat, low, high)))
        return self._rebuilt(replace(state, log_factors=log_factors, log_heat=log_heat))

    def _after_block(self, state: AdaptationState, history: Record, start: int, stop: int) -> AdaptationState:
        """Return the state after one block: steps `start` … `stop` − 1."""
        time_s = float(history.time_s[stop])
        known_u = np.isfinite(history.u[0, start:stop])
        weather = [np.isfinite(getattr(history, name)[start : stop + 1]).mean() for name in WEATHER]
        if min(np.isfinite(history.T_zone_C[0, start : stop + 1]).mean(), known_u.mean(), *weather) < _LEAST_MEASURED:
            return state.noted(time_s, "not measured", 0.0)
        history, _ = bridged(history)
        fading = float(np.exp((history.time_s[stop] - history.time_s[start]) / DAY_S / self.config.forgetting_days))
        before, state = state, self._heat_factor_updated(state, history, start, stop, fading, known_u)
        operator = before.model.operator.resampled(history.step_s)
        target, covariance, columns = self._regression(operator, history, start, stop)
        factor = cho_factor(covariance)
        information = columns.T @ cho_solve(factor, columns)
        score = columns.T @ cho_solve(factor, target)
        # Information on the gain after marginalising the time constants' error.
        gain_information = information[0, 0] - information[0, 1] ** 2 / (
            information[1, 1] + 1.0 / before.covariance[1, 1]
        )
        share = float(1.0 - 1.0 / (1.0 + gain_information * self._least[0, 0]))
        if share < self.config.least_information:
            return (self._rebuilt(state) or state).noted(time_s, "not informative", share)
        prior = self._faded(before.covariance, fading)
        posterior = np.linalg.inv(np.linalg.inv(prior) + information)
        # The columns are derivatives at the current factors, so posterior @ score is the step from there.
        log_factors = self._bounded(before.log_factors + posterior @ score)
        updated = self._rebuilt(replace(state, log_factors=log_factors, covariance=posterior))
        return updated.noted(time_s, "updated", share) if updated else state.noted(time_s, "refused", share)

    def _faded(self, covariance: Array, fading: float) -> Array:
        """Return the covariance (2, 2) after forgetting, with variances at most those of the prior."""
        widened = covariance * fading
        scale = np.minimum(1.0, np.sqrt(np.diag(self._least) / np.diag(widened)))
        return np.asarray(widened * np.outer(scale, scale))

    def _regression(
        self, operator: OperatorParameters, history: Record, start: int, stop: int
    ) -> tuple[Array, Array, Array]:
        """Return the block's residual (rows,), its covariance (rows, rows), and dF/d(ln gain, ln τ) (rows, 2); K."""
        block = history.slice(start, stop)
        regression = run_regression(block, operator.heat_input, self._assumed)
        rest = residuals(regression, np.log(operator.time_constants_h))
        forced = forced_history(single(operator), history)[0, 0, start:stop]
        T_zone = _interpolated(block.T_zone_C[0])[:-1]
        features = feature_matrix(
            T_zone - forced.sum(axis=1), block.T_out_C[:-1], block.solar_W_m2[:-1], block.time_s[:-1]
        )
        drive = (
            operator.modulation(operator.seen(features, forced)) * heat_drive(single(operator), history, start, stop)[0]
        )
        effect = _response(operator, drive)[regression.rows]
        slower, faster = (
            _response(_scaled(operator, 0.0, shift), drive)[regression.rows]
            for shift in (_DERIVATIVE_STEP, -_DERIVATIVE_STEP)
        )
        columns = np.stack([effect, (slower - faster) / (2.0 * _DERIVATIVE_STEP)], axis=1)
        return regression.target - rest.mean - effect, rest.covariance, columns

    def _heat_factor_updated(
        self,
        state: AdaptationState,
        history: Record,
        start: int,
        stop: int,
        fading: float,
        known_u: NDArray[np.bool_],
    ) -> AdaptationState:
        """Return the state with the heat factor updated from measured heat, over steps on with a known level."""
        heat = self._identified.operator.heat_input.law
        if heat is None:
            return state
        u, Q = history.u[0, start:stop], history.heat_W[0, start:stop] * self._identified.operator.sign
        used = np.isfinite(Q) & (u > _ON) & known_u
        if used.sum() * history.step_s < _LEAST_ON_H * HOUR_S:
            return state
        expected = heat(u[used], history.T_out_C[start:stop][used])
        ratio = float(expected @ Q[used] / (expected @ expected))
        low, high = self.config.gain_bounds
        log_ratio = float(np.log(np.clip(ratio, low, high)))
        variance = min(state.heat_variance * fading, self.config.gain_sd**2)
        gain = variance / (variance + _HEAT_SD**2)
        log_heat = state.log_heat + gain * (log_ratio - state.log_heat)
        return replace(state, log_heat=log_heat, heat_variance=(1.0 - gain) * variance)

    def _bounded(self, state: Array) -> Array:
        """Return the log factors (2,) clipped to the gain's band and the pole bounds."""
        low, high = np.log(self.config.gain_bounds)
        operator = self._identified.operator
        tau, bounds = operator.time_constants_h, operator.pole_bounds
        with np.errstate(divide="ignore"):
            edges = operator.step_s / HOUR_S / np.abs(np.log(bounds))  # pole bounds 0 and 1 give τ = 0 and ∞
            shifts = np.log(edges / tau[:, None])
        return np.array(
            [
                np.clip(state[0], low, high),
                np.clip(state[1], min(shifts[:, 0].max(), 0.0), max(shifts[:, 1].min(), 0.0)),
            ]
        )

    def _rebuilt(self, state: AdaptationState) -> AdaptationState | None:
        """Return `state` with the model of its factors; None if that is not certified."""
        base = self._identified.operator
        operator = _scaled(base, float(state.log_factors[0]), float(state.log_factors[1]))
        load = base.heat_input.law
        if load is not None:
            # The heat of v = 1 scales with the machine, and the gain per v with it.
            factor = float(np.exp(state.log_heat))
            c0, c1, c2, c3 = (factor * c for c in load.coefficients)
            weaker = replace(load, coefficients=(c0, c1, c2, c3))
            operator = replace(operator, heat_input=base.heat_input.with_law(weaker), gains=operator.gains * factor)
        if not certificate(operator, self._n_steps).certified:
            return None
        return replace(state, model=replace(self._identified, operator=operator))


def _scaled(operator: OperatorParameters, log_gain: float, log_tau: float) -> OperatorParameters:
    """Return the operator with steady gains × exp(`log_gain`), time constants × exp(`log_tau`); pole bounds widen."""
    tau = operator.time_constants_h * np.exp(log_tau)
    poles = np.exp(-operator.step_s / HOUR_S / tau)
    bounds = operator.pole_bounds
    return replace(
        operator,
        poles=poles,
        gains=np.exp(log_gain) * operator.steady_gains_K * (1.0 - poles),
        pole_bounds=np.stack([np.minimum(bounds[:, 0], poles), np.maximum(bounds[:, 1], poles)], axis=1),
    )


def _response(operator: OperatorParameters, drive: Array) -> Array:
    """Return the forced response (n + 1,) K of the linear modes to a drive (n,), starting from 0."""
    modes = driven_rollout(operator, np.zeros(operator.order), drive)
    return np.concatenate([[0.0], modes.sum(axis=-1)])


def _interpolated(values: Array) -> Array:
    """Return `values` with gaps filled by linear interpolation."""
    steps, finite = np.arange(values.size), np.isfinite(values)
    return np.asarray(np.interp(steps, steps[finite], values[finite]))
