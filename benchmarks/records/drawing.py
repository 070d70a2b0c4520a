"""Clean records of houses drawn anew: probed, under thermostats with a night setback, and of several rooms."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.identification.probing.probe import ProbingConfig
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.rooms import house_of_rooms
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec

Operation = Literal["probing", "thermostat", "rooms"]
OPERATIONS: tuple[Operation, ...] = ("probing", "thermostat", "rooms")
# Days of the record by operation, and those of native control before it.
_DAYS: dict[Operation, int] = {"probing": 7, "thermostat": 14, "rooms": 14}
_WARMUP_DAYS, STEP_S = 3, 900.0
# Thermostats: drawn set-points by day, setbacks by night and hysteresis, K; begin of day and night, h.
_SET_C, _SETBACK_K, _BAND_K, _BEGINS_H, _ENDS_H = (19.5, 21.5), (1.0, 3.0), 0.2, (5, 8), (20, 23)
_ROOMS = (2, 5)


@dataclass(frozen=True)
class Drawn:
    """A clean record: `name` of its house, how it was made, and the set-points (A, n), °C, NaN where there were none.

    `setpoint_C` are those that the thermostats followed in each step.
    """

    name: str
    operation: Operation
    record: Record
    layout: Layout
    setpoint_C: Array


def drawn(operation: Operation, seed: int, number: int) -> Drawn:
    """The record of house `number` of the population `seed`; the same arguments give the same record.

    Raises:
        PlantError: the plant failed.
    """
    rng = np.random.default_rng([seed, number, OPERATIONS.index(operation)])
    start_s = float(rng.integers(10, 60)) * DAY_S
    if operation == "rooms":
        plant = house_of_rooms(f"house:{rng.integers(*_ROOMS)}rooms:{1000 * seed + number}")
        layout, name = plant.layout, plant.house.name
        record, setpoint_C = _kept(plant, layout, start_s, _DAYS[operation], rng)
        return Drawn(name, operation, record, layout, setpoint_C)
    name = f"generated:{seed}:{number}"
    testcase = load_testcase(name)
    layout = Layout.single(floor_area_m2=testcase.area_m2)
    with closing(build_plant(PlantSpec(), testcase, 1)) as built:
        if operation == "probing":
            config = ProbingConfig(warmup_days=_WARMUP_DAYS)
            record = probe(built, start_s, _DAYS[operation], seed=number, layout=layout, config=config)
            return Drawn(name, operation, record, layout, np.full_like(record.u, np.nan))
        record, setpoint_C = _kept(built, layout, start_s, _DAYS[operation], rng)
    return Drawn(name, operation, record, layout, setpoint_C)


def _kept(plant: Plant, layout: Layout, start_s: float, days: int, rng: np.random.Generator) -> tuple[Record, Array]:
    """The record under thermostats of drawn set-points, one a room, and what these were (A, n), °C."""
    n = len(layout.home)
    day_C = rng.uniform(*_SET_C, n)
    night_C = day_C - rng.uniform(*_SETBACK_K, n)
    begins_h, ends_h = rng.integers(*_BEGINS_H), rng.integers(*_ENDS_H)
    now = plant.reset(start_s, _WARMUP_DAYS * DAY_S)
    on = np.zeros(n, dtype=bool)
    asked = []
    for _ in range(round(days * DAY_S / STEP_S)):
        hour = now.time_s / HOUR_S % 24
        target = day_C if begins_h <= hour < ends_h else night_C
        on = target + np.where(on, _BAND_K, -_BAND_K) > now.T_zone_C[list(layout.home)]
        asked.append(target)
        now = plant.advance(tuple(on.astype(float).tolist()), STEP_S)
    record = plant.past(STEP_S).last(len(asked))
    return replace(record, names=layout.names), np.array(asked).T
