"""Many EnergyPlus simulations, each in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from benchmarks.cases import TaskFailed, run_all
from benchmarks.interventions.zones import simulate
from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.plants.energyplus.engine import engine_folder, file_hash

J = TypeVar("J")


def simulate_all(
    jobs: Sequence[J],
    engine: Engine,
    *,
    run: Callable[[J], Record] = simulate,  # type: ignore[assignment]
    on_done: Callable[[int], None] = lambda n: None,
) -> list[Record]:
    """Run all jobs on `engine`; returns records in the order of the jobs.

    `run` simulates one job in its process, by default a zone (`Job`). `on_done` is called with the number of
    finished jobs.

    Raises:
        PlantError: EnergyPlus is missing, failed, or crashed its process.
    """
    engine_folder()
    try:
        return run_all(run, jobs, engine, lambda n, record: on_done(n))
    except TaskFailed as error:
        raise PlantError(f"EnergyPlus crashed: {error}") from error


def engine_hash() -> str:
    """Return the SHA-256 of the engine's shared library; raises `PlantError` if it is missing."""
    folder = engine_folder().parent
    for name in ("libenergyplusapi.so", "libenergyplusapi.dylib", "EnergyPlusAPI.dll"):
        if (folder / name).is_file():
            return file_hash((folder / name).resolve())
    raise PlantError(f"EnergyPlus: its shared library is not beside {folder / 'pyenergyplus'}; install the wheel again")
