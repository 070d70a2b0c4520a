"""The engine that a user asked for."""

from __future__ import annotations

import os
from collections.abc import Callable

from thermoforce_mpc.execution.cluster import DaskEngine
from thermoforce_mpc.execution.local import LocalEngine


def open_engine(
    jobs: int | None = None,
    scheduler: str | None = None,
    say: Callable[[str], None] = lambda line: None,
    warn: Callable[[str], None] | None = None,
) -> LocalEngine | DaskEngine:
    """A context manager: the workers of the Dask scheduler at the address `scheduler`, else `jobs` local processes.

    Args:
        jobs: number of processes, by default one per core; has no meaning for a cluster.
        scheduler: such as tcp://host:8786.
        say: callback for what a user may want to know.
        warn: callback for why nothing goes on; by default `say`.

    Raises:
        ConfigError: the cluster cannot be used; see `DaskEngine`.
    """
    if scheduler is not None:
        return DaskEngine(scheduler, say=say, warn=warn)
    return LocalEngine(jobs or os.cpu_count() or 1)
