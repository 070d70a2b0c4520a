"""A first-order house for tests of control: T' = T + (T_out - T)·loss + gain·u, exact and fast. Not a product plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    Array,
    Boundary,
    FreeForecast,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
)
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

POLE = 0.99  # per hour: slow enough that on/off blocks inside an hour hardly show
GAIN_K = 0.4  # K per hour at u = 1
FIXED_W, PER_U_W = 1600.0, 2700.0


def outdoor_C(time_s: Array | float) -> Array:
    hour = np.asarray(time_s) / HOUR_S
    return 3.0 + 4.0 * np.cos(2 * np.pi * (hour - 15) / 24)


def bounds_C(time_s: Array) -> tuple[Array, Array]:
    hour = (np.asarray(time_s) % DAY_S) / HOUR_S
    occupied = (hour <= 7) | (hour >= 20)
    return np.where(occupied, 21.0, 15.0), np.where(occupied, 24.0, 30.0)


def native_level(T_C: float) -> float:
    """The level of native control."""
    return float(T_C < 21.2) * 0.5


def power_W(u: float) -> float:
    """Electric power at a level; of an unknown one unknown."""
    return (FIXED_W * (u > 0) + PER_U_W * u) if np.isfinite(u) else np.nan


class SimpleHouse:
    """Implements `Plant`; `fail_at_s` makes the next advance past that time raise `PlantError`."""

    def __init__(self, T_start_C: float = 21.0, fail_at_s: float = np.inf) -> None:
        self.info = PlantInfo("simple", "simple_house", "first-order house of the tests", "cosine", "0")
        self.T_start_C, self.fail_at_s = T_start_C, fail_at_s
        self.applied: list[tuple[float | None, float]] = []
        self.closed = False

    def period(self, name: str) -> Period:
        return Period(name, start_s=10 * DAY_S, scored_s=2 * DAY_S, warmup_s=2 * DAY_S)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        self.now_s, self.T, self._rows = start_s - warmup_s, self.T_start_C, []
        self._first = self.measure()
        while self.now_s < start_s - 1e-6:
            self.step(None, HOUR_S)
        self.applied.clear()
        self.start_s, self.kWh, self.Kh = start_s, 0.0, 0.0
        return self.measure()

    def measure(self, u: float = np.nan) -> Measurement:
        power = power_W(u)
        return Measurement(self.now_s, self.T, float(outdoor_C(self.now_s)), 0.0, u, power, 2.5 * power)

    def live(self, u: float | None, duration_s: float) -> float:
        """Go on at level `u`, or under native control; returns the level."""
        level = native_level(self.T) if u is None else u
        share = duration_s / HOUR_S
        pole = POLE**share
        gain = GAIN_K / (1 - POLE) * (1 - pole)
        self.T = pole * self.T + (1 - pole) * float(outdoor_C(self.now_s)) + gain * level
        self.now_s += duration_s
        return level

    def step(self, u: float | None, duration_s: float) -> Measurement:
        measurement = self.measure(self.live(u, duration_s))
        self._rows.append((duration_s, measurement))
        return measurement

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        (level,) = u if isinstance(u, tuple) else (u,)
        if self.now_s + duration_s > self.fail_at_s:
            raise PlantError("the simple house lost its connection")
        self.applied.append((level, duration_s))
        measurement = self.step(level, duration_s)
        lower, upper = bounds_C(np.array(self.now_s))
        self.kWh += float(measurement.power_W[0]) * duration_s / 3.6e6
        self.Kh += float(max(lower - self.T, self.T - upper, 0.0)) * duration_s / HOUR_S
        return measurement

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        time_s = self.now_s + np.arange(round(horizon_s / interval_s) + 1) * interval_s
        lower, upper = bounds_C(time_s)
        same = np.ones_like(time_s)
        return Boundary(time_s, outdoor_C(time_s), 0 * same, 5 * same, lower, upper, 0.25 * same, 0.167 * same)

    def past(self, step_s: float) -> Record:
        """Warm-up record at one hour; other steps know the present only."""
        m = [self._first, *(row for _, row in self._rows)]
        if step_s != HOUR_S:
            m = m[-1:]
        return Record(
            **{k: [getattr(x, k) for x in m] for k in ("time_s", "T_out_C", "solar_W_m2")},
            T_zone_C=[x.T_zone_C[0] for x in m],
            **{k: [getattr(x, k)[0] for x in m[1:]] for k in ("u", "power_W", "heat_W")},
        )

    def kpis(self) -> dict[str, float]:
        return {"ener_tot": self.kWh, "tdis_tot": self.Kh, "cost_tot": 0.25 * self.kWh}

    def close(self) -> None:
        self.closed = True


class OutdoorResponse:
    """The exact free response of the simple house, from the last free temperature and the outdoor forecast."""

    name = "exact"

    def forecast(self, free_C: Array, history: Record, boundary: Boundary) -> FreeForecast:
        T, out = float(free_C[-1]), []
        for T_out in boundary.T_out_C[:-1]:
            T = POLE * T + (1 - POLE) * T_out
            out.append(T)
        median = np.array(out)
        return FreeForecast(np.array([0.1, 0.5, 0.9]), np.stack([median - 0.2, median, median + 0.2]), "exact")


def simple_model(sd: float | None = None) -> ThermalModel:
    """The exact model of the simple house at hourly steps; `sd`: how well it is said to know its effect, as a share."""
    power = PowerModel(MachineLoad((FIXED_W, 0.0, PER_U_W, 0.0), (-20.0, 30.0), lowest_level=1.0))
    model = ThermalModel.single(linear_operator(np.array([POLE]), np.array([GAIN_K]), step_s=HOUR_S), power)
    if sd is None:
        return model
    known = {f"step_response_{h}h_K": GAIN_K / (1 - POLE) * (1 - POLE**h) for h in (1, 2, 4, 8, 12, 24, 48)}
    known |= {name.replace("h_K", "h_sd_K"): sd * value for name, value in known.items()}
    return replace(model, cards=(ModelCard("exact", uncertainty=known),))
