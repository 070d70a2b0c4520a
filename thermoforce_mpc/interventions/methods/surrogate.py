"""Distillation surrogate: one network, taught by the forecaster, in which the control is an input like any other.

The student steps T forward from T, its last changes, control, weather and clock. Its teachers are the forecaster's
courses from origins in plain operation, and the measured courses of both probe runs; their weights against each other
and the weight decay are chosen on validation. Trained on rollouts over the horizon (Adam), as it will be used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from thermoforce_mpc.interventions.dataset import Window, steps
from thermoforce_mpc.interventions.methods.base import Training, best, joined
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.types import DAY_S, Array, Boundary, History

_HIDDEN = 32
_EPOCHS = 150
_BATCH = 256
_LEARNING_RATE = 3e-3
_TEACHER_STRIDE, _MEASURED_STRIDE = 8, 2
# Courses taken of each measured run, at most: neighbours say nearly the same.
_MOST_COURSES = 400
_TEACHER_DAYS = 10
# (weight of the teacher's courses, weight decay)
_SETTINGS = ((1.0, 1e-4), (0.2, 1e-4), (0.05, 1e-4), (0.2, 1e-2))
_INPUTS = 7


@dataclass(frozen=True)
class _Lessons:
    """Courses to learn: start (M, 2) °C, drivers (M, N, 5), course (M, N) °C, weight (M,)."""

    start: Tensor
    drivers: Tensor
    course: Tensor
    taught: Tensor


class _Student(nn.Module):
    """T(t+1) = T(t) + network(T, last change, u, T_out, sun, clock)."""

    def __init__(self, centre_C: float) -> None:
        super().__init__()
        self.centre_C = centre_C
        self.network = nn.Sequential(
            nn.Linear(_INPUTS, _HIDDEN), nn.Tanh(), nn.Linear(_HIDDEN, _HIDDEN), nn.Tanh(), nn.Linear(_HIDDEN, 1)
        )

    def forward(self, start: Tensor, drivers: Tensor) -> Tensor:
        before, now = start[:, 0], start[:, 1]
        course = []
        for k in range(drivers.shape[1]):
            state = torch.stack([(now - self.centre_C) / 3.0, now - before], dim=1)
            change = self.network(torch.cat([state, drivers[:, k]], dim=1))[:, 0]
            before, now = now, now + 0.5 * change
            course.append(now)
        return torch.stack(course, dim=1)


class Surrogate:
    """`Predictor` by the student."""

    def __init__(self, student: _Student, note: str) -> None:
        self._student, self.note = student, note

    def respond(self, window: Window, u: Array) -> Array:
        """See `Predictor.respond`."""
        T = window.history.T_zone_C[-2:]
        boundary = window.boundary
        drivers = np.stack([_drivers(boundary.time_s, boundary.T_out_C, boundary.solar_W_m2, row) for row in u])
        with torch.inference_mode():
            start = torch.tensor(np.broadcast_to(T, (u.shape[0], 2)).copy())
            return np.asarray(self._student(start, torch.tensor(drivers)).numpy())


def build_surrogate(training: Training, free_response: FreeResponse) -> Surrogate:
    """Train one student per setting and keep the one with the best effect on the validation windows."""
    lessons = _lessons(training, free_response)
    candidates = {}
    for teacher_weight, decay in _SETTINGS:
        note = f"teacher's weight {teacher_weight:g}, weight decay {decay:g}"
        candidates[note] = Surrogate(_train(lessons, training, teacher_weight, decay), note)
    return candidates[best(candidates, training.validation)]


def _drivers(time_s: Array, T_out_C: Array, solar_W_m2: Array, u: Array) -> Array:
    """Inputs of each step besides the state, shape (N, 5)."""
    angle = 2.0 * np.pi * time_s[:-1] / DAY_S
    return np.stack([u, (T_out_C[1:] - 15.0) / 15.0, solar_W_m2[1:] / 400.0, np.cos(angle), np.sin(angle)], axis=1)


def _lessons(training: Training, free_response: FreeResponse) -> _Lessons:
    horizon = training.validation[0].factual.n_steps
    start, drivers, course, taught = [], [], [], []

    def add(ahead: History, T_before: float, T: Array, by_teacher: bool) -> None:
        start.append([T_before, ahead.T_zone_C[0]])
        drivers.append(_drivers(ahead.time_s, ahead.T_out_C, ahead.solar_W_m2, ahead.u))
        course.append(T)
        taught.append(by_teacher)

    plain = joined(training.probe.history, training.probe.pair.b)
    per_day = round(DAY_S / plain.step_s)
    none = np.zeros(horizon + 1)
    first = max(per_day + 1, plain.n_steps - (_TEACHER_DAYS + training.days) * per_day)
    for origin in range(first, plain.n_steps - horizon + 1, _TEACHER_STRIDE):
        past, ahead = steps(plain, 0, origin), steps(plain, origin, origin + horizon)
        boundary = Boundary(ahead.time_s, ahead.T_out_C, ahead.solar_W_m2, none, none, none, none, none)
        forecast = free_response.forecast(past.T_zone_C, past, boundary).median_C
        add(ahead, float(past.T_zone_C[-2]), forecast, True)
    for run in (training.probe.pair.a, training.probe.pair.b):
        last = run.n_steps - horizon + 1
        for origin in range(1, last, max(_MEASURED_STRIDE, -(-last // _MOST_COURSES))):
            ahead = steps(run, origin, origin + horizon)
            add(ahead, float(run.T_zone_C[origin - 1]), ahead.T_zone_C[1:], False)
    return _Lessons(
        torch.tensor(np.array(start)),
        torch.tensor(np.array(drivers)),
        torch.tensor(np.array(course)),
        torch.tensor(np.array(taught)),
    )


def _train(lessons: _Lessons, training: Training, teacher_weight: float, decay: float) -> _Student:
    n_measured = float((~lessons.taught).sum())
    n_taught = float(lessons.taught.sum())
    # Each teacher counts as a whole, however many courses it gave.
    weight = torch.where(lessons.taught, teacher_weight / max(n_taught, 1.0), 1.0 / n_measured) * lessons.taught.numel()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        student = _Student(float(lessons.course.mean())).double()
        optimiser = torch.optim.AdamW(student.parameters(), lr=_LEARNING_RATE, weight_decay=decay)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, _EPOCHS)
        for _ in range(_EPOCHS):
            order = torch.randperm(lessons.taught.numel())
            for rows in order.split(_BATCH):
                optimiser.zero_grad()
                error = student(lessons.start[rows], lessons.drivers[rows]) - lessons.course[rows]
                loss = (weight[rows, None] * error**2).mean()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
                optimiser.step()
            schedule.step()
    return student.eval()
