"""`python -m benchmarks.faults.foreign SEED --houses N`: another load on the meter, and no fault.

Generated houses whose meter of power, or of heat, also holds an air unit: a constant part, and from 6 to 19 h a coil
that grows with the cold and varies. Probed for three days, then controlled from the cold week on, by the defaults: what
was told of the load, and how often the watch handed control back though nothing is wrong.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import count, islice
from typing import TypeVar

import click
import numpy as np

from benchmarks.closed_loop.buildings import identify_by_default
from controllers.registry import build_controller
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Measurement, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, House, draw_house
from thermoforce_mpc.report.findings import watch_spells

Shown = TypeVar("Shown", Record, Measurement)
PROBED_DAYS, WEEK = 3.0, "cold_week"
_COP = 3.0
# Constant part of the load, and its coil: at 25 K below `_NEEDLESS_C` outdoors, as shares of its size.
_ALWAYS, _NEEDLESS_C, _RANGE_K, _VARIES, _PERIOD_S = 0.15, 18.0, 25.0, 0.15, 31400.0


class WithAirUnit(GeneratedHousePlant):
    """A generated house whose `meter`, "power" or "heat", holds an air unit too.

    It has `size` times the power of the machine at design, or its heat.
    """

    size, meter = 0.0, "power"

    def __init__(self, house: House, size: float, meter: str = "power") -> None:
        self.size, self.meter = size, meter
        super().__init__(house)

    def other_W(self, time_s: Array, T_out_C: Array | float) -> Array:
        """The air unit's load, W."""
        hour = np.asarray(time_s) % DAY_S / HOUR_S
        by_power = self.meter == "power" and "heat pump" in self.house.machine
        full_W = self.house.capacity_W / (_COP if by_power else 1.0)
        needed = np.clip((_NEEDLESS_C - np.asarray(T_out_C)) / _RANGE_K, 0.0, 1.5)
        varied = 1.0 + _VARIES * np.sin(2 * np.pi * np.asarray(time_s) / _PERIOD_S + self.house.index)
        coil = ((hour >= 6.0) & (hour < 19.0)) * needed * varied
        return np.asarray(self.size * full_W * (_ALWAYS + coil))

    def past(self, step_s: float) -> Record:
        """See `Plant.past`."""
        record = super().past(step_s)
        return self._with_other(record, self.other_W(record.time_s[:-1], record.T_out_C[:-1]))

    def _measured(self, before_s: float) -> Measurement:
        measured = super()._measured(before_s)
        return self._with_other(measured, self.other_W(np.array([before_s]), measured.T_out_C))

    def _with_other(self, shown: Shown, other_W: Array) -> Shown:
        if self.meter == "heat":
            return replace(shown, heat_W=np.asarray(shown.heat_W) + other_W)
        return replace(shown, power_W=np.asarray(shown.power_W) + other_W)


@dataclass(frozen=True)
class Found:
    """What became of one house: what its model says of the load, spells and steps of the watch, cost and discomfort."""

    words: str
    spells: int
    steps: int
    cost: float
    discomfort_Kh: float


def found_in(house: House, size: float, meter: str, days: float) -> Found:
    """Probe, identify and control one house; raises `DataError` where its record is refused."""
    plant = WithAirUnit(house, size, meter)
    period = replace(plant.period(WEEK), scored_s=days * DAY_S)
    model = identify_by_default(plant, period, PROBED_DAYS)
    controller = build_controller("thermoforce_mpc", {}, plant.testcase, model)
    result = run_closed_loop(plant, controller, period, allowed=limits_of(controller, house.floor_area_m2))
    law = model.power[0]
    on_power = None if law is None else law.foreign
    foreign = model.only.card.foreign_heat if meter == "heat" else on_power
    words = "no other load found" if foreign is None else foreign.in_words()
    steps = result.fallback_levels()["watch"]
    return Found(words, len(watch_spells(result)), steps, result.kpis["cost_tot"], result.kpis["tdis_tot"])


@click.command()
@click.argument("seed", type=click.IntRange(0))
@click.option("--houses", type=click.IntRange(1), default=6, show_default=True, help="Number of generated houses.")
@click.option("--size", default=0.5, show_default=True, help="Air unit over the machine's power, or heat, at design.")
@click.option("--meter", type=click.Choice(("power", "heat")), default="power", show_default=True)
@click.option("--days", default=14.0, show_default=True, help="Days controlled.")
def main(seed: int, houses: int, size: float, meter: str, days: float) -> None:
    """Run generated houses with an air unit on their meter, of heat those alone that have one."""
    drawn = (draw_house(seed, index) for index in count())
    metered = (house for house in drawn if meter == "power" or house.heat_metered)
    found = []
    for house in islice(metered, houses):
        index = house.index
        try:
            one = found_in(house, size, meter, days)
        except DataError as error:
            click.echo(f"{index}: {house.machine}: refused: {error}")
            continue
        found.append(one)
        click.echo(
            f"{index}: {house.machine}: {one.words}; watch {one.spells} times, {one.steps} steps; "
            f"{one.cost:.3f} EUR/m2, {one.discomfort_Kh:.2f} K·h"
        )
    spells, months = sum(one.spells for one in found), len(found) * days / 30.0
    click.echo(f"{spells} alarms without a fault in {months:.1f} months (goal: at most one a month)")


if __name__ == "__main__":
    main(sys.argv[1:])
