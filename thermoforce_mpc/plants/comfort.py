"""Comfort bounds of a scenario in the place of a plant's own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from thermoforce_mpc.data import HOUR_S, Boundary, Measurement
from thermoforce_mpc.plants.kpis import excess
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.testcase import TestCase

# Distance of the readings from which discomfort is integrated, s.
_SAMPLE_S = 60.0


class WithComfort:
    """A `Plant` with the comfort bounds of a schedule in forecasts and KPIs; all else is that of the plant inside.

    Discomfort is integrated over readings a minute apart, by the trapezoidal rule: where a plant's own discomfort is
    that of true temperatures, this one has the error of its sensors.
    """

    def __init__(self, plant: Plant, comfort: Comfort, testcase: TestCase) -> None:
        """Wrap `plant`; raises `ConfigError` for a zone that the test case does not have."""
        self._plant, self._comfort, self._zones = plant, comfort, testcase.layout.names.zones
        # The engine's year begins on a Monday, BOPTEST's and that of drawn houses on a Tuesday.
        self._first = "monday" if testcase.energyplus or testcase.plant == "small_office" else "tuesday"
        self._start_s = 0.0
        self._comfort.bounds_C(np.zeros(1), self._zones, self._first)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        self._start_s = float(start_s)
        return self._plant.reset(start_s, warmup_s, price)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        ahead = self._plant.forecast(horizon_s, interval_s)
        lower, upper = self._comfort.bounds_C(ahead.time_s, self._zones, self._first)
        return replace(ahead, lower_C=lower, upper_C=upper)

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`; discomfort in K·h also zone by zone."""
        return dict(self._plant.kpis()) | self._discomfort()

    def _discomfort(self) -> dict[str, float]:
        record = self._plant.past(_SAMPLE_S)
        scored = record.time_s >= self._start_s
        time_s, T_zone = record.time_s[scored], record.T_zone_C[:, scored]
        outside = excess(T_zone, *self._comfort.bounds_C(time_s, self._zones, self._first))
        of_zones = np.atleast_1d(np.trapezoid(np.nan_to_num(outside), time_s / HOUR_S, axis=1))
        named = {f"tdis_tot[{zone}]": float(Kh) for zone, Kh in zip(self._zones, of_zones, strict=True)}
        return {"tdis_tot": float(of_zones.mean()), **(named if len(self._zones) > 1 else {})}
