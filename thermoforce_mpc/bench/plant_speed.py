"""How fast the embedded plant is, and how that grows with plants stepped together, in threads and in processes."""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np

from thermoforce_mpc.plants.embedded import EmbeddedPlant, advance_together
from thermoforce_mpc.types import DAY_S, HOUR_S, Array
from thermoforce_mpc.weather.year import Weather

_QUARTER_S = 900.0
_TOGETHER = (1, 2, 4, 16)
_PROCESSES = (1, 2, 4)
_BEST_OF = 3

# A process builds its plant once, when it starts: what the weather does to each surface takes a while to work out.
_plant: EmbeddedPlant | None = None


def two_weeks_s(plant: EmbeddedPlant) -> float:
    """Seconds for two weeks at 15-min control after a week of warm-up on one core, best of three."""
    best = np.inf
    for _ in range(_BEST_OF):
        began = time.perf_counter()
        plant.reset(16 * DAY_S, 7 * DAY_S)
        for _ in range(14 * 96):
            plant.advance(None, _QUARTER_S)
        best = min(best, time.perf_counter() - began)
    return best


def scaling(weather: Weather, *, days: int = 10) -> list[dict[str, Any]]:
    """Simulated days per second, all plants counted: hourly steps of n plants together, then whole runs in n processes.

    Threads step side by side, as paired interventions and what-if branches need it; processes run one plant each from
    start to end, as the making of training data does. At most as many run at once as there are cores.
    """
    cores = os.cpu_count() or 1
    measured: list[tuple[int, str, float]] = []
    plants = [EmbeddedPlant(weather) for _ in range(max(_TOGETHER))]
    for n in _TOGETHER:
        rate = max(_threads(plants[:n], days) for _ in range(_BEST_OF))
        measured.append((n, f"{min(n, cores)} threads, hourly steps", rate))
    measured += [(n, f"{n} processes, whole runs", _processes(weather, n)) for n in _PROCESSES]
    alone = measured[0][2]
    return [
        {"plants": n, "stepped in": how, "days_per_second": rate, "growth": rate / alone, "cores": cores}
        for n, how, rate in measured
    ]


def run_in_processes(weather: Weather, levels: list[float], days: int, n_processes: int) -> list[Array]:
    """Zone temperatures (24 days + 1,) °C at the hours of a run at each level, in as many processes as asked for.

    The outcome does not depend on the number of processes, to the last bit.
    """
    # Started anew, not forked: a fork would copy the threads' locks of the compiled code in whatever state they are.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(n_processes, context, initializer=_begin, initargs=(weather,)) as executor:
        return list(executor.map(_run, levels, [days] * len(levels)))


def _threads(plants: list[EmbeddedPlant], days: int) -> float:
    levels = [0.5] * len(plants)
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        began = time.perf_counter()
        for _ in range(days * 24):
            advance_together(plants, levels, HOUR_S, executor)
        return len(plants) * days / (time.perf_counter() - began)


def _processes(weather: Weather, n: int, days: int = 60) -> float:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(n, context, initializer=_begin, initargs=(weather,)) as executor:
        list(executor.map(_run, [0.5] * n, [1] * n))  # started, compiled code loaded
        began = time.perf_counter()
        list(executor.map(_run, [0.5] * n, [days] * n))
        return n * days / (time.perf_counter() - began)


def _begin(weather: Weather) -> None:
    global _plant
    _plant = EmbeddedPlant(weather)


def _run(level: float, days: int) -> Array:
    if _plant is None:
        raise RuntimeError("the process was not given its plant")
    start = _plant.reset(0.0, 0.0)
    return np.array([start.T_zone_C, *(_plant.advance(level, HOUR_S).T_zone_C for _ in range(24 * days))])
