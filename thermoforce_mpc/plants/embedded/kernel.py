"""Time step of the whole plant, native control to walls, and its integrals. Compiled; no allocation per step.

Control, refrigerant, pump and fan at a sample follow from the state at that instant and act over the next step.
The envelope, and with it the air, advance by implicit Euler, see `envelope`.
"""

from __future__ import annotations

import math

import numpy as np

from thermoforce_mpc.data import HOUR_S, ZERO_C_K, Array
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.embedded import exposure as x
from thermoforce_mpc.plants.embedded import heat_pump as hp
from thermoforce_mpc.plants.embedded import houses as c
from thermoforce_mpc.plants.embedded import schedule as s
from thermoforce_mpc.plants.embedded.envelope import (
    COOKING,
    PEOPLE,
    WINDOWS,
    air_and_star,
    films,
    radiant_temperature,
    read_weather,
    respond,
    settle,
)
from thermoforce_mpc.plants.embedded.heat_pump import heat_pump
from thermoforce_mpc.plants.embedded.houses import HEAT_PUMP_HOUSE
from thermoforce_mpc.plants.embedded.schedule import is_occupied

# Default step length, s; also the shortest distance of samples, except for shorter advances.
STEP_S = 30.0

# Scalar states, besides the nodes: the first twelve are carried from step to step (T_SUPPLY and T_RETURN: water of
# condenser and floor; LAST_*: values of the previous step), the others are computed from them by `_operate`.
(T_AIR, T_SUPPLY, T_RETURN, T_EVAPORATOR, INTEGRAL, COMPRESSOR_ON, BLOCKED, CO2_PPM, T_OPERATIVE,
 LAST_Q_CONDENSER, LAST_Q_EVAPORATOR, LAST_T_PIPE,
 SETPOINT, INTEGRAL_RATE, LEVEL, POWER, Q_CONDENSER, Q_EVAPORATOR, PUMP, FAN) = range(20)  # fmt: skip
N_SCALARS = 20

# Columns of the record, one row per sample (K, W, ppm); water temperatures are sensor readings.
RECORD = (
    "T_operative", "P_heat_pump", "P_fan", "P_pump", "Q_condenser", "Q_floor", "T_supply", "T_return", "COP", "level",
    "T_setpoint", "CO2", "T_out", "solar", "fan", "pump", "Q_evaporator",
)  # fmt: skip

_FLOOR_M2, _AIR_J_K = HEAT_PUMP_HOUSE.area_m2, HEAT_PUMP_HOUSE.air_J_K
_AIR_CHANGES_S = 0.5 / 3600.0
_INFILTRATION_KG_S = HEAT_PUMP_HOUSE.air_kg * _AIR_CHANGES_S
_INFILTRATION_W_K = _INFILTRATION_KG_S * HEAT_PUMP_HOUSE.cp
_OUTDOOR_PPM = 400.0
_PPM_PER_KG_KG = 1e6 / 1.528635  # the test case's ratio of molar masses, CO2 to moist air
_CO2_KG_S_PERSON = 1.08167e-5
_PEOPLE = float(s.HEAT_PUMP_USE.people)
_GAIN_RADIANT_W, _GAIN_CONVECTIVE_W = 219.0, 146.0  # five people

# Floor heating: one circuit, 168.9 kg of water, resistance water to pipe plane after Koschenz and Lehmann (2000).
_CONDENSER_J_K = 30.0 * hp.WATER_J_KG_K
_FLOOR_J_K = 168.9 * hp.WATER_J_KG_K
_FLOOR_W_K = _FLOOR_M2 / 0.10207009
_EVAPORATOR_J_K = 180.0 * hp.AIR_J_KG_K
# Temperature of the expansion vessel, connected between supply sensor and pump.
_VESSEL_K = 293.15

# Native PI: gain 1/K, integral time s, anti-windup.
NATIVE_GAIN, _INTEGRAL_S, _ANTI_WINDUP = 0.6, 8000.0, 0.9
_SWITCH_ON, _SWITCH_OFF = 0.01, 0.005


