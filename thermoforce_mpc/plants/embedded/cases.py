"""The test cases that ship as embedded plants: house, system and schedule, points and prices of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.periods import BOTH_NAMES, NAMES
from thermoforce_mpc.boundary.tariffs import Tariff
from thermoforce_mpc.boundary.weather import CONTINENTAL, MARITIME, SyntheticClimate
from thermoforce_mpc.data import ZERO_C_K, Array
from thermoforce_mpc.plants.embedded import boiler, fan_coil, kernel
from thermoforce_mpc.plants.embedded.houses import BOILER_HOUSE, HEAT_PUMP_HOUSE, OFFICE, BestestHouse
from thermoforce_mpc.plants.embedded.schedule import BOILER_USE, HEAT_PUMP_USE, OFFICE_USE, OccupancySchedule

ELECTRICITY, GAS = "ElectricPower", "GasPower"
_SETPOINT_K = (278.15, 308.15)


@dataclass(frozen=True)
class Carrier:
    """An energy carrier: columns of the record that it powers, and its emissions, kg CO2/kWh.

    `price_per_kWh`: where all three tariffs have the same; None: that of the tariff.
    """

    columns: tuple[str, ...]
    emission_kg_per_kWh: float
    price_per_kWh: float | None = None


@dataclass(frozen=True)
class EmulatedCase:
    """A test case of BOPTEST as an embedded plant.

    Attributes:
        name: that of the test case.
        description: one line of what it is.
        house: building and what weather meets there.
        system: its compiled step: `RECORD`, `N_SCALARS`, `start`, `advance`.
        schedule: who is there, and when.
        overwrites: inputs in the order of the step: (name, lowest, highest), in units of BOPTEST's interface.
        applied: columns of the record with the value in force, in the same order.
        measurements: column of the record of each measurement.
        zone: column of the temperature that comfort is judged by.
        carriers: what it consumes, by BOPTEST's name of the carrier; the first is the one that tariffs are of.
        heating, cooling: columns whose sum is the power that names the peak days, see `boundary.periods`.
        periods: names of its windows.
        site: latitude and longitude, degrees, of its own weather.
        climate: of its synthetic weather.
        prices: its tariffs by name, with a highly dynamic one of one's own or None.
    """

    name: str
    description: str
    house: BestestHouse
    system: ModuleType
    schedule: OccupancySchedule
    overwrites: tuple[tuple[str, float, float], ...]
    applied: tuple[str, ...]
    measurements: Mapping[str, str]
    zone: str
    carriers: Mapping[str, Carrier]
    heating: str
    cooling: str | None
    periods: tuple[str, ...]
    site: tuple[float, float]
    climate: SyntheticClimate
    prices: Callable[[Tariff | None], dict[str, Tariff]]

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each overwrite input."""
        return {name: (low, high) for name, low, high in self.overwrites}

    def scheduled(self, prices: Mapping[str, Tariff]) -> dict[str, Callable[[Array], Array]]:
        """Forecast points that depend on the time alone, by BOPTEST's name, as functions of times (n,), s."""
        use = self.schedule
        known: dict[str, Callable[[Array], Array]] = {
            "Occupancy[1]": use.occupants,
            "InternalGainsRad[1]": lambda t: use.gains_W(t)[0],
            "InternalGainsCon[1]": lambda t: use.gains_W(t)[1],
            "InternalGainsLat[1]": lambda t: use.gains_W(t)[2],
            "LowerSetp[1]": lambda t: use.bounds_C(t)[0] + ZERO_C_K,
            "UpperSetp[1]": lambda t: use.bounds_C(t)[1] + ZERO_C_K,
            "UpperCO2[1]": use.co2_limit_ppm,
            "PriceElectricPowerConstant": prices["constant"],
            "PriceElectricPowerDynamic": prices["dynamic"],
            "PriceElectricPowerHighlyDynamic": prices["highly_dynamic"],
        }
        for name, carrier in self.carriers.items():
            known[f"Emissions{name}"] = _held(carrier.emission_kg_per_kWh)
            if carrier.price_per_kWh is not None:
                known[f"Price{name}"] = _held(carrier.price_per_kWh)
        return known


def _held(value: float) -> Callable[[Array], Array]:
    return lambda time_s: np.full(np.shape(time_s), value)


def _denver(highly_dynamic: Tariff | None) -> dict[str, Tariff]:
    return {
        "constant": _held(0.05461),
        "dynamic": tariffs.denver_dynamic,
        "highly_dynamic": highly_dynamic or tariffs.synthetic_denver_spot(),
    }


