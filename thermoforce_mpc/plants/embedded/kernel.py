"""Time step of the whole plant, native control to walls, and its integrals. Compiled; no allocation per step.

Control, refrigerant, pump and fan at a sample follow from the state at that instant and act over the next step.

The envelope uses implicit Euler (first order, L-stable) with film coefficients of the previous step. The nodes of all
constructions form one tridiagonal system that shares only the air and the radiant node. It is solved for three
right-hand sides (constant, per K of air, per K of the radiant node); two balances then give air and radiant node.
"""

from __future__ import annotations

import math

import numpy as np

from thermoforce_mpc.data import HOUR_S, ZERO_C_K, Array
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.embedded import constructions as c
from thermoforce_mpc.plants.embedded import exposure as x
from thermoforce_mpc.plants.embedded import heat_pump as hp
from thermoforce_mpc.plants.embedded import schedule as s
from thermoforce_mpc.plants.embedded.heat_pump import heat_pump
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

_SIGMA = 5.670374419e-8
_CP_AIR = 1006.0 + 1860.0 * 0.006  # dry air with 6 g/kg of vapour
_AIR_J_K = 1.2 * c.VOLUME_M3 * _CP_AIR
_AIR_CHANGES_S = 0.5 / 3600.0
_INFILTRATION_KG_S = 1.2 * c.VOLUME_M3 * _AIR_CHANGES_S
_INFILTRATION_W_K = _INFILTRATION_KG_S * _CP_AIR
_OUTDOOR_PPM = 400.0
_PPM_PER_KG_KG = 1e6 / 1.528635  # the test case's ratio of molar masses, CO2 to moist air
_CO2_KG_S_PERSON = 1.08167e-5
_GAIN_RADIANT_W, _GAIN_CONVECTIVE_W = 219.0, 146.0  # five people

# Columns of what differs from the schedule, held for 15 min: people, heat of cooking W, air changes by windows 1/h.
PEOPLE, COOKING, WINDOWS = range(3)
AS_SCHEDULED = np.zeros((1, 3))

# Floor heating: one circuit, 168.9 kg of water, resistance water to pipe plane after Koschenz and Lehmann (2000).
_CONDENSER_J_K = 30.0 * hp.WATER_J_KG_K
_FLOOR_J_K = 168.9 * hp.WATER_J_KG_K
_FLOOR_W_K = c.AREA_M2 / 0.10207009
_EVAPORATOR_J_K = 180.0 * hp.AIR_J_KG_K
# Temperature of the expansion vessel, connected between supply sensor and pump.
_VESSEL_K = 293.15

# Native PI: gain 1/K, integral time s, anti-windup.
NATIVE_GAIN, _INTEGRAL_S, _ANTI_WINDUP = 0.6, 8000.0, 0.9
_SWITCH_ON, _SWITCH_OFF = 0.01, 0.005

_WALL_EMISSIVITY = 0.9
_SKY_VIEW = np.array([0.5 * math.cos(math.pi / 4)] * 4 + [1.0, 0.5 * math.cos(math.pi / 4)])
_OUTSIDE_M2 = np.array([*c.WALLS_M2, c.AREA_M2, c.WINDOW_M2])
# Long-wave radiation of the window panes, linearised about 280 K.
_WINDOW_RADIATION = 0.9 * _SIGMA * (280.0 + 285.0) * (280.0**2 + 285.0**2)

_N_INSIDE = len(c.SURFACES)
_INSIDE_M2, _SHARE, _EMISSIVITY, _RESISTANCE = np.array(list(c.SURFACES.values())).T.copy()
_RADIANT_W_K = (2 * 295.15 - 2) * (295.15**2 + 293.15**2) / _RESISTANCE
_SHARE = _SHARE / sum(_SHARE.tolist())
_EMITTED = _INSIDE_M2 * _EMISSIVITY / (_INSIDE_M2 * _EMISSIVITY).sum()
# Beam irradiance falls on the floor, which absorbs 55 % and reflects the rest to all other surfaces.
_FLOOR, _CEILING = (list(c.SURFACES).index(name) for name in ("floor", "roof"))
_BEAM = np.where(np.arange(_N_INSIDE) == _FLOOR, 0.0, _SHARE)
_BEAM = 0.45 * _BEAM / _BEAM.sum()
_BEAM[_FLOOR] = 0.55
# Khalifa-type films: A·1.823/Dh^0.121·|dT|^1.293 on walls, with Dh from the perimeter of each wall.
_DH = 4.0 * _INSIDE_M2 / (2.0 * _INSIDE_M2 / c.HEIGHT_M + 2.0 * c.HEIGHT_M)
_WALL_FILM = _INSIDE_M2 * 1.823 / _DH**0.121
_SIDE = math.sqrt(c.AREA_M2)
_BUOYANT_FILM, _STABLE_FILM = c.AREA_M2 * 2.175 / _SIDE**0.076, c.AREA_M2 * 0.704 / _SIDE**0.601
_BLEND_K = 0.1
_ZERO_ROUNDING_K = 1e-4


