"""A controller, a free response and a plant for thermoforce-mpc, from a package of its own (docs/how-to/plugins.md)."""

import numpy as np
from pydantic import Field

from controllers.registry import Entry
from thermoforce_mpc.data import DAY_S, Block, FreeForecast, Plan, PlanStatus
from thermoforce_mpc.plants.generated import GeneratedHousePlant, draw_house, house_testcase
from thermoforce_mpc.plants.registry import PlantEntry
from thermoforce_mpc.scenario.settings import StrictModel


class Options(StrictModel):
    """Options of the controller; `tf-mpc controllers night_setback` lists them."""

    day_C: float = Field(21.5, ge=10, le=30, description="heat below this from 6 to 22 h, °C")
    night_C: float = Field(19.0, ge=10, le=30, description="heat below this from 22 to 6 h, °C")


class NightSetback:
    """Heats at full level below a set-point of the hour."""

    step_s = horizon_s = 900.0

    def __init__(self, name, options):
        self.name, self.options = name, options

    def plan(self, observation, state=None):
        """One block per actuator and step, see `thermoforce_mpc.protocols.Controller`."""
        day = 6 <= observation.time_s % DAY_S / 3600 < 22
        setpoint_C = self.options.day_C if day else self.options.night_C
        level = float(observation.T_zone_C[0] < setpoint_C)
        return Plan((Block((level,), self.step_s),), PlanStatus.RULE, f"set-point {setpoint_C:g} °C")


class Yesterday:
    """What was measured a day before comes again"""

    name = "yesterday"

    def __init__(self, spread_K=0.5):
        self.spread_K = spread_K

    def forecast(self, free_C, history, boundary):
        """Median and 80 % band over the steps ahead, see `thermoforce_mpc.protocols.FreeResponse`."""
        day = free_C[-round(DAY_S / boundary.step_s) :]
        median = np.resize(np.where(np.isfinite(day), day, np.nanmean(free_C)), boundary.n_steps)
        return FreeForecast(np.array([0.1, 0.5, 0.9]), median + self.spread_K * np.array([[-1], [0], [1]]), self.name)


def testcase(name):
    """The building of the plant: points, floor area, and which plant implements it."""
    return house_testcase(draw_house(1, 7)).model_copy(update={"name": name, "plant": "north_house"})


def _controller(name, options, testcase, model):
    return NightSetback(name, options)


def _plant(spec, testcase, options, seed):
    return GeneratedHousePlant(draw_house(1, 7))


CONTROLLER = Entry("on/off with a night setback", False, lambda: Options, _controller)
PLANT = PlantEntry("a house generated with seed 1", _plant)
