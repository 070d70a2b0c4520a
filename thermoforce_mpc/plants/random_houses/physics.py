"""Equations of a generated house: envelope of EN ISO 13790 with an air node, emitter, machine, sensor; one step 30 s.

Nodes: room air, room surfaces, structure, slab, emitter water, and where a house has it the part that the sun heats
first (`draw.SunlitPart`). Unlike in the hourly method of the standard, the surfaces have the heat capacity of their
first centimetre, taken from that of the structure: without it a heater's swings of some minutes would show fully in the
operative temperature.

All couplings are implicit (backward Euler) and every heat flow leaves one node and enters another, or crosses the
boundary and is recorded: the energy balance closes to rounding. The machine's heat is that of the water temperature at
the start of the step.
"""

from __future__ import annotations

import math

import numpy as np

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants import drawn_houses
from thermoforce_mpc.plants.random_houses.draw import House, heat_pump_cop

# States, °C. PI integral in levels, on/off flag of the native thermostat.
AIR, SURFACE, MASS, SLAB, WATER, SUNLIT, SENSOR, INTEGRAL, ON = range(9)
N_STATES = 9
# Columns of the weather and schedule grid: °C, W/m², W, W/K, W, share 0 to 1, °C. The last two columns are held for
# 15 min, the others interpolated.
T_OUT, GLOBAL, SUN_IN, VENTILATION, SUN_ON_SENSOR, GAINS, SETPOINT = range(7)
N_COLUMNS = 7
# Columns of the record, one row per step: temperatures K as at BOPTEST's interface, W, W/m², J.
RECORD = (
    "T_operative", "T_measured", "P_billed", "Q_machine", "T_return", "level", "T_out", "solar",
    "loss_W", "gain_W", "stored_J", "T_supply",
)  # fmt: skip

# Width of the throttling range below the water limit, K.
_THROTTLE_K = 10.0
# Return temperature below which a boiler condenses, °C, and gain of efficiency per K below it (EN 15502 data sheets:
# about 10 % of the gross calorific value between 55 and 30 °C).
_DEW_POINT_C, _CONDENSING_PER_K = 55.0, 0.004

# Native control: dead band, K; PI gain 1/K and integral time, s, by emitter.
_DEAD_BAND_K = 0.3
_GAIN_1_K = 1.0
_INTEGRAL_S = {"floor": 4 * 3600.0, "radiator": 1.5 * 3600.0, "air": 0.75 * 3600.0}

# Indices of the parameter vector.
(P_AIR_J, P_MASS_J, P_SLAB_J, P_WATER_J, P_IS, P_WINDOWS, P_MS, P_EM, P_SLAB_ROOM, P_SLAB_GROUND, P_GROUND_C,
 P_STRENGTH, P_EXPONENT, P_CONVECTIVE, P_FLOOR, P_MASS_SHARE, P_MACHINE, P_CAPACITY, P_CAPACITY_K, P_DESIGN_C,
 P_LOWEST, P_CARNOT, P_FIXED, P_EFFICIENCY, P_SPREAD, P_LIMIT, P_LAG, P_BIAS, P_NOISE, P_RESOLUTION, P_TI,
 P_MODULATES, P_SURFACE_J, P_SUNLIT_SHARE, P_SUNLIT_J, P_SUNLIT_AIR, P_SUNLIT_SURFACE, P_SUNLIT_MASS,
 P_SUNLIT_OUT) = range(39)  # fmt: skip
N_PARAMETERS = 39
_HEAT_PUMP, _BOILER, _ELECTRIC = 0.0, 1.0, 2.0

_cop = njit(cache=True)(heat_pump_cop)


