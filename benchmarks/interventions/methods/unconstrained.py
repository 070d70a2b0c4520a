"""ThermoForce without monotonicity: the same superposition with a gain g(x) of any sign, F' = a F + g(x) u.

It is trained on the difference of the probe pair (paper eq:paired) like the monotone operator. Weight decay replaces
the bound of the gain and is chosen on validation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Training, best
from benchmarks.interventions.methods.thermoforce import identified
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.model.forced_state import forced_history
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.parameters import HIDDEN, N_FEATURES, OperatorParameters, feature_matrix
from thermoforce_mpc.protocols import FreeResponse

_DECAY = (100.0, 10.0, 1.0, 1e-1, 1e-2)
_EPOCHS = 300


@dataclass(frozen=True)
class FreeGain:
    """F' = `pole` · F + g(x) u with a network g(x), as numpy arrays; `mean` and `scale` normalise x."""

    pole: float
    hidden_weight: Array
    hidden_bias: Array
    output_weight: Array
    output_bias: float
    mean: Array
    scale: Array

    def gain(self, features: Array) -> Array:
        """g(x) for `features` (..., 4), K per step; shape (...)."""
        x = (features - self.mean) / self.scale
        return np.asarray(np.tanh(x @ self.hidden_weight.T + self.hidden_bias) @ self.output_weight + self.output_bias)

    def history(self, history: Record) -> Array:
        """F at the boundaries of `history`, shape (n + 1,), K, from steady state at the mean action of day one."""
        F = np.empty(history.n_steps + 1)
        T, u = history.T_zone_C[0], history.u[0]
        x = feature_matrix(T[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])
        F[0] = float(np.mean(self.gain(x[:96]) * u[:96])) / (1.0 - self.pole)
        for t in range(history.n_steps):
            x[t, 0] = T[t] - F[t]
            F[t + 1] = self.pole * F[t] + self.gain(x[t]) * u[t]
        return F


class FreeGainPredictor:
    """`Predictor`: superposition with an unconstrained gain."""

    def __init__(self, operator: FreeGain, free_response: FreeResponse, note: str) -> None:
        self.operator, self._free_response, self.note = operator, free_response, note

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        history, boundary = window.history, window.boundary
        F = self.operator.history(history)
        free_C = history.T_zone_C[0] - F
        median = self._free_response.forecast(free_C, history, boundary).median_C
        starts = np.concatenate([free_C[-1:], median[:-1]])
        x = feature_matrix(starts, boundary.T_out_C[:-1], boundary.solar_W_m2[:-1], boundary.time_s[:-1])
        gain = self.operator.gain(x)
        forced, state = np.empty(u.shape), np.full(u.shape[0], F[-1])
        for k in range(u.shape[1]):
            state = self.operator.pole * state + gain[k] * u[:, k]
            forced[:, k] = state
        return np.asarray(median + forced)


class _Trainable(nn.Module):
    def __init__(self, pole: float, gain: float) -> None:
        super().__init__()
        self.raw_pole = nn.Parameter(torch.tensor(np.log(pole / (1.0 - pole)), dtype=torch.float64))
        self.hidden = nn.Linear(N_FEATURES, HIDDEN, dtype=torch.float64)
        self.output = nn.Linear(HIDDEN, 1, dtype=torch.float64)
        with torch.no_grad():
            self.output.weight.zero_()
            self.output.bias.fill_(gain)

    def gain(self, x: Tensor) -> Tensor:
        return self.output(torch.tanh(self.hidden(x)))[..., 0]


def build_unconstrained(training: Training, free_response: FreeResponse) -> FreeGainPredictor:
    """Train with each weight decay and keep the result with the best effect on the validation windows."""
    linear = identified(training, 1, modulation="linear").only.operator
    candidates = {}
    for decay in _DECAY:
        operator = _fit(training, linear, decay)
        hours = -training.climate.spec.step_s / 3600.0 / np.log(operator.pole)
        note = f"{hours:.2g} h, gain without sign or bound, weight decay {decay:g}"
        candidates[note] = FreeGainPredictor(operator, free_response, note)
    return candidates[best(candidates, training.validation)]


def _fit(training: Training, linear: OperatorParameters, decay: float) -> FreeGain:
    """The gain that begins at that of the `linear` operator."""
    pair = training.probe.pair
    features = []
    for run in (pair.a, pair.b):
        free = run.T_zone_C[0] - forced_history(single(linear), run)[0, 0].sum(axis=1)
        features.append(feature_matrix(free[:-1], run.T_out_C[:-1], run.solar_W_m2[:-1], run.time_s[:-1]))
    stacked = np.concatenate(features)
    mean, scale = stacked.mean(axis=0), np.maximum(stacked.std(axis=0), [1.0, 1.0, 50.0, 0.5])
    x = torch.tensor(np.stack([(f - mean) / scale for f in features]))
    u = torch.tensor(np.stack([pair.a.u[0], pair.b.u[0]]))
    target = torch.tensor(pair.a.T_zone_C[0, 1:] - pair.b.T_zone_C[0, 1:])
    n = u.shape[1]
    n_fft = 1 << (2 * n).bit_length()
    lags = torch.arange(n, dtype=torch.float64)
    size = float(np.abs(linear.gains[0]))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        model = _Trainable(float(linear.poles[0]), float(linear.gains[0]))
    optimiser = torch.optim.LBFGS(
        model.parameters(), max_iter=_EPOCHS, history_size=30, tolerance_change=1e-9, line_search_fn="strong_wolfe"
    )

    def closure() -> Tensor:
        optimiser.zero_grad()
        pole = torch.sigmoid(model.raw_pole)
        response = causal_convolution(pole**lags, model.gain(x) * u, n_fft)
        error = (response[0] - response[1] - target).square().mean()
        weights = (model.output.weight / size).square().sum() + model.hidden.weight.square().mean()
        loss = error + decay * weights
        loss.backward()
        return loss

    optimiser.step(closure)

    def array(tensor: Tensor) -> Array:
        return tensor.detach().numpy().astype(np.float64)

    return FreeGain(
        pole=float(torch.sigmoid(model.raw_pole.detach())),
        hidden_weight=array(model.hidden.weight),
        hidden_bias=array(model.hidden.bias),
        output_weight=array(model.output.weight)[0],
        output_bias=float(model.output.bias.detach()),
        mean=mean,
        scale=scale,
    )


def causal_convolution(kernel: Tensor, drive: Tensor, n_fft: int) -> Tensor:
    """Return the first n values of the convolution of `drive` (..., n) with `kernel` (n,); `n_fft` at least 2n."""
    n = drive.shape[-1]
    product = torch.fft.rfft(drive, n_fft) * torch.fft.rfft(kernel, n_fft)
    return torch.fft.irfft(product, n_fft)[..., :n]
