"""Certificate: guaranteed bounds of the effect of an action for given weights (paper, proposition).

For k = 1 … K, ∂F(t+k)/∂u(t) = m(x_t) · ∂v/∂u · Σ_i g_i a_i^(k−1). With a_i in (0, 1), an impulse response of one sign
(two conditions on the gains suffice, see `operator.parameters`), m in [1 − γ, 1 + γ] and ∂v/∂u in known bounds, the
effect lies in an interval that does not cross zero, for any features.

With feedback, m depends on the predicted zone temperature, and so on F: F(t+1) = a ⊙ F(t) + g m(T_free + ΣF(t), …) v(t)
(remark below eq:mod). With x(1) = g m ∂v/∂u the derivative of the modes with respect to the action,

    x(j+1) = (diag a + κ_j g 1ᵀ) x(j),   κ_j = v_j ∂m/∂T,   ∂F(t+k)/∂u(t) = 1ᵀ x(k).

κ_j is known by an interval: v lies in [u_min, v_max], and both derivatives of tanh lie in [0, 1]. 1ᵀ x(k) is affine in
each κ_j, so its extremes lie at the interval ends, and the convex hull of all reachable x(k) is propagated exactly. The
interval is valid for the `n_steps` of the certificate and may cross zero: that operator is not certified.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.parameters import ZONE, OperatorParameters

# More corners than this are reduced to their convex hull, and a hull with more than that to its bounding box: each step
# multiplies them, so that bounds would take seconds.
_PRUNE_ABOVE, _BOX_ABOVE = 48, 768
# Relative margin for rounding, here and in Qhull's joggled input.
_HULL_ROUNDING = 1e-9
# Feedback gain per step above which the bounds are infinite; larger values would soon overflow float64.
_RUNAWAY = 1e3
# Tolerance of a negative response by rounding, as a share of the gains.
_ROUNDING = 1e-8


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
    drive = params.heat_input.u_min, params.heat_input.largest()
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
        margin += _HULL_ROUNDING * float(np.abs(corners).max()) if low < high else 0.0
    bounds = np.array(responses)
    return FeedbackBounds((low, high), bounds[:, 0], bounds[:, 1])


def _pruned(corners: Array) -> Array:
    """Return fewer points with the same convex hull (or, above 768 points, their bounding box)."""
    from scipy.spatial import ConvexHull, QhullError

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


@dataclass(frozen=True)
class Certificate:
    """Proven bounds of the effect, K per step ahead; `certified` if all conditions hold, else see `reasons`.

    `feedback_slope_per_K` encloses v ∂m/∂T, 1/K, with feedback, else (0, 0).
    """

    certified: bool
    sign: int
    poles: tuple[float, ...]
    modulation_bounds: tuple[float, float]
    actuator_slope_bounds: tuple[float, float]
    effect_low_K: tuple[float, ...]
    effect_high_K: tuple[float, ...]
    reasons: tuple[str, ...]
    feedback: bool = False
    feedback_slope_per_K: tuple[float, float] = (0.0, 0.0)

    def to_json(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def modulation_interval(params: OperatorParameters) -> tuple[float, float]:
    """Return an interval that contains m(x) for every x, since hidden units lie in [−1, 1]."""
    reach = float(np.abs(params.output_weight).sum())
    low, high = np.tanh(params.output_bias - reach), np.tanh(params.output_bias + reach)
    return 1.0 + params.gamma * float(low), 1.0 + params.gamma * float(high)


def certificate(params: OperatorParameters, n_steps: int = 48) -> Certificate:
    """Check the proposition for these weights over `n_steps` steps, at least 1 (else `DataError`)."""
    if n_steps < 1:
        raise DataError(f"certificate over {n_steps} steps: expected at least 1")
    reasons: list[str] = []
    if not ((params.poles > 0) & (params.poles < 1)).all():
        reasons.append(f"a pole is outside (0, 1): {params.poles.tolist()}")
    least, most, slope = _responses(params, n_steps)
    if not (most > 0).any():
        reasons.append(f"no action has an effect: gains {params.gains.tolist()}")
    # Without feedback the response is nonnegative by construction, up to rounding.
    refuted = ~(np.isfinite(least) & (least >= -_ROUNDING * np.abs(params.gains).sum()))
    if refuted.any():
        first = int(np.flatnonzero(refuted)[0])
        reasons.append(
            "the modulation depends on the predicted temperature, and its slope "
            f"(v dm/dT within [{slope[0]:.4g}, {slope[1]:.4g}] per K) could reverse the effect of an action: "
            f"{first + 1} steps later its lower bound in the direction of the sign is {least[first]:.4g} K; "
            "use feedback: false, or a smaller gamma or modulation_sd"
        )
    m_low, m_high = modulation_interval(params)
    if m_low <= 0:
        reasons.append(f"the modulation can reach {m_low:g}")
    v_low, v_high = params.heat_input.slope_bounds()
    if v_low < 0:
        reasons.append(f"the heat input falls with u (slope {v_low:g})")
    # Product with the nonnegative interval of m ∂v/∂u; a negative lower response takes the upper end of that interval.
    weak = np.where(least < 0, least * m_high * v_high, least * m_low * v_low)
    strong = most * m_high * v_high
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
        feedback=params.feedback,
        feedback_slope_per_K=slope,
    )


def _responses(params: OperatorParameters, n_steps: int) -> tuple[Array, Array, tuple[float, float]]:
    """Return bounds (n,) K of the response to one unit of m ∂v/∂u, in the direction of the sign; feedback slope 1/K."""
    if not params.feedback_active:
        impulse: Array = params.impulse(n_steps) * params.sign
        return impulse, impulse, (0.0, 0.0)
    bounds = feedback_bounds(params, n_steps)
    low, high = bounds.response_low_K, bounds.response_high_K
    return (low, high, bounds.slope_per_K) if params.sign > 0 else (-high, -low, bounds.slope_per_K)
