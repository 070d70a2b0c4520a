"""Time step of `bestest_hydronic`: a gas boiler, a pump and a radiator, their native control, and the house. Compiled.

Control and water act in short steps on the air, beside surfaces of the last step; the envelope then takes their means,
see `envelope`.
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
    radiant_temperature,
    read_weather,
    respond,
    settle,
    star_beside,
)
from thermoforce_mpc.plants.embedded.houses import BOILER_HOUSE, moist_air_cp
from thermoforce_mpc.plants.embedded.schedule import is_occupied

_WATER_S = 5.0

# Scalar states: the first eleven are carried from step to step, the others computed from them by `_operate`.
(T_AIR, T_RADIANT, RADIANT_RATE, INTEGRAL, PUMP_ON, CO2_PPM, RADIATOR_1, _RADIATOR_2, _RADIATOR_3, _RADIATOR_4,
 T_RETURN, HEATING_K, COOLING_K, SUPPLY_K, PUMP, BOILER_W, GAS_W, INTEGRAL_RATE) = range(18)  # fmt: skip
N_SCALARS = 18
# Columns of the record (K, W, ppm).
RECORD = (
    "T_operative", "P_gas", "P_pump", "CO2", "T_heating", "T_cooling", "T_supply", "pump", "T_air", "T_return",
    "T_out", "solar",
)  # fmt: skip
# Overwrite inputs in this order; NaN where not overwritten.
_TSET_HEATING, _TSET_COOLING, _TSET_SUPPLY, _PUMP = range(4)

_AIR_J_K = BOILER_HOUSE.air_J_K
_INFILTRATION_KG_S = 0.0216
_INFILTRATION_W_K = _INFILTRATION_KG_S * moist_air_cp(0.0)
_AIR_CHANGES_S = 0.5 / 3600.0
_OUTDOOR_PPM, _PERSON_PPM = 400.0, 1.08167e-5 / _INFILTRATION_KG_S * 1e6 / 1.528635
_PEOPLE = float(s.BOILER_USE.people)
_PERSON_CONVECTIVE_W = s.PERSON_CONVECTIVE_W + s.PERSON_VAPOUR_W

_FLOW_W_K = 0.0597514 * 4184.0
_PUMP_W = 12.2482
_BOILER_W = 5000.0
# Efficiency by the temperature of the returning water, °C.
_EFFICIENCY = (-0.4540036, 0.1805752, -0.009048470, 2.266453e-4, -3.058709e-6, 2.130271e-8, -6.017763e-11)
_COLDEST_C, _WARMEST_C = 25.0, 75.0
_ELEMENTS, _ELEMENT_J_K = 5, 37_310.0
_ELEMENT_W_K, _EXPONENT, _RADIANT_SHARE = 11.3258327, 1.24, 0.35

# Native control: the set-point above the lower bound, K, and the PI from it to the supply water, K.
_ABOVE_BOUND_K = 0.1
_GAIN, _INTEGRAL_S, _ANTI_WINDUP = 10.0, 300.0, 0.9
_LEAST_SUPPLY_K, _MOST_SUPPLY_K = 293.15, 353.15


@njit(cache=True)
def efficiency(T_return_K: float) -> float:
    """Return the boiler's efficiency for water that comes back at `T_return_K`."""
    T_C = min(max(T_return_K - ZERO_C_K, _COLDEST_C), _WARMEST_C)
    value = 0.0
    for i in range(len(_EFFICIENCY) - 1, -1, -1):
        value = value * T_C + _EFFICIENCY[i]
    return value


@njit(cache=True)
def _operate(scalars: np.ndarray, time_s: float, overrides: np.ndarray) -> None:
    """Set control, pump and boiler for the state at `time_s`. Idempotent."""
    occupied = is_occupied(time_s)
    heating = ZERO_C_K + (s.LOWER_OCCUPIED_C if occupied else s.LOWER_EMPTY_C) + _ABOVE_BOUND_K
    cooling = ZERO_C_K + (s.UPPER_OCCUPIED_C if occupied else s.UPPER_EMPTY_C)
    if not math.isnan(overrides[_TSET_HEATING]):
        heating = overrides[_TSET_HEATING]
    if not math.isnan(overrides[_TSET_COOLING]):
        cooling = overrides[_TSET_COOLING]
    T_operative = 0.5 * (scalars[T_AIR] + scalars[T_RADIANT])
    error = heating - T_operative
    wanted = _GAIN * (error + scalars[INTEGRAL])
    supply = min(max(wanted, _LEAST_SUPPLY_K), _MOST_SUPPLY_K)
    scalars[INTEGRAL_RATE] = (error + (supply - wanted) / (_GAIN * _ANTI_WINDUP)) / _INTEGRAL_S
    if T_operative < heating:
        scalars[PUMP_ON] = 1.0
    elif T_operative > cooling:
        scalars[PUMP_ON] = 0.0
    if not math.isnan(overrides[_TSET_SUPPLY]):
        supply = overrides[_TSET_SUPPLY]
    pump = scalars[PUMP_ON] if math.isnan(overrides[_PUMP]) else math.floor(overrides[_PUMP] + 0.5)
    boiler_W = min(max(_FLOW_W_K * (supply - scalars[T_RETURN]), 0.0), _BOILER_W) if pump > 0.5 else 0.0
    scalars[HEATING_K], scalars[COOLING_K], scalars[SUPPLY_K], scalars[PUMP] = heating, cooling, supply, pump
    scalars[BOILER_W], scalars[GAS_W] = boiler_W, boiler_W / efficiency(scalars[T_RETURN])


