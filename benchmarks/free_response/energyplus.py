"""Free runs of EnergyPlus zones in typical-year weather, independent of the embedded plant (extra [energyplus])."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.free_response.sources import Source
from benchmarks.interventions.pool import simulate_all
from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.plants.energyplus.engine import is_available
from thermoforce_mpc.plants.energyplus.zone import CLIMATES, Climate, ZoneJob, ZoneSpec, gains

__all__ = ["energyplus_sources", "is_available"]

_DAYS = 28
_SEED = 1
# Set-points that keep the heating or cooling source off.
_NEVER_C = {"heating": -90.0, "cooling": 150.0}
_HEAVY = ZoneSpec("Chicago-OHare", "heating", capacity_W=4000.0, insulation_m=0.06, slab_m=0.18, window_m2=9.0)


def energyplus_sources(engine: Engine, days: int = _DAYS) -> list[Source]:
    """Three zones without heating or cooling, hourly, 28 `days` each, with internal gains that differ from day to day.

    The two zones of the interventional suite (Chicago in winter, Phoenix in early summer) and one with a heavier floor,
    less insulation and larger windows (Chicago in spring).

    Raises:
        PlantError: the engine is not installed or failed.
    """
    heating, cooling = CLIMATES["heating_chicago"], CLIMATES["cooling_phoenix"]
    zones: list[tuple[str, Climate, int]] = [
        ("EnergyPlus Chicago winter", heating, 10),
        ("EnergyPlus Chicago spring, heavy", replace(heating, spec=_HEAVY), 90),
        ("EnergyPlus Phoenix June", cooling, cooling.first_day),
    ]
    records = simulate_all([_job(climate, day, days) for _, climate, day in zones], engine)
    return [
        Source(name, "EnergyPlus", *_hourly(record), context_steps=14 * 24, least_context_steps=7 * 24)
        for (name, _, _), record in zip(zones, records, strict=True)
    ]


def _job(climate: Climate, day: int, days: int) -> ZoneJob:
    spec = climate.spec
    off = np.full(round(days * DAY_S / spec.step_s), _NEVER_C[spec.mode])
    return ZoneJob(spec, day, off, gains(climate, day, days, _SEED))


def _hourly(record: Record) -> tuple[Record, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Record at full hours and its temperature, °C."""
    every = round(HOUR_S / record.step_s)
    n = record.n_steps // every
    off = np.zeros(n)
    hourly = Record(
        record.time_s[::every], record.T_zone_C[:, ::every], record.T_out_C[::every], record.solar_W_m2[::every],
        off, off, off,
    )  # fmt: skip
    return hourly, hourly.T_zone_C[0]
