"""Histories and boundary conditions for tests of forecasters."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Boundary, Record

LEVELS = np.arange(1, 10) / 10.0


def hours(n: int) -> np.ndarray:
    """0, 1, ... n."""
    return np.arange(n + 1, dtype=float)


def daily(t: np.ndarray) -> np.ndarray:
    """A daily course, °C, at hours `t`."""
    return 15.0 + 2.0 * np.sin(2 * np.pi * t / 24) + 0.3 * np.cos(4 * np.pi * t / 24)


def first_order_room() -> tuple[np.ndarray, np.ndarray]:
    """Two weeks of a room that forgets a tenth an hour under random weather: its temperature and the outdoors, °C."""
    rng = np.random.default_rng(3)
    t = hours(336)
    outdoor = 5 + 3 * np.sin(2 * np.pi * t / 24) + np.cumsum(0.3 * rng.standard_normal(t.size))
    free = np.empty(t.size)
    free[0] = 10.0
    for k in range(t.size - 1):
        free[k + 1] = 0.9 * free[k] + 0.1 * 0.5 * (outdoor[k] + outdoor[k + 1])
    return free, outdoor


def weather_at(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A plain day: outdoor temperature °C and irradiance W/m² at given times."""
    angle = 2 * np.pi * time_s / 86400
    return 5 - 4 * np.cos(angle - 0.7), np.maximum(-np.cos(angle), 0) * 300


def history_of(free: np.ndarray, step_s: float = 3600.0, **replaced: np.ndarray) -> Record:
    """A history for the control-free series `free`, with plain weather unless replaced."""
    n = free.size - 1
    time_s = np.arange(n + 1) * step_s
    outdoor, solar = weather_at(time_s)
    values = {
        "T_out_C": outdoor,
        "solar_W_m2": solar,
        "u": np.zeros(n),
        "power_W": np.zeros(n),
        "heat_W": np.full(n, np.nan),
    }
    return Record(time_s=time_s, T_zone_C=free, **(values | replaced))


def boundary_of(start: int, n: int, step_s: float = 3600.0, **replaced: np.ndarray) -> Boundary:
    """Boundary conditions of `n` steps from step `start` on, with plain weather unless replaced."""
    time_s = (start + np.arange(n + 1)) * step_s
    outdoor, solar = weather_at(time_s)
    zero = np.zeros(n + 1)
    return Boundary(
        time_s=time_s,
        T_out_C=replaced.get("T_out_C", outdoor),
        solar_W_m2=replaced.get("solar_W_m2", solar),
        occupancy=zero,
        lower_C=zero + 21,
        upper_C=zero + 24,
        price_per_kWh=zero + 0.25,
        emission_kg_per_kWh=zero + 0.2,
    )
