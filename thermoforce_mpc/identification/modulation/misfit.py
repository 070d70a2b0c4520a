"""Negative log posterior of an operator with modulation (paper eq:operator to eq:mod), and its gradient.

The gradient is written out: the network is small, so that automatic differentiation takes ten times as long to follow
the steps as to do them. Tests compare it with automatic differentiation by torch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import expit, logit

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.rest import Rest
from thermoforce_mpc.model.operator.parameters import OperatorParameters, initial_weight

# Least relative distance of an initial pole to its bounds, which keeps its logit and gradient finite.
_EDGE = 1e-9
_SMALLEST_GAIN = 1e-12


def responses(drives: Array, poles: Array) -> tuple[Array, Array]:
    """Modes y(t + 1) = a y(t) + d(t) from zero under each of `drives` (m, n), and their derivatives by `poles` (r,).

    Shape (m, n + 1, r) each.
    """
    y, slope = np.zeros((2, drives.shape[0], drives.shape[1] + 1, poles.size))
    for i, a in enumerate(poles):
        y[:, 1:, i] = lfilter([1.0], [1.0, -a], drives)
        slope[:, 1:, i] = lfilter([1.0], [1.0, -a], y[:, :-1, i])
    return y, slope


def adjoint(by_response: Array, poles: Array, gains: Array) -> Array:
    """Derivatives (m, n) by the drives of what has derivatives `by_response` (m, n + 1) by Σ gains y of `responses`."""
    backwards = by_response[:, :0:-1]
    return np.sum([lfilter([g], [1.0, -a], backwards)[:, ::-1] for a, g in zip(poles, gains, strict=True)], axis=0)


@dataclass(frozen=True)
class TrainingData:
    """Regression with its features x_t (n, 4) of each run, in the order of its drives, and what is left of it."""

    regression: RegressionData
    features: tuple[Array, ...]
    rest: Rest


@dataclass(frozen=True)
class _Alike:
    """Regressions of equal shapes, m of them.

    `steps` (m, k, n): places of their k runs in the stack of all steps; `rows` of each; `whitener` L⁻¹ (m, t, rows) and
    `target` L⁻¹ target (m, t) of the training rows.
    """

    steps: NDArray[np.intp]
    rows: NDArray[np.intp]
    whitener: Array
    target: Array


def _grouped(data: Sequence[TrainingData]) -> list[_Alike]:
    """The regressions by shape: pairs are many and short, so that they are computed together."""
    groups: dict[tuple[object, ...], list[tuple[TrainingData, NDArray[np.intp]]]] = {}
    first = 0
    for e in data:
        places = first + np.arange(len(e.regression.drives) * e.regression.n_steps)
        first += places.size
        key = (e.regression.n_steps, e.regression.rows.tobytes(), e.regression.held)
        groups.setdefault(key, []).append((e, places.reshape(len(e.regression.drives), -1)))
    stacks = []
    for members in groups.values():
        example = members[0][0].regression
        L = np.stack([e.rest.whitener[: example.seen] for e, _ in members])
        residual = np.stack([e.regression.target - e.rest.mean for e, _ in members])
        steps = np.stack([places for _, places in members])
        stacks.append(_Alike(steps, example.rows, L, (L @ residual[..., None])[..., 0]))
    return stacks


@dataclass(frozen=True)
class _Modes:
    """Poles a and gains g (r,) with what their derivatives need: magnitudes s, weights w = −ln a / (1 − a) and w'."""

    a: Array
    g: Array
    s: Array
    w: Array
    dw: Array
    a_by_raw: Array
    s_by_raw: Array

    def to_raw(self, by_a: Array, by_s: Array) -> Array:
        """Derivatives by ã and g̃ (2r,) from those by a and s."""
        return np.concatenate([by_a * self.a_by_raw, by_s * self.s_by_raw])


