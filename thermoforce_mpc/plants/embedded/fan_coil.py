"""Time step of `bestest_air`: a four-pipe fan coil unit, its native control, and the office. Compiled.

Control and fan act in steps of about a second on the air, beside surfaces of the last step; the envelope then takes
their means, see `envelope`.
"""

from __future__ import annotations

import math

import numpy as np

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.embedded import exposure as x
from thermoforce_mpc.plants.embedded import houses as c
from thermoforce_mpc.plants.embedded import schedule as s
from thermoforce_mpc.plants.embedded.envelope import (
    COOKING,
    PEOPLE,
    WINDOWS,
    films,
    read_weather,
    respond,
    settle,
    star_beside,
)
from thermoforce_mpc.plants.embedded.houses import OFFICE
from thermoforce_mpc.plants.embedded.schedule import is_open

_AIR_S = 1.0
# The sample of the instant at which the schedule switches shows the state before, s: so do the set-points in the real
# case's records; its gas peaks, of the quarter of an hour that begins then, agree to 0.3 % instead of 1.5.
_BEFORE_S = 1e-3

# Scalar states: the first eight are carried from step to step, the others computed from them by `_operate`.
(T_AIR, HEATING_INTEGRAL, COOLING_INTEGRAL, COOLS, FLOW_LAGGED, FLOW_KG_S, CO2_PPM, CO2_SENSED,
 HEATING_K, COOLING_K, SUPPLY_K, FAN, HEATING_RATE, COOLING_RATE) = range(14)  # fmt: skip
N_SCALARS = 14
# Columns of the record (K, W, kg/s, ppm).
RECORD = (
    "T_air", "P_gas", "P_chiller", "P_fan", "flow", "CO2", "T_heating", "T_cooling", "T_supply", "fan", "P_lights",
    "P_plugs", "T_out", "solar",
)  # fmt: skip
# Overwrite inputs in this order; NaN where not overwritten.
_TSET_HEATING, _TSET_COOLING, _T_SUPPLY, _FAN = range(4)

_AIR_J_K, _CP = OFFICE.air_J_K, OFFICE.cp
_INFILTRATION_KG_S = 0.0216
_AIR_CHANGES_S = 0.5 / 3600.0
_OUTDOOR_PPM, _PERSON_PPM = 400.0, 8.64e-6 / _INFILTRATION_KG_S * 1e6 / 1.5194
_SENSOR_S = 25.0
_PEOPLE = float(s.OFFICE_USE.people)
_PERSON_CONVECTIVE_W = s.PERSON_CONVECTIVE_W + s.PERSON_VAPOUR_W
_RADIANT_W = s.LIGHTS_RADIANT * s.LIGHTS_W + s.PLUGS_RADIANT * s.PLUGS_W
_CONVECTIVE_W = s.LIGHTS_W + s.PLUGS_W - _RADIANT_W

FULL_FLOW_KG_S, _FAN_S = 0.55, 3.86
_FULL_FAN_W = 173.0442
_BOILER_EFFICIENCY, _CHILLER_COP = 0.9, 3.0

# Native control: PI of both loops, supply air, and how far below the set-point cooling ends, K.
_GAIN, _INTEGRAL_S, _ANTI_WINDUP = 0.1, 120.0, 0.9
_NEUTRAL_HEATING_K, _SPAN_HEATING_K = ZERO_C_K + 21.0, 19.0
_NEUTRAL_COOLING_K, _SPAN_COOLING_K = ZERO_C_K + 24.0, 12.0
_COOLING_HYSTERESIS_K = 1.0


@njit(cache=True)
def _loop(error: float, integral: float) -> tuple[float, float]:
    """Return output in [0, 1] of a PI loop, and the rate of its integral."""
    wanted = _GAIN * (error + integral)
    output = min(max(wanted, 0.0), 1.0)
    return output, (error + (output - wanted) / (_GAIN * _ANTI_WINDUP)) / _INTEGRAL_S


@njit(cache=True)
def _operate(scalars: np.ndarray, time_s: float, overrides: np.ndarray) -> None:
    """Set control for the state at `time_s`. Idempotent."""
    occupied = is_open(time_s)
    heating = ZERO_C_K + (s.LOWER_OCCUPIED_C if occupied else s.LOWER_EMPTY_C)
    cooling = ZERO_C_K + (s.UPPER_OCCUPIED_C if occupied else s.UPPER_EMPTY_C)
    T = scalars[T_AIR]
    # The mode follows the schedule, whatever set-points are overwritten.
    if cooling < T:
        scalars[COOLS] = 1.0
    elif cooling - _COOLING_HYSTERESIS_K > T:
        scalars[COOLS] = 0.0
    if not math.isnan(overrides[_TSET_HEATING]):
        heating = overrides[_TSET_HEATING]
    if not math.isnan(overrides[_TSET_COOLING]):
        cooling = overrides[_TSET_COOLING]
    heat, scalars[HEATING_RATE] = _loop(heating - T, scalars[HEATING_INTEGRAL])
    cool, scalars[COOLING_RATE] = _loop(T - cooling, scalars[COOLING_INTEGRAL])
    if scalars[COOLS] > 0.5:
        supply = _NEUTRAL_COOLING_K - _SPAN_COOLING_K * cool
    else:
        supply = _NEUTRAL_HEATING_K + _SPAN_HEATING_K * heat
    scalars[HEATING_K], scalars[COOLING_K] = heating, cooling
    scalars[SUPPLY_K] = supply if math.isnan(overrides[_T_SUPPLY]) else overrides[_T_SUPPLY]
    scalars[FAN] = min(heat + cool, 1.0) if math.isnan(overrides[_FAN]) else overrides[_FAN]


