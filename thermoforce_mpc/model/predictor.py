"""Prediction before an action is chosen: the free response and what actions add to it (paper eq:compose, eq:effect)."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import SINGLE, Array, Boundary, FreeForecast, Names, Observation, Record
from thermoforce_mpc.data.limits import ROUNDING
from thermoforce_mpc.data.series import WEATHER, bridged
from thermoforce_mpc.data.superposition import compose, control_free
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution.cooperative import Computation, gather, run, timed
from thermoforce_mpc.model.forced_state import ForcedState, InitialForce, followed
from thermoforce_mpc.model.forecast_gaps import weather_spread
from thermoforce_mpc.model.free_response.checks import checked_forecast
from thermoforce_mpc.model.free_response.following import following
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.protocols import FreeResponse

if TYPE_CHECKING:  # loaded only where tables go out
    import pandas as pd


@dataclass(frozen=True)
class Prediction:
    """Free and forced parts of a prediction over N steps, at the end of each step.

    `free_C` °C and its 80 % band `free_low_C` to `free_high_C` have shape (Z, N), `forced_K` K shape (..., Z, N), one
    per candidate; `time_s` (N,) is the end of each step, counted from `origin` where the record has time stamps.
    """

    free_C: Array
    forced_K: Array
    free_low_C: Array
    free_high_C: Array
    time_s: Array
    origin: pd.Timestamp | None = None
    names: Names = SINGLE

    @property
    def total_C(self) -> Array:
        """Free plus forced (paper eq:compose), shape (..., Z, N), °C."""
        return compose(self.free_C, self.forced_K)

    @property
    def band_C(self) -> tuple[Array, Array]:
        """Ends of the 80 % band of the temperature, (..., Z, N) each, °C: that of the free response, moved by F."""
        return compose(self.free_low_C, self.forced_K), compose(self.free_high_C, self.forced_K)

    def to_dataframe(self) -> pd.DataFrame:
        """One row per step, at its end: `T_zone_C`, its 80 % band `T_low_C` to `T_high_C`, `T_free_C`, `T_forced_K`.

        The band is that of the free response; the uncertainty of the gain is on the model's card. With several zones,
        one of each per name: `T_zone_C[bath]`. Raises `DataError` for several candidates at once.
        """
        if self.forced_K.ndim != 2:
            raise DataError(f"the prediction has {self.forced_K.shape[:-2]} candidates: predict one to get a table")
        from thermoforce_mpc.data.dataframes import table

        columns = self.names.columns(
            T_zone_C=self.total_C,
            T_low_C=self.band_C[0],
            T_high_C=self.band_C[1],
            T_free_C=self.free_C,
            T_forced_K=self.forced_K,
        )
        return table(self.time_s, self.origin, **columns)


@dataclass(frozen=True)
class PredictorState:
    """What a predictor has learned in one run: the forced state so far, and what each free response (Z,) keeps."""

    forced: ForcedState | None = None
    free: tuple[object, ...] = ()


@dataclass(frozen=True)
class PredictionContext:
    """A prediction at one instant, before an action is chosen: the free response, and what actions add to it.

    `operator` at the step of `boundary`; `forced_K` (Z, A, r): forced state now, K; `free`: forecast of all zones, N
    steps; `features` (Z, N, 4): x_t at the start of each step. `bridged`: which gaps of the history were filled and
    how, in words. `unmeasured`: zones without any temperature in the history; their free response is the mean of the
    others'. `origin`: time stamp that the seconds count from, where the history has one. `seconds`: what it cost, by
    part: `estimate` (forced state) and `forecast` (free response). `state`: for the next context of this run.
    """

    operator: BuildingOperator
    forced_K: Array
    free: FreeForecast
    features: Array
    boundary: Boundary
    bridged: str = ""
    unmeasured: tuple[int, ...] = ()
    origin: pd.Timestamp | None = None
    seconds: Mapping[str, float] = field(default_factory=dict, compare=False)
    state: PredictorState | None = field(default=None, compare=False)
    names: Names = SINGLE

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return self.boundary.n_steps

    def predict(self, u: Array) -> Prediction:
        """Temperature under `u` (..., A, N) in [0, 1], free and forced apart; all candidates at once.

        One actuator's levels may be given as (..., N). Raises `DataError` for another number of actuators or steps, and
        levels that are not finite or leave [0, 1] (its lower end where the operator's levels are signed).
        """
        u = np.asarray(u, dtype=np.float64)
        actuators = len(self.operator.actuators)
        if actuators == 1 and u.shape[-2:] != (1, self.n_steps):
            u = u[..., None, :]
        if u.shape[-2:] != (actuators, self.n_steps):
            raise DataError(f"u has shape {u.shape}, expected (..., {actuators}, {self.n_steps})")
        u_min = self.operator.u_min[:, None]
        if not ((u >= u_min - ROUNDING) & (u <= 1 + ROUNDING)).all():
            raise DataError(f"levels (u) must be finite and inside [{u_min.min():g}, 1]")
        u = np.clip(u, u_min, 1.0)
        forced = self.operator.rollout(self.forced_K, u, self.features).sum(axis=(-3, -1))
        return Prediction(
            free_C=self.free.median_C,
            forced_K=forced,
            free_low_C=self.free.quantile_C(0.1),
            free_high_C=self.free.quantile_C(0.9),
            time_s=self.boundary.time_s[1:],
            origin=self.origin,
            names=self.names,
        )

    def effect(self, u_alt: Array, u: Array) -> Array:
        """What `u_alt` instead of `u` changes (paper eq:effect), shape (..., Z, N), K. The free response cancels."""
        return np.asarray(self.predict(u_alt).forced_K - self.predict(u).forced_K)

    def counterfactuals(self, levels: Array) -> Prediction:
        """Temperature under each constant level of all actuators, `levels` (L,) in [0, 1]; `forced_K` is (L, Z, N)."""
        levels = np.asarray(levels, dtype=np.float64)
        shape = (levels.size, len(self.operator.actuators), self.n_steps)
        return self.predict(np.broadcast_to(levels[:, None, None], shape))


class Predictor:
    """Splits a history into free and forced response and predicts both (paper eq:compose).

    `free_responses`: forecaster of the control-free series of each zone (Z,), or one for all that keeps no state of its
    own. `initial_force`: 'steady' starts F at the steady state of the first day's mean action, 'zero' at 0 as the paper
    does (F_t0 = 0); with modes of days the difference takes days to fade.
    """

    def __init__(
        self,
        operator: BuildingOperator,
        free_responses: FreeResponse | Sequence[FreeResponse],
        *,
        initial_force: InitialForce = "steady",
    ) -> None:
        if initial_force not in ("steady", "zero"):
            raise DataError(f"initial_force is '{initial_force}', expected 'steady' or 'zero'")
        zones = len(operator.zones)
        methods = tuple(free_responses) if isinstance(free_responses, Sequence) else (free_responses,) * zones
        if len(methods) != zones:
            raise DataError(f"{len(methods)} free responses for {zones} zones")
        self.operator = operator
        self.free_responses = methods
        self._initial_force: InitialForce = initial_force

    def forced_history(self, history: Record) -> Array:
        """Forced state of each pair at each boundary of `history`, (Z, A, n + 1, r), K; gaps are bridged (`gaps`)."""
        return self.followed(history).forced_K

    def forced_state(self, history: Record) -> Array:
        """Forced state of each pair now, shape (Z, A, r), K."""
        return np.asarray(self.forced_history(history)[:, :, -1])

    def free_history(self, history: Record) -> Array:
        """Control-free temperature T − F at each boundary of `history`, (Z, n + 1), °C; NaN where T is."""
        return control_free(history.T_zone_C, self.forced_history(history).sum(axis=(1, 3)))

    def followed(self, history: Record, state: PredictorState | None = None) -> ForcedState:
        """Forced states at all boundaries of `history`, from those that `state` knows; gaps are bridged (`gaps`)."""
        filled, _ = bridged(history)
        return followed(self.operator, state.forced if state else None, filled, self._initial_force)

    def context(self, observation: Observation, state: PredictorState | None = None) -> PredictionContext:
        """Forecast the free response and set up everything an action could change; `state` is of the last context.

        Gaps in the weather and the levels of the past are bridged, see `data.series`. A zone that was never measured is
        given the mean of the others' free responses, and `bridged` says so.

        Raises:
            DataError: the history cannot be split (see `forced_history`), no zone's temperature was ever measured nor
                the weather, the forecast of the weather does not begin now, is of one instant or has gaps, or the free
                forecast is not fit to plan with.
        """
        return run(self.contexting(observation, state))

    def contexting(
        self, observation: Observation, state: PredictorState | None = None
    ) -> Computation[PredictionContext]:
        """`context` as a computation: the forecasts of all zones are requested together."""
        boundary = observation.boundary
        observation.check_begin()
        if not boundary.n_steps:
            raise DataError("boundary forecast: it is of one instant, which is no step to predict: give two or more")
        boundary.check(*WEATHER)
        began = time.perf_counter()
        history, note = bridged(observation.history, boundary)
        before = state or PredictorState()
        forced_state = followed(self.operator, before.forced, history, self._initial_force)
        forced = forced_state.forced_K
        estimate_s = time.perf_counter() - began
        free_C = control_free(history.T_zone_C, forced.sum(axis=(1, 3)))
        zones = range(len(self.free_responses))
        kept = before.free or (None,) * len(zones)
        has_readings = np.asarray(np.isfinite(free_C).any(axis=1))
        if not has_readings.any():
            raise DataError("the zone temperature was never measured in the history: nothing to forecast from")
        measured, states = np.flatnonzero(has_readings).tolist(), list(kept)
        forecasts = [following(self.free_responses[z], free_C[z], history, boundary, kept[z]) for z in measured]
        # What is guessed of the weather may be off: what that does to each zone, by the forecaster itself.
        shifted = _shifted(boundary, history)
        forecasts += [
            following(self.free_responses[z], free_C[z], history, other, kept[z]) for other in shifted for z in measured
        ]
        results, forecast_s = yield from timed(gather(forecasts))
        results, others = results[: len(measured)], results[len(measured) :]
        answers = []
        for z, (answer, states[z]) in zip(measured, results, strict=True):
            answers.append(checked_forecast(answer, boundary.n_steps, self.free_responses[z].name))
        unmeasured = tuple(np.flatnonzero(~has_readings).tolist())
        stacked = FreeForecast.stacked(answers)
        if shifted:
            medians = np.array([answer.median_C for answer, _ in others]).reshape(len(shifted), *stacked.median_C.shape)
            sd_K = np.sqrt(((medians - stacked.median_C) ** 2).sum(axis=0))
            stacked = stacked.widened(sd_K)
            remark = f"weather that nobody gave: it may move a zone by {sd_K.max():.2g} K (standard deviation)"
            note = f"{note}; {remark}" if note else remark
        free = _with_mean(stacked, has_readings)
        for z in unmeasured:
            remark = f"{history.names.label('T_zone_C', z)}: never measured, the mean free response of the other zones"
            note = f"{note}, {remark}" if note else f"bridged {remark}"
        now_C = np.empty(len(zones))
        now_C[has_readings] = [row[np.isfinite(row)][-1] for row in free_C[has_readings]]
        now_C[~has_readings] = now_C[has_readings].mean()
        starts = np.concatenate([now_C[:, None], free.median_C[:, :-1]], axis=1)
        features = feature_matrix(starts, boundary.T_out_C[:-1], boundary.solar_W_m2[:-1], boundary.time_s[:-1])
        return PredictionContext(
            operator=self.operator.resampled(boundary.step_s),
            forced_K=forced[:, :, -1],
            free=free,
            features=features,
            boundary=boundary,
            bridged=note,
            unmeasured=unmeasured,
            origin=history.origin,
            seconds={"estimate": estimate_s, "forecast": forecast_s},
            state=PredictorState(forced_state, tuple(states)),
            names=history.names,
        )


def _shifted(boundary: Boundary, history: Record) -> list[Boundary]:
    """`boundary` with each weather signal that is guessed off by its standard deviation, as long as it is."""
    out = []
    for name in filter(boundary.guessed.__contains__, WEATHER):
        spread = weather_spread(name, boundary, history)
        if (spread > 0.0).any():
            out.append(replace(boundary, **{name: getattr(boundary, name) + spread}))
    return out


def _with_mean(free: FreeForecast, measured: NDArray[np.bool_]) -> FreeForecast:
    """The forecasts of the `measured` zones (Z,) set among all, with the mean of theirs for the others."""
    if measured.all():
        return free
    quantiles_C = np.repeat(free.quantiles_C.mean(axis=1, keepdims=True), measured.size, axis=1)
    quantiles_C[:, measured] = free.quantiles_C
    return replace(free, quantiles_C=quantiles_C)
