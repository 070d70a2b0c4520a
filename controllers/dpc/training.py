"""Training of the policy through the differentiable operator: rollouts in closed loop, cost as loss."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from controllers.actuation.actuator import Actuation
from controllers.checks import ControllerConfigError
from controllers.dpc.config import DPCConfig
from controllers.dpc.policy import (
    MOST,
    N_INPUTS,
    STEEP,
    Policy,
    drive_parts,
    lead_steps,
    operator_sha256,
    scales_K,
)
from controllers.dpc.situations import Drawer, Situations
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.operator.torch_module import ForcedResponseOperator
from thermoforce_mpc.model.zone_model import ZoneModel

# Length of a course, from which rollouts follow one another; then new ones are drawn.
_COURSE_DAYS = 8.0
# A kelvin of heat in the building at the end of a rollout is worth what it would cost, for as long as it lasts of this.
_WORTH_H = 48.0
# Disturbance of the forced state at the start of a rollout, relative.
_PERTURBED = 0.01

Progress = Callable[[int, float], None]


class Network(nn.Module):
    """The policy as a torch module, in double precision."""

    def __init__(self, hidden: int, seed: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        sizes = ((N_INPUTS, hidden), (hidden, hidden), (hidden, 1))
        self.layers = [nn.Linear(n, m, dtype=torch.float64) for n, m in sizes]
        for i, layer in enumerate(self.layers):
            self.add_module(f"layer_{i + 1}", layer)
        with torch.no_grad():
            for layer in self.layers:
                bound = 1.0 / math.sqrt(layer.weight.shape[1])
                for values in (layer.weight, layer.bias):
                    values.copy_(
                        (2.0 * torch.rand(values.shape, generator=generator, dtype=torch.float64) - 1.0) * bound
                    )

    def forward(self, x: Tensor) -> Tensor:
        """Share of the highest level (...,) for inputs (..., 5 J)."""
        first, second, third = self.layers
        need = -x[..., : x.shape[-1] // 5].amin(-1)
        return torch.sigmoid(third(torch.tanh(second(torch.tanh(first(x)))))[..., 0] + STEEP * (need - 0.5))


@dataclass(frozen=True)
class Course:
    """Situations as tensors, with what the operator and the machine make of them; (B, n) each."""

    T_free: Tensor
    lower: Tensor
    upper: Tensor
    drive_fixed: Tensor
    drive_per_u: Tensor
    relative: Tensor
    cost_fixed: Tensor
    cost_per_u: Tensor


def train_policy(
    zone: ZoneModel,
    actuation: Actuation,
    config: DPCConfig,
    step_s: float,
    floor_area_m2: float = math.nan,
    progress: Progress | None = None,
) -> Policy:
    """Train a policy for an actuator on its zone.

    The loss is the objective of the MPC over `rollout_h`, in units of the cost of full level: energy with the machine's
    fixed part as the actuation switches it, comfort violation at its price, less what heat left at the end is worth.

    Args:
        zone: operator and power, as identified.
        actuation: how the actuator is run.
        config: options.
        step_s: control step, s.
        floor_area_m2: of the zone, m²; NaN where it is not known.
        progress: called with the number of iterations done and their loss.

    Raises:
        ControllerConfigError: the model has no linear free response or no power, or its gain depends on what is done.
    """
    if zone.free is None or zone.power is None:
        missing = "linear free response" if zone.free is None else "power"
        raise ControllerConfigError(f"dpc: the model was identified without {missing}; identify it from one record")
    params = zone.operator.resampled(step_s)
    if params.feedback_active:
        raise ControllerConfigError("dpc: an operator with feedback is not supported; identify with feedback: false")
    params = replace(params, heat_input=params.heat_input.at_lowest_level(actuation.lowest_level))
    power = zone.power.at_lowest_level(actuation.lowest_level)
    t, lowest, highest = config.training, actuation.lowest_level, actuation.highest
    module = ForcedResponseOperator(params).requires_grad_(False)
    network = Network(t.hidden, t.seed)
    optimiser = torch.optim.Adam(network.parameters(), t.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, t.iterations, 0.1 * t.learning_rate)
    drawer = Drawer(zone.free, step_s, params.sign, t.seed)
    noise = torch.Generator().manual_seed(t.seed)
    leads = torch.from_numpy(lead_steps(step_s))
    n, reach = max(1, round(t.rollout_h * HOUR_S / step_s)), int(leads[-1])
    length = max(n, round(_COURSE_DAYS * DAY_S / step_s))
    comfort_price = float(config.objective.comfort_weights([floor_area_m2])[0]) * step_s / HOUR_S
    losses: list[float] = []
    at = length
    for iteration in range(t.iterations):
        if at + n > length:
            course = course_of(drawer.draw(t.buildings, length + reach), params, power, step_s)
            at, F = 0, states_near_band(course, module, highest)
        F = F * (1.0 + _PERTURBED * torch.randn(F.shape[0], 1, generator=noise, dtype=torch.float64))
        loss, F = rollout(network, module, course, F, at, n, leads, (lowest, highest), comfort_price, step_s)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        F, at = F.detach(), at + n
        losses.append(float(loss.detach()))
        if progress:
            progress(iteration + 1, losses[-1])
    weights = tuple(value.detach().numpy().copy() for layer in network.layers for value in (layer.weight, layer.bias))
    last = float(np.mean(losses[-max(1, t.iterations // 10) :]))
    return Policy(weights, highest, lowest, step_s, operator_sha256(params), t.iterations, last)


def course_of(situations: Situations, operator: OperatorParameters, power: PowerModel, step_s: float) -> Course:
    """The situations as tensors; costs in currency."""
    before = np.concatenate([situations.T_free_C[:, :1], situations.T_free_C[:, :-1]], axis=1)
    features = feature_matrix(before, situations.T_out_C, situations.solar_W_m2, situations.time_s)
    drive_fixed, drive_per_u = drive_parts(operator, features)
    fixed_W, per_u_W = power.parts(situations.T_out_C)
    price = situations.price_per_kWh * step_s / J_PER_KWH
    relative = price * (fixed_W + per_u_W) / (drive_fixed + drive_per_u)
    return Course(
        T_free=torch.from_numpy(situations.T_free_C),
        lower=torch.from_numpy(situations.lower_C),
        upper=torch.from_numpy(situations.upper_C),
        drive_fixed=torch.from_numpy(drive_fixed),
        drive_per_u=torch.from_numpy(drive_per_u),
        relative=torch.from_numpy(relative),
        cost_fixed=torch.from_numpy(price * fixed_W),
        cost_per_u=torch.from_numpy(price * per_u_W),
    )


def states_near_band(course: Course, module: ForcedResponseOperator, highest: float) -> Tensor:
    """Forced states (B, r), K, that hold each zone near its band: a steady level of the past."""
    steady = module.gains / (1.0 - module.poles)
    middle = 0.5 * (course.lower[:, 0] + course.upper[:, 0]) - course.T_free[:, 0]
    share = (middle / steady.sum()).clamp(0.0, highest)
    return share[:, None] * steady


def rollout(
    network: Network,
    module: ForcedResponseOperator,
    course: Course,
    F: Tensor,
    first: int,
    n: int,
    leads: Tensor,
    levels: tuple[float, float],
    comfort_price: float,
    step_s: float,
) -> tuple[Tensor, Tensor]:
    """Mean loss of `n` steps in closed loop from forced states `F` (B, r) at step `first`, and the states after.

    `comfort_price`: of a kelvin of violation in a step, currency/K.
    """
    poles, gains, (lowest, highest), (step_K, coarse_K) = module.poles, module.gains, levels, scales_K(module.numpy())
    # Inputs of all steps where nothing acts at all (B, n, 4 J), and what the forced state adds to them.
    at = torch.arange(first, first + n)[:, None] + leads - 1
    T_free, lower, upper = (x[:, at] for x in (course.T_free, course.lower, course.upper))
    below, above = (T_free - lower, upper - T_free) if module.sign > 0 else (upper - T_free, T_free - lower)
    fine, coarse = 1.0 / torch.from_numpy(step_K), torch.full(leads.shape, 1.0 / coarse_K, dtype=torch.float64)
    at_rest = torch.cat([below * fine, above * fine, below * coarse, above * coarse], dim=2)
    fading = module.sign * poles[:, None] ** leads
    added = torch.cat([fading * fine, -fading * fine, fading * coarse, -fading * coarse], dim=1)
    relative = course.relative[:, at]
    dearer = relative / relative.abs().mean(2, keepdim=True) - 1.0
    levels_u, forced = [], []
    for i in range(n):
        x = torch.cat([torch.addmm(at_rest[:, i], F, added), dearer[:, i]], dim=1).clamp(-MOST, MOST)
        u = highest * network(x)
        drive = (u / lowest).clamp(max=1.0) * course.drive_fixed[:, first + i] + u * course.drive_per_u[:, first + i]
        F = poles * F + gains * drive[:, None]
        levels_u.append(u)
        forced.append(F.sum(1))
    u, rows = torch.stack(levels_u, dim=1), slice(first, first + n)
    T = course.T_free[:, rows] + torch.stack(forced, dim=1)
    slack = torch.relu(course.lower[:, rows] - T) + torch.relu(T - course.upper[:, rows])
    energy = (u / lowest).clamp(max=1.0) * course.cost_fixed[:, rows] + u * course.cost_per_u[:, rows]
    cost = (energy + comfort_price * slack).sum(1).mean()
    lasts = (1.0 - poles ** round(_WORTH_H * HOUR_S / step_s)) / (1.0 - poles)
    heat = (F * lasts).sum(1) / (gains * lasts).sum()
    worth = course.relative[:, first + n : first + n + int(leads[-1])].mean(1)
    full = (course.cost_fixed + course.cost_per_u).mean() * n
    return (cost - (worth * heat).mean()) / full, F
