"""The optimisation problem of one control step, as numbers: what every solver is given.

    minimise    sum_k  price_k · P_k(u_k) · Δt  +  w · s_k · Δt  +  ε u_k²
    subject to  F_{k+1} = A F_k + g m(x_k) u_k            forced response (paper eq:operator)
                lower_k - s_k ≤ T_free,k + F_k ≤ upper_k + s_k,   s_k ≥ 0,   0 ≤ u_k ≤ u_max

The free response T_free enters as a fixed vector. The slack s makes every instance feasible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.operator.rollout import forced_rollout
from thermoforce_mpc.types import HOUR_S, Array

J_PER_KWH = 3.6e6


@dataclass(frozen=True)
class Weights:
    """What an hour of discomfort is worth, and the tiny curvature that makes the optimum unique.

    `comfort` currency/(K·h); `curvature` currency per step and u².
    """

    comfort: float
    curvature: float


@dataclass(frozen=True)
class MPCProblem:
    """Numbers of one instance over N steps, r modes.

    `forced_state_K` (r,): F now. `features` (N, 4): raw features at the start of each step.
    (N,): `T_free_C`, `lower_C`, `upper_C` at the end of each step (margins already inside); `price_per_kWh`,
    `power_fixed_W` (while on) and `power_per_u_W` over each step. `u_max` is the highest level; below `lowest_level`
    the machine is on for the share u / `lowest_level` of a step, so the power is linear in u when the two are equal.
    """

    forced_state_K: Array
    features: Array
    T_free_C: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    power_fixed_W: Array
    power_per_u_W: Array
    step_s: float
    u_max: float
    lowest_level: float
    weights: Weights

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.T_free_C.size)

    @property
    def price_per_W(self) -> Array:
        """What one watt held over each step costs, currency/W, shape (N,)."""
        return np.asarray(self.price_per_kWh * self.step_s / J_PER_KWH, dtype=np.float64)

    @property
    def comfort_price(self) -> float:
        """What one kelvin of violation at the end of one step costs, currency/K."""
        return self.weights.comfort * self.step_s / HOUR_S

    def power_W(self, u: Array) -> Array:
        """Mean electric power over each step for levels `u` (..., N), W."""
        on_share = np.minimum(u / self.lowest_level, 1.0)
        return np.asarray(self.power_fixed_W * on_share + self.power_per_u_W * u, dtype=np.float64)

    def forced_K(self, operator: OperatorParameters, u: Array) -> Array:
        """Forced response at the end of each step for levels `u` (..., N), K, shape (..., N)."""
        modes = forced_rollout(operator, self.forced_state_K, u, self.features)
        return np.asarray(modes.sum(axis=-1), dtype=np.float64)

    def slack_K(self, T_zone_C: Array) -> Array:
        """Violation of the comfort bounds at the end of each step, K, shape as `T_zone_C`."""
        below, above = self.lower_C - T_zone_C, T_zone_C - self.upper_C
        return np.maximum(np.maximum(below, above), 0.0)

    def cost(self, operator: OperatorParameters, u: Array) -> Array:
        """Objective for levels `u` (..., N), currency, shape (...,)."""
        slack = self.slack_K(self.T_free_C + self.forced_K(operator, u))
        energy = (self.price_per_W * self.power_W(u)).sum(axis=-1)
        comfort = self.comfort_price * slack.sum(axis=-1)
        return np.asarray(energy + comfort + self.weights.curvature * (u**2).sum(axis=-1), dtype=np.float64)


@dataclass(frozen=True)
class Solution:
    """What a solver answers; `ok` only after its status, finiteness and bounds were checked.

    `u` (N,) levels (empty when not ok), `status` the solver's own word, `problem` what is wrong in one phrase.
    """

    ok: bool
    u: Array
    status: str
    iterations: int
    problem: str = ""
