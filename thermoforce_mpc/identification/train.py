"""Training of the monotone-neural operator on multi-step rollouts (paper eq:operator, eq:paired).

The forced response is linear in the drive m(x_t) v_t, so a run or pair is one causal convolution (by FFT) with the
operator's impulse response, without a loop over steps. Training starts from the linear fit with m = 1, with priors on
modes and weights; held-out data decide whether the network is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.likelihood import Residuals, Split
from thermoforce_mpc.identification.modes import ModePriors
from thermoforce_mpc.identification.regression_data import RegressionData
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.torch_module import ForcedResponseOperator

# Initial standard deviation of hidden weights: features are normalised, so slopes of order 1 use the range of tanh.
_HIDDEN_SD = 0.5
# Prior standard deviation of m(x) − 1, smaller with a heat capacity, which includes the dependence on T_out.
_MODULATION_SD = {"identity": 0.15, "heat": 0.05}
# The network is kept if it predicts the held-out rows better than m = 1 by this many standard errors and this factor.
# With little data it may be better by chance and fit weather errors.
_SIGNIFICANT, _RELEVANT = 1.0, 0.98
# L-BFGS: history size; convergence tolerances of the gradient's largest element and of the change of the loss.
_MEMORY, _FLAT, _SETTLED = 30, 1e-6, 1e-8


@dataclass(frozen=True)
class TrainingData:
    """Regression with its features x_t (n, 4) of each run, in the order of its drives, residual model and split."""

    regression: RegressionData
    features: tuple[Array, ...]
    residuals: Residuals
    split: Split


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


class _Batch:
    """All runs of all regressions as tensors, zero-padded at the end."""

    def __init__(self, regressions: Sequence[TrainingData]) -> None:
        runs = [(s, v, x) for e in regressions for (s, v), x in zip(e.regression.drives, e.features, strict=True)]
        self.n = max(v.size for _, v, _ in runs)
        self.n_fft = 1 << (2 * self.n).bit_length()
        self.heat = torch.zeros(len(runs), self.n, dtype=torch.float64)
        self.features = torch.zeros(len(runs), self.n, 4, dtype=torch.float64)
        for i, (s, v, x) in enumerate(runs):
            self.heat[i, : v.size] = torch.tensor(s * v)
            self.features[i, : v.size] = torch.tensor(np.array(x))
        self.items = []
        first = 0
        for e in regressions:
            last = first + len(e.regression.drives)
            whitener = e.residuals.whitener()
            target = whitener @ (e.regression.target - e.residuals.mean)
            rows = torch.tensor(e.regression.rows)
            of = [
                (torch.tensor(target[part]), torch.tensor(whitener[part])) for part in (e.split.train, e.split.judged)
            ]
            self.items.append((first, last, rows, of))
            first = last
        self.n_train = sum(e.split.train.size for e in regressions)

    def whitened(self, operator: ForcedResponseOperator, poles: Tensor, gains: Tensor, *, judged: bool) -> Tensor:
        """Return the whitened residuals of the training rows, or of the held-out rows, with these modes (r,) each."""
        drive = operator.modulation(self.features) * self.heat
        response = causal_convolution(impulse_response(poles, gains, self.n), drive, self.n_fft)
        response = torch.nn.functional.pad(response, (1, 0))
        parts = []
        for first, last, rows, of in self.items:
            target, whitener = of[judged]
            forced = response[first] if last == first + 1 else response[first:last].sum(0)
            parts.append(target - whitener @ forced[rows])
        return torch.cat(parts)


def impulse_response(poles: Tensor, gains: Tensor, n_steps: int) -> Tensor:
    """Return the impulse response Σ g_i a_i^k for k = 0 … n − 1, shape (n,), K, of `poles` and `gains` (r,)."""
    steps = torch.arange(n_steps, dtype=torch.float64)
    return gains @ poles[:, None] ** steps


def causal_convolution(kernel: Tensor, drive: Tensor, n_fft: int) -> Tensor:
    """Return the first n values of the convolution of `drive` (..., n) with `kernel` (n,); `n_fft` at least 2n."""
    n = drive.shape[-1]
    product = torch.fft.rfft(drive, n_fft) * torch.fft.rfft(kernel, n_fft)
    return torch.fft.irfft(product, n_fft)[..., :n]


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
    batch = _Batch(regressions)
    known = ModePenalty(priors, operator)

    def judged() -> Array:
        with torch.no_grad():
            return batch.whitened(operator, operator.poles, operator.gains, judged=True).numpy()

    def loss() -> Tensor:
        poles = operator.poles
        gains = operator.gains_at(poles)
        away = 2.0 * (known(poles, gains) + network_penalty(operator, modulation_sd))
        return ((batch.whitened(operator, poles, gains, judged=False) ** 2).sum() + away) / batch.n_train

    linear = judged()
    losses = minimise(loss, list(operator.parameters()), config)
    return TrainingResult(operator.numpy(), linear, judged(), np.array(losses))


def minimise(loss: Callable[[], Tensor], parameters: list[Tensor], config: IdentificationConfig) -> list[float]:
    """Minimise with the configured optimiser; return the loss of each epoch (evaluation of loss and gradient)."""
    losses: list[float] = []

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss()
        value.backward()
        losses.append(float(value.detach()))
        return value

    if config.optimiser == "adam":
        optimiser: torch.optim.Optimizer = torch.optim.Adam(parameters, lr=config.learning_rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs)
        for _ in range(config.epochs):
            closure()
            optimiser.step()
            schedule.step()
        return losses
    # The loss is smooth and deterministic, so L-BFGS needs a fraction of the steps (Nocedal 1980).
    optimiser = torch.optim.LBFGS(
        parameters,
        max_iter=config.epochs,
        max_eval=config.epochs,
        history_size=_MEMORY,
        tolerance_grad=_FLAT,
        tolerance_change=_SETTLED,
        line_search_fn="strong_wolfe",
    )
    optimiser.step(closure)
    return losses


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(residual**2))) if residual.size else float("nan")


def network_penalty(operator: ForcedResponseOperator, modulation_sd: float) -> Tensor:
    """Return the negative log prior of the weights: hidden ones sd 1, output such that m − 1 has `modulation_sd`."""
    hidden = sum((p**2).sum() for p in operator.hidden.parameters())
    if operator.gamma == 0.0:
        return torch.as_tensor(0.5 * hidden)
    output_sd = modulation_sd / operator.gamma
    weights = (operator.output.weight**2).sum() * operator.output.in_features + (operator.output.bias**2).sum()
    return 0.5 * hidden + 0.5 * weights / output_sd**2


class ModePenalty:
    """Negative log prior of time constants and gains (up to a constant)."""

    def __init__(self, priors: ModePriors, operator: ForcedResponseOperator) -> None:
        mean, sd = priors.gains_at(priors.log_tau)
        self._by_rate = priors.order > 1
        if self._by_rate:
            # The prior of the slowest mode is on its rate G/τ, independent of its time constant.
            mean[-1], sd[-1] = priors.slowest_rate
        spread = np.full(priors.order, priors.log_tau_sd)
        self._mean, self._sd = (torch.tensor(np.concatenate(both)) for both in ((mean, priors.log_tau), (sd, spread)))
        self._hours, self._sign = operator.step_s / HOUR_S, operator.sign

    def __call__(self, poles: Tensor, gains: Tensor) -> Tensor:
        """The penalty of `poles` and `gains` (r,)."""
        tau = -self._hours / torch.log(poles)
        steady = self._sign * gains / (1.0 - poles)
        rates = steady / tau
        known = [rates.sum()[None], steady[1:]]
        if self._by_rate:
            known = [rates.sum()[None], steady[1:-1], rates[-1:]]
        return 0.5 * (((torch.cat([*known, torch.log(tau)]) - self._mean) / self._sd) ** 2).sum()