@njit(cache=True)
def soil_heat_W(time_s: float) -> float:
    """Return the heat loss at the underside of the slab, W: ISO 13370 edge loss, mean and two periodic parts."""
    month = time_s / 3.1536e7 * 12.0
    mean = 0.0823985 * _FLOOR_M2 * (295.15 - 283.95)
    outside = 11.921 * 2.0 * math.cos(2.0 * math.pi / 12.0 * (month - 1.0 + 0.1322))
    inside = 5.7858 * 4.0 * math.cos(2.0 * math.pi / 12.0 * (month - 1.0 - 2.3167))
    return mean - outside + inside


@njit(cache=True)
def _operate(scalars: np.ndarray, time_s: float, overrides: np.ndarray) -> None:
    """Set control, heat pump, pump and fan for the state at `time_s`. Idempotent, independent of the step length."""
    # Native control. While the level is overwritten, the integral follows the native level.
    setpoint = overrides[1]
    if math.isnan(setpoint):
        occupied_C, empty_C = s.LOWER_OCCUPIED_C + s.SETPOINT_OCCUPIED_K, s.LOWER_EMPTY_C + s.SETPOINT_EMPTY_K
        setpoint = ZERO_C_K + (occupied_C if is_occupied(time_s) else empty_C)
    error = setpoint - scalars[T_OPERATIVE]
    wanted = NATIVE_GAIN * (error + scalars[INTEGRAL])
    level = min(max(wanted, 0.0), 1.0)
    scalars[SETPOINT] = setpoint
    scalars[INTEGRAL_RATE] = (error + (level - wanted) / (NATIVE_GAIN * _ANTI_WINDUP)) / _INTEGRAL_S
    if not math.isnan(overrides[0]):
        level = overrides[0]

    # Heat pump: protection, hysteresis, then quasi-static refrigerant with the heat flows of the previous step.
    condenser_W_K = hp.STILL_CONDENSER_W_K if overrides[2] < 0.5 else hp.CONDENSER_W_K
    evaporator_W_K = hp.STILL_EVAPORATOR_W_K if overrides[3] < 0.5 else hp.EVAPORATOR_W_K
    T_condensing = scalars[T_SUPPLY] + scalars[LAST_Q_CONDENSER] / condenser_W_K
    T_evaporating = scalars[T_EVAPORATOR] - scalars[LAST_Q_EVAPORATOR] / evaporator_W_K
    margin = hp.PROTECTION_HYSTERESIS_K if scalars[BLOCKED] > 0.5 else 0.0
    too_cold, too_hot = T_evaporating < hp.LEAST_EVAPORATING_K + margin, T_condensing > hp.MOST_CONDENSING_K - margin
    scalars[BLOCKED] = 1.0 if too_cold or too_hot or T_condensing < T_evaporating + margin else 0.0
    speed = 0.0 if scalars[BLOCKED] > 0.5 else level
    on = speed >= _SWITCH_OFF if scalars[COMPRESSOR_ON] > 0.5 else speed > _SWITCH_ON
    scalars[COMPRESSOR_ON] = 1.0 if on else 0.0
    scalars[LEVEL] = level if on else 0.0
    power, to_water, from_air = 0.0, 0.0, 0.0
    if on:
        power, to_water, from_air = heat_pump(T_evaporating, T_condensing, speed)
    scalars[POWER], scalars[Q_CONDENSER], scalars[Q_EVAPORATOR] = power, to_water, from_air
    scalars[PUMP] = scalars[COMPRESSOR_ON] if math.isnan(overrides[2]) else math.floor(overrides[2] + 0.5)
    scalars[FAN] = scalars[COMPRESSOR_ON] if math.isnan(overrides[3]) else math.floor(overrides[3] + 0.5)


