"""Key performance indicators as BOPTEST defines them, computed in one place for every plant.

Definitions: BOPTEST documentation (Blum et al. 2021, doi:10.1080/19401493.2021.1986574): 30-s samples, integrals by the
trapezoidal rule, per square metre of floor, peak as the highest mean over 15 minutes.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.types import HOUR_S, Array

_J_PER_KWH = 3.6e6
_PEAK_WINDOW_S = 900.0


def compute_kpis(
    time_s: Array,
    *,
    power_W: Array,
    T_operative_C: Array,
    lower_C: Array,
    upper_C: Array,
    co2_ppm: Array,
    co2_limit_ppm: float,
    price_per_kWh: Array,
    emission_kg_per_kWh: Array,
    area_m2: float,
) -> dict[str, float]:
    """KPIs of one zone over samples at `time_s` (n,), s; every other array has shape (n,).

    Returns:
        `ener_tot` kWh/m², `cost_tot` currency/m², `emis_tot` kg/m², `tdis_tot` K·h, `idis_tot` ppm·h, `pele_tot` kW/m².

    Raises:
        DataError: arrays differ in length or time does not increase.
    """
    arrays = (power_W, T_operative_C, lower_C, upper_C, co2_ppm, price_per_kWh, emission_kg_per_kWh)
    if any(np.shape(array) != np.shape(time_s) for array in arrays):
        raise DataError("KPIs: every series needs one value per time sample")
    if np.size(time_s) < 2 or not (np.diff(time_s) > 0).all():
        raise DataError("KPIs: time must increase over at least two samples")
    hours = time_s / HOUR_S
    kW = power_W / 1e3 / area_m2
    violation = np.maximum(np.maximum(lower_C - T_operative_C, T_operative_C - upper_C), 0.0)
    return {
        "ener_tot": float(np.trapezoid(kW, hours)),
        "cost_tot": float(np.trapezoid(kW * price_per_kWh, hours)),
        "emis_tot": float(np.trapezoid(kW * emission_kg_per_kWh, hours)),
        "tdis_tot": float(np.trapezoid(violation, hours)),
        "idis_tot": float(np.trapezoid(np.maximum(co2_ppm - co2_limit_ppm, 0.0), hours)),
        "pele_tot": peak_power(time_s, power_W) / 1e3 / area_m2,
    }


def peak_power(time_s: Array, power_W: Array) -> float:
    """Highest mean over consecutive 15-minute windows from the first sample, W (the whole span when shorter)."""
    energy_J = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * (power_W[1:] + power_W[:-1]) / 2)])
    edges = np.arange(time_s[0], time_s[-1] + 1e-6, _PEAK_WINDOW_S)
    if edges.size < 2:
        edges = np.array([time_s[0], time_s[-1]])
    at_edges = np.interp(edges, time_s, energy_J)
    return float(np.max(np.diff(at_edges) / np.diff(edges)))
