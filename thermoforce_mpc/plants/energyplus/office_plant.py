"""The small office behind the `Plant` protocol: one room thermostat per zone, with a level of either sign.

A zone's unit has a burner and a cooling coil, of which one works at a time; its level is heat over the burner's size,
negative for cooling. Gas and electricity of a unit are billed apart: while heating at the price of gas, while cooling
at that of electricity.
"""

from __future__ import annotations

import math

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import ZERO_C_K, Array, Bands, Boundary, Levels, Measurement, Period, PlantInfo, Record
from thermoforce_mpc.plants.checks import check_levels
from thermoforce_mpc.plants.energyplus.office import SmallOffice
from thermoforce_mpc.plants.energyplus.office_data import OfficeMeasurement, OfficeRecord
from thermoforce_mpc.plants.shell import Releasing
from thermoforce_mpc.plants.waiting import PATIENCE_S
from thermoforce_mpc.scenario.room_setpoints import RoomSetpoints
from thermoforce_mpc.scenario.testcase import TestCase


class SmallOfficePlant(Releasing):
    """`RoomSetpointPlant` of the DOE small office: zones, actuators and machines as in its test case, five each."""

    def __init__(
        self,
        testcase: TestCase,
        *,
        highly_dynamic: tariffs.Tariff | None = None,
        forecast_error: ForecastError | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Arguments as for `SmallOffice`; raises as it does."""
        self.testcase, self._points = testcase, testcase.points
        self._office = SmallOffice(highly_dynamic=highly_dynamic, forecast_error=forecast_error, patience_s=patience_s)
        self._full_W = self._office.capacity_W[: len(self._points.zones)]

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        return self._office.info

    def period(self, name: str) -> Period:
        """See `SmallOffice.period`."""
        return self._office.period(name)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `SmallOffice.reset`."""
        return self._measured(self._office.reset(start_s, warmup_s, price))

    def advance(self, u: Levels, duration_s: float, band_C: Bands = None) -> Measurement:
        """Let the thermostats keep the room set-points `band_C` (A,), °C, for `duration_s`, a multiple of 5 min.

        `u` (A,) tells by its sign which loop of a zone may act; None leaves the zone to the file's own thermostat.

        Raises:
            InputError: a level, a band or the duration is out of range, or the plant was not reset.
            PlantError: the engine failed.
        """
        layout = self._points.layout
        block = check_levels(u, duration_s, band_C, names=layout.names, lowest=layout.lowest)
        n = len(layout.home)
        setpoints_C = np.full(2 * n, math.nan)
        for a, (level, band, one) in enumerate(zip(block.u, block.band_C, self._points.actuators, strict=True)):
            actuator = one.actuator
            if level is None or not isinstance(actuator, RoomSetpoints):
                continue
            values = actuator.inputs(level, band)
            setpoints_C[a] = values[f"{actuator.heating}_u"] - ZERO_C_K
            setpoints_C[n + a] = values[f"{actuator.cooling}_u"] - ZERO_C_K
        return self._measured(self._office.advance(setpoints_C, block.duration_s))

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `SmallOffice.forecast`; raises as it does."""
        office = self._office.forecast(horizon_s, interval_s)
        n = len(self._points.zones)
        return Boundary(
            time_s=office.time_s,
            T_out_C=office.T_out_C,
            solar_W_m2=office.solar_W_m2,
            occupancy=office.occupancy,
            lower_C=office.lower_C,
            upper_C=office.upper_C,
            price_per_kWh=office.price_per_kWh[n:],
            emission_kg_per_kWh=office.emission_kg_per_kWh[n:],
            heating_price_per_kWh=office.price_per_kWh[:n],
            names=self._points.layout.names,
        )

    def past(self, step_s: float) -> Record:
        """See `SmallOffice.past`; raises as it does."""
        office = self._office.past(step_s)
        return Record(
            time_s=office.time_s,
            T_zone_C=office.T_zone_C,
            T_out_C=office.T_out_C,
            solar_W_m2=office.solar_W_m2,
            names=self._points.layout.names,
            **self._acting(office),
        )

    def kpis(self) -> dict[str, float]:
        """BOPTEST's KPIs of the building, its discomfort also zone by zone; see `SmallOffice.kpis`."""
        return self._office.kpis()

    def close(self) -> None:
        """End the engine's process; safe to call twice."""
        self._office.close()

    def _measured(self, office: OfficeMeasurement) -> Measurement:
        acting = self._acting(office)
        return Measurement(
            time_s=office.time_s,
            T_zone_C=office.T_zone_C,
            T_out_C=office.T_out_C,
            solar_W_m2=office.solar_W_m2,
            u=acting["u"],
            heat_W=acting["heat_W"],
            power_W=acting["power_W"],
            names=self._points.layout.names,
        )

    def _acting(self, office: OfficeRecord | OfficeMeasurement) -> dict[str, Array]:
        """Level, heat and power of each zone's unit: burner and coil together."""
        n = len(self._points.zones)
        heat_W = office.heat_W[:n] + office.heat_W[n:]
        lowest = np.array(self._points.layout.lowest)
        full_W, lowest = (values.reshape(-1, *(1,) * (heat_W.ndim - 1)) for values in (self._full_W, lowest))
        return {
            "u": np.clip(heat_W / full_W, lowest, 1.0),
            "heat_W": heat_W,
            "power_W": office.power_W[:n] + office.power_W[n:],
        }
