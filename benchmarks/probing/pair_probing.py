"""Paired probing: two probes from the same state under the same weather (paper eq:paired)."""

from __future__ import annotations

from thermoforce_mpc.data import DAY_S, Layout
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.protocols import Plant


def probe_pair(
    plant: Plant,
    start_s: float,
    days: float,
    *,
    seeds: tuple[int, int] = (1, 2),
    mode: str = "heating",
    config: ProbingConfig | None = None,
) -> Pair:
    """Probe twice from `start_s` for `days`, with a reset of the plant in between (emulators only).

    Args:
        seeds: seeds of the probing signals of the two runs.
        mode: 'heating' or 'cooling'.
        config: probing options.

    Raises:
        DataError: the seeds are equal, or the plant did not start both runs in the same state.
        PlantError: the plant failed.
    """
    if seeds[0] == seeds[1]:
        raise DataError(f"probing a pair: both runs have seed {seeds[0]}; give two different seeds")
    first, second = (
        probe(plant, start_s, days, seed=seed, layout=Layout.single(mode), config=config) for seed in seeds
    )
    return Pair(first, second, label=f"day {start_s / DAY_S:g}, seeds {seeds[0]} and {seeds[1]}")
