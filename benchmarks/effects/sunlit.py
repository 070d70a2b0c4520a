"""`python -m benchmarks.effects.sunlit [--part] SEED ...`: how often is sun found on sensors, with it and without?

Forty houses of each seed are probed at a winter and a sunny start, each with an ideal sensor and, where it was drawn,
with sun on it; beside them the embedded plant, whose sensor is ideal, around the year. With `--part`: the houses alone,
each with an ideal sensor and a floor in the sun or a double-skin glazing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.records import prepared_runs
from thermoforce_mpc.identification.network.sensor import sun_on_sensor
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.operator.heat_input import IDENTITY
from thermoforce_mpc.model.screening import ReadingLimits
from thermoforce_mpc.model.sun_on_sensor import LIKELY
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house, with_sunlit_part
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec
from thermoforce_mpc.scenario.testcase import TestCase

HOUSES, DAYS, EMBEDDED = 40, (3.0, 7.0), "bestest_hydronic_heat_pump"
_STARTS, _EMBEDDED_STARTS, _SEED = (15, 66), (12, 40, 66, 72, 85, 100, 270, 290, 320), 1


@dataclass(frozen=True)
class Look:
    """What a record of `days` says of a sensor that reads `bias_K` too much in full sun: `probability` of sun on it."""

    building: str
    days: float
    bias_K: float
    probability: float
    full_K: float


def main(words: Sequence[str] | None = None) -> None:
    """Print each claim that is wrong or missed, and the shares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("seeds", type=int, nargs="+", metavar="SEED", help="of the houses")
    parser.add_argument("--part", action="store_true", help="houses with a part that the sun heats first")
    given = parser.parse_args(words)
    looks = [look for seed in given.seeds for look in of_houses(seed, given.part)]
    embedded = [] if given.part else list(of_embedded())
    for look in (*looks, *embedded):
        if (look.probability > LIKELY) != (look.bias_K > 0.0):
            print(
                f"{look.building}, {look.days:g} days: {look.bias_K:.1f} K in full sun, said {look.full_K:.1f} K with "
                f"probability {look.probability:.2f}"
            )
    for name, some in (("random houses", looks), ("embedded plant", embedded)):
        for days in DAYS if some else ():
            print(f"{name}, {days:g} days: {shares([look for look in some if look.days == days])}")


def shares(looks: Sequence[Look]) -> str:
    """How many sensors in the sun were found, with the error of their size, and how many others were claimed."""
    lit, ideal = ([look for look in looks if (look.bias_K > 0.0) is sunlit] for sunlit in (True, False))
    found = [look for look in lit if look.probability > LIKELY]
    wrong = sum(look.probability > LIKELY for look in ideal)
    errors = [look.full_K - look.bias_K for look in found]
    size = f", size wrong by {np.mean(np.abs(errors)):.1f} K in the mean" if errors else ""
    return f"{len(found)} of {len(lit)} in the sun found{size}; {wrong} of {len(ideal)} ideal ones claimed"


def of_houses(seed: int, part: bool = False) -> Iterator[Look]:
    """Looks at the houses of a seed; `part`: with a part that the sun heats first, and ideal sensors alone."""
    for index in range(HOUSES):
        house = draw_house(seed, index)
        if part:
            house = replace(with_sunlit_part(house), sun_bias_K=0.0)
        for bias_K in {0.0, house.sun_bias_K}:
            plant = GeneratedHousePlant(replace(house, sun_bias_K=bias_K))
            for day in _STARTS:
                yield from _looks(f"generated:{seed}:{index} from day {day}", plant, plant.testcase, day, bias_K)


def of_embedded() -> Iterator[Look]:
    """Looks at the embedded plant."""
    testcase = load_testcase(EMBEDDED)
    for day in _EMBEDDED_STARTS:
        with closing(build_plant(PlantSpec(), testcase, _SEED)) as plant:
            yield from _looks(f"{EMBEDDED} from day {day}", plant, testcase, day, 0.0)


def _looks(name: str, plant: Plant, testcase: TestCase, day: int, bias_K: float) -> Iterator[Look]:
    run = Probing(plant, day * DAY_S, seed=_SEED, layout=testcase.layout)
    for days in DAYS:
        found = probability_of_sun(run.go_on(days - run.days), testcase)
        if found is not None:
            yield Look(name, days, bias_K, *found)


def probability_of_sun(record: Record, testcase: TestCase) -> tuple[float, float] | None:
    """Probability of sun on the sensor and K in full sun; None where the record cannot be identified from."""
    try:
        runs, _ = prepared_runs([record], ReadingLimits.of(None, testcase.area_m2, 0.0))
    except DataError:
        return None
    sun = sun_on_sensor(runs, 0, testcase.layout, [IDENTITY], IdentificationConfig())
    return (sun.probability, sun.full_K) if sun else (0.0, 0.0)


if __name__ == "__main__":
    main()
