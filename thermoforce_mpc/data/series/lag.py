"""A first-order lag: what follows a signal with a time constant."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array


def lagged(signal: Array, pole: float, start: float = 0.0) -> Array:
    """States (n + 1,) of a lag of steady gain 1 of `signal` (n,), constant in each step, from `start`.

    `pole`: the share of a state that is left after a step, exp(−step/τ).
    """
    from scipy.signal import lfilter  # takes half a second to import; loading a model does not need it

    return np.append(start, lfilter([1.0 - pole], [1.0, -pole], signal, zi=[pole * start])[0])
