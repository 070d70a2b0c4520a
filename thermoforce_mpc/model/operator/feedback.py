"""Bounds of the effect of an action if the modulation depends on the predicted zone temperature, and so on F.

Then F(t+1) = a ⊙ F(t) + g m(T_free + ΣF(t), …) v(t) (paper eq:operator with the remark below eq:mod), and an action
changes the gain of all later ones. With x(1) = g m ∂v/∂u the derivative of the modes with respect to the action, the
chain rule gives

    x(j+1) = (diag a + κ_j g 1ᵀ) x(j),   κ_j = v_j ∂m/∂T,   ∂F(t+k)/∂u(t) = 1ᵀ x(k).

κ_j is known by an interval only: v lies in [lowest, v_max], with lowest below 0 where levels are signed, and the slope
of the network is enclosed by interval arithmetic (both derivatives of tanh lie in [0, 1] everywhere). 1ᵀ x(k) is affine
in each κ_j, so its extremes lie at the interval ends, and the convex hull of all reachable x(k) is propagated exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from thermoforce_mpc.data import Array
from thermoforce_mpc.model.operator.features import ZONE
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# More corners than this are reduced to their convex hull, and a hull with more than that to its bounding box.
_PRUNE_ABOVE, _BOX_ABOVE = 48, 768
# Relative margin for rounding, here and in Qhull's joggled input.
_ROUNDING = 1e-9
# Feedback gain per step above which the bounds are infinite; larger values would soon overflow float64.
_RUNAWAY = 1e3


@dataclass(frozen=True)
class FeedbackBounds:
    """Enclosure of the feedback of F through the modulation.

    `slope_per_K` encloses v ∂m/∂T, 1/K; `response_low_K` and `response_high_K` (n,) enclose, for k = 1 … n, the effect
    on F of one unit of m ∂v/∂u, K (the impulse response without feedback).
    """

    slope_per_K: tuple[float, float]
    response_low_K: Array
    response_high_K: Array


def modulation_slope(params: OperatorParameters) -> tuple[float, float]:
    """Return an interval that contains ∂m/∂(zone temperature) for every x, 1/K."""
    paths = params.output_weight * params.hidden_weight[:, ZONE] / params.feature_scale[ZONE]
    return params.gamma * float(np.minimum(paths, 0.0).sum()), params.gamma * float(np.maximum(paths, 0.0).sum())


def feedback_bounds(params: OperatorParameters, n_steps: int) -> FeedbackBounds:
    """Return bounds of the response over `n_steps` steps for any weather, temperatures and later actions."""
    drive = params.heat_input.lowest, params.heat_input.largest()
    ends = [v * slope for v in drive for slope in modulation_slope(params)]
    low, high = (min(0.0, *ends), max(0.0, *ends)) if params.feedback_active else (0.0, 0.0)
    responses: list[tuple[float, float]] = []
    if max(-low, high) * float(np.abs(params.gains).sum()) > _RUNAWAY:
        nothing = np.full(n_steps, np.inf)
        return FeedbackBounds((low, high), -nothing, nothing)
    steps = [np.diag(params.poles) + kappa * np.outer(params.gains, np.ones(params.order)) for kappa in (low, high)]
    corners = np.array([params.gains])
    margin = 0.0
    for _ in range(n_steps):
        sums = corners.sum(axis=1)
        responses.append((float(sums.min()) - margin, float(sums.max()) + margin))
        corners = _pruned(np.concatenate([corners @ step.T for step in steps]) if low < high else corners @ steps[0].T)
        margin = margin * max(float(np.abs(step).sum(axis=0).max()) for step in steps)
        margin += _ROUNDING * float(np.abs(corners).max()) if low < high else 0.0
    bounds = np.array(responses)
    return FeedbackBounds((low, high), bounds[:, 0], bounds[:, 1])


def _pruned(corners: Array) -> Array:
    """Return fewer points with the same convex hull (or, above 768 points, their bounding box)."""
    order = corners.shape[1]
    if order == 1:
        return np.array([corners.min(axis=0), corners.max(axis=0)])
    if corners.shape[0] <= _PRUNE_ABOVE:
        return corners
    scale = np.abs(corners).max(axis=0)
    try:
        corners = corners[ConvexHull(corners / np.where(scale > 0, scale, 1.0), qhull_options="QJ").vertices]
    except QhullError:
        return _box(corners)
    return corners if corners.shape[0] <= _BOX_ABOVE else _box(corners)


def _box(points: Array) -> Array:
    """Return the corners of the bounding box of the points, sides along the modes."""
    low, high = points.min(axis=0), points.max(axis=0)
    grids = np.meshgrid(*zip(low, high, strict=True), indexing="ij")
    return np.stack([grid.ravel() for grid in grids], axis=1)
