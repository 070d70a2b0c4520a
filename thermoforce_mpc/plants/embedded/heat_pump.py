"""Air-to-water heat pump with a scroll compressor (Jin 2002, as in the IDEAS library), quasi-static refrigerant.

The constant loss does not scale with speed, so the COP falls at part load.
Parameters: data record Carrier_30AW015_15kW_4_9COP_R410A of the test case.
"""

from __future__ import annotations

import math

from numba import njit

from thermoforce_mpc.plants.embedded.refrigerant import (
    isentropic_exponent,
    liquid_enthalpy,
    saturation_pressure,
    vapour_enthalpy,
    vapour_volume,
)

VOLUME_RATIO = 3.3462310104583497
SUCTION_FLOW_M3_S = 0.002053683987444995
LEAKAGE_KG_S = 0.005198105847571281
EFFICIENCY = 0.9999999999999999
CONSTANT_LOSS_W = 1094.80443337558
SUPERHEAT_K = 6.119909663822337

# Fan and pump run at constant power while the compressor is on.
FAN_W = 510.204
FAN_KG_S = 3.0
PUMP_W = 20.4986
PUMP_KG_S = 0.5

# Heat exchangers with an effectiveness limited to 0.999: the refrigerant couples to the leaving node through 999·C
# while water or air flows, and through the exchanger's own conductance without flow.
WATER_J_KG_K = 4184.0
AIR_J_KG_K = 1014.54
CONDENSER_W_K = 999.0 * PUMP_KG_S * WATER_J_KG_K
EVAPORATOR_W_K = 999.0 * FAN_KG_S * AIR_J_KG_K
STILL_CONDENSER_W_K = 55_857.415
STILL_EVAPORATOR_W_K = 194_869.324

# Protection limits, K.
LEAST_EVAPORATING_K = 253.15
MOST_CONDENSING_K = 340.25
PROTECTION_HYSTERESIS_K = 3.0


@njit(cache=True)
def heat_pump(T_evaporating: float, T_condensing: float, speed: float) -> tuple[float, float, float]:
    """Return electric power of the compressor, condenser heat and evaporator heat, W, at `speed` in (0, 1].

    Args:
        T_evaporating, T_condensing: refrigerant temperatures, K.
    """
    p_low = saturation_pressure(T_evaporating)
    p_high = saturation_pressure(T_condensing)
    T_suction = T_evaporating + SUPERHEAT_K
    v = vapour_volume(p_low, T_suction)
    ratio = p_high / p_low
    k = isentropic_exponent(T_suction, v)
    full = SUCTION_FLOW_M3_S / v
    flow = speed * _smooth_max(full - LEAKAGE_KG_S * ratio, 1e-5 * full, 1e-6 * full)
    work = (k - 1.0) / k * ratio / VOLUME_RATIO + VOLUME_RATIO ** (k - 1.0) / k - 1.0
    power = speed * k / (k - 1.0) * p_low * SUCTION_FLOW_M3_S * work / EFFICIENCY + CONSTANT_LOSS_W
    from_air = flow * (vapour_enthalpy(T_evaporating) - liquid_enthalpy(T_condensing))
    return power, from_air + power, from_air


@njit(cache=True, inline="always")
def _smooth_max(a: float, b: float, width: float) -> float:
    """Return max(a, b), smoothed over a difference of about `width`."""
    return 0.5 * (a + b + math.sqrt((a - b) ** 2 + width**2))
