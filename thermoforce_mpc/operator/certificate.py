"""The certificate: what the weights at hand guarantee about the effect of an action (paper, proposition).

For k = 1 … K, ∂F(t+k)/∂u(t) = m(x_t) · ∂v/∂u · Σ_i g_i a_i^(k−1). With a_i in (0, 1), an impulse response of one sign
(see `operator.parameters` for why two conditions on the gains are enough), m inside [1 − γ, 1 + γ] and ∂v/∂u inside
known bounds, the effect lies in an interval that never crosses zero, for any features.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.operator.parameters import OperatorParameters
from thermoforce_mpc.types import Array


@dataclass(frozen=True)
class Certificate:
    """Proven bounds; `certified` only where every clause holds, `reasons` says which do not."""

    certified: bool
    sign: int
    poles: tuple[float, ...]
    modulation_bounds: tuple[float, float]
    actuator_slope_bounds: tuple[float, float]
    effect_low_K: tuple[float, ...]
    effect_high_K: tuple[float, ...]
    reasons: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Plain values, for the artifact."""
        return {
            "certified": self.certified,
            "sign": self.sign,
            "poles": list(self.poles),
            "modulation_bounds": list(self.modulation_bounds),
            "actuator_slope_bounds": list(self.actuator_slope_bounds),
            "effect_low_K": list(self.effect_low_K),
            "effect_high_K": list(self.effect_high_K),
            "reasons": list(self.reasons),
        }


def modulation_interval(params: OperatorParameters) -> tuple[float, float]:
    """Interval that contains m(x) for every x: the output layer sees hidden units inside [−1, 1], whatever they saw."""
    reach = float(np.abs(params.output_weight).sum())
    low, high = np.tanh(params.output_bias - reach), np.tanh(params.output_bias + reach)
    return 1.0 + params.gamma * float(low), 1.0 + params.gamma * float(high)


def certificate(params: OperatorParameters, n_steps: int = 48) -> Certificate:
    """Prove the proposition for these weights over `n_steps` steps.

    Raises:
        DataError: `n_steps` is not positive.
    """
    if n_steps < 1:
        raise DataError(f"certificate over {n_steps} steps: expected at least 1")
    reasons: list[str] = []
    if not ((params.poles > 0) & (params.poles < 1)).all():
        reasons.append(f"a pole is outside (0, 1): {params.poles.tolist()}")
    impulse: Array = params.impulse(n_steps) * params.sign
    if not (impulse > 0).any():
        reasons.append(f"no action has an effect: gains {params.gains.tolist()}")
    m_low, m_high = modulation_interval(params)
    if m_low <= 0:
        reasons.append(f"the modulation can reach {m_low:g}")
    v_low, v_high = params.actuator.slope_bounds()
    if v_low < 0:
        reasons.append(f"the actuator map falls with u (slope {v_low:g})")
    weak, strong = impulse * m_low * v_low, impulse * m_high * v_high
    low, high = (weak, strong) if params.sign > 0 else (-strong, -weak)
    return Certificate(
        certified=not reasons,
        sign=params.sign,
        poles=tuple(params.poles.tolist()),
        modulation_bounds=(m_low, m_high),
        actuator_slope_bounds=(v_low, v_high),
        effect_low_K=tuple(low.tolist()),
        effect_high_K=tuple(high.tolist()),
        reasons=tuple(reasons),
    )