def parameters(house: House) -> np.ndarray:
    """Return the parameter vector of a house for `advance`, shape (39,), SI units and °C."""
    p = np.zeros(N_PARAMETERS)
    area = house.floor_area_m2
    surface_m2 = drawn_houses.SURFACE_PER_FLOOR * area
    p[P_AIR_J], p[P_SURFACE_J] = drawn_houses.AIR_J_M2_K * area, drawn_houses.SURFACE_J_M2_K * surface_m2
    p[P_MASS_J] = house.mass_J_K - p[P_SURFACE_J]
    p[P_SLAB_J], p[P_WATER_J] = house.slab_J_K or 1.0, house.emitter_J_K
    p[P_IS], p[P_WINDOWS] = drawn_houses.SURFACE_AIR_W_M2_K * surface_m2, house.windows_W_K
    p[P_MS] = drawn_houses.SURFACE_MASS_W_M2_K * house.mass_area_m2
    p[P_EM] = 1.0 / (1.0 / house.opaque_W_K - 1.0 / p[P_MS])
    p[P_SLAB_ROOM], p[P_SLAB_GROUND] = house.slab_room_W_K, house.slab_ground_W_K
    p[P_GROUND_C] = drawn_houses.ground_C(house.warmer_K)
    p[P_STRENGTH], p[P_EXPONENT] = house.emitter_W_Kn, house.emitter_exponent
    p[P_CONVECTIVE], p[P_FLOOR] = house.convective, float(house.emitter == "floor")
    p[P_MASS_SHARE] = house.mass_area_m2 / surface_m2
    p[P_MACHINE] = {"boiler": _BOILER, "electric": _ELECTRIC}.get(house.machine, _HEAT_PUMP)
    p[P_CAPACITY], p[P_CAPACITY_K], p[P_DESIGN_C] = house.capacity_W, house.capacity_per_K, house.design_out_C
    p[P_LOWEST], p[P_CARNOT], p[P_FIXED] = house.lowest_level, house.carnot, house.fixed_W
    p[P_EFFICIENCY], p[P_SPREAD], p[P_LIMIT] = house.efficiency, house.spread_K, house.water_limit_C
    p[P_LAG], p[P_BIAS], p[P_NOISE] = house.lag_s, house.sun_bias_K, house.noise_sd_K
    p[P_RESOLUTION], p[P_TI] = house.resolution_K, _INTEGRAL_S[house.emitter]
    p[P_MODULATES] = float(house.machine in ("heat pump", "boiler"))
    p[P_SUNLIT_J] = 1.0
    if (part := house.sunlit) is not None:
        p[P_SUNLIT_SHARE], p[P_SUNLIT_J] = part.share, part.capacity_J_K
        p[P_SUNLIT_AIR], p[P_SUNLIT_SURFACE], p[P_SUNLIT_MASS] = part.air_W_K, part.surface_W_K, part.mass_W_K
        # What is lost through the part is lost by no other way.
        p[P_SUNLIT_OUT], p[P_WINDOWS] = part.out_W_K, house.windows_W_K - part.through_W_K
    return p


@njit(cache=True)
def machine(p: np.ndarray, level: float, T_out_C: float, water_C: float) -> tuple[float, float, float]:
    """Return heat W, billed power W and supply over return K at `level` in [0, 1].

    Below its lowest level, and near the limit of the water temperature, the machine cycles; heat and power are then
    means in proportion to its on-time.
    """
    if level <= 0.0:
        return 0.0, 0.0, 0.0
    throttle = min(max((p[P_LIMIT] - water_C) / _THROTTLE_K, 0.0), 1.0)
    lowest = max(p[P_LOWEST], 1e-6)
    on = min(level / lowest, 1.0) * throttle
    running = max(level, lowest)
    capacity = p[P_CAPACITY] * min(max(1.0 + p[P_CAPACITY_K] * (T_out_C - p[P_DESIGN_C]), 0.5), 1.6)
    heat = running * capacity
    spread = p[P_SPREAD] * running
    if p[P_MACHINE] == _HEAT_PUMP:
        power = p[P_FIXED] + heat / _cop(p[P_CARNOT], T_out_C, water_C + 0.5 * spread)
    elif p[P_MACHINE] == _BOILER:
        colder = max(_DEW_POINT_C - (water_C - 0.5 * spread), 0.0)
        power = heat / (p[P_EFFICIENCY] + _CONDENSING_PER_K * min(colder, 25.0))
    else:
        power = heat
    return on * heat, on * power, on * spread


