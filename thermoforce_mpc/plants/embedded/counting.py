"""BOPTEST's KPIs of the embedded plant's samples in one pass: a reward asks for them after every step."""

from __future__ import annotations

import numpy as np
from numba import njit

from thermoforce_mpc.data import HOUR_S, ZERO_C_K, Array
from thermoforce_mpc.plants.embedded import kernel, schedule

_POWER = tuple(kernel.RECORD.index(name) for name in ("P_heat_pump", "P_fan", "P_pump"))
_T, _CO2 = kernel.RECORD.index("T_operative"), kernel.RECORD.index("CO2")


@njit(cache=True)
def integrals(time_s: Array, rows: Array, price_per_kWh: Array) -> Array:
    """Integrate samples (n, 17) of `kernel.RECORD` at times (n,), s, by the trapezoidal rule.

    Returns:
        Energy, Wh; cost, currency · 1000; thermal discomfort, K·h; CO2 above its limit, ppm·h.
    """
    out = np.zeros(4)
    for i in range(time_s.size):
        weight_h = 0.0
        if i > 0:
            weight_h += (time_s[i] - time_s[i - 1]) / (2.0 * HOUR_S)
        if i < time_s.size - 1:
            weight_h += (time_s[i + 1] - time_s[i]) / (2.0 * HOUR_S)
        power_W = rows[i, _POWER[0]] + rows[i, _POWER[1]] + rows[i, _POWER[2]]
        out[0] += weight_h * power_W
        out[1] += weight_h * power_W * price_per_kWh[i]
        at_home = schedule.is_occupied_sample(time_s[i])
        lower_C = schedule.LOWER_OCCUPIED_C if at_home else schedule.LOWER_EMPTY_C
        upper_C = schedule.UPPER_OCCUPIED_C if at_home else schedule.UPPER_EMPTY_C
        T_C = rows[i, _T] - ZERO_C_K
        out[2] += weight_h * max(lower_C - T_C, T_C - upper_C, 0.0)
        out[3] += weight_h * max(rows[i, _CO2] - schedule.CO2_LIMIT_PPM, 0.0)
    return out
