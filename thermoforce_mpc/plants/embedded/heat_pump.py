"""Air-to-water heat pump with a scroll compressor (Jin 2002, as in the IDEAS library), quasi-static R410A.

The constant loss does not scale with speed, so the COP falls at part load.
Parameters: data record Carrier_30AW015_15kW_4_9COP_R410A of the test case.

Property fits of the refrigerant R410A in the IBPSA Modelica library (DuPont technical data, Martin and Hou 1955).
All temperatures in K, pressures in Pa, specific volume in m³/kg, enthalpies in J/kg, heat capacities in J/(kg·K).
"""

from __future__ import annotations

import math

from thermoforce_mpc.data.compiled import njit

CRITICAL_K = 345.25
_CRITICAL_PA = 4926.1e3
_R = 114.55
_B = 4.355134e-4
_K = 5.75


@njit(cache=True, inline="always")
def saturation_pressure(T: float) -> float:
    """Return saturation pressure at temperature T."""
    x = 1.0 - T / CRITICAL_K - 0.2086902
    poly = -1.440004 + x * (-6.865265 + x * (-0.5354309 + x * (-3.749023 + x * (-3.521484 + x * -7.75))))
    return _CRITICAL_PA * math.exp(CRITICAL_K / T * poly)


@njit(cache=True, inline="always")
def liquid_enthalpy(T: float) -> float:
    """Return enthalpy of saturated liquid."""
    x = (1.0 - T / CRITICAL_K) ** (1.0 / 3.0) - 0.5541498
    return 1000.0 * (221.1749 + x * (-514.9668 + x * (-631.625 + x * (-262.2749 + x * (1052.0 + x * 1596.0)))))


@njit(cache=True, inline="always")
def vapour_enthalpy(T: float) -> float:
    """Return enthalpy of saturated vapour."""
    x = (1.0 - T / CRITICAL_K) ** (1.0 / 3.0)
    return 1000.0 * (406.0598 + x * (-34.78156 + x * (262.8079 + x * (223.8549 + x * (-1162.627 + x * 570.6635)))))


@njit(cache=True)
def pressure_and_slopes(T: float, v: float) -> tuple[float, float, float]:
    """Return p(T, v), ∂p/∂v at constant T and ∂p/∂T at constant v (Martin-Hou)."""
    d = v - _B
    e = math.exp(-_K * T / CRITICAL_K)
    de = -_K / CRITICAL_K * e
    a1, b1, c1 = -172.1781, 0.1646288, -6293.665
    a2, b2, c2 = 0.2381558, -1.462803e-5, 15.32461
    a3 = -4.329207e-4
    a4, b4, c4 = -6.241072e-7, 1.380469e-9, 1.604125e-4
    n1 = a1 + b1 * T + c1 * e
    n2 = a2 + b2 * T + c2 * e
    n4 = a4 + b4 * T + c4 * e
    p = _R * T / d + n1 / d**2 + n2 / d**3 + a3 / d**4 + n4 / d**5
    dp_dv = -_R * T / d**2 - 2.0 * n1 / d**3 - 3.0 * n2 / d**4 - 4.0 * a3 / d**5 - 5.0 * n4 / d**6
    dp_dT = _R / d + (b1 + c1 * de) / d**2 + (b2 + c2 * de) / d**3 + (b4 + c4 * de) / d**5
    return p, dp_dv, dp_dT


@njit(cache=True)
def vapour_volume(p: float, T: float) -> float:
    """Return the specific volume of vapour at p, T, by Newton's method from the ideal gas."""
    v = _R * T / p
    for _ in range(50):
        value, slope, _unused = pressure_and_slopes(T, v)
        change = (value - p) / slope
        # The ideal gas overestimates v; a full Newton step may overshoot below the liquid branch.
        v = max(v - change, 0.5 * v)
        if abs(change) < 1e-13 + 1e-11 * v:
            break
    return v


@njit(cache=True)
def isentropic_exponent(T: float, v: float) -> float:
    """Return cp/cv of vapour at T, v."""
    d = v - _B
    ideal = 1000.0 * (0.2676087 + T * (2.115353e-3 + T * (-9.848184e-7 + T * 6.493781e-11)))
    e = math.exp(-_K * T / CRITICAL_K)
    residual = -6293.665 / d + 15.32461 / (2.0 * d**2) + 1.604125e-4 / (4.0 * d**4)
    cv = ideal - _R - T * (_K / CRITICAL_K) ** 2 * e * residual
    _p, dp_dv, dp_dT = pressure_and_slopes(T, v)
    cp = cv - T * dp_dT**2 / dp_dv
    return cp / cv


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
    """Return power, condenser and evaporator heat, W, at `speed` in (0, 1]; refrigerant temperatures in K."""
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
