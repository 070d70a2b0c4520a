"""A controller, a free response, a connection and a plant for thermoforce-mpc (docs/how-to/plugins.md)."""

from dataclasses import dataclass

import numpy as np
import requests

from thermoforce_mpc.connections.files import FilesConnection
from thermoforce_mpc.data import Block, FreeForecast, Plan, PlanStatus
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house, house_testcase


@dataclass
class NightSetback:
    """On below a set-point of the hour, else off"""

    day_C: float = 21.5
    night_C: float = 19.0
    name, step_s, horizon_s = "night_setback", 900.0, 900.0

    def plan(self, observation, state=None):
        setpoint_C = self.day_C if 6 <= observation.time_s / 3600 % 24 < 22 else self.night_C
        level = float(observation.T_zone_C[0] < setpoint_C)
        return Plan((Block((level,), self.step_s),), PlanStatus.RULE, f"set-point {setpoint_C:g} °C")


@dataclass
class Yesterday:
    """What was measured a day before comes again"""

    spread_K: float = 0.5
    name = "yesterday"

    def forecast(self, free_C, history, boundary):
        median = np.resize(free_C[-round(86400 / boundary.step_s) :], boundary.n_steps)
        return FreeForecast(np.array([0.1, 0.5, 0.9]), median + self.spread_K * np.array([[-1], [0], [1]]), self.name)


class Gateway(FilesConnection):
    """Tables in files, levels over HTTP"""

    def __init__(self, url: str = "http://127.0.0.1:8123/levels"):
        super().__init__()
        self.url = url

    def write(self, levels, seconds):
        requests.post(self.url, json={"levels": levels, "seconds": seconds}, timeout=30).raise_for_status()


def plant():
    """A house generated with seed 1"""
    return GeneratedHousePlant(draw_house(1, 7))


def testcase(name):
    return house_testcase(draw_house(1, 7)).model_copy(update={"name": name, "plant": "north_house"})