@njit(cache=True)
def _horizontal_film(buoyant_K: float) -> float:
    """Return the film conductance of floor or ceiling, W/K; buoyant for positive `buoyant_K`, blended over ±0.1 K."""
    d = abs(buoyant_K) + _ZERO_ROUNDING_K
    share = min(max(0.5 + 0.5 * buoyant_K / _BLEND_K, 0.0), 1.0)
    share = share * share * (3.0 - 2.0 * share)
    return share * _BUOYANT_FILM * d**0.308 + (1.0 - share) * _STABLE_FILM * d**0.133


@njit(cache=True)
def soil_heat_W(time_s: float) -> float:
    """Return the heat loss at the underside of the slab, W: ISO 13370 edge loss, mean and two periodic parts."""
    month = time_s / 3.1536e7 * 12.0
    mean = 0.0823985 * c.AREA_M2 * (295.15 - 283.95)
    outside = 11.921 * 2.0 * math.cos(2.0 * math.pi / 12.0 * (month - 1.0 + 0.1322))
    inside = 5.7858 * 4.0 * math.cos(2.0 * math.pi / 12.0 * (month - 1.0 - 2.3167))
    return mean - outside + inside


@njit(cache=True, inline="always")
def _read_weather(grid: np.ndarray, time_s: float, w: np.ndarray) -> None:
    """Interpolate the exposure linearly at `time_s` into `w` (17,)."""
    at = (time_s % ((grid.shape[0] - 1) * x.GRID_S)) / x.GRID_S
    row = int(at)
    share = at - row
    for j in range(x.N_COLUMNS):
        w[j] = (1.0 - share) * grid[row, j] + share * grid[row + 1, j]


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
def sample(scalars: np.ndarray, time_s: float, overrides: np.ndarray, grid: np.ndarray, row: np.ndarray) -> None:
    """Write the sample at `time_s` under `overrides` (4,) into `row` (17,), see `advance`."""
    w = np.empty(x.N_COLUMNS)
    _read_weather(grid, time_s, w)
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
    net: c.Network,
    record: np.ndarray,
) -> None:
    """Advance `nodes` (n,) K and `scalars` (20,) in place by `n_steps` of `dt` s; fill `record` (n_steps, 17).

    `overrides` (4,) level 0 to 1, set-point K, pump, fan; NaN where not overwritten. Names: see `RECORD`.
    `unannounced` (n, 3): see `PEOPLE`, periodic; `AS_SCHEDULED` where people keep to the schedule.
    """
    capacity, coupling, pipe, slab = net.capacity, net.coupling, net.pipe, net.slab
    outside, inside = net.outside, net.inside
    n, n_inside = nodes.size, inside.size
    w = np.empty(x.N_COLUMNS)
    diagonal, right = np.empty(n), np.empty((n, 3))
    factor = np.empty(n)
    film, absorbed = np.empty(n_inside), np.empty(n_inside)
    _operate(scalars, time_s, overrides)
    for step in range(n_steps):
        t = time_s + (step + 1) * dt
        # Weather at the end of the step.
        _read_weather(grid, t, w)
        midway = t - 0.5 * dt
        differs = unannounced[int(midway / x.GRID_S) % unannounced.shape[0]]
        people = max((float(s.PEOPLE) if is_occupied(midway) else 0.0) + differs[PEOPLE], 0.0)
        gains = people / s.PEOPLE
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

        # Envelope: storage and conduction of every node, then its surface exchange.
        for i in range(n):
            diagonal[i] = capacity[i] / dt + coupling[i] + (coupling[i - 1] if i > 0 else 0.0)
            right[i, 0] = capacity[i] / dt * nodes[i]
            right[i, 1] = 0.0
            right[i, 2] = 0.0
        right[pipe, 0] += floor_W
        right[slab, 0] -= soil_heat_W(t)
        for k in range(6):
            i = outside[k]
            window = k == 5
            view = _SKY_VIEW[k]
            environment = (view * w[x.T_SKY] ** 4 + (1.0 - view) * w[x.T_OUT] ** 4) ** 0.25
            difference = nodes[i] - w[x.T_OUT]
            if k == 4:
                natural = (1.509 if difference > 0.0 else 0.76) * abs(difference) ** (1.0 / 3.0)
            else:
                natural = 1.31 * abs(difference) ** (1.0 / 3.0)
            forced = w[x.FORCED] if window else w[x.FORCED + k]
            convective = _OUTSIDE_M2[k] * math.sqrt(natural**2 + forced**2)
            if window:
                radiative = _OUTSIDE_M2[k] * _WINDOW_RADIATION
                sun = w[x.PANE_OUTER]
            else:
                T = nodes[i]
                radiative = (
                    _OUTSIDE_M2[k] * _WALL_EMISSIVITY * _SIGMA * (T + environment) * (T * T + environment * environment)
                )
                sun = _OUTSIDE_M2[k] * w[x.ABSORBED + k]
            diagonal[i] += convective + radiative
            right[i, 0] += convective * w[x.T_OUT] + radiative * environment + sun
        radiant_gain = _GAIN_RADIANT_W * gains + 0.5 * differs[COOKING]
        for k in range(n_inside):
            i = inside[k]
            difference = nodes[i] - scalars[T_AIR]
            if k == _FLOOR:
                film[k] = _horizontal_film(difference)
            elif k == _CEILING:
                film[k] = _horizontal_film(-difference)
            else:
                film[k] = _WALL_FILM[k] * (abs(difference) + _ZERO_ROUNDING_K) ** 0.293
            absorbed[k] = _BEAM[k] * w[x.BEAM_IN] + _SHARE[k] * w[x.DIFFUSE_IN] + _EMITTED[k] * radiant_gain
            diagonal[i] += film[k] + _RADIANT_W_K[k]
            right[i, 0] += absorbed[k]
            right[i, 1] += film[k]
            right[i, 2] += _RADIANT_W_K[k]
        right[inside[n_inside - 1], 0] += w[x.PANE_INNER]

        # Thomas algorithm for all constructions at once: couplings between them are zero.
        factor[0] = diagonal[0]
        for i in range(1, n):
            ratio = coupling[i - 1] / factor[i - 1]
            factor[i] = diagonal[i] - ratio * coupling[i - 1]
            for j in range(3):
                right[i, j] += ratio * right[i - 1, j]
        for j in range(3):
            right[n - 1, j] /= factor[n - 1]
        for i in range(n - 2, -1, -1):
            for j in range(3):
                right[i, j] = (right[i, j] + coupling[i] * right[i + 1, j]) / factor[i]

        # Heat balances of the air and of the massless radiant node, two equations in these two temperatures.
        m11, m12, r1 = _AIR_J_K / dt + ventilation_W_K, 0.0, _AIR_J_K / dt * scalars[T_AIR]
        r1 += ventilation_W_K * w[x.T_OUT] + (_GAIN_CONVECTIVE_W * gains + 0.5 * differs[COOKING])
        m21, m22, r2 = 0.0, 0.0, 0.0
        for k in range(n_inside):
            i = inside[k]
            m11 += film[k] * (1.0 - right[i, 1])
            m12 -= film[k] * right[i, 2]
            r1 += film[k] * right[i, 0]
            m21 -= _RADIANT_W_K[k] * right[i, 1]
            m22 += _RADIANT_W_K[k] * (1.0 - right[i, 2])
            r2 += _RADIANT_W_K[k] * right[i, 0]
        determinant = m11 * m22 - m12 * m21
        air = (r1 * m22 - m12 * r2) / determinant
        star = (m11 * r2 - m21 * r1) / determinant
        for i in range(n):
            nodes[i] = right[i, 0] + right[i, 1] * air + right[i, 2] * star
        scalars[T_AIR] = air
        radiant = 0.0
        for k in range(n_inside):
            radiant += _SHARE[k] * nodes[inside[k]]
        scalars[T_OPERATIVE] = 0.5 * (air + radiant)
        steady_ppm = _OUTDOOR_PPM + people * _CO2_KG_S_PERSON / (_INFILTRATION_KG_S * aired) * _PPM_PER_KG_KG
        scalars[CO2_PPM] = steady_ppm + (scalars[CO2_PPM] - steady_ppm) * math.exp(-_AIR_CHANGES_S * aired * dt)

        _operate(scalars, t, overrides)
        _note(scalars, w, record[step])


