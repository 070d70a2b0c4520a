"""KPIs of an FMU's record: the FMU names the signals, `thermoforce_mpc.plants.kpis` computes the KPIs."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.fmu.archive import FmuArchive
from thermoforce_mpc.plants.kpis import PEAKS, EnergySupply, Violation, building_kpis, excess
from thermoforce_mpc.scenario.testcase import ForecastPoints, Price, TestCase

_ELECTRIC = "ElectricPower"
# BOPTEST's energy carriers. Fresh water is omitted: it has a cost but no energy, and no test case meters it.
_CARRIERS = (_ELECTRIC, "DistrictHeatingPower", "GasPower", "BiomassPower", "SolarThermalPower")
_THERMAL, _AIR_QUALITY = ("AirZoneTemperature", "OperativeZoneTemperature"), ("CO2Concentration",)


class KpiOutputs:
    """Outputs that make up each KPI, from the FMU's kpis.json or else from the test case file."""

    def __init__(self, archive: FmuArchive, testcase: TestCase) -> None:
        """Collect signals and series; raises `ConfigError` where one is missing or the floor areas differ."""
        self._boundary = archive.boundary
        self._area_m2 = testcase.area_m2
        if archive.area_m2 is not None and abs(archive.area_m2 - testcase.area_m2) > 0.01 * archive.area_m2:
            raise ConfigError(
                f"test case '{testcase.name}' has {testcase.area_m2:g} m2 of floor, "
                f"the FMU {archive.path} has {archive.area_m2:g} m2: this is another building"
            )
        self._prices, self._emissions = testcase.forecast.price, testcase.forecast.emission
        if archive.kpi_signals:  # BOPTEST bills each carrier at its own price, whichever the controller uses
            names = ForecastPoints()
            self._prices, self._emissions = names.price, names.emission
        listed = archive.kpi_signals
        if not listed:  # `metered` refuses several zones, whose bounds it would not name
            m = testcase.metered
            listed = {f"{_THERMAL[1]}[1]": (m.zone_temperature,), _ELECTRIC: m.electric_power}
        self._carriers = {name: signals for name, signals in listed.items() if name in _CARRIERS}
        self._thermal = _zones(listed, _THERMAL)
        self._air_quality = _zones(listed, _AIR_QUALITY)
        self.signals = tuple(
            signal
            for part in (self._carriers, self._thermal, self._air_quality)
            for group in part.values()
            for signal in group
        )
        missing = sorted(set(self.signals) - set(archive.outputs))
        if missing:
            raise ConfigError(
                f"{archive.path}: kpis.json names outputs that the FMU does not have: {', '.join(missing)}"
            )
        series = [f"UpperCO2[{zone}]" for zone in self._air_quality]
        series += [f"{end}Setp[{zone}]" for zone in self._thermal for end in ("Lower", "Upper")]
        series += [
            name for carrier in self._carriers for name in (self._emission(carrier), self._price(carrier, "constant"))
        ]
        self._boundary.require(series, "the KPIs")

    def kpis(self, record: Mapping[str, Array], start_s: float, price: Price) -> dict[str, float]:
        """Return the KPIs of the samples of `record` ('time' and outputs, (n,)) from `start_s`."""
        at = self._boundary.at
        scored = record["time"] >= start_s - 1e-6
        time_s = record["time"][scored]
        if time_s.size < 2:  # no step simulated yet: BOPTEST returns zeros
            names = ["ener_tot", "cost_tot", "emis_tot", *(PEAKS[name] for name in self._carriers if name in PEAKS)]
            names += ["tdis_tot"] * bool(self._thermal) + ["idis_tot"] * bool(self._air_quality)
            return dict.fromkeys(names, 0.0)
        supplies = [
            EnergySupply(
                carrier,
                np.sum([record[signal][scored] for signal in signals], axis=0),
                at(self._price(carrier, price), time_s),
                at(self._emission(carrier), time_s),
            )
            for carrier, signals in self._carriers.items()
        ]
        thermal = [
            Violation(
                zone, excess(record[signal][scored], at(f"LowerSetp[{zone}]", time_s), at(f"UpperSetp[{zone}]", time_s))
            )
            for zone, signals in self._thermal.items()
            for signal in signals
        ]
        air_quality = [
            Violation(zone, np.maximum(record[signal][scored] - at(f"UpperCO2[{zone}]", time_s), 0.0))
            for zone, signals in self._air_quality.items()
            for signal in signals
        ]
        return building_kpis(time_s, supplies=supplies, thermal=thermal, air_quality=air_quality, area_m2=self._area_m2)

    def _price(self, carrier: str, price: Price) -> str:
        return self._prices[price] if carrier == _ELECTRIC else f"Price{carrier}"

    def _emission(self, carrier: str) -> str:
        return self._emissions if carrier == _ELECTRIC else f"Emissions{carrier}"


def _zones(listed: Mapping[str, tuple[str, ...]], categories: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return signals by zone for the given categories, listed as 'Category[zone]'."""
    by_name: dict[str, tuple[str, ...]] = {}
    for name, signals in listed.items():
        match = re.fullmatch(r"(\w+)\[(\w+)\]", name)
        if match and match[1] in categories:
            by_name[match[2]] = by_name.get(match[2], ()) + signals
    return by_name
