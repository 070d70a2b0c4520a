"""Training of the monotone-neural operator on multi-step rollouts (paper eq:operator, eq:paired).

The loss and its gradient are those of `misfit`. Training starts from the linear fit with priors on modes and weights.
m(x) starts at 1; where heat was measured beside v = u, at the measured heat of full level over T_out: the meter knows
that better than a few days of temperatures, also in weather that they did not see.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.modulation.misfit import Misfit, TrainingData
from thermoforce_mpc.model.operator.features import N_FEATURES, OUTDOOR
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# Initial standard deviation of hidden weights: features are normalised, so slopes of order 1 use the range of tanh.
_HIDDEN_SD = 0.5
# Hidden weight of the unit that starts as the measured heat of full level: tanh is straight within 1 % over ± 2
# standard deviations of T_out, and bends far outside.
_STRAIGHT = 0.1
# Largest part of γ that m(x) starts at.
_MOST = 0.99
# Prior standard deviation of m(x) around its start: smaller where measured heat includes the dependence on T_out.
_MODULATION_SD, _MODULATION_SD_METERED = 0.15, 0.02
_LEARNING_RATE = 0.01  # of Adam
# L-BFGS: history size; convergence tolerances of the gradient's largest element and of the loss's relative change.
_MEMORY, _FLAT, _SETTLED = 30, 1e-6, 1e-9


def train(
    linear: OperatorParameters, regressions: Sequence[TrainingData], priors: ModePriors, config: IdentificationConfig
) -> OperatorParameters:
    """Train from the `linear` operator for at most the configured number of epochs."""
    metered = linear.heat_input.law is not None
    start = with_network(linear, config.seed)
    misfit = Misfit(start, regressions, priors, _MODULATION_SD_METERED if metered else _MODULATION_SD)
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
