"""Identification of many generated houses: time a house."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import perf_counter

from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings
from thermoforce_mpc.identification import identify
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.drawn_houses import WEEKS
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.scenario.scenario import Scenario

# Population of the bench; that of `bench buildings` is another.
SEED = 7
PROBED_DAYS = 3.0
_CONTROLLER = "thermoforce_mpc"


@dataclass(frozen=True)
class ManyTimes:
    """Identification of `houses` with its defaults: `seconds` a house; `refused` and `failed` have no model."""

    houses: int
    refused: int
    failed: int
    seconds: float


def measure(houses: int = 100, seed: int = SEED, progress: Callable[[str], None] = lambda _line: None) -> ManyTimes:
    """Probe `houses` of population `seed` for three days and time their identification in this process.

    Args:
        houses: number of houses, half of them before each of the two weeks of the benches.
        seed: of the population.
        progress: callback for progress lines.
    """
    buildings = []
    for index in range(houses):
        progress(f"probing house {index + 1} of {houses}")
        buildings.append(probed_house(seed, index))
    _ending(buildings[0])  # compiled functions are loaded before the clock starts
    progress(f"identifying {houses} houses")
    begin = perf_counter()
    endings = [_ending(identified) for identified in buildings]
    seconds = (perf_counter() - begin) / houses
    return ManyTimes(houses, endings.count("refused"), endings.count("failed"), seconds)


def _ending(identified: Callable[[], ThermalModel]) -> str:
    """How an identification ends: with a model, refused for its records, or failed."""
    try:
        identified()
    except DataError:
        return "refused"
    except Exception:  # counted; the other houses go on
        return "failed"
    return "model"


def probed_house(seed: int, index: int) -> Callable[[], ThermalModel]:
    """Identification of house `index` of population `seed` from three days of probing, as `tf-mpc run` does them."""
    plant = GeneratedHousePlant(draw_house(seed, index))
    testcase, scenario = plant.testcase, Scenario(testcase=plant.testcase.name)
    probing, config = identification_settings(scenario, chosen_of(scenario, testcase, _CONTROLLER))
    period = plant.period(list(WEEKS)[index % len(WEEKS)])
    start_s = period.start_s - period.warmup_s - PROBED_DAYS * DAY_S
    if start_s < 0.0:
        start_s = (365.0 - PROBED_DAYS) * DAY_S
    run = Probing(plant, start_s, seed=scenario.seed, layout=testcase.layout, config=probing)
    run.go_on(PROBED_DAYS)
    return partial(identify, run.record, config=config, layout=testcase.layout, step_s=testcase.step_s)