@njit(cache=True)
def native_level(p: np.ndarray, state: np.ndarray, measured_C: float, setpoint_C: float, dt: float) -> float:
    """Return the level of the house's own control and update its state: PI, or on/off with a dead band of ±0.3 K."""
    error = setpoint_C - measured_C
    if p[P_MODULATES] > 0.5:
        wanted = _GAIN_1_K * error + state[INTEGRAL]
        level = min(max(wanted, 0.0), 1.0)
        if level == wanted or (wanted > 1.0) != (error > 0.0):  # integrate unless that saturates further
            state[INTEGRAL] += _GAIN_1_K * error * dt / p[P_TI]
        return level
    if error > _DEAD_BAND_K:
        state[ON] = 1.0
    elif error < -_DEAD_BAND_K:
        state[ON] = 0.0
    return state[ON]


@njit(cache=True)
def measured_C(p: np.ndarray, sensor_C: float, noise: float) -> float:
    """Return the reading of a sensor at `sensor_C`, °C; `noise` of unit variance."""
    reading = sensor_C + p[P_NOISE] * noise
    step = p[P_RESOLUTION]
    return math.floor(reading / step + 0.5) * step if step > 0.0 else reading


@njit(cache=True)
def stored_J(p: np.ndarray, state: np.ndarray) -> float:
    """Return the heat stored in all nodes above 0 °C, J."""
    return (
        p[P_AIR_J] * state[AIR]
        + p[P_SURFACE_J] * state[SURFACE]
        + p[P_MASS_J] * state[MASS]
        + p[P_SLAB_J] * state[SLAB]
        + p[P_WATER_J] * state[WATER]
        + p[P_SUNLIT_J] * state[SUNLIT]
    )


