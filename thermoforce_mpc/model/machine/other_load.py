"""A load on a machine's meter of power or heat that is not the machine's: an air unit's coil, other circuits.

It is what the meter shows while all that the machine feeds is off: by hour of the day and by outdoor temperature. Plans
cannot change it, so laws of the machine are fitted to what is left, and it is added again where a meter of power is
expected. What fades while the machine stays off is no such load: an emitter gives off what it holds. In hours in which
it comes and goes, as hot water does, a meter of a machine that runs does not tell which of the two it shows, as hot
water may also come instead of the rooms' heat: laws are fitted to the other hours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record, steps_in
from thermoforce_mpc.data.clock import DAY_H, whole_hour
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.machine.load import LEVEL_EDGE, MEASURED, error_of_a_step

# Least mean of such a load as a share of full power: below, it is a standby or an error of the meter. By judgement.
_LEAST_SHARE = 0.03
# Steps that the machine must have been off, and hours before which a step off still shows what ran before, h. By
# judgement: three hours.
_LEAST_STEPS, _AFTER_H = 12, 0.25

# Prior standard deviations as shares of the mean: from one hour of the day to the next, and per K outdoors. Errors of a
# step have this share. By judgement.
_BY_HOUR, _PER_K, _ERROR = 0.3, 0.03, 0.2
# Share of its mean from which the error counts as unexplained. By judgement.
_UNEXPLAINED = 0.5
# What fades with this time constant, h, once the machine is off, and the share of the mean from which it is its own. By
# judgement.
_FADES_H, _FADES_SHARE, _SURE_SD = 3.0, 0.3, 3.0
# Share of the load that the meter may lack, hour by hour, while the machine is on. A house whose SG-Ready blocks its
# machine shows it off for a few hours, in which its hot water was 836 W at 8 and 24 W at 23: on a line between them
# 26 % more than its meter held, and all of the rooms' energy was another load (`bench commands`, seed 421, 2026-11-28).
_LACKS = 0.1
# Mean scatter of an hour of the day, as a share of full power, from which a load comes and goes in it. By judgement:
# a coil that follows the weather to 20 % scatters less, half an hour of hot water in an hour by five times more. Half
# and twice as much change full power by the law of five houses of `bench commands` by 2 % at most (2026-11-30).
_AT_TIMES = 0.1
# Share of the load that may lie in hours of the day in which the machine was never seen off. By judgement: a house with
# an enable contact was off for 45 quarters of an hour, those at 7 with its own hot water, and 86 % of another load of
# 412 W lay at night, half of what the rooms took; of five other houses 1 to 33 % (`bench commands`,
# seeds 9740 and 9703 to 9717, 2026-11-30).
_GUESSED = 0.75
# Time with the machine off, s, by which a load is judged again in a run, and the share of it below which it is taken
# back, where its own error is not as large. By judgement: a load that ended with the probing of generated house
# 140930:0 (800 W by day) made the watch claim its heat pump three times in a week (2026-11-30).
_JUDGED_S, GONE = 6.0 * HOUR_S, 0.3


@dataclass(frozen=True)
class OtherLoad:
    """A foreign load: `by_hour_W` (24,) at `reference_C` outdoors, its change with the outdoor temperature, and error.

    The change holds within `T_out_range_C`. `rmse_W`: of the fit, over the steps in which the machine was off.
    `at_times`: hours of the day in which it comes and goes, of which laws are not fitted.
    """

    by_hour_W: tuple[float, ...]
    per_K_W: float
    reference_C: float
    T_out_range_C: tuple[float, float]
    rmse_W: float
    at_times: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.by_hour_W) != DAY_H:
            raise DataError(f"by_hour_W has {len(self.by_hour_W)} entries, expected {DAY_H}")

    def __call__(self, time_s: Array, T_out_C: Array) -> Array:
        """Return the load over steps that start at `time_s`, s since 1 January, at `T_out_C` °C, W; shapes alike."""
        by_hour = np.asarray(self.by_hour_W)[whole_hour(time_s)]
        warmer_K = np.clip(T_out_C, *self.T_out_range_C) - self.reference_C
        return np.maximum(by_hour + self.per_K_W * warmer_K, 0.0)

    def steady(self, time_s: Array, T_out_C: Array) -> Array:
        """The same, NaN in hours in which it comes and goes."""
        return np.where(np.isin(whole_hour(time_s), self.at_times), np.nan, self(time_s, T_out_C))

    def there(self, u: Array, time_s: Array, T_out_C: Array, meter_W: Array) -> NDArray[np.bool_]:
        """Whether it is still believed after each step (n,), by what a meter shows while the machine is off.

        `u` (A, n): levels of all that it feeds; `time_s`, `T_out_C`, `meter_W` (n,) as for `other_load`. It is until
        the latest hours in which it should be on the meter lack most of it, and again as they hold it.
        """
        believed = np.ones(time_s.size, dtype=bool)
        if time_s.size < 2:
            return believed
        law_W = self.steady(time_s, T_out_C)
        at = np.flatnonzero(_steps(u, time_s, T_out_C, meter_W).settled & (law_W >= 0.5 * self.mean_W))
        n = steps_in(_JUDGED_S, float(time_s[1] - time_s[0]))
        if at.size < n:
            return believed
        sums_W = np.cumsum(np.vstack([np.zeros((1, 2)), np.column_stack([law_W, meter_W])[at]]), axis=0)
        law, meter = ((sums_W[n:] - sums_W[:-n]) / n).T
        holds = law - meter <= np.maximum((1.0 - GONE) * law, self.rmse_W)
        latest = np.searchsorted(at[n - 1 :], np.arange(time_s.size), side="right") - 1
        return np.asarray(np.where(latest < 0, True, holds[latest]))

    def news(self, there: NDArray[np.bool_]) -> str:
        """What the last of the steps (n,) of `there` told, in words; '' where nothing new."""
        if there.size < 2 or there[-1] == there[-2]:
            return ""
        what = f"the other load of {self.mean_W:.0f} W on average"
        if there[-1]:
            return f"the meter holds {what} again: it is taken off"
        return f"the meter lacks {what} while the machine is off: it has ended, and nothing is taken off"

    @property
    def mean_W(self) -> float:
        """Mean over the day at the reference, W."""
        return float(np.mean(self.by_hour_W))

    def in_words(self) -> str:
        """A note for the model card."""
        low, high = min(self.by_hour_W), max(self.by_hour_W)
        words = (
            f"the meter holds another load: {self.mean_W:.0f} W on average ({low:.0f} to {high:.0f} W by hour of the "
            f"day, {self.per_K_W:+.0f} W per K outdoors), known to ± {self.rmse_W:.0f} W; it is taken off"
        )
        if self.at_times:
            hours = ", ".join(map(str, self.at_times))
            words += f"; in the hours from {hours} it comes and goes, and nothing is learned of the machine"
        if self.rmse_W > _UNEXPLAINED * self.mean_W:
            words += "; hour and weather hardly tell it: a meter of the machine alone would"
        return words


def other_load(u: Array, time_s: Array, T_out_C: Array, meter_W: Array) -> OtherLoad | None:
    """The foreign load on the meter of a machine; None where there is none, or the machine was hardly seen off.

    `u` (A, n): levels of all that it feeds; `time_s` (n,): starts of the steps; `meter_W` (n,): of power, or of heat in
    the direction of the machine, NaN where it is missing.
    """
    known, on, off_h, settled = _steps(u, time_s, T_out_C, meter_W)
    if settled.sum() < _LEAST_STEPS or not on.any():
        return None
    load_W, T, hour = meter_W[settled], T_out_C[settled], whole_hour(time_s)
    mean_W, full_W = float(load_W.mean()), float(np.percentile(meter_W[on], 90.0))
    # A meter against the machine's direction has none, and a machine that never ran tells none.
    if mean_W <= max(0.0, _LEAST_SHARE * full_W):
        return None
    reference_C = float(T.mean())
    design = np.zeros((load_W.size, DAY_H + 1))
    design[np.arange(load_W.size), hour[settled]] = 1.0
    design[:, DAY_H] = T - reference_C
    if _fades(design, load_W, off_h[settled]):
        return None
    at_times = _at_times(design, load_W, full_W)
    kept = known & ~np.isin(hour, at_times)
    # What is left must tell the load of other hours and the laws of the machine.
    enough = kept.sum() >= MEASURED * known.size and (kept & on).sum() >= MEASURED * on.sum()
    if not enough or (kept & settled).sum() < _LEAST_STEPS:
        at_times, kept = np.array([], dtype=np.intp), known
    steady = kept[settled]
    mean_W, rows, steady_W = float(load_W[steady].mean()), design[steady], load_W[steady]
    found = _coefficients(rows, steady_W, _ERROR * mean_W)
    found = _coefficients(rows, steady_W, error_of_a_step(rows @ found - steady_W, _ERROR * mean_W))
    for one in at_times:
        of_hour = design[:, one] > 0.0
        found[one] = float(np.mean(load_W[of_hour] - found[DAY_H] * design[of_hour, DAY_H]))
    rmse_W = rms(design @ found - load_W)
    load = OtherLoad(
        tuple(np.maximum(found[:DAY_H], 0.0).tolist()),
        float(found[DAY_H]),
        reference_C,
        (float(T.min()), float(T.max())),
        rmse_W,
        tuple(at_times.tolist()),
    )
    by_hour_W, seen = np.array(load.by_hour_W), np.unique(hour[settled])
    if np.delete(by_hour_W, seen).sum() > _GUESSED * by_hour_W.sum():
        return None
    return None if _lacking(load, time_s[on], T_out_C[on], meter_W[on]) > _LACKS else load


def own_W(
    meter_W: Array,
    foreign: Sequence[OtherLoad | None],
    record: Record,
    signs: Sequence[int] | None = None,
    *,
    of_days: bool = False,
) -> Array:
    """The meters (k, n) without the `foreign` load on each (k,), W; `signs` (k,): direction of each, 1 by default.

    NaN in hours in which such a load comes and goes. `of_days`: there without its mean, which is right over days and of
    no step: energies of days in houses 31000 and 31001 with hot water on the meter lie in their bands 17 times of 20,
    14 where those hours are taken by the law of power (`house:3rooms:31000`, `house:4rooms:31001`, 2026-11-30).
    """
    time_s, T_out_C = record.time_s[:-1], record.T_out_C[:-1]
    rows = []
    for row, other, sign in zip(meter_W, foreign, signs or [1] * len(foreign), strict=True):
        if other is None:
            rows.append(row)
        elif of_days:
            rows.append(row - sign * other(time_s, T_out_C))
        else:
            rows.append(sign * np.maximum(sign * row - other.steady(time_s, T_out_C), 0.0))
    return np.stack(rows)


def left_while_off(u: Array, time_s: Array, T_out_C: Array, rest_W: Array) -> tuple[float, float] | None:
    """Least and most of `rest_W` (n,), what a meter shows beyond what is expected, in the last day with the machine
    off, W: that is not the machine's; None where it was not off.

    `u` (A, n), `time_s`, `T_out_C` (n,) as for `other_load`.
    """
    seen = _steps(u, time_s, T_out_C, rest_W).settled & (time_s >= time_s[-1:] - DAY_S)
    return (float(rest_W[seen].min()), float(rest_W[seen].max())) if seen.any() else None


class _Steps(NamedTuple):
    """What is known of steps (n,): whether all is, whether the machine runs, hours since it did (infinite: it never
    did), and whether a step shows what else is on the meter: all is known, and the machine was off for a while."""

    known: NDArray[np.bool_]
    on: NDArray[np.bool_]
    off_h: Array
    settled: NDArray[np.bool_]


def _steps(u: Array, time_s: Array, T_out_C: Array, meter_W: Array) -> _Steps:
    off = np.asarray((np.abs(u) <= LEVEL_EDGE).all(axis=0))
    known = np.isfinite(meter_W) & np.isfinite(T_out_C) & np.isfinite(u).all(axis=0)
    off_h = (time_s - np.maximum.accumulate(np.where(off, -np.inf, time_s))) / HOUR_S
    return _Steps(known, known & ~off, off_h, off & known & (off_h > _AFTER_H + 1.0 / HOUR_S))


def _lacking(load: OtherLoad, time_s: Array, T_out_C: Array, meter_W: Array) -> float:
    """Share of `load` that a meter (n,) did not hold, by its means of the hours of the day."""
    hour, load_W = whole_hour(time_s), load(time_s, T_out_C)
    meter, expected = (np.bincount(hour, weights=values, minlength=DAY_H) for values in (meter_W, load_W))
    return float(np.maximum(expected - meter, 0.0).sum() / max(expected.sum(), 1e-9))


def _at_times(design: Array, load_W: Array, full_W: float) -> NDArray[np.intp]:
    """The hours in which a load (n,), whose steps are rows of `design`, comes and goes."""
    by_hour = design[:, :DAY_H]
    found = np.linalg.lstsq(design, load_W, rcond=None)[0]
    scatter_W = by_hour.T @ np.abs(load_W - design @ found) / np.maximum(by_hour.sum(axis=0), 1.0)
    return np.flatnonzero(scatter_W > _AT_TIMES * full_W)


def _fades(design: Array, load_W: Array, off_h: Array) -> bool:
    """Whether a good part of the load surely fades with the hours (n,) since the machine was on."""
    fading = np.exp(-np.minimum(off_h, DAY_H) / _FADES_H)
    design = np.column_stack([design, fading])
    found = _coefficients(design, load_W, _ERROR * float(load_W.mean()))
    sd_W = np.std(design @ found - load_W) / max(np.sqrt(fading.size) * np.std(fading), 1e-9)
    return bool(found[-1] * fading.mean() > _FADES_SHARE * load_W.mean() and found[-1] > _SURE_SD * sd_W)


def _coefficients(design: Array, load_W: Array, error_W: float) -> Array:
    """Of each hour, of the outdoor temperature and of what may follow (k,), W each, around their priors.

    `error_W`: of a step.
    """
    mean_W, k = float(load_W.mean()), design.shape[1]
    smooth = np.zeros((DAY_H, k))  # from each hour to the next, around the clock
    smooth[:, :DAY_H] = np.eye(DAY_H) - np.roll(np.eye(DAY_H), 1, axis=1)
    flat = np.zeros((1, k))
    flat[0, DAY_H] = 1.0
    rows = np.vstack([design / error_W, smooth / (_BY_HOUR * mean_W), flat / (_PER_K * mean_W)])
    values = np.concatenate([load_W / error_W, np.zeros(DAY_H + 1)])
    return np.asarray(np.linalg.lstsq(rows, values, rcond=None)[0])
