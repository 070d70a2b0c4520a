"""Arrays that a house of rooms takes out of the door: zones, actuators or machines first, time last."""

from __future__ import annotations

from dataclasses import dataclass

from thermoforce_mpc.data import Array


@dataclass(frozen=True)
class HouseForecast:
    """Boundary conditions at N + 1 instants, the first being *now*; Z rooms, one machine.

    `time_s` (N + 1,) s; `T_out_C` °C and `solar_W_m2` global horizontal (N + 1,); `occupancy` expected persons,
    `lower_C` and `upper_C` comfort bounds °C (Z, N + 1); `price_per_kWh` EUR/kWh and `emission_kg_per_kWh` (1, N + 1).
    """

    time_s: Array
    T_out_C: Array
    solar_W_m2: Array
    occupancy: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    emission_kg_per_kWh: Array


@dataclass(frozen=True)
class HouseRecord:
    """What was measured over n past equal steps, the last instant being *now*; Z rooms, A valves, one machine.

    Sampled: `time_s`, `T_out_C`, `solar_W_m2` (n + 1,), `T_zone_C` operative temperatures (Z, n + 1). Means over each
    step: `u` levels and `heat_W` heat delivered to the circuits (A, n), `power_W` electric (1, n). `zones`, `actuators`
    and `machines` name the rows.
    """

    zones: tuple[str, ...]
    actuators: tuple[str, ...]
    machines: tuple[str, ...]
    time_s: Array
    T_zone_C: Array
    T_out_C: Array
    solar_W_m2: Array
    u: Array
    heat_W: Array
    power_W: Array


@dataclass(frozen=True)
class HouseMeasurement:
    """State at `time_s` and means over the step that led there: Z rooms, A valves, one machine.

    `T_zone_C` (Z,) °C, `T_out_C` °C, `solar_W_m2`; means `u` (A,), `heat_W` (A,), `power_W` (1,) and `T_supply_C` (1,),
    NaN before the first step.
    """

    time_s: float
    T_zone_C: Array
    T_out_C: float
    solar_W_m2: float
    u: Array
    heat_W: Array
    power_W: Array
    T_supply_C: Array
