"""Forced-response operator and its parameters (paper eq:operator to eq:mod), in numpy only.

`r` parallel modes, fastest first, F = Σ F_i with F_i(t+1) = a_i F_i(t) + g_i m(x_t) v(u_t, T_out). Order 1 with v = u
is the paper's operator. A floor slab responds hours later, so the fastest gain may be negative, which gives a delay, as
long as Σ g_i (−ln a_i)/(1 − a_i), the initial slope of the step response (up to the step), keeps the sign. That is
sufficient: the impulse response divided by the fastest decay is monotone, so it does not cross zero at any step length
and for any weights.

Features x_t of the modulation (paper eq:mod): zone temperature and weather, without the control.

Without `u` and `F` in x_t the effect of an action is exactly `a^k g m(x_t)` (paper eq:marginal). An operator with
`feedback` adds F to the first column itself, and its certificate accounts for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.data.layout import mode_of
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

FEATURES: tuple[str, ...] = ("free_temperature_C", "outdoor_temperature_C", "solar_W_m2", "time_of_day")
"""Order of the columns: T − F in °C, outdoor °C, global horizontal W/m², cos(2π(hour − 15)/24)."""

N_FEATURES = len(FEATURES)
ZONE = FEATURES.index("free_temperature_C")
OUTDOOR = FEATURES.index("outdoor_temperature_C")

# Air outdoors is warmest about three hours after noon: storage in the ground delays it.
_WARMEST_HOUR = 15.0


def time_of_day(time_s: Array) -> Array:
    """Return cos(2π(hour − 15)/24): 1 at 15:00, −1 at 03:00; `time_s` in s since 1 January 00:00, any shape."""
    hour = np.mod(np.asarray(time_s, dtype=np.float64), DAY_S) / HOUR_S
    return np.asarray(np.cos(2.0 * np.pi * (hour - _WARMEST_HOUR) / 24.0))


def feature_matrix(free_C: Array, T_out_C: Array, solar_W_m2: Array, time_s: Array) -> Array:
    """Stack the four features of N steps, each sampled at the *start* of its step: (..., N, 4), as `FEATURES`.

    `free_C`: T − F, °C; `time_s`: s since 1 January; all (..., N) in physical units. Raises `DataError` where shapes do
    not broadcast, or a value is not finite.
    """
    columns = (free_C, T_out_C, solar_W_m2, time_of_day(time_s))
    try:
        matrix = np.empty((*np.broadcast_shapes(*map(np.shape, columns)), N_FEATURES))
    except ValueError as error:
        raise DataError(f"features of the operator differ in shape: {error}") from error
    for i, column in enumerate(columns):
        matrix[..., i] = column
    if not np.isfinite(matrix).all():
        bad = [name for i, name in enumerate(FEATURES) if not np.isfinite(matrix[..., i]).all()]
        raise DataError(f"features of the operator are not finite: {', '.join(bad)}; fill gaps first")
    return matrix


# Units of the network m(x), by judgement; the most that it may change an effect, as in the paper, whose errors are the
# same over a wide range of it (fig:gamma).
HIDDEN = 32
GAMMA = 0.75

# Weights and features below this saturate the network but cannot overflow float64.
_LARGEST = 1e100
# Tolerance of the initial slope by rounding: a pure delay has slope zero.
_ROUNDING = 1e-9
# Share of all gains below which a mode has none: rounding.
_NO_GAIN = 1e-10


def initial_weight(poles: Array) -> Array:
    """Return (−ln a_i)/(1 − a_i), the contribution of one unit of g_i to the step response's initial slope, (r,)."""
    return np.asarray(-np.log(poles) / (1.0 - poles))


