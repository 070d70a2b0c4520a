"""Check of the watch on the size of the effect of acting: does the zone answer as strongly as the model says?

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

import numpy as np
from scipy.special import ndtri

from thermoforce_mpc.data import Array

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
    """Share of the predicted effect of acting that did not come, and that over its standard deviation.

    Args:
        error_K: measured − predicted (n,), K, of predictions that do not overlap.
        effect_K: predicted effect (n,) of the levels since each prediction, K.
        promise_K: promised half-width of the 80 % band (n,), K.

    Returns:
        Both 0 where nothing acted.
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
