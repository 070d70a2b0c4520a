"""Computing times of identification, as ratios within one run of the bench."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from benchmarks.operator.many_buildings import fit_two_stage_many
from benchmarks.operator.speed import Comparison, median_s, must_agree, random_operator
from benchmarks.operator.torch_operator import ForcedResponseOperator
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.rest import Rest
from thermoforce_mpc.identification.modulation import Misfit, TrainingData, minimise
from thermoforce_mpc.identification.zones.two_stage import TwoStageFit, fit_two_stage

# Noise of the synthetic targets, K, so that the final loss is not zero.
_NOISE_K = 0.05
# Relative tolerance between batched and single identification; the solver of the latter stops within a tolerance.
_SAME_POLE = 1e-3
# Standard deviation of a prior that says nothing.
_WEAK = 1e9


class _Task:
    """Training of an operator on noisy rollouts of another; the same loss by `Misfit` and by a loop over the steps."""

    def __init__(self, n_steps: int, rollouts: int) -> None:
        rng = np.random.default_rng(0)
        self.n, self.rollouts = n_steps, rollouts
        features, heat = rng.normal(size=(rollouts, n_steps, 4)), rng.uniform(size=(rollouts, n_steps))
        self.features, self.heat = torch.tensor(features), torch.tensor(heat)
        base = random_operator(3, 1)
        # Initial operator, always the same, with weights that differ from the target operator.
        self._start = base
        with torch.no_grad():
            clean = torch.stack(self._states(ForcedResponseOperator(random_operator(3, 7))), dim=1)
        self.target = clean + _NOISE_K * torch.tensor(rng.normal(size=(rollouts, n_steps)))
        rows = np.arange(1, n_steps + 1)
        data = [
            TrainingData(
                RegressionData(target, rows, base.step_s, ((1, v),)), (x,), Rest(np.zeros(n_steps), np.eye(n_steps))
            )
            for target, v, x in zip(self.target.numpy(), heat, features, strict=True)
        ]
        self.misfit = Misfit(self._start, data, modulation_sd=_WEAK)

    def start(self) -> ForcedResponseOperator:
        """Initial operator."""
        return ForcedResponseOperator(self._start)

    def loop(self, operator: ForcedResponseOperator) -> Tensor:
        """The loss by a loop over the steps, for all rollouts at once."""
        weights, biases = (torch.tensor(values) for values in (self._start.hidden_weight, self._start.hidden_bias))
        known = ((operator.hidden.weight - weights) ** 2).sum() + ((operator.hidden.bias - biases) ** 2).sum()
        error = torch.stack(self._states(operator), dim=1) - self.target
        return ((error**2).sum() + known) / self.target.numel()

    def _states(self, operator: ForcedResponseOperator) -> list[Tensor]:
        """Forced response after each step, (rollouts,) each."""
        poles, gains = operator.poles.detach(), operator.gains.detach()
        state, found = torch.zeros(self.rollouts, 3, dtype=torch.float64), []
        for t in range(self.n):
            drive = operator.modulation(self.features[:, t]) * self.heat[:, t]
            state = poles * state + gains * drive[:, None]
            found.append(state.sum(-1))
        return found


def _network(operator: ForcedResponseOperator) -> list[Tensor]:
    """The parameters that are trained."""
    return [*operator.hidden.parameters(), *operator.output.parameters()]


def _vector(operator: ForcedResponseOperator) -> Tensor:
    return parameters_to_vector(_network(operator)).detach()


def compare_training(n_steps: int, rollouts: int, repeats: int = 9) -> Comparison:
    """Compare one epoch (loss and gradient): the package's against a loop over the steps for all rollouts at once."""
    task = _Task(n_steps, rollouts)
    operator = task.start()
    vector = _vector(operator).numpy()
    must_agree("training loss", np.array(task.misfit(vector)[0]), task.loop(operator).detach().numpy())

    def by_loop() -> None:
        operator.zero_grad()
        task.loop(operator).backward()

    return Comparison(
        f"epoch of training, {rollouts} rollouts of {n_steps} steps",
        median_s(by_loop, max(3, repeats // 3)),
        median_s(lambda: task.misfit(vector), repeats),
    )


class _Reached(Exception):
    """Raised when the target loss is reached."""


def compare_training_to_loss(n_steps: int, rollouts: int, epochs: int = 300) -> Comparison:
    """Compare training to the final loss of `epochs` epochs of Adam with a loop: that loop against the package."""
    task = _Task(n_steps, rollouts)
    plain = task.start()
    config = IdentificationConfig(optimiser="adam", epochs=epochs)
    began = perf_counter()

    def by_loop(parameters: Array) -> tuple[float, Array]:
        vector_to_parameters(torch.from_numpy(parameters), _network(plain))
        found = task.loop(plain)
        gradients = torch.autograd.grad(found, _network(plain))
        return float(found.detach()), torch.cat([gradient.ravel() for gradient in gradients]).numpy()

    aim = min(minimise(by_loop, _vector(plain).numpy(), config)[1])
    plain_s = perf_counter() - began

    def value(parameters: Array) -> tuple[float, Array]:
        found = task.misfit(parameters)
        if found[0] <= aim:
            raise _Reached
        return found

    def train() -> None:
        try:
            minimise(value, _vector(task.start()).numpy(), IdentificationConfig(epochs=5000))
        except _Reached:
            return
        raise ArithmeticError(f"training: L-BFGS ended above the loss that Adam reached, {aim:g}")

    name = f"training to the loss of {epochs} epochs, {rollouts} rollouts of {n_steps} steps"
    return Comparison(name, plain_s, median_s(train, 3))


def compare_many_buildings(buildings: int, days: int = 3) -> Comparison:
    """Compare two-stage identification of synthetic buildings: one after another against one batch."""
    runs = [_run(seed, days) for seed in range(buildings)]

    def one_by_one() -> list[TwoStageFit]:
        return [fit_two_stage([run]) for run in runs]

    poles = [np.array([fit.a for fit in fits]) for fits in (one_by_one(), fit_two_stage_many(runs))]
    loss = 1.0 - poles[0]
    if not np.allclose(poles[0], poles[1], rtol=0.0, atol=float(_SAME_POLE * loss.max())):
        raise ArithmeticError("two-stage: many at once and one after another disagree")
    return Comparison(
        f"two-stage identification of {buildings} buildings, {days} days each",
        median_s(one_by_one, 5),
        median_s(lambda: fit_two_stage_many(runs), 15),
    )


def _run(seed: int, days: int, step_s: float = 900.0) -> Record:
    """Simulated run of a first-order building with random time constant and random switching."""
    rng = np.random.default_rng(seed)
    n = round(days * DAY_S / step_s)
    time_s: Array = np.arange(n + 1, dtype=np.float64) * step_s
    hour = time_s / HOUR_S
    T_out: Array = 5.0 + 4.0 * np.cos(2 * np.pi * (hour - 15) / 24) + rng.normal(size=n + 1).cumsum() * 0.05
    solar: Array = np.maximum(0.0, 300.0 * np.cos(2 * np.pi * (hour - 12) / 24)) * rng.uniform(0.3, 1.0)
    u: Array = np.repeat(rng.choice([0.0, 0.5, 1.0], n // 8 + 1), 8)[:n]
    loss = 1.0 - np.exp(-step_s / HOUR_S / rng.uniform(15.0, 60.0))
    T = np.empty(n + 1)
    T[0] = 20.0
    for t in range(n):
        gain = loss * (T_out[t] - T[t]) + 2e-5 * solar[t] + loss * (5.0 + 20.0 * u[t])
        T[t + 1] = T[t] + gain + 0.005 * rng.normal()
    nothing = np.full(n, np.nan)
    return Record(time_s, T, T_out, solar, u, nothing, nothing)
