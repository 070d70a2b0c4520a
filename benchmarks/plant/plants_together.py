"""Parallel stepping of several plants, for paired interventions, what-if branches and training data."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

from thermoforce_mpc.data import Measurement
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.embedded.emulator import EmbeddedPlant


def advance_together(
    plants: Sequence[EmbeddedPlant], levels: Sequence[float | None], duration_s: float, executor: Executor
) -> list[Measurement]:
    """Advance every plant by `duration_s` with its own level; return measurements in the order of `plants`.

    The result does not depend on the `executor` (use a `ThreadPoolExecutor`: the compiled step releases the lock).
    Plants share only read-only arrays, so sequential and parallel runs give the same bytes.

    Raises:
        InputError: the numbers of levels and plants differ, a plant is given twice, or `EmbeddedPlant.advance` refuses.
    """
    if len(levels) != len(plants):
        raise InputError(f"{len(levels)} levels for {len(plants)} plants: expected one each")
    if len({id(plant) for plant in plants}) != len(plants):
        raise InputError("the same plant is given twice: branch it with snapshot() and restore() on another plant")
    return list(executor.map(lambda pair: pair[0].advance(pair[1], duration_s), zip(plants, levels, strict=True)))
