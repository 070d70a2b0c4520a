"""Operator as a torch module: the slow form by automatic differentiation that benches and tests compare with."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OUTDOOR, ZONE, OperatorParameters, initial_weight

# Least relative distance of an initial pole to its bounds, which keeps its logit and gradient finite.
_EDGE = 1e-9
_SMALLEST_GAIN = 1e-12


def _tensor(value: Array) -> Tensor:
    return torch.tensor(np.array(value, dtype=np.float64))


def bounds_between(poles: Array) -> Array:
    """Return bounds (r, 2) of eq:pole that divide (0, 1) in the middle between neighbouring poles."""
    edges = np.concatenate([[0.0], 0.5 * (poles[:-1] + poles[1:]), [1.0]])
    return np.stack([edges[:-1], edges[1:]], axis=1)


class ForcedResponseOperator(nn.Module):
    """Paper eq:operator to eq:mod in float64; trained: ã (r,), g̃ (r,) and the MLP, 195 parameters at order 1."""

    pole_bounds: Tensor
    feature_mean: Tensor
    feature_scale: Tensor

    def __init__(self, params: OperatorParameters) -> None:
        super().__init__()
        bounds = bounds_between(params.poles)
        low, high = bounds[:, 0], bounds[:, 1]
        share = np.clip((params.poles - low) / (high - low), _EDGE, 1.0 - _EDGE)
        weight = initial_weight(params.poles)
        magnitude = params.gains * params.sign
        magnitude = np.append(magnitude @ weight / weight[0], magnitude[1:])
        magnitude = np.maximum(magnitude, _SMALLEST_GAIN)
        self.raw_pole = nn.Parameter(_tensor(np.log(share) - np.log1p(-share)))
        self.raw_gain = nn.Parameter(_tensor(magnitude + np.log(-np.expm1(-magnitude))))
        self.hidden = nn.Linear(N_FEATURES, params.hidden_bias.size, dtype=torch.float64)
        self.output = nn.Linear(params.hidden_bias.size, 1, dtype=torch.float64)
        with torch.no_grad():
            self.hidden.weight.copy_(_tensor(params.hidden_weight))
            self.hidden.bias.copy_(_tensor(params.hidden_bias))
            self.output.weight.copy_(_tensor(params.output_weight)[None])
            self.output.bias.copy_(_tensor(np.array([params.output_bias])))
        self.register_buffer("pole_bounds", _tensor(bounds))
        self.register_buffer("feature_mean", _tensor(params.feature_mean))
        self.register_buffer("feature_scale", _tensor(params.feature_scale))
        self.gamma = params.gamma
        self.sign = params.sign
        self.step_s = params.step_s
        self.heat_input: HeatInput = params.heat_input
        self.feedback: bool = params.feedback

    @property
    def poles(self) -> Tensor:
        """Poles a = a_lo + (a_hi − a_lo) σ(ã) (eq:pole), shape (r,)."""
        low, high = self.pole_bounds[:, 0], self.pole_bounds[:, 1]
        return low + (high - low) * torch.sigmoid(self.raw_pole)

    @property
    def gains(self) -> Tensor:
        """Gains g (r,), K per step: ±softplus(g̃) (eq:gain) for all but the fastest mode.

        The fastest gain is set so that softplus(g̃_1) is the initial slope of the step response; at r = 1 it is eq:gain.
        """
        return self.gains_at(self.poles)

    def gains_at(self, poles: Tensor) -> Tensor:
        """Gains (r,) with these `poles` (r,), for callers that have them already."""
        magnitude = nn.functional.softplus(self.raw_gain)
        weight = -torch.log(poles) / (1.0 - poles)
        first = magnitude[:1] - (magnitude[1:] * weight[1:]).sum()[None] / weight[:1]
        return self.sign * torch.cat([first, magnitude[1:]])

    def modulation(self, features: Tensor) -> Tensor:
        """Return m(x) (eq:mod) for `features` (..., 4) in physical units; shape (...)."""
        x = (features - self.feature_mean) / self.feature_scale
        return 1.0 + self.gamma * torch.tanh(self.output(torch.tanh(self.hidden(x)))[..., 0])

    def heat(self, u: Tensor, T_out_C: Tensor) -> Tensor:
        """Return v(u, T_out) of the heat input, differentiable in u; shapes broadcast."""
        load, law = self.heat_input.heat, self.heat_input
        if load is None:
            if law.per_K == 0.0:
                return u
            return u * (1.0 + law.per_K * (torch.clamp(T_out_C, *law.T_out_range_C) - law.reference_C))
        T = torch.clamp(T_out_C, *load.T_out_range_C)
        c0, c1, c2, c3 = load.coefficients
        on = u if load.lowest_level == 1.0 else torch.clamp(u / load.lowest_level, max=1.0)
        return (on * (c0 + c1 * T) + u * (c2 + c3 * T)) / self.heat_input.reference_W

    def forward(self, F0: Tensor, u: Tensor, features: Tensor) -> Tensor:
        """Return the forced state after each step: `F0` (..., r) K, `u` (..., N), `features` (..., N, 4) → (..., N, r).

        The zone's column of `features` is T − F; with `feedback` F is added step by step.
        """
        if self.feedback:
            return self._stepwise(F0, self.heat(u, features[..., OUTDOOR]), features)
        drive = self.modulation(features) * self.heat(u, features[..., OUTDOOR])
        return self.respond(F0, drive)

    def _stepwise(self, F0: Tensor, heat: Tensor, features: Tensor) -> Tensor:
        """Roll out step by step for a modulation that depends on F."""
        state, out = F0, []
        for t in range(heat.shape[-1]):
            total = features[..., t, ZONE] + state.sum(-1)
            weather = features[..., t, ZONE + 1 :]
            weather = weather.expand(*torch.broadcast_shapes(total.shape, weather.shape[:-1]), weather.shape[-1])
            inputs = torch.cat([total.expand(weather.shape[:-1])[..., None], weather], dim=-1)
            drive = self.modulation(inputs) * heat[..., t]
            state = self.poles * state + self.gains * drive[..., None]
            out.append(state)
        return torch.stack(out, dim=-2)

    def respond(self, F0: Tensor, drive: Tensor) -> Tensor:
        """Return the modes' response (..., N, r) K to a drive m·v (..., N) from `F0` (..., r)."""
        n = drive.shape[-1]
        steps = torch.arange(n, device=drive.device)
        lag = steps[:, None] - steps[None, :]
        poles = self.poles[:, None, None]
        kernel = torch.where(lag >= 0, poles ** lag.clamp(min=0), torch.zeros((), dtype=torch.float64))
        forced = torch.einsum("rtk,...k->...tr", kernel, drive) * self.gains
        return forced + F0[..., None, :] * self.poles ** (steps[:, None] + 1)

    def numpy(self) -> OperatorParameters:
        """Return the present operator as numpy parameters."""

        def array(tensor: Tensor) -> Array:
            return tensor.detach().cpu().numpy().astype(np.float64)

        bounds = array(self.pole_bounds)
        return OperatorParameters(
            # Rounding of a saturated sigmoid must not leave the bounds or (0, 1).
            poles=np.clip(array(self.poles), np.maximum(bounds[:, 0], 1e-300), np.minimum(bounds[:, 1], 1 - 1e-16)),
            gains=array(self.gains),
            hidden_weight=array(self.hidden.weight),
            hidden_bias=array(self.hidden.bias),
            output_weight=array(self.output.weight)[0],
            output_bias=float(array(self.output.bias)[0]),
            feature_mean=array(self.feature_mean),
            feature_scale=array(self.feature_scale),
            gamma=self.gamma,
            sign=self.sign,
            step_s=self.step_s,
            heat_input=self.heat_input,
            feedback=self.feedback,
        )