_GAS_KG_PER_KWH = 0.18108

HEAT_PUMP = EmulatedCase(
    name="bestest_hydronic_heat_pump",
    description="emulator of the BOPTEST test case, written from its documented physics",
    house=HEAT_PUMP_HOUSE,
    system=kernel,
    schedule=HEAT_PUMP_USE,
    overwrites=(("oveHeaPumY", 0.0, 1.0), ("oveTSet", *_SETPOINT_K), ("ovePum", 0.0, 1.0), ("oveFan", 0.0, 1.0)),
    applied=("level", "T_setpoint", "pump", "fan"),
    measurements={
        "reaTZon_y": "T_operative",
        "reaPHeaPum_y": "P_heat_pump",
        "reaPFan_y": "P_fan",
        "reaPPumEmi_y": "P_pump",
        "reaQHeaPumCon_y": "Q_condenser",
        "reaQFloHea_y": "Q_floor",
        "reaTSup_y": "T_supply",
        "reaTRet_y": "T_return",
        "reaCOP_y": "COP",
        "reaCO2RooAir_y": "CO2",
        "weaSta_reaWeaTDryBul_y": "T_out",
        "weaSta_reaWeaHGloHor_y": "solar",
    },
    zone="T_operative",
    carriers={ELECTRICITY: Carrier(("P_heat_pump", "P_fan", "P_pump"), tariffs.EMISSION_KG_PER_KWH)},
    heating="P_heat_pump",
    cooling=None,
    periods=NAMES,
    site=(50.90, 4.53),
    climate=MARITIME,
    prices=tariffs.by_name,
)

BOILER = EmulatedCase(
    name="bestest_hydronic",
    description="emulator of the BOPTEST test case, written from its documented physics",
    house=BOILER_HOUSE,
    system=boiler,
    schedule=BOILER_USE,
    overwrites=(
        ("oveTSetHea", *_SETPOINT_K),
        ("oveTSetCoo", *_SETPOINT_K),
        ("oveTSetSup", 293.15, 353.15),
        ("ovePum", 0.0, 1.0),
    ),
    applied=("T_heating", "T_cooling", "T_supply", "pump"),
    measurements={
        "reaTRoo_y": "T_operative",
        "reaQHea_y": "P_gas",
        "reaPPum_y": "P_pump",
        "reaCO2RooAir_y": "CO2",
        "weaSta_reaWeaTDryBul_y": "T_out",
        "weaSta_reaWeaHGloHor_y": "solar",
    },
    zone="T_operative",
    carriers={
        ELECTRICITY: Carrier(("P_pump",), tariffs.EMISSION_KG_PER_KWH),
        GAS: Carrier(("P_gas",), _GAS_KG_PER_KWH, 0.0498),
    },
    heating="P_gas",
    cooling=None,
    periods=NAMES,
    site=(50.90, 4.53),
    climate=MARITIME,
    prices=tariffs.by_name,
)

FAN_COIL = EmulatedCase(
    name="bestest_air",
    description="emulator of the BOPTEST test case, written from its documented physics",
    house=OFFICE,
    system=fan_coil,
    schedule=OFFICE_USE,
    overwrites=(
        ("con_oveTSetHea", *_SETPOINT_K),
        ("con_oveTSetCoo", *_SETPOINT_K),
        ("fcu_oveTSup", 285.15, 313.15),
        ("fcu_oveFan", 0.0, 1.0),
    ),
    applied=("T_heating", "T_cooling", "T_supply", "fan"),
    measurements={
        "zon_reaTRooAir_y": "T_air",
        "fcu_reaPHea_y": "P_gas",
        "fcu_reaPCoo_y": "P_chiller",
        "fcu_reaPFan_y": "P_fan",
        "fcu_reaFloSup_y": "flow",
        "zon_reaCO2RooAir_y": "CO2",
        "zon_reaPLig_y": "P_lights",
        "zon_reaPPlu_y": "P_plugs",
        "zon_weaSta_reaWeaTDryBul_y": "T_out",
        "zon_weaSta_reaWeaHGloHor_y": "solar",
    },
    zone="T_air",
    carriers={
        ELECTRICITY: Carrier(("P_chiller", "P_fan"), 0.6618),
        GAS: Carrier(("P_gas",), _GAS_KG_PER_KWH, 0.002878),
    },
    heating="P_gas",
    cooling="P_chiller",
    periods=BOTH_NAMES,
    site=(39.76, -104.86),
    climate=CONTINENTAL,
    prices=_denver,
)

CASES = {case.name: case for case in (HEAT_PUMP, BOILER, FAN_COIL)}
