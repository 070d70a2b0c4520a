"""How far inside a comfort bound to plan so that an uncertain forecast keeps it: (integrated) chance constraints.

A chance level alone lets violations grow with the uncertainty: as often, but larger. An integrated chance constraint
(Klein Haneveld 1986) bounds the expected violation in K instead. The chance level rules where forecasts are good; where
they are not it is lowered, for all lead times alike, until the violation to be expected over the next hours is allowed.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from thermoforce_mpc.data import HOUR_S, Array, FreeForecast

# Expected shortfall of a standard normal variable below −z, on a grid of z: φ(z) − z (1 − Φ(z)), falling.
_Z = np.linspace(0.0, 4.0, 401)
_SHORTFALL = norm.pdf(_Z) - _Z * norm.sf(_Z)
# The calibrated quantile that the spread is read from, and its place on the normal scale.
_SPREAD_LEVEL = 0.1
_SPREAD_Z = float(norm.isf(_SPREAD_LEVEL))
# Heat given now arrives within these hours; what is expected beyond can still be acted on.
_AHEAD_H = 6.0


def backoff_K(forecast: FreeForecast, step_s: float, level: float, violation_K: float | None, *, below: bool) -> Array:
    """Distance to keep from the lower (`below`) or upper bound at the end of each step, shape (N,), K, not negative.

    Args:
        forecast: free response with calibrated quantiles.
        step_s: length of its steps, s.
        level: chance that the bound may be missed with, in (0, 0.5].
        violation_K: expected violation allowed in the mean over the next 6 h, K; None for the chance level alone.
        below: the bound is missed by being colder than the median.
    """
    T_C = forecast.median_C
    sign, quantile, spread_at = (1.0, level, _SPREAD_LEVEL) if below else (-1.0, 1.0 - level, 1.0 - _SPREAD_LEVEL)
    chance = np.maximum(sign * (T_C - forecast.quantile_C(quantile)), 0.0)
    if violation_K is None:
        return np.asarray(chance)
    sd = np.maximum(sign * (T_C - forecast.quantile_C(spread_at)), 0.0) / _SPREAD_Z
    soon = sd[: max(1, round(_AHEAD_H * HOUR_S / step_s))].mean()
    # sd · shortfall(z) = violation; np.interp wants rising abscissae.
    z = np.interp(violation_K / max(soon, 1e-9), _SHORTFALL[::-1], _Z[::-1])
    return np.asarray(np.maximum(chance, z * sd))
