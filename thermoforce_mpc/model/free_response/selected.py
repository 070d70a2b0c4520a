"""Choose among forecasters by walk-forward trials on the history alone, and widen the interval to what they showed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.free_response.checks import checked_free
from thermoforce_mpc.model.free_response.following import follow
from thermoforce_mpc.model.free_response.walk_forward import interval_scale, rescaled, run_trials, trial_origins
from thermoforce_mpc.protocols import FreeResponse

# Fixed before any data were looked at: what a more elaborate method must gain over a simpler one to be preferred.
_LEAST_GAIN = 0.02
_LEAST_CONTEXT_S = 3 * DAY_S
_SPAN_S = 7 * DAY_S
_EVERY_S = 7 * HOUR_S
_LEAST_TRIALS = 4
_RENEW_S = DAY_S


@dataclass(frozen=True)
class Selection:
    """Which method is used from `time_s` on and why; `scale` (N,) widens its interval."""

    name: str
    why: str
    errors_K: Mapping[str, float]
    scale: Array
    time_s: float


@dataclass(frozen=True)
class SelectedState:
    """What is known in a run: the method in use, and the state of that method."""

    selection: Selection
    of_method: object = None


class SelectedFreeResponse:
    """The best of several methods in trials over the last week; chosen anew every day.

    In the trials the weather that came stands in for the weather forecast of the time, which is not in the history:
    methods that use weather look a little better in them than they will be.
    """

    name = "selected"

    def __init__(self, candidates: Mapping[str, FreeResponse], first: str) -> None:
        """Give the candidates from the simplest to the most elaborate.

        Args:
            candidates: methods by name.
            first: the one used until the history is long enough for trials.

        Raises:
            DataError: `first` is not among the candidates.
        """
        if first not in candidates:
            raise DataError(f"selected: '{first}' is not among the candidates {', '.join(candidates)}")
        self._candidates, self._first = dict(candidates), first

    def weight_hash(self) -> str:
        """Hash of the weights of the frozen candidate; nothing here changes them."""
        for candidate in self._candidates.values():
            hashed = getattr(candidate, "weight_hash", None)
            if hashed is not None:
                return str(hashed())
        raise DataError("selected: no candidate has weights")

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises what the chosen method raises."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> tuple[FreeForecast, SelectedState]:
        """See `FollowingFreeResponse.follow`; raises what the chosen method raises."""
        free = checked_free(free_C, history)
        last = state if isinstance(state, SelectedState) else None
        current, now, n = last.selection if last else None, float(history.time_s[-1]), boundary.n_steps
        if current is None or not 0 <= now - current.time_s < _RENEW_S or current.scale.size != n:
            current = self._select(free, history, boundary)
        of_method = last.of_method if last and last.selection.name == current.name else None
        raw, of_method = follow(self._candidates[current.name], free, history, boundary, of_method)
        forecast = rescaled(raw, current.scale)
        note = f"{forecast.note}; {current.why}"
        return FreeForecast(forecast.levels, forecast.quantiles_C, note), SelectedState(current, of_method)

    def _select(self, free: Array, history: Record, boundary: Boundary) -> Selection:
        step_s, n, now = boundary.step_s, boundary.n_steps, float(history.time_s[-1])
        origins = (
            trial_origins(
                history.n_steps,
                n,
                least_context=round(_LEAST_CONTEXT_S / step_s),
                span=round(_SPAN_S / step_s),
                every=max(1, round(_EVERY_S / step_s)),
            )
            if history.n_steps
            else []
        )
        origins = [
            t for t in origins if np.isfinite(free[: t + 1]).any() and np.isfinite(free[t + 1 : t + n + 1]).any()
        ]
        if len(origins) < _LEAST_TRIALS:
            why = f"not chosen: history allows {len(origins)} trials, {_LEAST_TRIALS} are needed"
            return Selection(self._first, why, {}, np.ones(n), now)
        trials = {
            name: found
            for name, method in self._candidates.items()
            if (found := run_trials(method, free, history, n, origins)) is not None
        }
        errors = {name: float(np.mean([trial.error_K for trial in found])) for name, found in trials.items()}
        if not errors:
            return Selection(self._first, "not chosen: no candidate could forecast the trials", {}, np.ones(n), now)
        best = next(iter(errors))
        for name, error in errors.items():
            if error < (1.0 - _LEAST_GAIN) * errors[best]:
                best = name
        table = ", ".join(f"{name} {error:.2f}" for name, error in errors.items())
        why = f"chosen by {len(origins)} trials (mean absolute error in K: {table})"
        return Selection(best, why, errors, interval_scale(trials[best]), now)
