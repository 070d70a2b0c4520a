"""Call of a free response during a run, its work done here or together with others', and the mean of two."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, FreeForecast, Record
from thermoforce_mpc.data.series import at_instants
from thermoforce_mpc.execution.cooperative import Computation, Request, perform, run
from thermoforce_mpc.protocols import ComputedFreeResponse, FollowingFreeResponse, FreeResponse

Answer = tuple[FreeForecast, object]

# Days of a run after which shares of a mean are half way to what erred least, and in which what is known fades: by
# judgement. Over 1 to 24 h the error is .93 of that of equal shares on five runs of one and two weeks (heat pump from
# days 72 and 95, an office's cold week, two generated houses), 1.01 at worst; .91 on seven others (an air unit, houses,
# days 44 and 108), 1.06 at worst (29 November 2026).
_HALF_SURE_DAYS, _FADING_S = 2.0, 10.0 * DAY_S
# Mean square of the difference of two forecasts, as a share of both errors', below which they err alike: rounding.
_ALIKE = 1e-6


def follow(method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object) -> Answer:
    """The forecast of `method` and its state for the next call of this run (None at its start)."""
    # By name here and below: a protocol's check costs more than all else, and since Python 3.12 asks no `__getattr__`.
    if hasattr(method, "follow"):
        return cast(FollowingFreeResponse, method).follow(free_C, history, boundary, state)
    return method.forecast(free_C, history, boundary), None


def following(
    method: FreeResponse, free_C: Array, history: Record, boundary: Boundary, state: object
) -> Computation[Answer]:
    """`follow` as a computation that yields requests; a method that makes none is one request itself."""
    if hasattr(method, "following"):
        return (yield from cast(ComputedFreeResponse, method).following(free_C, history, boundary, state))
    answer: Answer = yield from perform(Request(method, lambda: follow(method, free_C, history, boundary, state)))
    return answer


class Computed(ABC):
    """`FreeResponse` around that of `of`, whose name and weights it has, by its computation `following`."""

    def __init__(self, of: FreeResponse) -> None:
        self._of = of
        if hasattr(of, "weight_hash"):
            self.weight_hash = of.weight_hash

    @property
    def name(self) -> str:
        """That of the method inside."""
        return self._of.name

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        """See `FreeResponse.forecast`; raises as `following` does."""
        return self.follow(free_C, history, boundary, None)[0]

    def follow(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> Answer:
        """See `FollowingFreeResponse.follow`; raises as `following` does."""
        return run(self.following(free_C, history, boundary, state))

    @abstractmethod
    def following(self, free_C: Array, history: Record, boundary: Boundary, state: object) -> Computation[Answer]:
        """See `ComputedFreeResponse.following`."""


@dataclass(frozen=True)
class MeanState:
    """State of a run: how both have erred, and forecasts of which not all is known.

    `lead_s` (K,): lead times at which they are compared, each hour of a day, s. `time_s` (I,): when each of the I
    forecasts was issued, one for each hour, s; `medians_C` (I, 2, K): of both. `products_K2` (3, K): sums of the
    products of errors, first with first, second with second, first with second; `known` (K,): in so many comparisons;
    both fade. `latest_s`: time of the last forecast, s; `of`: what both are, in words.
    """

    lead_s: Array
    time_s: Array
    medians_C: Array
    products_K2: Array
    known: Array
    latest_s: float
    of: tuple[str, str]


class MeanFreeResponse(Computed):
    """`FreeResponse` that is the mean of `first` and `second`, which keep no state; quantiles are averaged level by
    level (Lichtendahl et al. 2013).

    Their errors differ, so that the mean errs less than either in most buildings, by equal shares as well as by
    estimated ones where little is known (Clemen 1989). So it begins; as a run goes on, the shares go to those with the
    least error (Bates and Granger 1969), by how both erred on the same hours.
    """

    def __init__(self, first: FreeResponse, second: FreeResponse) -> None:
        super().__init__(first)
        self._each = (first, second)

    def following(
        self, free_C: Array, history: Record, boundary: Boundary, state: object
    ) -> Computation[tuple[FreeForecast, MeanState]]:
        """See `ComputedFreeResponse.following`; raises what either raises."""
        answers = []
        for method in self._each:
            forecast, _ = yield from following(method, free_C, history, boundary, None)
            answers.append(forecast)
        first, second = answers
        stride = max(1, min(round(HOUR_S / boundary.step_s), boundary.n_steps))
        compared = slice(stride - 1, max(stride, round(DAY_S / boundary.step_s)), stride)
        medians_C = np.stack([first.median_C, second.median_C])[:, compared]
        lead_s = boundary.step_s * stride * np.arange(1, medians_C.shape[1] + 1)
        now, of = float(history.time_s[-1]), (first.note, second.note)
        kept = state if isinstance(state, MeanState) else None
        same = kept is not None and lead_s.size == kept.lead_s.size and bool((abs(lead_s - kept.lead_s) < 1.0).all())
        if kept is None or not same or now < kept.latest_s or of != kept.of:
            # A run that begins; a method in whose place another one spoke (too little history) has not erred itself.
            K = lead_s.size
            kept = MeanState(lead_s, np.empty(0), np.empty((0, 2, K)), np.zeros((3, K)), np.zeros(K), now, of)
        kept = _compared(kept, np.asarray(free_C, dtype=np.float64), history)
        shares = _shares(kept, max(HOUR_S, boundary.step_s))
        if not kept.time_s.size or now - kept.time_s[-1] >= HOUR_S - 1.0:
            kept = replace(
                kept,
                time_s=np.append(kept.time_s, now),
                medians_C=np.concatenate([kept.medians_C, medians_C[None]]),
            )
        note = f"mean of {first.note} ({100.0 * shares.min():.0f} % to {100.0 * shares.max():.0f} %) and {second.note}"
        share = np.interp(boundary.time_s[1:] - boundary.time_s[0], lead_s, shares)
        quantiles_C = share * first.quantiles_C + (1.0 - share) * second.quantiles_C
        return FreeForecast(first.levels, quantiles_C, note), kept


def _compared(state: MeanState, free_C: Array, history: Record) -> MeanState:
    """The state after comparing the values since the last call with what forecast them."""
    now = float(history.time_s[-1])
    faded = np.exp(-(now - state.latest_s) / _FADING_S)
    products_K2, known = faded * state.products_K2, faded * state.known
    ends = state.time_s[:, None] + state.lead_s
    due = (ends > state.latest_s + 0.5) & (ends <= now + 0.5)
    if due.any():
        read_C = np.full(ends.shape, np.nan)
        read_C[due] = at_instants(ends[due], history.time_s, free_C, 0.5)
        first, second = (read_C[:, None] - state.medians_C).transpose(1, 0, 2)
        products_K2 = products_K2 + np.nansum([first * first, second * second, first * second], axis=1)
        known = known + np.isfinite(read_C).sum(axis=0)
    still = ends[:, -1] > now + 0.5
    return replace(
        state,
        time_s=state.time_s[still],
        medians_C=state.medians_C[still],
        products_K2=products_K2,
        known=known,
        latest_s=now,
    )


def _shares(state: MeanState, every_s: float) -> Array:
    """What the first counts at each lead time (K,): from a half towards what would have erred least, as more is known.

    One that follows the last readings is better over an hour, one of the weather over a day.
    """
    first, second, both = state.products_K2
    apart = first + second - 2.0 * both
    known = apart > _ALIKE * (first + second)
    best = np.clip((second - both) / np.where(known, apart, 1.0), 0.0, 1.0)
    days = state.known * every_s / DAY_S
    return np.asarray(0.5 + np.where(known, best - 0.5, 0.0) * days / (days + _HALF_SURE_DAYS))
