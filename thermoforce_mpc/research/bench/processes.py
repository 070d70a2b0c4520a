"""Cases of a bench in parallel processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

from thermoforce_mpc.simulation.comparison.runner import one_thread_each

C = TypeVar("C", bound=Hashable)
R = TypeVar("R")


def in_processes(
    run_case: Callable[[C], R], cases: Sequence[C], jobs: int, on_done: Callable[[int, R], None]
) -> list[R]:
    """Run cases in `jobs` processes of one thread each; results in the order of `cases`.

    `on_done` is told the number of cases done so far and the result of the latest.
    """
    # Spawned, not forked: a fork would copy locks of the compiled code in an undefined state.
    context = multiprocessing.get_context("spawn")
    done: dict[C, R] = {}
    with one_thread_each(), ProcessPoolExecutor(jobs, context) as executor:
        futures = {executor.submit(run_case, case): case for case in cases}
        for future in as_completed(futures):
            result = done[futures[future]] = future.result()
            on_done(len(done), result)
    return [done[case] for case in cases]
