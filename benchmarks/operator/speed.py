"""Computing times of operator rollouts, as ratios within one run of the bench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import torch

from benchmarks.operator.torch_operator import ForcedResponseOperator
from thermoforce_mpc.data import Array
from thermoforce_mpc.model.exported import rollout_function
from thermoforce_mpc.model.operator.building import forced_rollout
from thermoforce_mpc.model.operator.parameters import OperatorParameters, linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

# Largest difference between two implementations whose times are compared, K.
_SAME_K = 1e-9


@dataclass(frozen=True)
class Comparison:
    """Median times, s, of a plain implementation and of that of the package."""

    name: str
    plain_s: float
    fast_s: float

    @property
    def ratio(self) -> float:
        """Ratio of the times, plain over package."""
        return self.plain_s / self.fast_s


def random_operator(order: int, seed: int) -> OperatorParameters:
    """An operator of this order with random weights in the range of a house."""
    rng = np.random.default_rng(seed)
    poles, gains = np.array([0.14, 0.74, 0.98])[-order:], np.array([0.1, 0.5, 0.4])[-order:]
    base = linear_operator(poles, gains, step_s=3600.0)
    return OperatorParameters(
        **{
            **vars(base),
            "hidden_weight": rng.normal(size=base.hidden_weight.shape),
            "output_weight": rng.normal(size=base.output_weight.shape) * 0.2,
        }
    )


def median_s(work: Callable[[], object], repeats: int) -> float:
    """Median duration of `repeats` calls after a warm-up call, s."""
    work()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return float(np.median(times))


def _casadi_rollout(params: OperatorParameters, F0: Array, u: Array, features: Array) -> tuple[Any, Array]:
    """The exported rollout bound to fixed memory, and its output array of modes (n, r)."""
    buffer: Any
    buffer, evaluate = rollout_function(ThermalModel.single(params), u.size, params.step_s, part_load="held").buffer()
    arguments = [np.ascontiguousarray(value) for value in (F0, u, features)]
    results = [np.zeros((u.size, params.order)), np.zeros(u.size)]
    for i, value in enumerate(arguments):
        buffer.set_arg(i, memoryview(value))  # type: ignore[arg-type]
    for i, value in enumerate(results):
        buffer.set_res(i, memoryview(value))  # type: ignore[arg-type]
    return _Bound(evaluate, (buffer, *arguments, *results)), results[0]


class _Bound:
    """A CasADi call that keeps its input and output arrays alive, since CasADi stores only their addresses."""

    def __init__(self, evaluate: Any, memory: tuple[Any, ...]) -> None:
        self._evaluate, self._memory = evaluate, memory

    def __call__(self) -> None:
        self._evaluate()


def compare_rollout(n_steps: int, repeats: int = 200) -> tuple[Comparison, Comparison]:
    """Compare rollouts: CasADi and numpy against the torch module called step by step, as timed in the paper."""
    rng = np.random.default_rng(0)
    params = random_operator(3, 2)
    operator = ForcedResponseOperator(params)
    F0, u, x = rng.normal(size=3), rng.uniform(size=n_steps), rng.normal(size=(n_steps, 4))
    evaluate, modes = _casadi_rollout(params, F0, u, x)
    F0_t, u_t, x_t = torch.tensor(F0), torch.tensor(u), torch.tensor(x)

    def step_by_step() -> Array:
        with torch.no_grad():
            state, out = F0_t, []
            for t in range(n_steps):
                state = operator(state, u_t[t : t + 1], x_t[t : t + 1])[0]
                out.append(state)
            return torch.stack(out).numpy()

    evaluate()
    must_agree("CasADi rollout", modes, step_by_step())
    must_agree("numpy rollout", forced_rollout(params, F0, u, x), step_by_step())
    plain = median_s(step_by_step, max(5, repeats // 10))
    return (
        Comparison(f"rollout of {n_steps} steps, CasADi", plain, median_s(evaluate, repeats)),
        Comparison(
            f"rollout of {n_steps} steps, numpy", plain, median_s(lambda: forced_rollout(params, F0, u, x), repeats)
        ),
    )


def compare_module_call(n_steps: int, repeats: int = 200) -> Comparison:
    """Compare rollouts: CasADi against one call of the torch module over the whole horizon."""
    rng = np.random.default_rng(0)
    params = random_operator(3, 2)
    operator = ForcedResponseOperator(params)
    arrays = rng.normal(size=3), rng.uniform(size=n_steps), rng.normal(size=(n_steps, 4))
    tensors = [torch.tensor(value) for value in arrays]
    evaluate, modes = _casadi_rollout(params, *arrays)

    def module() -> torch.Tensor:
        with torch.no_grad():
            return operator(*tensors)

    evaluate()
    must_agree("CasADi rollout", modes, module().numpy())
    return Comparison(
        f"rollout of {n_steps} steps, CasADi against one module call",
        median_s(module, repeats),
        median_s(evaluate, repeats),
    )


def must_agree(what: str, a: Array, b: Array) -> None:
    """Check that two results agree before their times are compared; raises `ArithmeticError` if not."""
    difference = float(np.abs(a - b).max())
    if not difference <= _SAME_K:
        raise ArithmeticError(f"{what}: the fast and the plain computation differ by {difference:g}")
