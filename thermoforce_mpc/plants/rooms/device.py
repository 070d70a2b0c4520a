"""A heat pump behind its own controller: heating curve and hysteresis, minimum times, defrosting, hot water, SG-Ready.

The machine keeps the water of a small buffer, from which the rooms' circuits take their heat, at what the heating curve
asks for: it starts below it and stops above it by the hysteresis, each for a minimum time, and modulates between. In
the cold it defrosts from the buffer. A tank of hot water, one node, comes before the rooms: while it is charged the
rooms get what the buffer still has. SG-Ready blocks the machine, or raises curve and tank.

Sizes: buffer 12 l per kW, hysteresis 2 K and 10 min at least on or off as manufacturers give them; a defrosting of
5 min after 50 to 90 min below 6 °C (Vocale et al. 2014: 5 to 10 % of the energy in humid cold); tank 60 l a person and
75 l, at 46 to 52 °C, less 6 K where it is charged again, 1.4 W/K lost (EN 15450, EN 12897); 1.6 kWh of hot water a
person and day (40 l at 45 °C), at habitual times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, steps_in
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.drawn_houses import WATER_J_KG_K, year
from thermoforce_mpc.plants.rooms.house import DrawnHouse

# State of a device: whether it runs, and since when, s; time since it defrosted and left of a defrosting, s;
# temperatures of buffer and tank, °C; whether the tank is charged.
RUNS, HELD, FROST, DEFROSTS, BUFFER, TANK, CHARGES = range(7)
N_STATES = 7
# Parameters of a device; times in s, heat capacities in J/K, `RAISE` and `TANK_RAISE` by SG-Ready, K.
(
    HYSTERESIS, MIN_ON, MIN_OFF, BUFFER_J_K, FROST_AFTER, DEFROST_FOR, TANK_J_K, TANK_TARGET, TANK_BAND, TANK_LOSS,
    TANK_OVER, RAISE, TANK_RAISE, STANDBY,
) = range(14)  # fmt: skip
BLOCKED, NORMAL, RECOMMENDED, ORDERED = 1, 2, 3, 4
# Below it the outdoor coil freezes, °C; share of the capacity that defrosting takes from the water, and its power.
_FREEZES_C, _DEFROST_HEAT, DEFROST_POWER = 6.0, 0.4, 0.12
# Time in which the machine brings its water to the curve, s, and a room in which the tank stands, °C.
_MODULATES_S, _CELLAR_C = 600.0, 18.0
_PERSON_DAY_J = 1.63 * 3.6e6
# When hot water is used, h, how long, h, and how much of a day's.
_USES = ((7.0, 0.75, 0.40), (12.5, 0.25, 0.10), (18.5, 0.5, 0.15), (21.0, 1.0, 0.35))


@dataclass(frozen=True, eq=False)
class Device:
    """A heat pump's own controller: `parameters` (14,), and what hot water takes every 15 min of a year, W (35041,)."""

    parameters: Array
    draw_W: Array

    @property
    def tank_C(self) -> float:
        """Target of the tank, °C."""
        return float(self.parameters[TANK_TARGET])

    def told(self, target_C: float | None, charges: bool) -> Array:
        """Its parameters with another target of the tank, °C, and without its band where it is to be charged now."""
        if target_C is None and not charges:
            return self.parameters
        parameters = self.parameters.copy()
        if target_C is not None:
            parameters[TANK_TARGET] = target_C
        if charges:
            parameters[TANK_BAND] = 0.0
        return parameters

    def begin(self) -> Array:
        """The state at the begin: it stands, and may start."""
        state = np.zeros(N_STATES)
        state[HELD], state[BUFFER], state[TANK] = DAY_S, 30.0, self.parameters[TANK_TARGET]
        return state


def draw_device(house: DrawnHouse) -> Device:
    """Draw the device of a house, and its people's hot water; the same house has the same one."""
    rng = np.random.default_rng([house.seed, len(house.rooms), 7])
    parameters = np.zeros(14)
    parameters[HYSTERESIS] = rng.uniform(1.5, 2.5)
    parameters[MIN_ON], parameters[MIN_OFF] = 600.0, 600.0
    parameters[BUFFER_J_K] = 12.0 * house.heat_pump.capacity_W / 1000.0 * WATER_J_KG_K
    parameters[FROST_AFTER], parameters[DEFROST_FOR] = rng.uniform(3000.0, 5400.0), 300.0
    parameters[TANK_J_K] = (75.0 + 60.0 * house.people) * WATER_J_KG_K
    parameters[TANK_TARGET], parameters[TANK_BAND] = rng.uniform(46.0, 52.0), 6.0
    parameters[TANK_LOSS], parameters[TANK_OVER] = 1.4, 6.0
    parameters[RAISE], parameters[TANK_RAISE], parameters[STANDBY] = rng.uniform(2.5, 4.0), 5.0, 12.0
    return Device(parameters, _draw_off_W(house, rng))


