"""Distillation surrogate: a network with the control as an ordinary input, trained on forecasts and measurements.

The network predicts T one step ahead from T, its last change, control, weather and time of day. Targets are forecasts
from origins in plain operation and the measured temperatures of both probe runs. The weight of the forecasts and the
weight decay are chosen on validation. It is trained with Adam on rollouts over the horizon.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.interventions.dataset import Window
from benchmarks.interventions.methods.base import Training, best, joined
from thermoforce_mpc.data import DAY_S, Array, Boundary, Record
from thermoforce_mpc.protocols import FreeResponse

_HIDDEN = 32
_EPOCHS = 150
_BATCH = 256
_LEARNING_RATE = 3e-3
_TEACHER_STRIDE, _MEASURED_STRIDE = 8, 2
# Largest number of trajectories per measured run; neighbouring ones are nearly equal.
_MOST_COURSES = 400
_TEACHER_DAYS = 10
# (weight of the forecast trajectories, weight decay)
_SETTINGS = ((0.2, 1e-4), (0.05, 1e-4), (0.01, 1e-4), (0.05, 1e-2))
_INPUTS = 7


@dataclass(frozen=True)
class _Lessons:
    """Training trajectories: start (M, 2) °C, drivers (M, N, 5), course (M, N) °C, weight (M,)."""

    start: Tensor
    drivers: Tensor
    course: Tensor
    taught: Tensor


class _Students(nn.Module):
    """S networks in one batch, each T(t+1) = T(t) + network(T, last change, u, T_out, sun, clock).

    They start from the same weights and are trained independently; the batch costs little more than one network.
    """

    def __init__(self, count: int, centre_C: float) -> None:
        super().__init__()
        self.centre_C = centre_C
        network = [nn.Linear(_INPUTS, _HIDDEN), nn.Linear(_HIDDEN, _HIDDEN), nn.Linear(_HIDDEN, 1)]
        self.weights = nn.ParameterList([layer.weight.detach().T.double().repeat(count, 1, 1) for layer in network])
        self.biases = nn.ParameterList([layer.bias.detach().double().repeat(count, 1, 1) for layer in network])

    def forward(self, start: Tensor, drivers: Tensor) -> Tensor:
        """Trajectories (S, M, N), °C, from `start` (M, 2) under `drivers` (M, N, 5)."""
        count, n_state = self.weights[0].shape[0], start.shape[1]
        driven = torch.einsum("mnd,sdh->nsmh", drivers, self.weights[0][:, n_state:]) + self.biases[0]
        before, now = (start[None, :, i].expand(count, -1) for i in range(n_state))
        course = []
        for step in driven:
            state = torch.stack([(now - self.centre_C) / 3.0, now - before], dim=2)
            hidden = torch.tanh(torch.baddbmm(step, state, self.weights[0][:, :n_state]))
            hidden = torch.tanh(torch.baddbmm(self.biases[1], hidden, self.weights[1]))
            change = torch.baddbmm(self.biases[2], hidden, self.weights[2])[:, :, 0]
            before, now = now, now + 0.5 * change
            course.append(now)
        return torch.stack(course, dim=2)


class Surrogate:
    """`Predictor`: network number `index`."""

    def __init__(self, students: _Students, index: int, note: str) -> None:
        self._students, self._index, self.note = students, index, note

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        T = window.history.T_zone_C[0, -2:]
        boundary = window.boundary
        drivers = np.stack([_drivers(boundary.time_s, boundary.T_out_C, boundary.solar_W_m2, row) for row in u])
        with torch.inference_mode():
            start = torch.tensor(np.broadcast_to(T, (u.shape[0], 2)).copy())
            return np.asarray(self._students(start, torch.tensor(drivers))[self._index].numpy())


def build_surrogate(
    training: Training,
    free_response: FreeResponse,
    *,
    epochs: int = _EPOCHS,
    settings: Sequence[tuple[float, float]] = _SETTINGS,
) -> Surrogate:
    """Train one network per setting and keep the one with the best effect on the validation windows.

    `settings`: weight of the forecast trajectories and weight decay of each.
    """
    candidates = surrogates(training, free_response, epochs=epochs, settings=settings)
    return candidates[best(candidates, training.validation)]


def surrogates(
    training: Training,
    free_response: FreeResponse,
    *,
    epochs: int = _EPOCHS,
    settings: Sequence[tuple[float, float]] = _SETTINGS,
    rate: float = _LEARNING_RATE,
) -> dict[str, Surrogate]:
    """The network of each setting, see `build_surrogate`, by its settings in words; `rate`: Adam's."""
    students = _train(_lessons(training, free_response), training.seed, epochs, settings, rate)
    return {
        (note := f"teacher's weight {teacher_weight:g}, weight decay {decay:g}"): Surrogate(students, index, note)
        for index, (teacher_weight, decay) in enumerate(settings)
    }