class Misfit:
    """Σ of squared whitened residuals and priors over the training rows, per row, of the parameters (P,) of a network.

    Parameters, in this order: ã (r,) of eq:pole, g̃ (r,) of eq:gain, hidden weights (H, 4) and biases (H,), output
    weights (H,) and bias. The fastest gain is set so that softplus(g̃_1) is the initial slope of the step response; at
    r = 1 it is eq:gain.

    Args:
        start: operator that gives all but these parameters.
        data: runs and pairs.
        priors: of the modes.
        modulation_sd: prior standard deviation of m(x) around that of `start`.
    """

    def __init__(
        self, start: OperatorParameters, data: Sequence[TrainingData], priors: ModePriors, modulation_sd: float
    ) -> None:
        self._start, self._r, self._hidden = start, start.order, start.hidden_bias.size
        runs = [(s * v, x) for e in data for (s, v), x in zip(e.regression.drives, e.features, strict=True)]
        self._heat = np.concatenate([drive for drive, _ in runs])
        self._x = (np.concatenate([x for _, x in runs]) - start.feature_mean) / start.feature_scale
        self._groups = _grouped(data)
        self._n = sum(e.regression.seen for e in data)
        self._is_rate = np.isin(np.arange(start.order), (0, start.order - 1))
        mean, sd = priors.gains_at(priors.log_tau)
        if priors.order > 1:
            # The prior of the slowest mode is on its rate G/τ, independent of its time constant.
            mean[-1], sd[-1] = priors.slowest_rate
        self._mean = np.concatenate([mean, priors.log_tau])
        self._sd = np.concatenate([sd, np.full(priors.order, priors.log_tau_sd)])
        weights = 0.0 if start.gamma == 0.0 else (start.gamma / modulation_sd) ** 2
        # Output weights are such that m has `modulation_sd`, hidden ones have sd 1, or as much less as they move m.
        # Both about 0 instead of the start would take units that the data say little of to exactly nothing.
        H, hidden = self._hidden, 1.0 + weights * start.output_weight**2
        self._precision = np.concatenate([np.repeat(hidden, 4), hidden, np.full(H, H * weights), [weights]])
        self._centre = np.concatenate(
            [start.hidden_weight.ravel(), start.hidden_bias, start.output_weight, [start.output_bias]]
        )

    def __call__(self, parameters: Array) -> tuple[float, Array]:
        """The misfit and its gradient (P,)."""
        modes, network = self._modes(parameters), parameters[2 * self._r :]
        drive, activations = self._drive(network)
        squares, by_g, by_a, by_drive = 0.0, np.zeros(self._r), np.zeros(self._r), np.empty(drive.size)
        for group in self._groups:
            y, slope = responses(drive[group.steps].sum(axis=1), modes.a)
            residual = group.target - (group.whitener @ (y @ modes.g)[:, group.rows, None])[..., 0]
            squares += float(np.sum(residual**2))
            by_response = np.zeros(y.shape[:2])
            by_response[:, group.rows] = -2.0 * (residual[:, None] @ group.whitener)[:, 0]
            by_g += np.tensordot(by_response, y)
            by_a += modes.g * np.tensordot(by_response, slope)
            by_drive[group.steps] = adjoint(by_response, modes.a, modes.g)[:, None]
        penalty, penalty_by_raw = self._penalty(modes)
        away = network - self._centre
        by_raw = self._raw_gradient(modes, by_a, by_g) + 2.0 * penalty_by_raw
        by_network = self._network_gradient(network, activations, by_drive) + 2.0 * self._precision * away
        value = squares + 2.0 * (penalty + 0.5 * float(self._precision @ away**2))
        return value / self._n, np.concatenate([by_raw, by_network]) / self._n

    @property
    def begin(self) -> Array:
        """The parameters (P,) of `start`."""
        start, (low, high) = self._start, self._start.pole_bounds.T
        share = np.clip((start.poles - low) / (high - low), _EDGE, 1.0 - _EDGE)
        weight = initial_weight(start.poles)
        magnitude = start.gains * start.sign
        magnitude = np.maximum(np.append(magnitude @ weight / weight[0], magnitude[1:]), _SMALLEST_GAIN)
        return np.concatenate([logit(share), magnitude + np.log(-np.expm1(-magnitude)), self._centre])

    def operator(self, parameters: Array) -> OperatorParameters:
        """The operator with these parameters (P,)."""
        modes, H, network = self._modes(parameters), self._hidden, parameters[2 * self._r :]
        low, high = self._start.pole_bounds.T
        return replace(
            self._start,
            # Rounding of a saturated sigmoid must not leave the bounds or (0, 1).
            poles=np.clip(modes.a, np.maximum(low, 1e-300), np.minimum(high, 1 - 1e-16)),
            gains=modes.g,
            hidden_weight=network[: 4 * H].reshape(H, 4),
            hidden_bias=network[4 * H : 5 * H],
            output_weight=network[5 * H : 6 * H],
            output_bias=float(network[6 * H]),
        )

    def _modes(self, parameters: Array) -> _Modes:
        """Eq:pole and eq:gain."""
        r, (low, high) = self._r, self._start.pole_bounds.T
        share, raw_gain = expit(parameters[:r]), parameters[r : 2 * r]
        a, s = low + (high - low) * share, np.logaddexp(0.0, raw_gain)
        w = -np.log(a) / (1.0 - a)
        g = self._start.sign * np.append(s[0] - s[1:] @ w[1:] / w[0], s[1:])
        return _Modes(a, g, s, w, (w - 1.0 / a) / (1.0 - a), (high - low) * share * (1.0 - share), expit(raw_gain))

    def _raw_gradient(self, modes: _Modes, by_a: Array, by_g: Array) -> Array:
        """Derivatives by ã and g̃ (2r,) from those by poles and gains."""
        w, dw, s = modes.w, modes.dw, modes.s
        by_s = self._start.sign * by_g
        by_a = by_a.copy()
        by_a[0] += by_s[0] * (s[1:] @ w[1:]) * dw[0] / w[0] ** 2
        by_a[1:] -= by_s[0] * s[1:] * dw[1:] / w[0]
        by_s[1:] -= by_s[0] * w[1:] / w[0]
        return modes.to_raw(by_a, by_s)

    def _penalty(self, modes: _Modes) -> tuple[float, Array]:
        """Negative log prior of [slope, G_2 … rate of the slowest, ln τ] and its derivatives by ã and g̃ (2r,)."""
        r, a, s, step_h = self._r, modes.a, modes.s, self._start.step_s / HOUR_S
        rate, rate_by_a = s * modes.w / step_h, s * modes.dw / step_h
        steady, steady_by_a = s / (1.0 - a), s / (1.0 - a) ** 2
        value, by_a, by_s = (
            np.where(self._is_rate, *both)
            for both in ((rate, steady), (rate_by_a, steady_by_a), (modes.w / step_h, 1.0 / (1.0 - a)))
        )
        away = (np.concatenate([value, np.log(-step_h / np.log(a))]) - self._mean) / self._sd
        pull = away / self._sd
        return 0.5 * float(away @ away), modes.to_raw(pull[:r] * by_a - pull[r:] / (a * np.log(a)), pull[:r] * by_s)

    def _drive(self, network: Array) -> tuple[Array, tuple[Array, Array]]:
        """Drive m(x) v of each step (N,) of all runs, and the hidden units (N, H) and tanh (N,) that gave it."""
        H = self._hidden
        hidden = np.tanh(self._x @ network[: 4 * H].reshape(H, 4).T + network[4 * H : 5 * H])
        out = np.tanh(hidden @ network[5 * H : 6 * H] + network[6 * H])
        return (1.0 + self._start.gamma * out) * self._heat, (hidden, out)

    def _network_gradient(self, network: Array, activations: tuple[Array, Array], by_drive: Array) -> Array:
        """Derivatives by the network's parameters from those by the drive (N,)."""
        H, (hidden, out) = self._hidden, activations
        by_out = by_drive * self._heat * self._start.gamma * (1.0 - out**2)
        by_hidden = by_out[:, None] * network[5 * H : 6 * H] * (1.0 - hidden**2)
        return np.concatenate([(by_hidden.T @ self._x).ravel(), by_hidden.sum(axis=0), by_out @ hidden, [by_out.sum()]])