@njit(cache=True)
def integrals(time_s: Array, rows: Array, price_per_kWh: Array) -> Array:
    """Integrate samples (n, 17) at times (n,), s, by the trapezoidal rule, in one pass: a reward asks after every step.

    Returns energy, Wh; cost, currency · 1000; thermal discomfort, K·h; CO2 above its limit, ppm·h.
    """
    out = np.zeros(4)
    for i in range(time_s.size):
        weight_h = 0.0
        if i > 0:
            weight_h += (time_s[i] - time_s[i - 1]) / (2.0 * HOUR_S)
        if i < time_s.size - 1:
            weight_h += (time_s[i + 1] - time_s[i]) / (2.0 * HOUR_S)
        power_W = rows[i, 1] + rows[i, 2] + rows[i, 3]  # columns of `RECORD`, as in `_note`
        out[0] += weight_h * power_W
        out[1] += weight_h * power_W * price_per_kWh[i]
        at_home = s.is_occupied_sample(time_s[i])
        lower_C = s.LOWER_OCCUPIED_C if at_home else s.LOWER_EMPTY_C
        upper_C = s.UPPER_OCCUPIED_C if at_home else s.UPPER_EMPTY_C
        T_C = rows[i, 0] - ZERO_C_K
        out[2] += weight_h * max(lower_C - T_C, T_C - upper_C, 0.0)
        out[3] += weight_h * max(rows[i, 11] - s.CO2_LIMIT_PPM, 0.0)
    return out