@njit(cache=True)
def _note(scalars: np.ndarray, w: np.ndarray, row: np.ndarray) -> None:
    T_supply, T_return, floor_W = scalars[T_SUPPLY], scalars[T_RETURN], 0.0
    if scalars[PUMP] > 0.5:
        floor_W = _FLOOR_W_K * (T_supply - scalars[LAST_T_PIPE])
    else:
        # Without flow a sensor reads the mean of its two neighbours: condenser and vessel, floor and condenser.
        T_supply, T_return = 0.5 * (T_supply + _VESSEL_K), 0.5 * (T_return + T_supply)
    power = scalars[POWER]
    row[0], row[1] = scalars[T_OPERATIVE], power
    row[2], row[3] = scalars[FAN] * hp.FAN_W, scalars[PUMP] * hp.PUMP_W
    row[4], row[5] = scalars[Q_CONDENSER], floor_W
    row[6], row[7] = T_supply, T_return
    row[8], row[9] = scalars[Q_CONDENSER] / power if power > 0.0 else 1.0, scalars[LEVEL]
    row[10], row[11] = scalars[SETPOINT], scalars[CO2_PPM]
    row[12], row[13] = w[x.T_OUT], w[x.GLOBAL]
    row[14], row[15], row[16] = scalars[FAN], scalars[PUMP], scalars[Q_EVAPORATOR]


@njit(cache=True)
def start(
    nodes: np.ndarray,
    scalars: np.ndarray,
    time_s: float,
    overrides: np.ndarray,
    grid: np.ndarray,
    env: c.Envelope,
    row: np.ndarray,
) -> None:
    """Set `scalars` (20,) to a begin at `time_s`; write its sample into `row` (17,), see `advance`."""
    scalars[:] = 0.0
    scalars[T_AIR] = scalars[T_SUPPLY] = scalars[T_RETURN] = scalars[T_OPERATIVE] = c.START_K
    scalars[LAST_T_PIPE] = nodes[env.heated[0]]
    scalars[T_EVAPORATOR] = 278.15
    scalars[CO2_PPM] = _OUTDOOR_PPM
    w = np.empty(x.N_COLUMNS)
    read_weather(grid, time_s, w)
    _operate(scalars, time_s, overrides)
    _note(scalars, w, row)


