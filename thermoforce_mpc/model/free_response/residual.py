"""Free response by linear weather models plus a frozen backbone's forecast of their residuals.

The linear model is fitted for both `DISTURBANCES_H`. The backbone forecasts the residual of each fit, and the series
itself, for buildings with little weather influence. The weights of the three candidates are learned in walk-forward
trials on the history.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, SIGNALS, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.execution.cooperative import Computation, run
from thermoforce_mpc.model.free_response.checks import LEVELS, checked_free
from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse, Task
from thermoforce_mpc.model.free_response.linear_weather import (
    DISTURBANCES_H,
    SHORTEST_HISTORY_S,
    fits_linear_weather,
)
from thermoforce_mpc.model.free_response.stacking import stacking_weights

_NAMES = ("without weather", "independent errors", "slow disturbance")
# Chosen on the records that chose `DISTURBANCES_H`.
_PRIOR = np.array([0.10, 0.50, 0.40])
# Strength of the prior. Of 1, 2, 5, 10, 20, 50 and 1000 the best over the first 6 h of those records, and 2 % better
# than 1 over 24 h. A larger value is 1 % better over 24 h there, but those buildings depend strongly on the weather; in
# others the trials must be able to change the weights.
_STRENGTH = 10.0
# Decay of a trial's weight with age, s: later trials have a longer history, more like that of the forecast.
_FORGET_S = 3 * DAY_S
_LEAD_EDGES_H = (3.0, 6.0, 12.0)
_SPAN_S = 7 * DAY_S
# Distance of trials, not a divisor of a day, so that they cover all hours of the day.
_EVERY_S = 7 * HOUR_S
_LEAST_CONTEXT_S = 3 * DAY_S
_LEAST_TRIALS = 4
_TRIAL_S = DAY_S
_RENEW_S = DAY_S
# Number of cached trials, about two weeks, so that renewing the weights repeats none.
_REMEMBERED = 128


@dataclass(frozen=True)
class Weights:
    """Weights of the candidates by lead time, `share` (3, N), from `trials` trials up to `time_s`."""

    share: Array
    trials: int
    time_s: float
    step_s: float

    @property
    def why(self) -> str:
        """Description for notes."""
        if not self.trials:
            return "default weights: too little history for trials"
        shares = ", ".join(f"{name} {share:.0%}" for name, share in zip(_NAMES, self.share.mean(axis=1), strict=True))
        return f"weights by {self.trials} trials: {shares}"


class ResidualFreeResponse:
    """`FreeResponse`: linear weather models plus `backbone`'s forecasts of their residuals (history − simulation).

    The state of a run is its `Weights`, renewed every day. Past trials are cached only to save computation.
    """

    name = "residual"

    def __init__(self, backbone: ChronosFreeResponse) -> None:
        self.backbone = backbone
        self._errors: OrderedDict[tuple[float, int, bytes], Array] = OrderedDict()

    def weight_hash(self) -> str:
        """Return the hash of the backbone's weights, which are frozen."""
        return self.backbone.weight_hash()

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises `DataError` as the linear model and the backbone do."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> tuple[FreeForecast, Weights | None]:
        """See `FollowingFreeResponse.follow`; raises as `forecast` does."""
        return run(self.following(free_C, history, boundary, state))

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, Weights | None]]:
        """See `ComputedFreeResponse.following`; raises as `forecast` does."""
        weights = state if isinstance(state, Weights) else None
        free = checked_free(free_C, history)
        if history.n_steps * boundary.step_s < SHORTEST_HISTORY_S:
            # Too short for the linear model; the backbone handles short histories and notes it.
            (alone,) = yield from self.backbone.forecasting([(free, history, boundary)])
            return alone, weights
        candidates, note = yield from self._candidates([(free, history, boundary)])
        now = float(history.time_s[-1])
        if (
            weights is None
            or not 0 <= now - weights.time_s < _RENEW_S
            or weights.share.shape[1] != boundary.n_steps
            or weights.step_s != boundary.step_s
        ):
            weights = yield from self._learn(free, history, boundary)
        quantiles = np.einsum("kn,kqn->qn", weights.share, candidates[0])
        note = f"linear weather models plus residual by {note}; {weights.why}"
        return FreeForecast(LEVELS, quantiles, note), weights

    def candidates(self, tasks: Sequence[Task]) -> tuple[list[Array], str]:
        """Return the quantiles (3, 9, N) °C of the three candidates for each task, and the backbone's note.

        Candidates: the backbone alone, then with the weather model for independent errors and for a slow disturbance.
        Raises as `forecast` does.
        """
        return run(self._candidates(tasks))

    def _candidates(self, tasks: Sequence[Task]) -> Computation[tuple[list[Array], str]]:
        todo: list[Task] = []
        ahead: list[Array] = []
        for free, history, boundary in tasks:
            todo.append((free, history, boundary))
            ahead.append(np.zeros(boundary.n_steps))
            for fit in fits_linear_weather(free, history, boundary, DISTURBANCES_H):
                todo.append((free - fit.past_C, history, boundary))
                ahead.append(fit.ahead_C)
        rests = yield from self.backbone.forecasting(todo)
        quantiles = [course + rest.quantiles_C for course, rest in zip(ahead, rests, strict=True)]
        k = len(_NAMES)
        return [np.array(quantiles[i : i + k]) for i in range(0, len(quantiles), k)], rests[0].note

    def _learn(self, free: Array, history: Record, boundary: Boundary) -> Computation[Weights]:
        """Return weights from one-day trial forecasts over the last week, made with the measured weather."""
        step_s, now = boundary.step_s, float(history.time_s[-1])
        trial_steps = min(boundary.n_steps, round(_TRIAL_S / step_s))
        lead_h = np.arange(1, boundary.n_steps + 1) * step_s / HOUR_S
        group_of = np.searchsorted(_LEAD_EDGES_H, lead_h - 1e-9)
        errors, origin_s = yield from self._trial_errors(free, history, trial_steps)
        share = np.repeat(_PRIOR[:, None], boundary.n_steps, axis=1)
        if len(errors) >= _LEAST_TRIALS:
            trust = np.exp((origin_s - origin_s[-1]) / _FORGET_S)
            learned = stacking_weights(np.array(errors), _PRIOR, _STRENGTH, group_of[:trial_steps], trust)
            share[:, :trial_steps] = learned
            share[:, trial_steps:] = learned[:, -1:]
        return Weights(share, len(errors) if len(errors) >= _LEAST_TRIALS else 0, now, step_s)

    def _trial_errors(self, free: Array, history: Record, steps: int) -> Computation[tuple[list[Array], Array]]:
        """Return the errors of the candidates' medians, (3, steps) per trial, K, and the trials' instants, s."""
        step_s = history.step_s
        last = history.n_steps - steps
        first = max(round(_LEAST_CONTEXT_S / step_s), last - round(_SPAN_S / step_s))
        # Trials lie on a fixed grid, so that cached ones are reused the next day.
        number = np.round(history.time_s / step_s).astype(int)
        day = round(DAY_S / step_s)
        origins = [
            t
            for t in range(first, last + 1)
            if number[t] % max(1, round(_EVERY_S / step_s)) == 0
            and np.isfinite(free[: t + 1]).sum() > day
            and np.isfinite(free[t + 1 : t + steps + 1]).any()
        ]
        keys = [_key(free, history, t, steps) for t in origins]
        new = [(key, t) for key, t in zip(keys, origins, strict=True) if key not in self._errors]
        if new:
            candidates, _ = yield from self._candidates([_past_task(free, history, t, steps) for _, t in new])
            for (key, t), quantiles in zip(new, candidates, strict=True):
                self._errors[key] = quantiles[:, LEVELS.size // 2] - free[t + 1 : t + steps + 1]
        for key in keys:
            self._errors.move_to_end(key)
        errors = [self._errors[key] for key in keys]
        while len(self._errors) > _REMEMBERED:
            self._errors.popitem(last=False)
        return errors, history.time_s[origins]


def _past_task(free: Array, history: Record, origin: int, steps: int) -> Task:
    """Return the forecast task at step `origin` of the history, with the measured weather as weather forecast."""
    ahead = Boundary.measured(history.slice(origin, origin + steps))
    return free[: origin + 1], history.slice(0, origin), ahead


def _key(free: Array, history: Record, origin: int, steps: int) -> tuple[float, int, bytes]:
    """Return the cache key of a trial: its instant, and a hash of all data up to its end.

    All past values are hashed, since an adapted operator or a corrected record changes the past series. Within a run
    the past does not change, so cached trials are found again.
    """
    past = history.slice(0, origin + steps)
    digest = hashlib.blake2b(free[: origin + steps + 1].tobytes(), digest_size=16)
    for name in SIGNALS:
        digest.update(getattr(past, name).tobytes())
    return float(history.time_s[origin]), steps, digest.digest()
