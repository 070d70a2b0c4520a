"""Back-off from the comfort bounds under forecast uncertainty: chance and integrated chance constraints.

With a fixed chance level the frequency of violations is constant, but their size grows with the forecast uncertainty.
An integrated chance constraint (Klein Haneveld 1986) bounds the expected violation in K instead. The chance level is
active where forecasts are good; elsewhere it is lowered, equally for all lead times, until the expected violation over
the next 6 h is within its limit.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from thermoforce_mpc.data import HOUR_S, Array, FreeForecast

# Expected shortfall of a standard normal variable below −z, on a grid of z: φ(z) − z (1 − Φ(z)), decreasing.
_Z = np.linspace(0.0, 4.0, 401)
_SHORTFALL = norm.pdf(_Z) - _Z * norm.sf(_Z)
# `np.interp` needs increasing abscissae.
_BY_SHORTFALL = _SHORTFALL[::-1].copy(), _Z[::-1].copy()
# Calibrated quantile level from which the standard deviation is computed, and its normal score.
_SPREAD_LEVEL = 0.1
_SPREAD_Z = float(norm.isf(_SPREAD_LEVEL))
# Averaging window of the expected violation, h: heat given now arrives within it; later violations can be corrected.
_AHEAD_H = 6.0


def backoff_K(forecast: FreeForecast, step_s: float, level: float, violation_K: float | None, *, below: bool) -> Array:
    """Back-off from the lower (`below`) or upper bound at the end of each step, (N,) or (Z, N), K, nonnegative.

    Args:
        forecast: free response with calibrated quantiles.
        step_s: length of its steps, s.
        level: allowed probability of violating the bound, in (0, 0.5].
        violation_K: allowed expected violation, mean over the next 6 h, K; None for the chance level alone.
        below: True for the lower bound, False for the upper.
    """
    T_C = forecast.median_C
    sign, quantile, spread_at = (1.0, level, _SPREAD_LEVEL) if below else (-1.0, 1.0 - level, 1.0 - _SPREAD_LEVEL)
    chance = np.maximum(sign * (T_C - forecast.quantile_C(quantile)), 0.0)
    if violation_K is None:
        return np.asarray(chance)
    sd = np.maximum(sign * (T_C - forecast.quantile_C(spread_at)), 0.0) / _SPREAD_Z
    soon = sd[..., : max(1, round(_AHEAD_H * HOUR_S / step_s))].mean(axis=-1, keepdims=True)
    # Solve sd · shortfall(z) = violation.
    z = np.interp(violation_K / np.maximum(soon, 1e-9), *_BY_SHORTFALL)
    return np.asarray(np.maximum(chance, z * sd))
