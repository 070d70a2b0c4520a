"""What an identification works on: runs of one building, and pairs of runs that share their weather."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.limits import ROUNDING

# Least excitation: hours on, standard deviation of u, and changes of u. Below, gain and drift cannot be told apart.
MIN_ON_H = 1.0
MIN_SD_U = 0.05
MIN_CHANGES = 4
MIN_DAYS = 0.9
# Pairs are runs of one building from one state: their temperatures start equal.
MAX_START_DIFFERENCE_K = 0.05


@dataclass(frozen=True)
class Pair:
    """Two runs that start in the same state under the same weather and differ in what was done (paper eq:paired).

    Raises:
        DataError: the runs differ in time, weather or starting temperature.
    """

    a: Record
    b: Record
    label: str = ""

    def __post_init__(self) -> None:
        what = f"pair {self.label}".strip()
        for name in ("time_s", "T_out_C", "solar_W_m2"):
            first, second = getattr(self.a, name), getattr(self.b, name)
            if first.shape != second.shape or not np.allclose(first, second, atol=1e-6, equal_nan=True):
                raise DataError(f"{what}: {name} differs between the two runs; a pair shares clock and weather")
        start = abs(float(self.a.T_zone_C[0] - self.b.T_zone_C[0]))
        if not start <= MAX_START_DIFFERENCE_K:
            raise DataError(
                f"{what}: the zone starts {start:.3f} K apart, more than {MAX_START_DIFFERENCE_K} K: "
                "start both runs from the same state"
            )


def check_run(history: Record, name: str) -> None:
    """Refuse a run that nothing can be identified from.

    Raises:
        DataError: with the numbers that are wrong and what to do about them.
    """
    _check_signals(history, name)
    days = history.n_steps * history.step_s / DAY_S
    if days < MIN_DAYS:
        raise DataError(
            f"{name}: {days:.2f} days of data, need at least {MIN_DAYS}: in less, the slow part of the response and "
            "the daily cycle of the weather cannot be told apart; record one to three days"
        )
    u = history.u
    on_h = float((u > 0.02).sum()) * history.step_s / HOUR_S
    changes = int((np.abs(np.diff(u)) > 0.02).sum())
    spread = float(np.std(u))
    advice = "probe with varied levels and holding times (`tf-mpc identify` designs that), or add days"
    if spread < 1e-6:
        raise DataError(f"{name}: u is constant at {u[0]:g}: its effect cannot be seen; {advice}")
    if on_h < MIN_ON_H or spread < MIN_SD_U or changes < MIN_CHANGES:
        raise DataError(
            f"{name}: too little excitation: on for {on_h:.1f} h (need {MIN_ON_H:g}), standard deviation of u "
            f"{spread:.3f} (need {MIN_SD_U:g}), {changes} changes of u (need {MIN_CHANGES}); {advice}"
        )


def check_pairs(pairs: Sequence[Pair]) -> None:
    """Refuse pairs in which nothing differs.

    Raises:
        DataError: with the numbers that are wrong and what to do about them.
    """
    for index, pair in enumerate(pairs):
        name = f"pair {pair.label or index}"
        _check_signals(pair.a, name + " (first run)")
        _check_signals(pair.b, name + " (second run)")
    largest = max(float(np.max(np.abs(p.a.u - p.b.u))) for p in pairs)
    if largest < MIN_SD_U:
        raise DataError(
            f"pairs: u differs by at most {largest:.3f} between the runs of any pair, need {MIN_SD_U:g}: "
            "let the second run of each pair act differently"
        )


def check_steps(histories: Sequence[Record]) -> None:
    """Refuse records of different step lengths.

    Raises:
        DataError: naming the steps found.
    """
    steps = sorted({round(h.step_s, 3) for h in histories})
    if len(steps) > 1:
        raise DataError(f"the records have steps of {', '.join(f'{s:g}' for s in steps)} s: resample them to one step")


def _check_signals(history: Record, name: str) -> None:
    if history.n_steps < 2:
        raise DataError(f"{name}: {history.n_steps} steps, need at least 2")
    steps = np.diff(history.time_s)
    if not np.allclose(steps, steps[0], rtol=1e-6) or steps[0] <= 0:
        raise DataError(f"{name}: time steps vary between {steps.min():g} and {steps.max():g} s; resample to one step")
    finite = np.isfinite(history.T_zone_C)
    if not finite.any():
        raise DataError(f"{name}: every zone temperature is NaN; check the point of the sensor")
    if finite.mean() < 0.5:
        raise DataError(f"{name}: only {100 * finite.mean():.0f} % of the zone temperatures were measured, need half")
    for signal in ("u", "T_out_C", "solar_W_m2"):
        values = getattr(history, signal)
        gaps = np.flatnonzero(~np.isfinite(values))
        if gaps.size:
            raise DataError(
                f"{name}: {signal} is not finite at {gaps.size} of {values.size} places, first at {gaps[0]}; "
                "cut the record there or fill it"
            )
    if (history.u < -ROUNDING).any() or (history.u > 1 + ROUNDING).any():
        raise DataError(
            f"{name}: u ranges from {history.u.min():g} to {history.u.max():g}, expected [0, 1]; rescale it"
        )


def data_hash(history: Record) -> str:
    """sha256 over the numbers of a run, so that a saved model can say what it was made from."""
    digest = hashlib.sha256()
    for item in fields(history):
        digest.update(item.name.encode())
        digest.update(np.ascontiguousarray(getattr(history, item.name)).tobytes())
    return digest.hexdigest()
