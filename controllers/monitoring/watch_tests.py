"""What a watch tests of a model: the size of the effect of acting, levels against requests, meters against the machine.

A machine that gives less heat than its level makes the zone colder (cooling: warmer) than predicted, the more so the
longer it ran. The forecaster takes a lasting error for a disturbance within hours, so each error stays inside the
promise; what they have in common does not. Over a day the errors 1 h ahead are regressed on the predicted effect of the
levels since each prediction, weighted by the promise. Predictions 1 h ahead, recorded every hour, do not overlap. Under
the promise (errors no larger than promised, uncorrelated from hour to hour, their weighted sum over a day normal) the
missing share over its standard deviation exceeds the normal quantile of level p with probability p at most. It is
tested every 6 h, with p such that all tests of 30 days together have the stated probability of a false alarm. An error
counts with two promised half-widths at most, so that one hour alone (an open door) never makes an alarm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput

# Length of the record and time between two tests, h.
WINDOW_H, EVERY_H = 24.0, 6.0
# Time in which all tests together have the stated probability of a false alarm, h.
_MONTH_H = 30 * 24.0
# Least share of the effect that is missing in a fault: smaller ones are errors of the gain, for adaptation.
_LEAST_SHARE = 0.2
# 0.9 quantile of the normal distribution: half-width of an 80 % band over standard deviation.
_NORMAL_90 = 1.2816
# Largest error that counts, in promised half-widths.
_LARGEST = 2.0


def missing_effect(error_K: Array, effect_K: Array, promise_K: Array) -> tuple[float, float]:
    """Share of the predicted effect of acting that did not come, and that over its standard deviation; 0 if nothing
    acted.

    Of predictions that do not overlap (n,), K: `error_K` (measured − predicted), `effect_K` predicted for the levels
    since each, and `promise_K`, half-width of the 80 % band.
    """
    weight = 1.0 / promise_K**2
    information = float(weight @ effect_K**2)
    if information <= 0.0:
        return 0.0, 0.0
    clipped_K = np.clip(error_K, -_LARGEST * promise_K, _LARGEST * promise_K)
    share = -float(weight @ (clipped_K * effect_K)) / information
    return share, share * math.sqrt(information) * _NORMAL_90


def effect_fault(error_K: Array, effect_K: Array, promise_K: Array, false_alarm: float) -> str:
    """What is wrong with the effect of acting, empty if nothing is; arguments as `missing_effect`.

    `false_alarm` is the largest probability of an alarm in 30 days while errors are as promised.
    """
    share, z = missing_effect(error_K, effect_K, promise_K)
    if share < _LEAST_SHARE or z < -ndtri(false_alarm * EVERY_H / _MONTH_H):
        return ""
    return (
        f"acting has less effect than predicted: {share:.0%} of it is missing in the last {WINDOW_H:g} h ({z:.1f}"
        f" standard deviations; RMS error {np.sqrt(np.mean(error_K**2)):.2f} K 1 h ahead)"
    )


# Differences between requested and measured level count from here: rounding and rate limits of an actuator are below.
_SAME = 0.1
# Full-load hours of difference that make a fault, and their least share of what was requested or measured, in one of
# the windows, h. The long one is for levels that are low and wrong for long: native control that holds a zone on a mild
# day runs at a level of 0.1 to 0.2, less than an hour at full level in 6 h, where the plan wanted nothing.
_DIFFERENT_H, _DIFFERENT_SHARE = 1.0, 0.25
_WINDOWS_H = (6.0, 24.0)
# Hours of requested levels that are compared.
LEVELS_H = _WINDOWS_H[-1]
# Full-load hours that a comparison of meters needs.
_RUNNING_H = 1.5


# Levels tried to find the one that gives a measured heat.
_LEVELS = np.linspace(0.0, 1.0, 41)


def applied_levels(requests: Sequence[tuple[float, float]], history: Record, heat_input: HeatInput) -> Array:
    """Levels (n,) in [0, 1] to compare the predictions of a record for; NaN where neither level nor heat is known.

    They are those of the record. Where it has none, and where native control acted (no level in `requests`,
    see `level_fault`), which holds levels for which the map from level to heat was not identified, the level is taken
    that gives the measured heat.
    """
    levels = np.array(history.u[0])
    if heat_input.law is None:
        return levels
    requested, steps = _match_steps(requests, history)
    by_heat = np.isnan(levels)
    by_heat[steps[~np.isfinite(requested)]] = True
    for step in np.flatnonzero(by_heat & np.isfinite(history.heat_W[0] + history.T_out_C[:-1])):
        heat_W = abs(float(history.heat_W[0, step]))
        levels[step] = np.interp(heat_W, heat_input.law(_LEVELS, history.T_out_C[step]), _LEVELS)
    return levels


def heat_ratio(history: Record, heat_input: HeatInput) -> float | None:
    """Measured heat of a record over that of the map at its levels; None where little of both is known."""
    if heat_input.law is None:
        return None
    usable = np.isfinite(history.heat_W[0]) & np.isfinite(history.u[0]) & np.isfinite(history.T_out_C[:-1])
    u = np.clip(history.u[0, usable], 0.0, 1.0)
    if not u.size or float(u.sum()) * history.step_s / HOUR_S < _RUNNING_H:
        return None
    modelled = heat_input.law(u, history.T_out_C[:-1][usable])
    return float(np.abs(history.heat_W[0, usable]).sum() / modelled.sum())


def level_fault(requests: Sequence[tuple[float, float]], history: Record) -> str:
    """What is wrong between levels of `requests` (start of the step s, level) and those measured; empty if nothing is.

    A plant that does not report its level cannot fail here: the record then holds the level requested.
    """
    hours = history.step_s / HOUR_S
    all_requested, all_measured, all_index = _paired_levels(requests, history)
    for window_h in _WINDOWS_H:
        begin = float(history.time_s[-1]) - window_h * HOUR_S - 1.0
        last = slice(int(np.searchsorted(history.time_s[all_index], begin, side="right")), None)
        requested, measured, index = all_requested[last], all_measured[last], all_index[last]
        off = np.abs(_hourly(measured - requested, index, hours))
        off_h = float(off[off > _SAME].sum()) * hours
        if off_h >= max(_DIFFERENT_H, _DIFFERENT_SHARE * float(np.maximum(requested, measured).sum()) * hours):
            return (
                f"the actuator does not follow: {requested.mean():.2f} was asked for on average in the last"
                f" {requested.size * hours:g} h, {measured.mean():.2f} was measured"
            )
    return ""


def machine_ratio(
    requests: Sequence[tuple[float, float]],
    history: Record,
    heat: MachineLoad | None,
    power_W: Callable[[Record], Array],
) -> tuple[str, float] | None:
    """Which meter was read, and its sum over the modelled sum at the levels requested; None where little was running.

    `requests`: see `level_fault`; `heat`: the machine's, used where it is measured; `power_W`: electric power (n,) W
    expected for the levels of a record (n steps).
    """
    requested, levels, index = _paired_levels(requests, history)
    following = index[np.abs(levels - requested) <= _SAME]
    for meter, measured in (("heat", np.abs(history.heat_W[0])), ("power", history.power_W[0])):
        if meter == "heat" and heat is None:
            continue
        steps = following[np.isfinite(measured[following]) & np.isfinite(history.T_out_C[following])]
        if not steps.size or float(history.u[0, steps].sum()) * history.step_s / HOUR_S < _RUNNING_H:
            continue
        if meter == "heat":
            assert heat is not None
            modelled = heat(np.clip(history.u[0, steps], 0.0, 1.0), history.T_out_C[steps])
        else:
            first = int(steps[0])
            modelled = power_W(history.slice(first, history.n_steps))[steps - first]
        if not (np.isfinite(modelled).all() and modelled.sum() > 0):
            continue
        return meter, float(measured[steps].sum() / modelled.sum())
    return None


def _match_steps(requests: Sequence[tuple[float, float]], history: Record) -> tuple[Array, NDArray[np.intp]]:
    """Levels requested and the index of their steps of `history`, both (n,), without those that are not in it."""
    time_s, level = np.array(requests, dtype=np.float64).reshape(-1, 2).T
    half_s = 0.5 * history.step_s
    step = np.searchsorted(history.time_s, time_s - half_s)
    in_history = step < history.n_steps
    in_history[in_history] = np.abs(history.time_s[step[in_history]] - time_s[in_history]) <= half_s
    return level[in_history], step[in_history]


def _hourly(values: Array, index: NDArray[np.intp], hours: float) -> Array:
    """`values` (n,) at steps `index` of `hours`, each replaced by the mean of its hour.

    A level that is metered heat swings about what was requested where its machine runs on and off by itself.
    """
    if not values.size:  # before the first step its length is unknown
        return values
    hour = index // max(1, round(1.0 / hours))
    return np.asarray((np.bincount(hour, values) / np.maximum(np.bincount(hour), 1))[hour])


def _paired_levels(requests: Sequence[tuple[float, float]], history: Record) -> tuple[Array, Array, NDArray[np.intp]]:
    """Levels requested and measured, both (n,), and the index (n,) of those steps, where both are known."""
    requested, index = _match_steps(requests, history)
    measured = history.u[0, index]
    known = np.isfinite(requested) & np.isfinite(measured)
    return requested[known], measured[known], index[known]
