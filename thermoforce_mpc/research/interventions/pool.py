"""Run many EnergyPlus simulations in worker processes, one at a time in each process."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import engine_folder
from thermoforce_mpc.plants.energyplus.simulate import simulate

J = TypeVar("J")


def simulate_all(
    jobs: Sequence[J],
    *,
    run: Callable[[J], Record] = simulate,  # type: ignore[assignment]
    workers: int | None = None,
    on_done: Callable[[int], None] | None = None,
) -> list[Record]:
    """Run all jobs in `workers` processes (by default one per core); returns records in the order of the jobs.

    `run` simulates one job in its process, by default a zone (`simulate.Job`). `on_done` is called with the number of
    finished jobs.

    Raises:
        PlantError: the engine is missing, failed, or crashed its process.
    """
    engine_folder()
    workers = workers or min(len(jobs), os.cpu_count() or 1)
    records: list[Record] = []
    # Spawned, not forked: the engine must not be loaded into a process with threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=max(1, workers), mp_context=context) as pool:
        try:
            for record in pool.map(run, jobs):
                records.append(record)
                if on_done:
                    on_done(len(records))
        except BrokenProcessPool as error:
            raise PlantError(f"EnergyPlus crashed its process after {len(records)} of {len(jobs)} runs") from error
    return records