@njit(cache=True, nogil=True)  # nogil: several plants step in parallel threads
def advance(
    nodes: np.ndarray,
    scalars: np.ndarray,
    time_s: float,
    n_steps: int,
    dt: float,
    overrides: np.ndarray,
    grid: np.ndarray,
    unannounced: np.ndarray,
    env: c.Envelope,
    record: np.ndarray,
) -> None:
    """Advance `nodes` (n,) K and `scalars` (20,) in place by `n_steps` of `dt` s; fill `record` (n_steps, 17).

    `overrides` (4,) level 0 to 1, set-point K, pump, fan; NaN where not overwritten. Names: see `RECORD`.
    `unannounced` (n, 3): see `envelope.AS_SCHEDULED`, periodic.
    """
    pipe = env.heated[0]
    w, work, film, heat_W = np.empty(x.N_COLUMNS), np.empty((nodes.size, 5)), np.empty(env.inside.size), np.empty(2)
    _operate(scalars, time_s, overrides)
    for step in range(n_steps):
        t = time_s + (step + 1) * dt
        # Weather at the end of the step.
        read_weather(grid, t, w)
        midway = t - 0.5 * dt
        differs = unannounced[int(midway / x.GRID_S) % unannounced.shape[0]]
        people = max((_PEOPLE if is_occupied(midway) else 0.0) + differs[PEOPLE], 0.0)
        gains = people / _PEOPLE
        # Air change relative to that through leaks.
        aired = 1.0 + differs[WINDOWS] / 3600.0 / _AIR_CHANGES_S
        ventilation_W_K = _INFILTRATION_W_K * aired
        scalars[INTEGRAL] += dt * scalars[INTEGRAL_RATE]
        pump, fan = scalars[PUMP], scalars[FAN]
        to_water, from_air = scalars[Q_CONDENSER], scalars[Q_EVAPORATOR]
        scalars[LAST_Q_CONDENSER], scalars[LAST_Q_EVAPORATOR] = to_water, from_air
        scalars[LAST_T_PIPE] = nodes[pipe]

        # Air through the evaporator: heated by the fan, cooled by the refrigerant.
        air_flow = fan * hp.FAN_KG_S * hp.AIR_J_KG_K
        inlet_W = air_flow * w[x.T_OUT] + fan * hp.FAN_W
        scalars[T_EVAPORATOR] = (_EVAPORATOR_J_K / dt * scalars[T_EVAPORATOR] + inlet_W - from_air) / (
            _EVAPORATOR_J_K / dt + air_flow
        )
        # Water circuit: condenser volume, then floor volume.
        flow = pump * hp.PUMP_KG_S * hp.WATER_J_KG_K
        to_floor = _FLOOR_W_K if pump > 0.5 else 0.0
        a11, a12 = _CONDENSER_J_K / dt + flow, -flow
        a21, a22 = to_floor - flow, _FLOOR_J_K / dt + flow
        b1 = _CONDENSER_J_K / dt * scalars[T_SUPPLY] + to_water + pump * hp.PUMP_W
        b2 = _FLOOR_J_K / dt * scalars[T_RETURN] + to_floor * nodes[pipe]
        determinant = a11 * a22 - a12 * a21
        scalars[T_SUPPLY] = (b1 * a22 - a12 * b2) / determinant
        scalars[T_RETURN] = (a11 * b2 - a21 * b1) / determinant
        floor_W = to_floor * (scalars[T_SUPPLY] - nodes[pipe])

        heat_W[0], heat_W[1] = floor_W, -soil_heat_W(t)
        radiant_W = _GAIN_RADIANT_W * gains + 0.5 * differs[COOKING]
        films(nodes, scalars[T_AIR], env, film)
        respond(nodes, film, radiant_W, heat_W, dt, w, env, work)
        stored_W = _AIR_J_K / dt * scalars[T_AIR]
        convective_W = ventilation_W_K * w[x.T_OUT] + (_GAIN_CONVECTIVE_W * gains + 0.5 * differs[COOKING])
        air, star = air_and_star(_AIR_J_K / dt + ventilation_W_K, stored_W + convective_W, film, radiant_W, env, work)
        settle(nodes, air, star, work)
        scalars[T_AIR] = air
        scalars[T_OPERATIVE] = 0.5 * (air + radiant_temperature(nodes, env))
        steady_ppm = _OUTDOOR_PPM + people * _CO2_KG_S_PERSON / (_INFILTRATION_KG_S * aired) * _PPM_PER_KG_KG
        scalars[CO2_PPM] = steady_ppm + (scalars[CO2_PPM] - steady_ppm) * math.exp(-_AIR_CHANGES_S * aired * dt)

        _operate(scalars, t, overrides)
        _note(scalars, w, record[step])


@njit(cache=True)
def integrals(time_s: Array, rows: Array, price_per_kWh: Array) -> tuple[float, float, float, float]:
    """Integrate samples (n, 17) at times (n,), s, by the trapezoidal rule, in one pass: a reward asks after every step.

    Returns energy, Wh; cost, currency · 1000; thermal discomfort, K·h; CO2 above its limit, ppm·h.
    """
    Wh = cost = discomfort_Kh = excess_ppm_h = 0.0
    for i in range(time_s.size):
        weight_h = 0.0
        if i > 0:
            weight_h += (time_s[i] - time_s[i - 1]) / (2.0 * HOUR_S)
        if i < time_s.size - 1:
            weight_h += (time_s[i + 1] - time_s[i]) / (2.0 * HOUR_S)
        power_W = rows[i, 1] + rows[i, 2] + rows[i, 3]  # columns of `RECORD`, as in `_note`
        Wh += weight_h * power_W
        cost += weight_h * power_W * price_per_kWh[i]
        at_home = s.is_occupied_sample(time_s[i])
        lower_C = s.LOWER_OCCUPIED_C if at_home else s.LOWER_EMPTY_C
        upper_C = s.UPPER_OCCUPIED_C if at_home else s.UPPER_EMPTY_C
        T_C = rows[i, 0] - ZERO_C_K
        discomfort_Kh += weight_h * max(lower_C - T_C, T_C - upper_C, 0.0)
        excess_ppm_h += weight_h * max(rows[i, 11] - s.CO2_LIMIT_PPM, 0.0)
    return Wh, cost, discomfort_Kh, excess_ppm_h
