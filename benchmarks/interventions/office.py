"""Paired interventions on the DOE small office (`interventions.small_office`), an external reference building.

The protocol is smaller than that of the suite: one cold season, weekdays only (the rooftop units follow a working
week), the same windows and shifts. It checks effect prediction with another building and heating system and is not a
cell of the suite.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.interventions.dataset import ClimateData, Probe, Window, check_identical
from benchmarks.interventions.pool import simulate_all
from benchmarks.interventions.protocol import WINDOW_START_H, Part, probing_shift, shift_of
from benchmarks.interventions.small_office import (
    FLOOR_AREA_M2,
    RANGE_W,
    WEATHER,
    OfficeJob,
    simulate_office,
)
from thermoforce_mpc.data import Record
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.plants.energyplus.zone import Climate, ZoneSpec, base_setpoint

PROBE_DAYS = 3
_WARMUP_DAYS, _FORGOTTEN_DAYS = 12, 4
_SHIFT_STEPS, _HORIZON_STEPS, _PER_DAY = 16, 24, 96
# Day 21 (22 January) is a Monday in the engine's year, as is day 0.
_PROBE_DAY = 21
_DAYS: dict[Part, tuple[int, int]] = {"validation": (25, 4), "test": (31, 12)}

OFFICE = Climate(
    "small_office",
    "Small office (Chicago)",
    # Only mode, step and floor area are used; the building model is the IDF file of the engine.
    ZoneSpec(WEATHER, "heating", RANGE_W[1] - RANGE_W[0], 0.1, floor_area_m2=sum(FLOOR_AREA_M2.values())),
    first_day=_PROBE_DAY,
    comfort_C=21.0,
    setback_C=19.0,
)


def office_data(
    *, seed: int = 1, engine: Engine, quick: bool = False, say: Callable[[str], None] = lambda line: None
) -> ClimateData:
    """Simulate probe, validation and test pairs of the office; `quick` simulates a quarter of the days.

    Raises:
        DataError: a pair differs before its window.
        PlantError: the engine is missing or failed.
    """
    warm = _WARMUP_DAYS * _PER_DAY
    jobs: list[OfficeJob] = []

    def add(day: int, n_days: int, shift: Callable[[np.ndarray], None] = lambda setpoint: None) -> int:
        setpoint = base_setpoint(OFFICE, _WARMUP_DAYS + n_days)
        shift(setpoint)
        jobs.append(OfficeJob(day - _WARMUP_DAYS, setpoint))
        return len(jobs) - 1

    def probing(setpoint: np.ndarray) -> None:
        setpoint[warm:] += probing_shift(OFFICE, PROBE_DAYS, seed)

    plain, probed = add(_PROBE_DAY, PROBE_DAYS), add(_PROBE_DAY, PROBE_DAYS, probing)
    plan = []
    for part, (first, count) in _DAYS.items():
        weekdays = [day for day in range(first, first + 2 * count + 4) if day % 7 < 5]
        for index, day in enumerate(weekdays[: max(1, count // 4) if quick else count]):
            base = add(day, 1)
            for position, (name, hour) in enumerate(WINDOW_START_H.items()):
                start, K = warm + round(4 * hour), shift_of(index, position)

                def moved(setpoint: np.ndarray, start: int = start, K: float = K) -> None:
                    setpoint[start : start + _SHIFT_STEPS] += K

                plan.append((part, day, name, K, start, base, add(day, 1, moved)))
    say(f"EnergyPlus: {len(jobs)} simulations of the small office")
    tenth = max(1, len(jobs) // 10)

    def progress(done: int) -> None:
        if done % tenth == 0:
            say(f"EnergyPlus: {done} of {len(jobs)} simulations")

    records = simulate_all(jobs, engine, run=simulate_office, on_done=progress)
    forgotten = _FORGOTTEN_DAYS * _PER_DAY

    def past(record: Record, start: int) -> Record:
        return record.slice(forgotten, start)

    windows = []
    for part, day, name, K, start, base, other in plan:
        a, b = records[base], records[other]
        check_identical(b, a, start, f"small office, day {day}, {name}")
        end = start + _HORIZON_STEPS
        windows.append(
            Window("small_office", name, part, day, K, past(a, start), a.slice(start, end), b.slice(start, end))
        )
    a, b = records[plain], records[probed]
    check_identical(b, a, warm, "small office, probe")
    pair = Pair(b.slice(warm, b.n_steps), a.slice(warm, a.n_steps), label=f"{PROBE_DAYS} days of the small office")
    return ClimateData(OFFICE, tuple(windows), {PROBE_DAYS: Probe(past(a, warm), pair)})
