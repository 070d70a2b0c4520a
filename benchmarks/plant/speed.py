"""Speed of the embedded plant, and its scaling with several plants in threads and in processes."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.plant.plants_together import advance_together
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.emulator import Emulator

_QUARTER_S = 900.0
_TOGETHER = (1, 2, 4, 16)
_PROCESSES = (1, 2, 4)
_BEST_OF = 3

# Built once per process, since the computation of the weather on each surface takes a while.
_plant: EmbeddedPlant | None = None


def two_weeks_s(plant: Emulator) -> float:
    """Time for two weeks at 15-min control after a week of warm-up on one core, s, best of three."""
    best = np.inf
    for _ in range(_BEST_OF):
        began = time.perf_counter()
        plant.reset(16 * DAY_S, 7 * DAY_S)
        for _ in range(14 * 96):
            plant.advance(None, _QUARTER_S)
        best = min(best, time.perf_counter() - began)
    return best


@dataclass(frozen=True)
class Rate:
    """Days simulated by all plants, wall time, s, and processor time, s."""

    days: float
    wall_s: float
    cpu_s: float

    def row(self, plants: int, stepped_in: str, alone: Rate) -> dict[str, Any]:
        """Table row, with growth relative to one plant `alone`.

        Days per processor second are independent of other load; if they stay constant, n free cores give n times
        the days.
        """
        return {
            "plants": plants,
            "stepped in": stepped_in,
            "days_per_second": self.days / self.wall_s,
            "growth": self.days / self.wall_s / (alone.days / alone.wall_s),
            "cores_used": self.cpu_s / self.wall_s,
            "days_per_cpu_second": self.days / self.cpu_s,
            "cores": os.cpu_count(),
        }


def plant_processes(weather: Weather, n: int) -> ProcessPoolExecutor:
    """`n` processes, each with a plant of its own for `hourly_run`."""
    return ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), initializer=_begin, initargs=(weather,))


def rate_of_processes(weather: Weather, n: int, days: int = 60) -> Rate:
    """Rate of `n` processes that each run a plant for `days`."""
    with plant_processes(weather, n) as executor:
        list(executor.map(hourly_run, [0.5] * n, [1] * n))  # warm-up: start processes, load compiled code
        began = time.perf_counter()
        cpu_s = sum(executor.map(_cpu_s, [0.5] * n, [days] * n))
        return Rate(n * days, time.perf_counter() - began, cpu_s)


def scaling(
    weather: Weather,
    *,
    days: int = 10,
    together: Sequence[int] = _TOGETHER,
    processes: Sequence[int] = _PROCESSES,
    best_of: int = _BEST_OF,
    rate_of: Callable[[Weather, int], Rate] = rate_of_processes,
) -> list[dict[str, Any]]:
    """Simulated days per second of all plants: hourly steps of n plants in threads, then whole runs in n processes.

    Threads advance plants step by step (paired interventions, what-if branches); processes run one plant each from
    start to end (training data). At most one thread or process per core runs at a time.

    Args:
        weather: that of the plants.
        days: simulated in threads.
        together: numbers of plants in threads.
        processes: numbers of processes.
        best_of: times that threads are measured.
        rate_of: measures a number of processes.
    """
    plants = [EmbeddedPlant(weather) for _ in range(max(together))]
    threads = min(max(together), os.cpu_count() or 1)
    measured: list[tuple[int, str, Rate]] = []
    for n in together:
        rates = [_threads(plants[:n], days, threads) for _ in range(best_of)]
        best = min(rates, key=lambda rate: rate.wall_s)
        measured.append((n, f"{min(n, threads)} threads, hourly steps", best))
    measured += [(n, f"{n} processes, whole runs", rate_of(weather, n)) for n in processes]
    alone = measured[0][2]
    return [rate.row(n, how, alone) for n, how, rate in measured]


def _threads(plants: list[EmbeddedPlant], days: int, threads: int) -> Rate:
    levels = [0.5] * len(plants)
    with ThreadPoolExecutor(threads) as executor:
        began, busy = time.perf_counter(), time.process_time()
        for _ in range(days * 24):
            advance_together(plants, levels, HOUR_S, executor)
        return Rate(len(plants) * days, time.perf_counter() - began, time.process_time() - busy)


def _begin(weather: Weather) -> None:
    global _plant
    _plant = EmbeddedPlant(weather)


def hourly_run(level: float, days: int) -> Array:
    """Zone temperatures, °C, (24 days + 1,), of the plant of this process in `days` from New Year at one level."""
    if _plant is None:
        raise RuntimeError("the process was not given its plant")
    start = _plant.reset(0.0, 0.0)
    return np.array([start.T_zone_C[0], *(_plant.advance(level, HOUR_S).T_zone_C[0] for _ in range(24 * days))])


def _cpu_s(level: float, days: int) -> float:
    """Processor time of a run, s."""
    busy = time.process_time()
    hourly_run(level, days)
    return time.process_time() - busy
