"""Online adaptation: gain, time constants and delivered heat follow a building that slowly changes.

Twice a day or so, a block of the latest hours is looked at. What neither weather, nor drift, nor what happened before
the block explains is regressed on what the block's own actions should have done (the gain's error) and on how that
would change with slower modes (the time constants' error): the joint estimator's likelihood, linearised around the
operator in use. Blocks are combined recursively: the precision of what was known fades with a time constant
(exponential forgetting), but only when a block brings information of its own, so that weeks without excitation neither
wind the estimate up nor blur it (Åström and Wittenmark, Adaptive Control, on estimator wind-up).

Nothing leaves the bounds: the gain stays inside a band around the identified one, poles inside their own bounds, and an
operator whose certificate fails is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import lfilter

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.likelihood import residuals
from thermoforce_mpc.identification.regression_data import run_regression
from thermoforce_mpc.model.forced_history import forced_history, heat_drive
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.scenario.settings import StrictModel

# Steps that are on, and hours of them, from which measured heat can be compared with the map.
_ON, _LEAST_ON_H = 0.02, 0.5
# Relative error of one block's mean measured heat against the map, even when the machine is as identified.
_HEAT_SD = 0.05
# Step of the derivative with respect to ln τ.
_DERIVATIVE_STEP = 0.01
# Share of the block's temperatures that must have been measured.
_LEAST_MEASURED = 0.8


class AdaptationConfig(StrictModel):
    """Whether and how the operator follows the building while it is controlled."""

    enabled: bool = Field(False, description="adapt the operator online")
    block_h: float = Field(12.0, ge=3, le=168, description="hours looked at together, h")
    forgetting_days: float = Field(10.0, gt=0, description="time constant with which earlier data are forgotten, days")
    gain_sd: float = Field(0.15, gt=0, le=1, description="relative uncertainty of the gain before the first block")
    time_constant_sd: float = Field(0.05, gt=0, le=1, description="the same of the time constants")
    gain_bounds: tuple[float, float] = Field((0.5, 1.5), description="least and most of the identified gain")
    disturbance_scale: float = Field(
        0.4, gt=0, le=2, description="size of unexplained disturbances, as a share of what identification assumes"
    )
    least_information: float = Field(
        0.1, gt=0, lt=1, description="share of the gain's variance that a block must be able to remove to be used"
    )

    @model_validator(mode="after")
    def _ordered(self) -> AdaptationConfig:
        low, high = self.gain_bounds
        if not 0 < low <= 1 <= high:
            raise ValueError(f"gain_bounds must be positive and hold 1 between them, got {self.gain_bounds}")
        return self


@dataclass(frozen=True)
class AdaptationStep:
    """What one block did: end `time_s`; `outcome`; `information` the share of the gain's variance it could remove;
    factors on the identified gain, time constants and delivered heat after it; relative standard deviation of the gain.
    """

    time_s: float
    outcome: Literal["updated", "not informative", "not measured", "refused"]
    information: float
    gain: float
    time_constants: float
    heat: float
    gain_sd: float


class OnlineAdaptation:
    """Follows one run. Call `update` with the history at every step; work is done when a block is complete."""

    def __init__(
        self,
        model: ThermalModel,
        config: AdaptationConfig | None = None,
        identification: IdentificationConfig | None = None,
    ) -> None:
        """Start from an identified model.

        Args:
            model: what was identified; its free part and power are left as they are.
            config: options.
            identification: sizes of disturbances and sensor noise; by default those of an identification.
        """
        self.config = config or AdaptationConfig()
        c = self.config
        assumed = identification or IdentificationConfig()
        self._assumed = assumed.model_copy(
            update={"disturbance_sd_K": tuple(c.disturbance_scale * sd for sd in assumed.disturbance_sd_K)}
        )
        self._identified = self._model = model
        self._least = np.diag([c.gain_sd**2, c.time_constant_sd**2])
        self._state, self._covariance = np.zeros(2), self._least.copy()
        self._log_heat, self._heat_variance = 0.0, c.gain_sd**2
        self._done_s: float | None = None
        self._steps: list[AdaptationStep] = []

    @property
    def model(self) -> ThermalModel:
        """The model as adapted so far."""
        return self._model

    @property
    def steps(self) -> tuple[AdaptationStep, ...]:
        """What every block so far did."""
        return tuple(self._steps)

    def update(self, history: Record) -> ThermalModel:
        """Take in what is new and return the model to use from now on.

        Args:
            history: the run so far, or its latest days; blocks that were seen before are not looked at again.

        Raises:
            DataError: u or the weather have gaps, see `forced_history.heat_drive`.
        """
        if not self.config.enabled or history.n_steps == 0:
            return self._model
        n = max(2, round(self.config.block_h * HOUR_S / history.step_s))
        if self._done_s is None:
            self._done_s = float(history.time_s[0])
        while True:
            first = int(np.searchsorted(history.time_s, self._done_s - 0.5 * history.step_s))
            if first + n > history.n_steps:
                return self._model
            self._take(history, first, first + n)
            self._done_s = float(history.time_s[first + n])

    def _take(self, history: Record, start: int, stop: int) -> None:
        """One block: steps `start` … `stop` − 1."""
        time_s = float(history.time_s[stop])
        if np.isfinite(history.T_zone_C[start : stop + 1]).mean() < _LEAST_MEASURED:
            return self._note(time_s, "not measured", 0.0)
        fading = float(np.exp((history.time_s[stop] - history.time_s[start]) / DAY_S / self.config.forgetting_days))
        self._follow_heat(history, start, stop, fading)
        operator = self._model.operator.resampled(history.step_s)
        target, covariance, columns = self._regression(operator, history, start, stop)
        factor = cho_factor(covariance)
        information = columns.T @ cho_solve(factor, columns)
        score = columns.T @ cho_solve(factor, target)
        # What is known of the gain once the time constants' error has taken its share.
        known = information[0, 0] - information[0, 1] ** 2 / (information[1, 1] + 1.0 / self._covariance[1, 1])
        share = float(1.0 - 1.0 / (1.0 + known * self._least[0, 0]))
        if share < self.config.least_information:
            self._rebuild()
            return self._note(time_s, "not informative", share)
        prior = self._faded(fading)
        posterior = np.linalg.inv(np.linalg.inv(prior) + information)
        before = self._state, self._covariance
        # The columns are derivatives at the state in use, so the score is a step from there.
        self._state, self._covariance = self._bounded(self._state + posterior @ score), posterior
        if self._rebuild():
            return self._note(time_s, "updated", share)
        self._state, self._covariance = before
        return self._note(time_s, "refused", share)

    def _faded(self, fading: float) -> Array:
        """The covariance after forgetting, nowhere wider than at the start."""
        widened = self._covariance * fading
        scale = np.minimum(1.0, np.sqrt(np.diag(self._least) / np.diag(widened)))
        return np.asarray(widened * np.outer(scale, scale))

    def _regression(
        self, operator: OperatorParameters, history: Record, start: int, stop: int
    ) -> tuple[Array, Array, Array]:
        """What the block's own actions do not explain (rows,), its covariance, and d/d(ln gain, ln τ) (rows, 2), K."""
        block = history.slice(start, stop)
        regression = run_regression(block, operator.heat_input, self._assumed)
        rest = residuals(regression, np.log(operator.time_constants_h))
        forced = forced_history(operator, history)[start:stop]
        T_zone = _held(block.T_zone_C)[:-1]
        features = feature_matrix(
            T_zone - forced.sum(axis=1), block.T_out_C[:-1], block.solar_W_m2[:-1], block.time_s[:-1]
        )
        drive = operator.modulation(operator.seen(features, forced)) * heat_drive(operator, history, start, stop)
        effect = _response(operator, drive)[regression.rows]
        slower, faster = (
            _response(_scaled(operator, 0.0, shift), drive)[regression.rows]
            for shift in (_DERIVATIVE_STEP, -_DERIVATIVE_STEP)
        )
        columns = np.stack([effect, (slower - faster) / (2.0 * _DERIVATIVE_STEP)], axis=1)
        return regression.target - rest.mean - effect, rest.covariance, columns

    def _follow_heat(self, history: Record, start: int, stop: int, fading: float) -> None:
        """Compare measured heat with the identified map while the machine was on."""
        heat = self._identified.operator.heat_input.heat
        if heat is None:
            return
        u, Q = history.u[start:stop], history.heat_W[start:stop] * self._identified.operator.sign
        used = np.isfinite(Q) & (u > _ON)
        if used.sum() * history.step_s < _LEAST_ON_H * HOUR_S:
            return
        expected = heat(u[used], history.T_out_C[start:stop][used])
        ratio = float(expected @ Q[used] / (expected @ expected))
        low, high = self.config.gain_bounds
        found = float(np.log(np.clip(ratio, low, high)))
        variance = min(self._heat_variance * fading, self.config.gain_sd**2)
        gain = variance / (variance + _HEAT_SD**2)
        self._log_heat += gain * (found - self._log_heat)
        self._heat_variance = (1.0 - gain) * variance

    def _bounded(self, state: Array) -> Array:
        """The state with the gain inside its band and every pole inside its own bounds."""
        low, high = np.log(self.config.gain_bounds)
        operator = self._identified.operator
        tau, bounds = operator.time_constants_h, operator.pole_bounds
        with np.errstate(divide="ignore"):
            edges = operator.step_s / HOUR_S / np.abs(np.log(bounds))  # a pole bound of 0 or 1 is τ = 0 or infinity
            shifts = np.log(edges / tau[:, None])
        return np.array(
            [
                np.clip(state[0], low, high),
                np.clip(state[1], min(shifts[:, 0].max(), 0.0), max(shifts[:, 1].min(), 0.0)),
            ]
        )

    def _rebuild(self) -> bool:
        """Put the adapted model together; False, and nothing changed, where it is not certified."""
        base = self._identified.operator
        operator = _scaled(base, float(self._state[0]), float(self._state[1]))
        if base.heat_input.heat is not None:
            # Heat that counts as v = 1 shrinks with the machine, and the gain per v with it.
            factor = float(np.exp(self._log_heat))
            load = base.heat_input.heat
            c0, c1, c2, c3 = (factor * c for c in load.coefficients)
            weaker = replace(load, coefficients=(c0, c1, c2, c3))
            operator = replace(
                operator, heat_input=replace(base.heat_input, heat=weaker), gains=operator.gains * factor
            )
        if not certificate(operator).certified:
            return False
        self._model = replace(self._identified, operator=operator)
        return True

    def _note(
        self, time_s: float, outcome: Literal["updated", "not informative", "not measured", "refused"], share: float
    ) -> None:
        gain, slower = np.exp(self._state)
        self._steps.append(
            AdaptationStep(
                time_s=time_s,
                outcome=outcome,
                information=share,
                gain=float(gain),
                time_constants=float(slower),
                heat=float(np.exp(self._log_heat)),
                gain_sd=float(np.sqrt(self._covariance[0, 0])),
            )
        )


def _scaled(operator: OperatorParameters, log_gain: float, log_tau: float) -> OperatorParameters:
    """Steady gains times exp(`log_gain`), time constants times exp(`log_tau`), which keeps the form allowed."""
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
    """Forced response (n + 1,) K to a drive (n,), from rest."""
    modes = [lfilter([g], [1.0, -a], drive) for a, g in zip(operator.poles, operator.gains, strict=True)]
    return np.concatenate([[0.0], np.sum(modes, axis=0)])


def _held(values: Array) -> Array:
    """`values` with gaps filled along a straight line."""
    steps, known = np.arange(values.size), np.isfinite(values)
    return np.asarray(np.interp(steps, steps[known], values[known]))
