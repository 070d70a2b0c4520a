"""KPIs of one zone with electricity only: what the embedded plant counts step by step, over a whole record."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.kpis import EnergySupply, Violation, building_kpis


def compute_kpis(
    time_s: Array,
    *,
    power_W: Array,
    T_operative_C: Array,
    lower_C: Array,
    upper_C: Array,
    co2_ppm: Array,
    co2_limit_ppm: float,
    price_per_kWh: Array,
    emission_kg_per_kWh: Array,
    area_m2: float,
) -> dict[str, float]:
    """Return the KPIs of one zone with electricity only over samples at `time_s` (n,), s; all arrays have shape (n,).

    Returns:
        `ener_tot` kWh/m², `cost_tot` currency/m², `emis_tot` kg/m², `tdis_tot` K·h, `idis_tot` ppm·h, `pele_tot` kW/m².

    Raises:
        DataError: arrays differ in length or time does not increase.
    """
    arrays = (power_W, T_operative_C, lower_C, upper_C, co2_ppm, price_per_kWh, emission_kg_per_kWh)
    if any(array.shape != time_s.shape for array in arrays):
        raise DataError("KPIs: every series needs one value per time sample")
    return building_kpis(
        time_s,
        supplies=[EnergySupply("ElectricPower", power_W, price_per_kWh, emission_kg_per_kWh)],
        thermal=[Violation("1", excess(T_operative_C, lower_C, upper_C))],
        air_quality=[Violation("1", np.maximum(co2_ppm - co2_limit_ppm, 0.0))],
        area_m2=area_m2,
    )