def _drivers(time_s: Array, T_out_C: Array, solar_W_m2: Array, u: Array) -> Array:
    """Inputs of each step besides the state, shape (N, 5)."""
    angle = 2.0 * np.pi * time_s[:-1] / DAY_S
    return np.stack([u, (T_out_C[1:] - 15.0) / 15.0, solar_W_m2[1:] / 400.0, np.cos(angle), np.sin(angle)], axis=1)


def _lessons(training: Training, free_response: FreeResponse) -> _Lessons:
    horizon = training.validation[0].factual.n_steps
    start, drivers, course, taught = [], [], [], []

    def add(ahead: Record, T_before: float, T: Array, by_teacher: bool) -> None:
        start.append([T_before, ahead.T_zone_C[0, 0]])
        drivers.append(_drivers(ahead.time_s, ahead.T_out_C, ahead.solar_W_m2, ahead.u[0]))
        course.append(T)
        taught.append(by_teacher)

    plain = joined(training.probe.history, training.probe.pair.b)
    per_day = round(DAY_S / plain.step_s)
    first = max(per_day + 1, plain.n_steps - (_TEACHER_DAYS + training.days) * per_day)
    for origin in range(first, plain.n_steps - horizon + 1, _TEACHER_STRIDE):
        past, ahead = plain.slice(0, origin), plain.slice(origin, origin + horizon)
        forecast = free_response.forecast(past.T_zone_C[0], past, Boundary.measured(ahead)).median_C
        add(ahead, float(past.T_zone_C[0, -2]), forecast, True)
    for run in (training.probe.pair.a, training.probe.pair.b):
        last = run.n_steps - horizon + 1
        for origin in range(1, last, max(_MEASURED_STRIDE, -(-last // _MOST_COURSES))):
            ahead = run.slice(origin, origin + horizon)
            add(ahead, float(run.T_zone_C[0, origin - 1]), ahead.T_zone_C[0, 1:], False)
    return _Lessons(
        torch.tensor(np.array(start)),
        torch.tensor(np.array(drivers)),
        torch.tensor(np.array(course)),
        torch.tensor(np.array(taught)),
    )


def _train(
    lessons: _Lessons, seed: int, epochs: int, settings: Sequence[tuple[float, float]], rate: float
) -> _Students:
    """Train one network per setting."""
    n_measured = float((~lessons.taught).sum())
    n_taught = float(lessons.taught.sum())
    teacher_weight, decay = (torch.tensor(values, dtype=torch.float64) for values in zip(*settings, strict=True))
    # Weights are normalised by the number of trajectories from each source.
    of_teacher = teacher_weight[:, None] / max(n_taught, 1.0)
    weight = torch.where(lessons.taught, of_teacher, 1.0 / n_measured) * lessons.taught.numel()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        students = _Students(len(settings), float(lessons.course.mean()))
        parameters = list(students.parameters())
        optimiser = torch.optim.Adam(parameters, lr=rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
        for _ in range(epochs):
            order = torch.randperm(lessons.taught.numel())
            for rows in order.split(_BATCH):
                optimiser.zero_grad()
                error = students(lessons.start[rows], lessons.drivers[rows]) - lessons.course[rows]
                loss = (weight[:, rows, None] * error**2).mean(dim=(1, 2)).sum()
                loss.backward()
                _clip(parameters)
                _decay(parameters, decay * schedule.get_last_lr()[0])
                optimiser.step()
            schedule.step()
    return students.eval()


def _clip(parameters: Sequence[Tensor]) -> None:
    """Clip the gradient of each network to norm 1."""
    gradients = [p.grad for p in parameters if p.grad is not None]
    norm = torch.stack([g.square().sum(dim=(1, 2)) for g in gradients]).sum(dim=0).sqrt()
    factor = torch.clamp(1.0 / (norm + 1e-6), max=1.0)
    for gradient in gradients:
        gradient.mul_(factor[:, None, None])


def _decay(parameters: Sequence[Tensor], share: Tensor) -> None:
    """Decoupled weight decay, as in AdamW, with one coefficient per network."""
    with torch.no_grad():
        for parameter in parameters:
            parameter.mul_(1.0 - share[:, None, None])
