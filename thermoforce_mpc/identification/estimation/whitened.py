"""Columns of runs and pairs, whitened by their disturbances, and their derivatives by time constants, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.identification.estimation.columns import N_FREE, Lags
from thermoforce_mpc.identification.estimation.recursions import filter_slopes, filtered, innovations
from thermoforce_mpc.identification.estimation.regression import RegressionData


class Blocks(NamedTuple):
    """Runs and pairs, one after another, and the lags of which columns are made.

    Attributes:
        signals: of all steps (N, s); `steps` (b + 1,): where each block begins.
        rows: step of each row within its block (n,); `begins` (b + 1,): where the rows of each block begin.
        gain, decay, sd: innovations of the disturbances (n, k), (n, k), (n,).
        counts: how many of the lags each block has (b,); the first.
        places: their columns (b, c).
        signal, lead, start: see `recursions.filtered` (c,).
        mode: time constant of each (c,), −1 for one that stays, with the pole per step `pole` (c,).
        acting: number of lags that are those of gains, r of each actuator, first; `sign` of the first actuator.
        step_h: h.
    """

    signals: Array
    steps: NDArray[np.intp]
    rows: NDArray[np.intp]
    begins: NDArray[np.intp]
    gain: Array
    decay: Array
    sd: Array
    counts: NDArray[np.intp]
    places: NDArray[np.intp]
    signal: NDArray[np.intp]
    lead: NDArray[np.intp]
    start: Array
    mode: NDArray[np.intp]
    pole: Array
    acting: int
    sign: int
    step_h: float


def blocks_of(regressions: Sequence[RegressionData], order: int, sign: int) -> Blocks:
    """Runs and pairs as blocks; columns are those of `system.System`."""
    K = regressions[0].others.shape[0]
    acting, lags = (1 + K) * order, Lags.of(order, K)
    filters = [regression.disturbance.innovations for regression in regressions]
    k = max(gain.shape[1] for gain, _, _ in filters)
    step_h = regressions[0].step_s / HOUR_S
    starts = N_FREE + 1
    shared = lags.signal.size - starts
    places, run = np.tile(np.arange(lags.signal.size), (len(regressions), 1)), 0
    for i, regression in enumerate(regressions):
        if regression.is_pair:
            places[i, acting:] = 0
        else:
            places[i, shared:] += run * starts
            run += 1
    return Blocks(
        signals=np.concatenate([regression.signals for regression in regressions]),
        steps=_begins([regression.n_steps for regression in regressions]),
        rows=np.concatenate([regression.rows for regression in regressions]),
        begins=_begins([regression.rows.size for regression in regressions]),
        gain=np.concatenate([_padded(gain, k) for gain, _, _ in filters]),
        decay=np.concatenate([_padded(decay, k) for _, decay, _ in filters]),
        sd=np.concatenate([sd for _, _, sd in filters]),
        counts=np.array([acting if e.is_pair else lags.signal.size for e in regressions]),
        places=places,
        signal=lags.signal,
        lead=lags.lead,
        start=lags.start,
        mode=lags.tau,
        pole=lags.poles(np.zeros(order), regressions[0].step_s),
        acting=acting,
        sign=sign,
        step_h=step_h,
    )


def varying_blocks(blocks: Blocks, place: NDArray[np.intp]) -> Blocks:
    """Only the columns that depend on the time constants, the i-th at `place[i]` (p,)."""
    part = blocks.mode >= 0
    return blocks._replace(
        counts=np.array([np.count_nonzero(part[:n]) for n in blocks.counts]),
        places=np.ascontiguousarray(place[blocks.places[:, part]]),
        signal=blocks.signal[part],
        lead=blocks.lead[part],
        start=blocks.start[part],
        mode=blocks.mode[part],
        pole=blocks.pole[part],
    )


def _begins(sizes: Sequence[int]) -> NDArray[np.intp]:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)


def _padded(values: Array, k: int) -> Array:
    """`values` (n, j) with zeros to (n, k)."""
    return np.concatenate([values, np.zeros((values.shape[0], k - values.shape[1]))], axis=1)


@njit(cache=True)
def whitened_columns(blocks: Blocks, log_tau: Array, out: Array) -> None:
    """Fill in the columns `out` (n or more, p) of all rows at ln(τ/h) (r,), in standard deviations."""
    r, n_lags = log_tau.size, blocks.mode.size
    tau = np.exp(log_tau)
    pole, own, lead = blocks.pole.copy(), np.ones(n_lags), np.zeros(n_lags)
    for c in range(n_lags):
        if blocks.mode[c] >= 0:
            pole[c] = np.exp(-blocks.step_h / tau[blocks.mode[c]])
        if c < blocks.acting:
            sign = blocks.sign if c < r else 1
            own[c] = sign * (tau[0] if c % r == 0 else 1.0)
            lead[c] = 0.0 if c % r == 0 else -sign * tau[0] / tau[c % r]
    for b in range(blocks.counts.size):
        n, first, last = blocks.counts[b], blocks.begins[b], blocks.begins[b + 1]
        signals = blocks.signals[blocks.steps[b] : blocks.steps[b + 1]]
        columns = filtered(
            signals, blocks.signal[:n], pole[:n], blocks.start[:n], own[:n], blocks.lead[:n], lead[:n],
            blocks.rows[first:last],
        )  # fmt: skip
        white = innovations(columns, blocks.gain[first:last], blocks.decay[first:last], blocks.sd[first:last])
        for t in range(last - first):
            for c in range(n):
                out[first + t, blocks.places[b, c]] = white[t, c]


@njit(cache=True)
def whitened_slopes(blocks: Blocks, log_tau: Array, values: Array, out: Array) -> None:
    """Fill in the derivatives `out` (n or more, r) by ln τ of the columns times their `values` (p,)."""
    r, n_signals = log_tau.size, blocks.signals.shape[1]
    tau = np.exp(log_tau)
    pole = np.exp(-blocks.step_h / tau)
    for b in range(blocks.counts.size):
        weights, turned, start = np.zeros((r, n_signals)), np.zeros((r, n_signals)), np.zeros(r)
        for c in range(blocks.counts[b]):
            i, k, value = blocks.mode[c], blocks.signal[c], values[blocks.places[b, c]]
            if c < blocks.acting:
                gain = blocks.sign * value if c < r else value
                # The first lag has what the slope is not of the other modes.
                by_first = tau[0] * gain if i == 0 else -tau[0] / tau[i] * gain
                weights[0, k] += by_first
                turned[0, k] += by_first
                if i > 0:
                    weights[i, k] += gain
                    turned[i, k] -= by_first
            elif i >= 0:
                weights[i, k] += value
                start[i] += blocks.start[c] * value
        first, last = blocks.begins[b], blocks.begins[b + 1]
        signals = blocks.signals[blocks.steps[b] : blocks.steps[b + 1]]
        slopes = filter_slopes(signals, weights, turned, start, pole, blocks.rows[first:last])
        out[first:last] = innovations(slopes, blocks.gain[first:last], blocks.decay[first:last], blocks.sd[first:last])