@njit(cache=True, nogil=True)
def advance(
    state: np.ndarray,
    time_s: float,
    n_steps: int,
    dt: float,
    forced: float,
    grid: np.ndarray,
    noise: np.ndarray,
    p: np.ndarray,
    record: np.ndarray,
) -> None:
    """Advance `state` (9,) in place by `n_steps` of `dt` s and fill `record` (n_steps, 12).

    `forced`: level in [0, 1], NaN: native control. `grid`: weather and schedules of a year every 15 min, (35041, 7).
    `noise`: standard normal noise of the sensor, one value per 30 s of the year. `p`: see `parameters`.
    """
    w = np.empty(GAINS)
    a, b = np.empty((6, 6)), np.empty(6)
    for k in range(n_steps):
        now = time_s + k * dt
        held = grid[drawn_houses.read(grid, now, w)]
        reading = measured_C(p, state[SENSOR], noise[int(now / drawn_houses.STEP_S + 1e-6) % noise.size])
        native = native_level(p, state, reading, held[SETPOINT], dt)
        level = native if math.isnan(forced) else forced
        heat, power, spread = machine(p, level, w[T_OUT], state[WATER])
        # Weather at the end of the step, schedules of its start.
        gains = held[GAINS]
        drawn_houses.read(grid, now + dt, w)

        room = p[P_CONVECTIVE] * state[AIR] + (1.0 - p[P_CONVECTIVE]) * state[SURFACE]
        excess = max(abs(state[WATER] - room), 0.01)
        emission = p[P_STRENGTH] * excess ** (p[P_EXPONENT] - 1.0)
        to_slab = emission if p[P_FLOOR] > 0.5 else 0.0
        to_air = 0.0 if p[P_FLOOR] > 0.5 else emission * p[P_CONVECTIVE]
        to_surface = 0.0 if p[P_FLOOR] > 0.5 else emission * (1.0 - p[P_CONVECTIVE])
        T_out, ventilation = w[T_OUT], w[VENTILATION]
        # Half of the internal gains to the air, the rest and the sun to structure and surfaces (EN ISO 13790, C.2),
        # less what a part in the sun takes first.
        sunlit = p[P_SUNLIT_SHARE] * w[SUN_IN]
        radiant = 0.5 * gains + w[SUN_IN] - sunlit
        a[:] = 0.0
        a[0, 0] = p[P_AIR_J] / dt + ventilation + p[P_IS] + p[P_SUNLIT_AIR] + to_air
        a[0, 1], a[0, 4], a[0, 5] = -p[P_IS], -to_air, -p[P_SUNLIT_AIR]
        b[0] = p[P_AIR_J] / dt * state[AIR] + ventilation * T_out + 0.5 * gains
        a[1, 1] = p[P_SURFACE_J] / dt + p[P_IS] + p[P_WINDOWS] + p[P_MS] + p[P_SLAB_ROOM] + p[P_SUNLIT_SURFACE]
        a[1, 1] += to_surface
        a[1, 0], a[1, 2], a[1, 3], a[1, 4] = -p[P_IS], -p[P_MS], -p[P_SLAB_ROOM], -to_surface
        a[1, 5] = -p[P_SUNLIT_SURFACE]
        b[1] = p[P_SURFACE_J] / dt * state[SURFACE] + p[P_WINDOWS] * T_out + (1.0 - p[P_MASS_SHARE]) * radiant
        a[2, 2] = p[P_MASS_J] / dt + p[P_MS] + p[P_EM] + p[P_SUNLIT_MASS]
        a[2, 1], a[2, 5] = -p[P_MS], -p[P_SUNLIT_MASS]
        b[2] = p[P_MASS_J] / dt * state[MASS] + p[P_EM] * T_out + p[P_MASS_SHARE] * radiant
        a[3, 3] = p[P_SLAB_J] / dt + p[P_SLAB_ROOM] + p[P_SLAB_GROUND] + to_slab
        a[3, 1], a[3, 4] = -p[P_SLAB_ROOM], -to_slab
        b[3] = p[P_SLAB_J] / dt * state[SLAB] + p[P_SLAB_GROUND] * p[P_GROUND_C]
        a[4, 4] = p[P_WATER_J] / dt + to_air + to_surface + to_slab
        a[4, 0], a[4, 1], a[4, 3] = -to_air, -to_surface, -to_slab
        b[4] = p[P_WATER_J] / dt * state[WATER] + heat
        a[5, 5] = p[P_SUNLIT_J] / dt + p[P_SUNLIT_AIR] + p[P_SUNLIT_SURFACE] + p[P_SUNLIT_MASS] + p[P_SUNLIT_OUT]
        a[5, 0], a[5, 1], a[5, 2] = -p[P_SUNLIT_AIR], -p[P_SUNLIT_SURFACE], -p[P_SUNLIT_MASS]
        b[5] = p[P_SUNLIT_J] / dt * state[SUNLIT] + p[P_SUNLIT_OUT] * T_out + sunlit
        drawn_houses.solve(a, b)
        for i in range(6):
            state[i] = b[i]

        operative = drawn_houses.AIR_SHARE * state[AIR] + (1.0 - drawn_houses.AIR_SHARE) * state[SURFACE]
        felt = operative + p[P_BIAS] * w[SUN_ON_SENSOR]
        lag = p[P_LAG]
        state[SENSOR] = felt + (state[SENSOR] - felt) * math.exp(-dt / lag) if lag > 0.0 else felt
        reading = measured_C(p, state[SENSOR], noise[int((now + dt) / drawn_houses.STEP_S + 1e-6) % noise.size])
        row = record[k]
        row[0], row[1] = operative + ZERO_C_K, reading + ZERO_C_K
        row[2], row[3] = power, heat
        row[4], row[11] = state[WATER] - 0.5 * spread + ZERO_C_K, state[WATER] + 0.5 * spread + ZERO_C_K
        row[5], row[6], row[7] = level, T_out + ZERO_C_K, w[GLOBAL]
        row[8] = (
            ventilation * (state[AIR] - T_out)
            + p[P_WINDOWS] * (state[SURFACE] - T_out)
            + p[P_EM] * (state[MASS] - T_out)
            + p[P_SLAB_GROUND] * (state[SLAB] - p[P_GROUND_C])
            + p[P_SUNLIT_OUT] * (state[SUNLIT] - T_out)
        )
        row[9] = gains + w[SUN_IN]
        row[10] = stored_J(p, state)