@njit(cache=True)
def _radiate(scalars: np.ndarray, h: float) -> tuple[float, float]:
    """Advance the radiator by `h` s; returns its heat to the air and to the surfaces, W."""
    flow = _FLOW_W_K if scalars[PUMP] > 0.5 else 0.0
    T_before = scalars[T_RETURN] + (scalars[BOILER_W] / flow if flow > 0.0 else 0.0)
    convective, radiant = 0.0, 0.0
    for i in range(RADIATOR_1, RADIATOR_1 + _ELEMENTS):
        T = scalars[i]
        to_air, to_surfaces = T - scalars[T_AIR], T - scalars[T_RADIANT]
        air_W = math.copysign((1.0 - _RADIANT_SHARE) * _ELEMENT_W_K * abs(to_air) ** _EXPONENT, to_air)
        surfaces_W = math.copysign(_RADIANT_SHARE * _ELEMENT_W_K * abs(to_surfaces) ** _EXPONENT, to_surfaces)
        # The flow is implicit: each element ends a step with what the one before it ends with.
        stored = _ELEMENT_J_K / h
        scalars[i] = (stored * T + flow * T_before - air_W - surfaces_W) / (stored + flow)
        T_before = scalars[i]
        convective += air_W
        radiant += surfaces_W
    return convective, radiant


@njit(cache=True)
def _note(scalars: np.ndarray, w: np.ndarray, row: np.ndarray) -> None:
    row[0], row[1] = 0.5 * (scalars[T_AIR] + scalars[T_RADIANT]), scalars[GAS_W]
    row[2], row[3] = scalars[PUMP] * _PUMP_W, scalars[CO2_PPM]
    row[4], row[5], row[6] = scalars[HEATING_K], scalars[COOLING_K], scalars[SUPPLY_K]
    row[7], row[8], row[9] = scalars[PUMP], scalars[T_AIR], scalars[T_RETURN]
    row[10], row[11] = w[x.T_OUT], w[x.GLOBAL]


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
    """Set `scalars` (18,) to a begin at `time_s`; write its sample into `row` (12,), see `advance`."""
    scalars[:] = 0.0
    scalars[T_AIR] = scalars[T_RADIANT] = c.START_K
    scalars[RADIATOR_1 : T_RETURN + 1] = c.START_K
    scalars[CO2_PPM] = _OUTDOOR_PPM
    w = np.empty(x.N_COLUMNS)
    read_weather(grid, time_s, w)
    _operate(scalars, time_s, overrides)
    _note(scalars, w, row)


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
    """Advance `nodes` (n,) K and `scalars` (18,) in place by `n_steps` of `dt` s; fill `record` (n_steps, 12).

    `overrides` (4,): heating and cooling set-point K, supply water K, pump; NaN where not overwritten. Names: see
    `RECORD`. `unannounced` (n, 3): see `envelope.AS_SCHEDULED`, periodic.
    """
    w, work, film = np.empty(x.N_COLUMNS), np.empty((nodes.size, 5)), np.empty(env.inside.size)
    n_short = max(math.ceil(dt / _WATER_S - 1e-9), 1)
    h = dt / n_short
    no_heat = np.empty(0)
    for step in range(n_steps):
        begin = time_s + step * dt
        read_weather(grid, begin + dt, w)
        midway = begin + 0.5 * dt
        differs = unannounced[int(midway / x.GRID_S) % unannounced.shape[0]]
        people = max((_PEOPLE if is_occupied(midway) else 0.0) + differs[PEOPLE], 0.0)
        # Air change relative to that through leaks.
        aired = 1.0 + differs[WINDOWS] / 3600.0 / _AIR_CHANGES_S
        films(nodes, scalars[T_AIR], env, film)
        received, conductance = 0.0, aired * _INFILTRATION_W_K
        for k in range(env.inside.size):
            received += film[k] * nodes[env.inside[k]]
            conductance += film[k]
        received += aired * _INFILTRATION_W_K * w[x.T_OUT] + _PERSON_CONVECTIVE_W * people + 0.5 * differs[COOKING]
        mean_air, radiant_W, T_radiant = 0.0, 0.0, scalars[T_RADIANT]
        for short in range(n_short):
            _operate(scalars, begin + short * h, overrides)
            scalars[INTEGRAL] += h * scalars[INTEGRAL_RATE]
            convective, radiant = _radiate(scalars, h)
            before = scalars[T_AIR]
            change = h * (received + convective - conductance * before) / (_AIR_J_K + 0.5 * h * conductance)
            scalars[T_AIR] = before + change
            # The surfaces are taken to go on as in the last step: the pump's thermostat feels them.
            scalars[T_RADIANT] += h * scalars[RADIANT_RATE]
            mean_air += (before + 0.5 * change) / n_short
            radiant_W += radiant / n_short
        radiant_W += s.PERSON_RADIANT_W * people + 0.5 * differs[COOKING]
        respond(nodes, film, radiant_W, no_heat, dt, w, env, work)
        settle(nodes, mean_air, star_beside(mean_air, radiant_W, env, work), work)
        scalars[T_RADIANT] = radiant_temperature(nodes, env)
        scalars[RADIANT_RATE] = (scalars[T_RADIANT] - T_radiant) / dt
        steady_ppm = _OUTDOOR_PPM + people * _PERSON_PPM / aired
        scalars[CO2_PPM] = steady_ppm + (scalars[CO2_PPM] - steady_ppm) * math.exp(-_AIR_CHANGES_S * aired * dt)
        _operate(scalars, begin + dt, overrides)
        _note(scalars, w, record[step])