@dataclass(frozen=True)
class OperatorParameters:
    """Parameters of an identified operator; raises `DataError` naming the field that is not allowed.

    Attributes:
        poles: a_i, shape (r,), dimensionless, in (0, 1), per step, increasing.
        gains: g_i, shape (r,), K per step at v = 1 and m = 1; all but the first are of `sign` or zero.
        hidden_weight, hidden_bias, output_weight, output_bias: the MLP, shapes (H, 4), (H,), (H,), scalar.
        feature_mean, feature_scale: normalisation of the features, shape (4,), in their physical units.
        gamma: γ of eq:mod, in [0, 1).
        sign: +1 heating, −1 cooling.
        step_s: step of poles and gains, s.
        heat_input: v(u, T_out) in front of the modes.
        feedback: whether m(x) uses the predicted temperature T instead of T − F (the paper's). Past actions then change
            the gain of later ones; see `operator.certificate` for the bounds.
    """

    poles: Array
    gains: Array
    hidden_weight: Array
    hidden_bias: Array
    output_weight: Array
    output_bias: float
    feature_mean: Array
    feature_scale: Array
    step_s: float
    gamma: float = GAMMA
    sign: int = 1
    heat_input: HeatInput = field(default=IDENTITY)
    feedback: bool = False

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray | list | tuple):
                array = np.array(value, dtype=np.float64)
                array.setflags(write=False)
                object.__setattr__(self, item.name, array)
        r, h = np.size(self.poles), np.size(self.hidden_bias)
        shapes = {
            "poles": (r,),
            "gains": (r,),
            "hidden_weight": (h, N_FEATURES),
            "hidden_bias": (h,),
            "output_weight": (h,),
            "feature_mean": (N_FEATURES,),
            "feature_scale": (N_FEATURES,),
        }
        for name, shape in shapes.items():
            actual = np.shape(getattr(self, name))
            if actual != shape or 0 in shape:
                raise DataError(f"operator: {name} has shape {actual}, expected {shape} with nothing empty")
        for name in (*shapes, "output_bias", "step_s", "gamma"):
            value = np.asarray(getattr(self, name))
            if not (np.isfinite(value).all() and (np.abs(value) <= _LARGEST).all()):
                raise DataError(f"operator: {name} has values that are not finite or beyond ±{_LARGEST:g}")
        if not ((self.poles > 0) & (self.poles < 1)).all():
            raise DataError(f"operator: poles {self.poles.tolist()} leave (0, 1)")
        if self.sign not in (1, -1):
            raise DataError(f"operator: sign is {self.sign}, expected 1 (heating) or -1 (cooling)")
        if not (np.diff(self.poles) > 0).all():
            raise DataError(f"operator: poles {self.poles.tolist()} must increase")
        if (self.gains[1:] * self.sign < 0).any():
            raise DataError(f"operator: gains {self.gains.tolist()} beyond the first must have the sign {self.sign:+d}")
        rates = self.gains * initial_weight(self.poles) * self.sign
        if rates.sum() < -_ROUNDING * np.abs(rates).sum():
            raise DataError(
                f"operator: gains {self.gains.tolist()} give an initial response of sign {-self.sign:+d} (wrong sign)"
            )
        if not 0.0 <= self.gamma < 1.0:
            raise DataError(f"operator: gamma is {self.gamma}, expected a value in [0, 1)")
        if not (self.feature_scale > 0).all():
            raise DataError(f"operator: feature_scale {self.feature_scale.tolist()} is not positive")
        if not isinstance(self.feedback, bool):
            raise DataError(f"operator: feedback is {self.feedback!r}, expected True or False")
        if not self.step_s > 0:
            raise DataError(f"operator: step_s is {self.step_s}, expected a positive number of seconds")

    @property
    def order(self) -> int:
        """Number of modes r."""
        return int(self.poles.size)

    @property
    def acting(self) -> NDArray[np.bool_]:
        """Modes with a gain (r,); the others answer nothing."""
        sizes = np.abs(self.gains)
        return np.asarray(sizes >= _NO_GAIN * sizes.sum())

    @property
    def mode(self) -> str:
        """What its actuator does, see `mode_of`."""
        return mode_of(self.sign, self.heat_input.u_min)

    @property
    def n_trained(self) -> int:
        """Number of trained parameters: 195 at order 1 with 32 hidden units, 2 where no network was trained."""
        network = self.hidden_bias.size * (N_FEATURES + 2) + 1
        trained = self.gamma > 0.0 and bool(self.hidden_weight.any())
        return 2 * self.order + (network if trained else 0)

    @property
    def n_used(self) -> int:
        """Number of trained parameters that enter predictions: without the network where it was not kept."""
        return self.n_trained if self.gamma > 0.0 and self.output_weight.any() else 2 * self.order

    @property
    def n_effective(self) -> int:
        """Number of used parameters that a prediction depends on: not those of hidden units that lead nowhere."""
        idle = int(np.sum(self.output_weight == 0.0)) if self.n_used > 2 * self.order else 0
        return self.n_used - (N_FEATURES + 2) * idle

    @property
    def parameters_in_words(self) -> str:
        """Numbers of trained and used parameters and, if different, of effective ones, as text."""
        words = f"{self.n_trained} trained parameters, {self.n_used} used"
        if self.n_used < self.n_trained:
            return f"{words}: the network was not kept"
        return words if self.n_effective == self.n_used else f"{words}, {self.n_effective} effective"

    @property
    def time_constants_h(self) -> Array:
        """−step / ln(a_i), shape (r,), h."""
        return np.asarray(-self.step_s / HOUR_S / np.log(self.poles))

    @property
    def steady_gains_K(self) -> Array:
        """g_i / (1 − a_i): steady response to v = 1 at m = 1, shape (r,), K."""
        return np.asarray(self.gains / (1.0 - self.poles))

    def impulse(self, n_steps: int) -> Array:
        """The impulse response Σ g_i a_i^(k−1), k = 1 … `n_steps`, to one step of v = m = 1, (n_steps,), K.

        It has one sign; rounding errors beyond zero are clipped. The longest one asked for is kept.
        """

        def response() -> Array:
            both = (self.gains[:, None] * self.poles[:, None] ** np.arange(n_steps)).sum(axis=0)
            return self.sign * np.maximum(self.sign * both, 0.0)

        return self._longest("impulse", n_steps, response)

    def step_response(self, n_steps: int) -> Array:
        """What v = m = 1 has added after each of its first `n_steps` steps, (n_steps,), K; kept as `impulse`."""
        return self._longest("step", n_steps, lambda: np.cumsum(self.impulse(n_steps)))

    def _longest(self, name: str, n_steps: int, response: Callable[[], Array]) -> Array:
        """The first `n_steps` of the longest response of this name that was asked for."""
        kept = self._responses.get(name)
        if kept is None or kept.size < n_steps:
            kept = self._responses[name] = response()
            kept.setflags(write=False)
        return np.asarray(kept[:n_steps])

    @cached_property
    def _responses(self) -> dict[str, Array]:
        return {}

    @cached_property
    def constant_modulation(self) -> float | None:
        """The modulation where no feature enters it, since the network was not kept; None where features do."""
        return None if self.output_weight.any() else float(1.0 + self.gamma * np.tanh(self.output_bias))

    def modulation(self, features: Array) -> Array:
        """Return m(x) of eq:mod for `features` (..., 4) in physical units; shape (...), in [1 − γ, 1 + γ]."""
        if self.constant_modulation is not None:
            return np.full(np.shape(features)[:-1], self.constant_modulation)
        x = (np.asarray(features, dtype=np.float64) - self.feature_mean) / self.feature_scale
        hidden = np.tanh(x @ self.hidden_weight.T + self.hidden_bias)
        return np.asarray(1.0 + self.gamma * np.tanh(hidden @ self.output_weight + self.output_bias))

    @property
    def feedback_active(self) -> bool:
        """Whether the modulation depends on F; then a rollout is not linear in the drive."""
        # Without a connection to the zone temperature the modulation does not depend on F.
        connected = (self.output_weight != 0.0) & (self.hidden_weight[:, ZONE] != 0.0)
        return self.feedback and self.gamma > 0.0 and bool(connected.any())

    def seen(self, features: Array, forced_K: Array) -> Array:
        """Return the modulation's input for `features` (..., 4) with T − F at the forced state `forced_K` (..., r).

        Callers always pass T − F; with `feedback`, F is added only here.
        """
        features = np.asarray(features, dtype=np.float64)
        if not self.feedback:
            return features
        forced = np.asarray(forced_K, dtype=np.float64).sum(axis=-1)
        lead = np.broadcast_shapes(features.shape[:-1], forced.shape)
        features = np.array(np.broadcast_to(features, (*lead, N_FEATURES)))
        features[..., ZONE] += forced
        return features

    def drive(self, u: Array, features: Array) -> Array:
        """Return the drive m(x_t) · v(u_t, T_out,t) of all modes; `u` (..., N), `features` (..., N, 4) from `seen`."""
        features = np.asarray(features, dtype=np.float64)
        return self.modulation(features) * self.heat_input(u, features[..., OUTDOOR])

    def advance(self, forced_K: Array, heat: Array, features: Array) -> Array:
        """Advance one step with v = `heat` (...): `forced_K` (..., r), `features` (..., 4) with T − F → (..., r) K."""
        drive = self.modulation(self.seen(features, forced_K)) * heat
        return np.asarray(self.poles * forced_K + self.gains * np.asarray(drive)[..., None])

    def step(self, forced_K: Array, u: Array, features: Array) -> Array:
        """Advance one step of eq:operator: `forced_K` (..., r) K, `u` (...), `features` (..., 4) → (..., r) K."""
        features = np.asarray(features, dtype=np.float64)
        return self.advance(forced_K, self.heat_input(u, features[..., OUTDOOR]), features)

    def resampled(self, step_s: float) -> OperatorParameters:
        """Return the operator at another step; exact if v and m are constant over the longer of the two steps."""
        ratio = step_s / self.step_s
        if ratio == 1.0:
            return self
        poles = self.poles**ratio
        return replace(self, poles=poles, gains=self.steady_gains_K * (1.0 - poles), step_s=step_s)


def linear_operator(
    poles: Array,
    gains: Array,
    *,
    step_s: float,
    sign: int = 1,
    gamma: float = GAMMA,
    feature_mean: Array | None = None,
    feature_scale: Array | None = None,
    heat_input: HeatInput = IDENTITY,
    hidden: int = HIDDEN,
) -> OperatorParameters:
    """Return an operator with modulation exactly 1 (all weights zero): the linear gain of paper eq:arx."""
    return OperatorParameters(
        poles=np.asarray(poles, dtype=np.float64),
        gains=np.asarray(gains, dtype=np.float64),
        hidden_weight=np.zeros((hidden, N_FEATURES)),
        hidden_bias=np.zeros(hidden),
        output_weight=np.zeros(hidden),
        output_bias=0.0,
        feature_mean=np.zeros(N_FEATURES) if feature_mean is None else feature_mean,
        feature_scale=np.ones(N_FEATURES) if feature_scale is None else feature_scale,
        gamma=gamma,
        sign=sign,
        step_s=step_s,
        heat_input=heat_input,
    )