def _draw_off_W(house: DrawnHouse, rng: np.random.Generator) -> Array:
    """Heat that hot water takes, W, every 15 min of a year: by habit, earlier or later by chance."""
    time_s = year()
    out, of_day = np.zeros(time_s.size), round(DAY_S / (time_s[1] - time_s[0]))
    shift = rng.normal(0.0, 0.5, len(_USES))
    for day in range(time_s.size // of_day):
        for (hour, hours, share), usual in zip(_USES, shift, strict=True):
            begin = hour + usual + rng.normal(0.0, 0.25)
            first = day * of_day + max(round(begin * HOUR_S / (time_s[1] - time_s[0])), 0)
            n = steps_in(hours * HOUR_S, time_s[1] - time_s[0])
            J = house.people * _PERSON_DAY_J * share * rng.gamma(8.0, 1.0 / 8.0)
            out[first : first + n] += J / (n * (time_s[1] - time_s[0]))
    return out


@njit(cache=True)
def switched(state: np.ndarray, device: np.ndarray, wanted_C: float, is_open: bool, contact: float, dt: float) -> None:
    """Switch the machine of `state` (7,) in place for the next `dt` s, with water of `wanted_C` asked for, if any."""
    raised = device[TANK_RAISE] if contact >= RECOMMENDED else 0.0
    target = device[TANK_TARGET] + raised
    if state[TANK] < target - device[TANK_BAND]:
        state[CHARGES] = 1.0
    elif state[TANK] >= target:
        state[CHARGES] = 0.0
    is_blocked = contact == BLOCKED
    state[HELD] += dt
    if state[RUNS] > 0.0:
        warm = not is_open or state[BUFFER] > wanted_C + device[HYSTERESIS]
        done = state[CHARGES] == 0.0 and warm and state[HELD] >= device[MIN_ON]
        if is_blocked or done:
            state[RUNS], state[HELD], state[DEFROSTS] = 0.0, 0.0, 0.0
    else:
        cold = state[CHARGES] > 0.0 or (is_open and state[BUFFER] < wanted_C - device[HYSTERESIS])
        if cold and not is_blocked and state[HELD] >= device[MIN_OFF]:
            state[RUNS], state[HELD] = 1.0, 0.0


@njit(cache=True)
def heat_of_device(
    state: np.ndarray, device: np.ndarray, taken_W: float, wanted_C: float, least_W: float, most_W: float,
    T_out_C: float, draw_W: float, dt: float,
) -> tuple[float, float]:  # fmt: skip
    """Advance buffer and tank of `state` by `dt` s; the heat of the machine, W, and 1 while it defrosts, 0 otherwise.

    The heat goes to the tank while that is charged. `taken_W`: by the circuits; `least_W`, `most_W`: of the machine.
    """
    heat, defrosts = 0.0, 0.0
    to_tank = state[RUNS] > 0.0 and state[CHARGES] > 0.0
    if state[RUNS] > 0.0:
        if state[DEFROSTS] > 0.0:
            state[DEFROSTS] -= dt
            heat, defrosts = -_DEFROST_HEAT * most_W, 1.0
        else:
            lacking = device[BUFFER_J_K] * (wanted_C - state[BUFFER]) / _MODULATES_S
            heat = most_W if to_tank else min(max(taken_W + lacking, least_W), most_W)
            if T_out_C < _FREEZES_C:
                state[FROST] += dt
                if state[FROST] >= device[FROST_AFTER]:
                    state[FROST], state[DEFROSTS] = 0.0, device[DEFROST_FOR]
    into_buffer = heat if not to_tank or defrosts > 0.0 else 0.0
    state[BUFFER] += (into_buffer - taken_W) * dt / device[BUFFER_J_K]
    into_tank = heat - into_buffer
    lost = draw_W + device[TANK_LOSS] * (state[TANK] - _CELLAR_C)
    state[TANK] += (into_tank - lost) * dt / device[TANK_J_K]
    return heat, defrosts
