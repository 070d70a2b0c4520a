"""Probe a generated house, identify and judge it; what the model is worth is found by running the house itself.

The effect of an action is the difference of two runs (paper eq:paired); the worth of a plan is that of a week in closed
loop with the gate off, beside the thermostat.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.closed_loop.buildings import LEAST_HEATING_KWH_M2
from benchmarks.closed_loop.offices import CONTROLLER, THERMOSTAT, THERMOSTAT_STEP_S
from benchmarks.effects.asking import paired, said
from controllers.registry import build_controller
from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings
from thermoforce_mpc.identification import identify
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.card import Competence
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.scenario.scenario import Scenario

# Probing and the week in closed loop begin on these days of the year, the latter after native control; between them
# lies the question of `benchmarks.effects`.
_PROBING_DAY, _WEEK_DAY, WEEK_DAYS, WARMUP_DAYS = 25, 42, 7, 5
_SEED = 1
# Discomfort that counts as equal, K·h a week.
EQUAL_KH = 0.5
# Error of the effect of an action, as a share of it, up to which a model is of use for a plan.
USEFUL = 0.5


@dataclass(frozen=True)
class Case:
    """House `index` of population `seed`; `days` of probing, the fewest first; whether to run a week in closed loop."""

    seed: int
    index: int
    days: tuple[float, ...]
    closed_loop: bool


@dataclass(frozen=True)
class Week:
    """Cost, EUR/m², and discomfort, K·h, of a week; energy of the heating, kWh/m²."""

    cost: float
    discomfort_Kh: float
    energy_kWh_m2: float


@dataclass(frozen=True)
class Judged:
    """The verdict on the model of a house from `days` of probing, and what it is worth.

    `refused`: why there is no model; `error`: RMS error of the effect of six hours at full level over 48 h, as a share
    of it: 1 is that of the weather alone; `ours` and `thermostat`: their weeks, None where they were not run.
    """

    house: int
    words: str
    days: float
    verdict: Competence | None = None
    refused: str = ""
    error: float = float("nan")
    ours: Week | None = None
    thermostat: Week | None = None

    @property
    def passes(self) -> bool:
        """Whether a controller would act on the model."""
        return self.verdict is not None and self.verdict.competent

    @property
    def costs_more(self) -> bool | None:
        """Whether its plans cost more than the thermostat at equal comfort; None where that was not run.

        More comfort is worth its price here, less is not: half a kelvin hour a week counts as equal.
        """
        if self.ours is None or self.thermostat is None or self.thermostat.energy_kWh_m2 < LEAST_HEATING_KWH_M2:
            return None
        more_Kh = self.ours.discomfort_Kh - self.thermostat.discomfort_Kh
        return more_Kh > EQUAL_KH or (self.ours.cost > self.thermostat.cost and more_Kh > -EQUAL_KH)

    @property
    def is_good(self) -> bool:
        """Whether it is of use: it knows the effect of an action, and its plans, where they were run, cost no more."""
        return self.error <= USEFUL and not self.costs_more


def judged(case: Case) -> list[Judged]:
    """The models of one house, one for each number of days of the same probing.

    Raises:
        PlantError: the plant failed.
    """
    house = draw_house(case.seed, case.index)
    scenario = Scenario(testcase=house.name)
    with closing(GeneratedHousePlant(house)) as plant:
        testcase = plant.testcase
        probing, config = identification_settings(scenario, chosen_of(scenario, testcase, CONTROLLER))
        off, true_K = paired(plant)
        run = Probing(plant, _PROBING_DAY * DAY_S, seed=_SEED, layout=testcase.layout, config=probing)
        records = [(days, run.go_on(days - run.days)) for days in case.days]
        thermostat = _week(plant, THERMOSTAT, None) if case.closed_loop else None
        found = []
        for days, record in records:
            told = Judged(case.index, house.words, days, thermostat=thermostat)
            try:
                model = identify(record, config=config, layout=testcase.layout, step_s=testcase.step_s)
            except DataError as error:
                found.append(replace(told, refused=str(error)))
                continue
            error_K = said(model, off) - true_K
            share = float(np.sqrt(np.mean(error_K**2) / np.mean(true_K**2)))
            ours = _week(plant, CONTROLLER, model) if case.closed_loop else None
            found.append(replace(told, verdict=model.only.card.competence, error=share, ours=ours))
    return found


def _week(plant: GeneratedHousePlant, name: str, model: ThermalModel | None) -> Week:
    """A week in closed loop; an MPC acts on its model whatever the verdict."""
    options = {"step_s": THERMOSTAT_STEP_S} if model is None else {"gate": {"enabled": False}}
    controller = build_controller(name, options, plant.testcase, model)
    allowed = limits_of(controller, plant.house.floor_area_m2)
    kpis = run_closed_loop(plant, controller, _period(plant), allowed=allowed).kpis
    return Week(kpis["cost_tot"], kpis["tdis_tot"], kpis["ener_tot"])


def _period(plant: GeneratedHousePlant) -> Period:
    return replace(
        plant.period("cold_week"),
        start_s=_WEEK_DAY * DAY_S,
        scored_s=WEEK_DAYS * DAY_S,
        warmup_s=WARMUP_DAYS * DAY_S,
    )
