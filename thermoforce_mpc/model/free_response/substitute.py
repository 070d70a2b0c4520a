"""What takes the place of a forecaster that fails: the linear weather model, then persistence, each with its reason.

A forecast is not used where its method raised, did not answer in time, or gave numbers that are not a forecast or
absurd. Absurd is what leaves the last measured temperature faster than the record ever did over the same time, and is
at the same time far from the linear weather model. Either alone is no evidence: a cold front exceeds what three days
have shown, and the linear model is poor in a light building.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Boundary, FreeForecast, Record, steps_in
from thermoforce_mpc.errors import DataError, ThermoForceError
from thermoforce_mpc.execution.cooperative import Computation
from thermoforce_mpc.model.free_response.checks import checked_forecast, checked_free
from thermoforce_mpc.model.free_response.following import Computed, following
from thermoforce_mpc.model.free_response.linear_weather import LinearWeather, Persistence
from thermoforce_mpc.protocols import FreeResponse

# Lead times at which a forecast is compared with the record, h: a step, and those of hours and a day ahead, since each
# fails in its own way.
_LEADS_H = (0.25, 1.0, 6.0, 24.0)
# A change is ordinary within this many times the largest of the record over the same time, plus this, K. By judgement
# (2026-11-22): forecasts must be both, out of the ordinary and far from that model.
_TIMES_RECORD, _BEYOND_RECORD_K = 1.5, 1.0
# Largest difference from the linear weather model of a forecast whose change is not ordinary, K. Errors of healthy
# forecasters two days ahead stay below 4 K on the records of docs/evidence/free-responses.md.
_FROM_WEATHER_MODEL_K = 5.0
# The same where the record is too short for that model: from the last temperature, K. By judgement (2026-11-22), as the
# two below: no room that is used moves as far in two days.
_FROM_LAST_K = 20.0
# Widest half of a forecast's interval, as a multiple of the change that is allowed.
_WIDEST = 3.0
# Consecutive failures after which what was kept is given up, since it may be what fails: as long as a plan is followed
# (`FallbackConfig.follow_steps`).
COLD_AFTER = 3


@dataclass(frozen=True)
class SubstituteState:
    """State of the method, and the number of its consecutive failures."""

    inner: object = None
    failures: int = 0


class WithSubstitutes(Computed):
    """`method`, or the first of `substitutes` that gives a forecast fit to plan with; it is tried again at every step.

    `FreeForecast.doubt` says why another took its place. Without substitutes, failures are raised, and what is finite
    is taken.
    """

    def __init__(
        self, method: FreeResponse, substitutes: Sequence[FreeResponse] = (LinearWeather(), Persistence())
    ) -> None:
        super().__init__(method)
        self.method, self._substitutes = method, tuple(substitutes)

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, SubstituteState]]:
        """See `ComputedFreeResponse.following`; raises `DataError` where no temperature was measured or all fail."""
        free = checked_free(free_C, history)
        before = state if isinstance(state, SubstituteState) else SubstituteState()
        inner = before.inner if before.failures < COLD_AFTER else None
        try:
            answer, after = yield from following(self.method, free, history, boundary, inner)
            checked_forecast(answer, boundary.n_steps, self.name)
            absurd = absurdity(answer, free, history, boundary) if self._substitutes else ""
            if absurd:
                raise DataError(f"free response '{self.name}' {absurd}")
        except Exception as error:  # whatever a forecaster does, the next one is tried
            reasons = [str(error) if isinstance(error, ThermoForceError) else f"{type(error).__name__}: {error}"]
        else:
            return answer, SubstituteState(after)
        failed = SubstituteState(before.inner, before.failures + 1)
        for substitute in self._substitutes:
            if substitute.name == self.name:
                continue
            try:
                answer = checked_forecast(
                    substitute.forecast(free, history, boundary), boundary.n_steps, substitute.name
                )
            except Exception as error:  # likewise
                reasons.append(f"{substitute.name}: {error}")
                continue
            doubt = f"free forecast by {substitute.name} instead ({'; '.join(reasons)})"
            return replace(answer, doubt=doubt), failed
        raise DataError("; ".join(reasons))


def absurdity(forecast: FreeForecast, free_C: Array, history: Record, boundary: Boundary) -> str:
    """What is absurd about a forecast (Q, N) after `free_C` (n + 1,), °C, in words; empty where nothing is."""
    finite = np.flatnonzero(np.isfinite(free_C))
    # Where the last readings are missing, the temperature has moved on since.
    last, age = float(free_C[finite[-1]]), int(free_C.size - 1 - finite[-1])
    median = forecast.median_C
    half_K = 0.5 * (forecast.quantile_C(0.9) - forecast.quantile_C(0.1))
    leads = sorted({steps_in(hours * HOUR_S, boundary.step_s) for hours in _LEADS_H})
    allowed = {lead: _allowed_K(free_C, lead + age) for lead in leads if lead <= boundary.n_steps}
    ends = [*allowed, boundary.n_steps]
    largest = dict(zip(ends, [*allowed.values(), max(allowed.values())], strict=True))
    far = [lead for lead, most in largest.items() if not abs(median[lead - 1] - last) <= most]
    wide = [lead for lead, most in largest.items() if not half_K[lead - 1] <= _WIDEST * most]
    if not (far or wide):
        return ""
    if far:
        lead = far[0]
        hours = lead * boundary.step_s / HOUR_S
        finding = (
            f"goes from {last:.1f} °C to {median[lead - 1]:.1f} °C in {hours:g} h, where the record changed by less "
            f"than {largest[lead]:.1f} K"
        )
    else:
        finding = f"has an interval of ±{half_K[wide[0] - 1]:.0f} K"
    try:
        other, most, whom = LinearWeather().forecast(free_C, history, boundary).median_C, _FROM_WEATHER_MODEL_K, "that"
    except DataError:
        other, most, whom = np.full(median.size, last), _FROM_LAST_K, "the last one"
    apart = float(np.abs(median - other).max())
    if apart <= most and not wide:
        return ""
    return f"{finding}; it is {apart:.1f} K from {whom}{' of the linear weather model' if whom == 'that' else ''}"


def _allowed_K(free_C: Array, lead: int) -> float:
    """Largest change of `free_C` (n + 1,) over `lead` steps that is ordinary, K; from the longest known below it."""
    for n in range(min(lead, free_C.size - 1), 0, -1):
        largest = float(np.fmax.reduce(np.abs(free_C[n:] - free_C[:-n])))  # NaN where none is known
        if math.isfinite(largest):
            # A record that is too short for the lead: what it showed, in proportion.
            return _TIMES_RECORD * largest * lead / n + _BEYOND_RECORD_K
    return _BEYOND_RECORD_K * max(1.0, lead)
