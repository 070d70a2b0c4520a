"""What the small office reports: arrays per zone (Z), actuator (A) and machine (M), time as the last axis."""

from __future__ import annotations

from dataclasses import dataclass

from thermoforce_mpc.data import Array


@dataclass(frozen=True)
class OfficeBoundary:
    """Boundary conditions at N + 1 equally spaced instants, the first being now.

    (N + 1,): `time_s`, `T_out_C`, `solar_W_m2` global horizontal. (Z, N + 1): `occupancy` persons, comfort bounds
    `lower_C` and `upper_C`. (M, N + 1): `price_per_kWh` and `emission_kg_per_kWh` of each machine's carrier.
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
class OfficeRecord:
    """Record of n past steps.

    Samples at their n + 1 ends: `time_s`, `T_out_C`, `solar_W_m2` (n + 1,) and `T_zone_C` (Z, n + 1).
    Means over the steps: per actuator (A, n) the applied `setpoint_C`, the `level` in [0, 1] and `heat_W`, what burner
    or coil brings to the air, negative for cooling; per machine (M, n) `power_W`; per zone (Z, n) `fan_W`, part of the
    electric power, and `supply_W`, sensible heat that the supply air brings to the room with fan and outdoor air.
    """

    time_s: Array
    T_zone_C: Array
    T_out_C: Array
    solar_W_m2: Array
    setpoint_C: Array
    level: Array
    heat_W: Array
    power_W: Array
    supply_W: Array
    fan_W: Array


@dataclass(frozen=True)
class OfficeMeasurement:
    """Measured values at `time_s`: samples now, and means over the interval just advanced (NaN right after a reset).

    (Z,): `T_zone_C`, `supply_W`, `fan_W`. (A,): `setpoint_C`, `level`, `heat_W`. (M,): `power_W`. See `OfficeRecord`.
    """

    time_s: float
    T_zone_C: Array
    T_out_C: float
    solar_W_m2: float
    setpoint_C: Array
    level: Array
    heat_W: Array
    power_W: Array
    supply_W: Array
    fan_W: Array