@njit(cache=True)
def _note(scalars: np.ndarray, time_s: float, w: np.ndarray, row: np.ndarray) -> None:
    flow = scalars[FLOW_KG_S]
    heat = flow * _CP * (scalars[SUPPLY_K] - scalars[T_AIR])
    on = 1.0 if is_open(time_s) else s.STANDBY
    row[0], row[1], row[2] = scalars[T_AIR], max(heat, 0.0) / _BOILER_EFFICIENCY, max(-heat, 0.0) / _CHILLER_COP
    row[3], row[4], row[5] = _FULL_FAN_W * (flow / FULL_FLOW_KG_S) ** 3, flow, scalars[CO2_SENSED]
    row[6], row[7] = scalars[HEATING_K], scalars[COOLING_K]
    row[8], row[9] = scalars[SUPPLY_K], scalars[FAN]
    row[10], row[11], row[12], row[13] = on * s.LIGHTS_W, on * s.PLUGS_W, w[x.T_OUT], w[x.GLOBAL]


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
    """Set `scalars` (14,) to a begin at `time_s`; write its sample into `row` (14,), see `advance`."""
    scalars[:] = 0.0
    scalars[T_AIR] = c.START_K
    scalars[CO2_PPM] = scalars[CO2_SENSED] = _OUTDOOR_PPM
    w = np.empty(x.N_COLUMNS)
    read_weather(grid, time_s, w)
    _operate(scalars, time_s, overrides)
    _note(scalars, time_s, w, row)


@njit(cache=True, nogil=True)
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
    """Advance `nodes` (n,) K and `scalars` (14,) in place by `n_steps` of `dt` s; fill `record` (n_steps, 14).

    `overrides` (4,): heating and cooling set-point K, supply air K, fan; NaN where not overwritten. Names: see
    `RECORD`. `unannounced` (n, 3): see `envelope.AS_SCHEDULED`, periodic.
    """
    w, work, film = np.empty(x.N_COLUMNS), np.empty((nodes.size, 5)), np.empty(env.inside.size)
    n_short = max(math.ceil(dt / _AIR_S - 1e-9), 1)
    h = dt / n_short
    lag, sensor_lag = 1.0 - math.exp(-h / _FAN_S), 1.0 - math.exp(-dt / _SENSOR_S)
    no_heat = np.empty(0)
    for step in range(n_steps):
        begin = time_s + step * dt
        read_weather(grid, begin + dt, w)
        midway = begin + 0.5 * dt
        occupied = is_open(midway)
        differs = unannounced[int(midway / x.GRID_S) % unannounced.shape[0]]
        people = max((_PEOPLE if occupied else 0.0) + differs[PEOPLE], 0.0)
        on = 1.0 if occupied else s.STANDBY
        radiant_W = on * _RADIANT_W + s.PERSON_RADIANT_W * people + 0.5 * differs[COOKING]
        # Air change relative to that through leaks.
        aired = 1.0 + differs[WINDOWS] / 3600.0 / _AIR_CHANGES_S
        films(nodes, scalars[T_AIR], env, film)
        infiltration_W_K = aired * _INFILTRATION_KG_S * w[x.CP_OUT]
        received, still_W_K = 0.0, infiltration_W_K
        for k in range(env.inside.size):
            received += film[k] * nodes[env.inside[k]]
            still_W_K += film[k]
        received += infiltration_W_K * w[x.T_OUT] + (
            on * _CONVECTIVE_W + _PERSON_CONVECTIVE_W * people + 0.5 * differs[COOKING]
        )
        mean_air = 0.0
        for short in range(n_short):
            _operate(scalars, begin + short * h, overrides)
            scalars[HEATING_INTEGRAL] += h * scalars[HEATING_RATE]
            scalars[COOLING_INTEGRAL] += h * scalars[COOLING_RATE]
            # Two lags in a row; the flow of the middle of the step.
            flow = scalars[FLOW_KG_S]
            scalars[FLOW_LAGGED] += lag * (FULL_FLOW_KG_S * scalars[FAN] - scalars[FLOW_LAGGED])
            scalars[FLOW_KG_S] += lag * (scalars[FLOW_LAGGED] - flow)
            blown_W_K = 0.5 * (flow + scalars[FLOW_KG_S]) * _CP
            conductance = still_W_K + blown_W_K
            before = scalars[T_AIR]
            gained = received + blown_W_K * scalars[SUPPLY_K] - conductance * before
            change = h * gained / (_AIR_J_K + 0.5 * h * conductance)
            scalars[T_AIR] = before + change
            mean_air += (before + 0.5 * change) / n_short
        respond(nodes, film, radiant_W, no_heat, dt, w, env, work)
        settle(nodes, mean_air, star_beside(mean_air, radiant_W, env, work), work)
        steady_ppm = _OUTDOOR_PPM + people * _PERSON_PPM / aired
        scalars[CO2_PPM] = steady_ppm + (scalars[CO2_PPM] - steady_ppm) * math.exp(-_AIR_CHANGES_S * aired * dt)
        scalars[CO2_SENSED] += sensor_lag * (scalars[CO2_PPM] - scalars[CO2_SENSED])
        _operate(scalars, begin + dt - _BEFORE_S, overrides)
        _note(scalars, begin + dt - _BEFORE_S, w, record[step])
