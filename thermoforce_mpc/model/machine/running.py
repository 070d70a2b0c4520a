"""How long a machine that feeds several actuators runs for them.

The machine gives what its actuators take together. Below a load ℓ, a share of its capacity, it cycles: with the set
S of actuators on it runs for f(S) = min(Σ_{a in S} w_a, 1) of the time, w_a = share_a / ℓ. On-times that begin
together are nested, so over a step it runs for ∫₀¹ f({a: on_a > τ}) dτ. That is the Lovász extension of f, convex in
the on-times because f is submodular (Lovász 1983; Bach 2013, Learning with Submodular Functions, prop. 3.6). By duality

    running  =  min_{θ ≥ 0}  θ + Σ_a w_a max(on_a − θ, 0)                                          θ: time at ℓ or above

It is the longest on-time where each actuator alone takes ℓ or more, and proportional to the load where all together
take less.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array


def running_share(on: Array, weights: Array) -> Array:
    """Share of each step that a machine runs for actuators whose on-times begin together.

    Args:
        on: share of each step that each actuator is on, shape (..., A, N), in [0, 1].
        weights: share of the time that the machine runs while only that actuator is on, shape (A,), in (0, 1].

    Returns:
        Shape (..., N), in [0, 1].
    """
    order = np.argsort(-on, axis=-2, kind="stable")
    longest_first = np.take_along_axis(on, order, axis=-2)
    runs = np.minimum(np.cumsum(np.asarray(weights)[order], axis=-2), 1.0)
    # From the end of the next shorter on-time to its own, the machine runs for those on at least that long.
    shorter = np.concatenate([longest_first[..., 1:, :], np.zeros_like(longest_first[..., :1, :])], axis=-2)
    return np.asarray((runs * (longest_first - shorter)).sum(axis=-2))
