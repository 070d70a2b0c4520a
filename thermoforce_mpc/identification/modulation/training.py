"""Training of the monotone-neural operator on multi-step rollouts (paper eq:operator, eq:paired).

The loss and its gradient are those of `misfit`. Training starts from the linear fit with m = 1, with priors on modes
and weights; held-out data decide whether the network is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.modulation.misfit import Misfit, TrainingData
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.torch_module import ForcedResponseOperator

# Initial standard deviation of hidden weights: features are normalised, so slopes of order 1 use the range of tanh.
_HIDDEN_SD = 0.5
# Prior standard deviation of m(x) − 1, smaller with a heat capacity, which includes the dependence on T_out.
_MODULATION_SD = {"identity": 0.15, "heat": 0.05}
# The network is kept if it predicts the held-out rows better than m = 1 by this many standard errors and this factor.
# With little data it may be better by chance and fit weather errors.
_SIGNIFICANT, _RELEVANT = 1.0, 0.98
# L-BFGS: history size; convergence tolerances of the gradient's largest element and of the loss's relative change.
_MEMORY, _FLAT, _SETTLED = 30, 1e-6, 1e-9


@dataclass(frozen=True)
class TrainingResult:
    """Trained operator, whitened held-out residuals (rows,) before (m = 1) and after training, and loss per epoch."""

    operator: OperatorParameters
    linear_residuals: Array
    residuals: Array
    losses: Array

    @property
    def linear_score(self) -> float:
        """RMS of the held-out residuals with m = 1 (NaN without held-out rows)."""
        return _rms(self.linear_residuals)

    @property
    def score(self) -> float:
        """RMS of the held-out residuals after training."""
        return _rms(self.residuals)

    @property
    def improvement_in_standard_errors(self) -> float:
        """Mean decrease of the squared held-out residuals over its standard error (NaN with fewer than two rows)."""
        gain = self.linear_residuals**2 - self.residuals**2
        if gain.size < 2:
            return float("nan")
        spread = float(np.std(gain, ddof=1))
        return 0.0 if spread == 0.0 else float(np.mean(gain)) / (spread / np.sqrt(gain.size))

    @property
    def worth_it(self) -> bool:
        """Whether the network improves the held-out rows by more than 1 standard error and 2 % in RMS."""
        return self.improvement_in_standard_errors > _SIGNIFICANT and self.score < _RELEVANT * self.linear_score


def train(
    start: OperatorParameters, regressions: Sequence[TrainingData], priors: ModePriors, config: IdentificationConfig
) -> TrainingResult:
    """Train from the linear operator `start` for at most the configured number of epochs."""
    modulation_sd = config.modulation_sd or _MODULATION_SD[start.heat_input.kind]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        operator = ForcedResponseOperator(start)
        with torch.no_grad():
            operator.hidden.weight.normal_(0.0, _HIDDEN_SD)
            operator.hidden.bias.normal_(0.0, _HIDDEN_SD)
            operator.output.weight.zero_()
            operator.output.bias.zero_()
    misfit = Misfit(start, regressions, priors, modulation_sd)
    begin = parameters_to_vector(operator.parameters()).detach().numpy()
    end, losses = minimise(misfit, begin, config)
    vector_to_parameters(torch.from_numpy(end), operator.parameters())
    return TrainingResult(
        operator.numpy(), misfit.held_out_residuals(begin), misfit.held_out_residuals(end), np.array(losses)
    )


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
        parameters = torch.nn.Parameter(torch.from_numpy(start.copy()))
        optimiser = torch.optim.Adam([parameters], lr=config.learning_rate)
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


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2))) if residual.size else float("nan")
