"""An office with a light air node, two loops on room set-points, gas heat and a chiller; for this bench and tests.

Air and structure are two nodes, sun falls on the structure and the air. The loops deliver the heat that brings the air
to its set-point within the next minute, within their limits; native control knows the bounds in force only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    Array,
    Boundary,
    Commands,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
    energy_kWh,
)
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.plants.shell import check_levels

AIR_J_K, MASS_J_K = 8.0e5, 8.0e6
AIR_MASS_W_K, AIR_OUT_W_K = 250.0, 45.0
HEATING_W, COOLING_W = 11000.0, 6600.0
GAS_PRICE, POWER_PRICE = 0.05, 0.2
DT_S = 60.0


class LightOffice:
    """Deterministic plant with room set-points; weather is a sine outdoors and a half sine of sun."""

    def __init__(self, mean_C: float = 3.0, sun_W_m2: float = 600.0, asleep_until_h: float = 0.0) -> None:
        """`mean_C` outdoors and most sun: the season; `asleep_until_h`: the unit stands from 0:00 until then, h."""
        self._mean_C, self._sun_W_m2, self._asleep_until_h = mean_C, sun_W_m2, asleep_until_h
        self.reset(0.0, 0.0)

    info = PlantInfo("test", "light office", "air node, structure, two loops", "sine", "1")

    def period(self, name: str) -> Period:
        """Two weeks from the day `name` on."""
        return Period(name, float(name) * DAY_S)

    def weather(self, time_s: Array) -> tuple[Array, Array]:
        """Outdoor temperature, °C, and irradiance, W/m², at `time_s`."""
        hour = np.mod(time_s, DAY_S) / HOUR_S
        day = np.floor_divide(time_s, DAY_S)
        cloud = 0.6 + 0.4 * np.sin(1.7 * day)
        sun_W_m2 = self._sun_W_m2 * cloud * np.maximum(np.sin(np.pi * (hour - 6) / 12), 0)
        return self._mean_C + 5.0 * np.sin(2 * np.pi * (hour - 9) / 24), sun_W_m2

    @staticmethod
    def bounds_C(time_s: Array) -> tuple[Array, Array]:
        """Lower and upper comfort bound at `time_s`, °C."""
        hour = np.mod(time_s, DAY_S) / HOUR_S
        busy = (hour >= 8) & (hour < 18)
        return np.where(busy, 21.0, 15.0), np.where(busy, 24.0, 30.0)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`."""
        self.now_s = max(start_s - warmup_s, 0.0)
        self.T, self.T_mass = 19.0, 19.0
        self.begin_s, self.rows = self.now_s, list[tuple[float, Measurement]]()
        self.kept = {"gas": 0.0, "chiller": 0.0, "discomfort": 0.0}
        while self.now_s < start_s - 1e-6:
            self.advance(None, 900.0)
        self.kept = dict.fromkeys(self.kept, 0.0)
        return self._measurement(math.nan, math.nan, math.nan)

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """See `RoomSetpointPlant.advance`."""
        block = check_levels(u, duration_s, command, u_min=-1.0)
        (level,), (told,) = block.u, block.command
        band = told if isinstance(told, tuple) else None
        heat = gas = chiller = 0.0
        n = round(duration_s / DT_S)
        for _ in range(n):
            lower, upper = (float(b) for b in self.bounds_C(np.array(self.now_s)))
            low, high = band if band is not None and level is not None else (lower, upper)
            T_out, sun = (float(w) for w in self.weather(np.array(self.now_s)))
            rest = AIR_MASS_W_K * (self.T_mass - self.T) + AIR_OUT_W_K * (T_out - self.T) + 1.0 * sun
            drifting = self.T + rest * DT_S / AIR_J_K
            wanted = (
                (low - drifting if drifting < low else high - drifting if drifting > high else 0.0) * AIR_J_K / DT_S
            )
            # The loops close half of the gap in a step, as a proportional band does.
            q = min(max(0.5 * wanted, -COOLING_W), HEATING_W)
            if self.now_s % DAY_S < self._asleep_until_h * HOUR_S:
                q = 0.0
            self.T_mass += DT_S / MASS_J_K * (AIR_MASS_W_K * (self.T - self.T_mass) + 3.0 * sun)
            self.T = drifting + q * DT_S / AIR_J_K
            self.now_s += DT_S
            heat, gas, chiller = heat + q / n, gas + max(q, 0) / 0.9 / n, chiller + max(-q, 0) / 3 / n
            self.kept["gas"] += energy_kWh(max(q, 0) / 0.9, DT_S)
            self.kept["chiller"] += energy_kWh(max(-q, 0) / 3, DT_S)
            lower, upper = (float(b) for b in self.bounds_C(np.array(self.now_s)))
            self.kept["discomfort"] += float(excess(self.T, lower, upper)) * DT_S / HOUR_S
        found = self._measurement(heat / HEATING_W, gas + chiller, heat)
        self.rows.append((duration_s, found))
        return found

    def _measurement(self, u: float, power_W: float, heat_W: float) -> Measurement:
        T_out, sun = (float(w) for w in self.weather(np.array(self.now_s)))
        values: tuple[Any, ...] = (self.T, T_out, sun, u, power_W, heat_W)
        return Measurement(self.now_s, *values)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        time_s = self.now_s + np.arange(0.0, horizon_s + 1.0, interval_s)
        T_out, sun = self.weather(time_s)
        flat = np.ones(time_s.size)
        return Boundary(time_s, T_out, sun, flat, *self.bounds_C(time_s), POWER_PRICE * flat, flat, GAS_PRICE * flat)

    def past(self, step_s: float) -> Record:
        """Only what a warm-up in whole steps of 900 s left behind."""
        values: tuple[Any, ...] = (19.0, *(float(w) for w in self.weather(np.array(self.begin_s))))
        first = Measurement(self.begin_s, *values)
        record = Record.beginning(first)
        for duration_s, found in self.rows:
            assert duration_s == step_s
            record = record.extended(found)
        return record

    def kpis(self) -> dict[str, float]:
        """See `Plant.kpis`."""
        cost = (GAS_PRICE * self.kept["gas"] + POWER_PRICE * self.kept["chiller"]) / 48.0
        return {"cost_tot": cost, "tdis_tot": self.kept["discomfort"], "ener_tot": self.kept["gas"] / 48.0}

    def close(self) -> None:
        """Nothing to release."""

    def native_kpis(self, period: Period) -> dict[str, float]:
        """KPIs of native control over `period`."""
        self.reset(period.start_s, period.warmup_s)
        for _ in range(round(period.scored_s / 900.0)):
            self.advance(None, 900.0)
        return self.kpis()

    def step_response_K(self, step_s: float) -> float:
        """Rise of the air after `step_s` at full heat, without drift, K."""
        T = T_mass = 0.0
        for _ in range(round(step_s / DT_S)):
            flow = AIR_MASS_W_K * (T_mass - T)
            T_mass -= DT_S / MASS_J_K * flow
            T += DT_S / AIR_J_K * (HEATING_W + flow - AIR_OUT_W_K * T)
        return T
