"""Training of the modulation m(x) on multi-step rollouts (paper eq:operator to eq:mod) of modes that are known.

The forced response is linear in the drive m(x) v, so that a run is one matrix: whitened responses at the training rows
to the drive of each step. m(x) starts at 1; where heat was measured beside v = u, at the measured heat of full level
over T_out: the meter knows that better than a few days of temperatures, also in weather that they did not see. Tests
compare the gradient with automatic differentiation by torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.rest import Rest
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OUTDOOR, OperatorParameters

# Initial standard deviation of hidden weights: features are normalised, so slopes of order 1 use the range of tanh. A
# third more does what it does for `_LEAST_SCALE` of `modulation.selection`.
_HIDDEN_SD = 0.5
# Hidden weight of the unit that starts as the measured heat of full level: tanh is straight within 1 % over ± 2
# standard deviations of T_out, and bends far outside.
_STRAIGHT = 0.1
# Largest part of γ that m(x) starts at: at all of it tanh would be flat, and its bias infinite.
_MOST = 0.99
# Prior standard deviation of m(x) around its start: smaller where measured heat includes the dependence on T_out. A
# third more changes effects by 0.2 % (drawn house) and 0.02 % (heat pump, metered; `benchmarks.constants`, 2026-11-28).
_MODULATION_SD, _MODULATION_SD_METERED = 0.15, 0.02
# The usual start of Adam for networks of this size.
_LEARNING_RATE = 0.01  # of Adam
# L-BFGS: history size; convergence tolerances of the gradient's largest element and of the loss's relative change.
_MEMORY, _FLAT, _SETTLED = 30, 1e-6, 1e-9


@dataclass(frozen=True)
class TrainingData:
    """Regression with its features x_t (n, 4) of each run, in the order of its drives, and what is left of it."""

    regression: RegressionData
    features: tuple[Array, ...]
    rest: Rest


class Misfit:
    """Σ of squared whitened residuals of the training rows and of the network's prior, per row, of its parameters (P,).

    Parameters, in this order: hidden weights (H, 4) and biases (H,), output weights (H,) and bias.

    Args:
        start: operator that gives all but these parameters; where they are expected.
        data: runs and pairs.
        modulation_sd: prior standard deviation of m(x) around that of `start`.
    """

    def __init__(self, start: OperatorParameters, data: Sequence[TrainingData], modulation_sd: float) -> None:
        self._start = start
        data = [e for e in data if e.regression.seen]
        runs = [(s * v, x) for e in data for (s, v), x in zip(e.regression.drives, e.features, strict=True)]
        self._heat = np.concatenate([drive for drive, _ in runs])
        self._x = (np.concatenate([x for _, x in runs]) - start.feature_mean) / start.feature_scale
        self._matrices = [_responses(start, e) for e in data]
        self._targets = [e.rest.white((e.regression.target - e.rest.mean)[: e.regression.seen]) for e in data]
        self._n = sum(target.size for target in self._targets)
        weights = 0.0 if start.gamma == 0.0 else (start.gamma / modulation_sd) ** 2
        # Output weights are such that m has `modulation_sd`, hidden ones have sd 1, or as much less as they move m.
        # Both about 0 instead of the start would take units that the data say little of to exactly nothing.
        H, hidden = start.hidden_bias.size, 1.0 + weights * start.output_weight**2
        self._precision = np.concatenate([np.repeat(hidden, 4), hidden, np.full(H, H * weights), [weights]])
        self.begin = np.concatenate(
            [start.hidden_weight.ravel(), start.hidden_bias, start.output_weight, [start.output_bias]]
        )

    def __call__(self, network: Array) -> tuple[float, Array]:
        """The misfit and its gradient (P,)."""
        H, gamma = self._start.hidden_bias.size, self._start.gamma
        output = network[5 * H : 6 * H]
        hidden = np.tanh(self._x @ network[: 4 * H].reshape(H, 4).T + network[4 * H : 5 * H])
        out = np.tanh(hidden @ output + network[6 * H])
        drive, by_drive = (1.0 + gamma * out) * self._heat, np.empty(out.size)
        squares, first = 0.0, 0
        for matrix, target in zip(self._matrices, self._targets, strict=True):
            steps = slice(first, first + matrix.shape[1])
            residual = target - matrix @ drive[steps]
            squares += float(residual @ residual)
            by_drive[steps] = -2.0 * (residual @ matrix)
            first = steps.stop
        by_out = by_drive * self._heat * gamma * (1.0 - out**2)
        by_hidden = by_out[:, None] * output * (1.0 - hidden**2)
        away = network - self.begin
        gradient = np.concatenate(
            [(by_hidden.T @ self._x).ravel(), by_hidden.sum(axis=0), by_out @ hidden, [by_out.sum()]]
        )
        value = squares + float(self._precision @ away**2)
        return value / self._n, (gradient + 2.0 * self._precision * away) / self._n

    def operator(self, network: Array) -> OperatorParameters:
        """The operator with these parameters (P,)."""
        H = self._start.hidden_bias.size
        weight, bias, output = np.split(network[: 6 * H], [4 * H, 5 * H])
        return replace(
            self._start,
            hidden_weight=weight.reshape(H, 4),
            hidden_bias=bias,
            output_weight=output,
            output_bias=float(network[-1]),
        )


def _responses(operator: OperatorParameters, data: TrainingData) -> Array:
    """Whitened responses (rows, k n), K, of the training rows to the drive of each step of the k runs."""
    e = data.regression
    impulse = operator.impulse(e.n_steps)
    lags = e.rows[: e.seen, None] - 1 - np.arange(e.n_steps)
    response = data.rest.white(np.where(lags >= 0, impulse[lags], 0.0))
    return np.tile(response, (1, len(e.drives)))


def train(
    linear: OperatorParameters, regressions: Sequence[TrainingData], config: IdentificationConfig
) -> OperatorParameters:
    """Train the network of the `linear` operator for at most the configured number of epochs."""
    metered = linear.heat_input.law is not None
    start = with_network(linear, config.seed)
    misfit = Misfit(start, regressions, _MODULATION_SD_METERED if metered else _MODULATION_SD)
    end, _ = minimise(misfit, misfit.begin, config)
    return misfit.operator(end)


def with_network(linear: OperatorParameters, seed: int) -> OperatorParameters:
    """Return the operator with the network that training starts from; its normalisation of features is set."""
    rng, H, gamma = np.random.default_rng(seed), linear.hidden_bias.size, linear.gamma
    weight, bias = rng.normal(0.0, _HIDDEN_SD, (H, N_FEATURES)), rng.normal(0.0, _HIDDEN_SD, H)
    output, output_bias = np.zeros(H), 0.0
    if linear.heat_input.metered is not None and gamma > 0.0:
        T_out_C = linear.feature_mean[OUTDOOR] + linear.feature_scale[OUTDOOR] * np.array([-1.0, 1.0])
        share = (linear.heat_input.full_share(T_out_C) - 1.0) / gamma
        low, high = np.arctanh(np.clip(share, -_MOST, _MOST))
        weight[0], bias[0] = _STRAIGHT * np.eye(N_FEATURES)[OUTDOOR], 0.0
        output[0], output_bias = 0.5 * (high - low) / np.tanh(_STRAIGHT), 0.5 * (high + low)
    return replace(linear, hidden_weight=weight, hidden_bias=bias, output_weight=output, output_bias=float(output_bias))


def minimise(
    misfit: Callable[[Array], tuple[float, Array]], start: Array, config: IdentificationConfig
) -> tuple[Array, list[float]]:
    """Minimise `misfit`, loss and gradient (P,), from `start` (P,) with the configured optimiser.

    Returns the end (P,) and the loss of each epoch (evaluation of loss and gradient).
    """
    from scipy.optimize import minimize

    losses: list[float] = []

    def evaluate(parameters: Array) -> tuple[float, Array]:
        value, gradient = misfit(parameters)
        losses.append(value)
        return value, gradient

    if config.optimiser == "adam":
        import torch  # slow to load, and for the paper's optimiser only

        parameters = torch.nn.Parameter(torch.from_numpy(start.copy()))
        optimiser = torch.optim.Adam([parameters], lr=_LEARNING_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs)
        for _ in range(config.epochs):
            parameters.grad = torch.from_numpy(evaluate(parameters.detach().numpy())[1])
            optimiser.step()
            schedule.step()
        return parameters.detach().numpy(), losses
    # The loss is smooth and deterministic, so L-BFGS needs a fraction of the steps (Nocedal 1980).
    options = {"maxcor": _MEMORY, "maxiter": config.epochs, "maxfun": config.epochs, "gtol": _FLAT, "ftol": _SETTLED}
    result = minimize(evaluate, start, jac=True, method="L-BFGS-B", options=options)
    return np.asarray(result.x), losses
