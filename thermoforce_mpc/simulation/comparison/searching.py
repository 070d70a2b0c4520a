"""Cells beside thermostats that are as comfortable, whose runs are cells of the comparison too: stored, found again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.simulation.comparison.cells import Cell, Inputs, varied
from thermoforce_mpc.simulation.comparison.equal_comfort import THERMOSTAT, as_comfortable, shifted_options
from thermoforce_mpc.simulation.comparison.outcome import COST, DISCOMFORT
from thermoforce_mpc.simulation.comparison.store import DONE, Store
from thermoforce_mpc.simulation.comparison.tasks import follow

Record = Mapping[str, Any]


@dataclass(frozen=True)
class EqualComfort:
    """Searches thermostats for the cells of a comparison; `say` is told of each."""

    store: Store
    inputs: Inputs
    testcase: TestCase
    say: Callable[[str], None]

    def beside(self, cells: Sequence[Cell], records: Sequence[Record]) -> list[dict[str, Any]]:
        """The records (of `cells`), those of controllers with a model with the thermostat that is as comfortable.

        It is searched from the first thermostat of the same window, tariff and forecast error.

        Raises:
            PlantError: the plant failed.
        """
        thermostats: dict[tuple[str, str, str], tuple[Cell, Record]] = {}
        for cell, record in zip(cells, records, strict=True):
            if record["status"] == DONE and record["controller"] == THERMOSTAT:
                thermostats.setdefault(cell.group, (cell, record))
        found = []
        for cell, record in zip(cells, records, strict=True):
            own = dict(record)
            if record["status"] == DONE and record["needs_model"] and cell.group in thermostats:
                thermostat, at_its_own = thermostats[cell.group]
                run = partial(self._shifted, thermostat)
                equal = as_comfortable(run, at_its_own["kpis"], record["kpis"][DISCOMFORT])
                own["equal_comfort"] = equal.to_json(record["kpis"][COST], self.testcase.currency)
                self.say(f"{cell.title}: {own['equal_comfort']['in_words']}")
            found.append(own)
        return found

    def _shifted(self, thermostat: Cell, shift_K: float) -> Mapping[str, float]:
        """KPIs of a thermostat with other set-points, run in this process where they are not stored."""
        options = shifted_options(thermostat.scenario.controller.options, self.testcase, shift_K)
        cell = varied(thermostat, f"{THERMOSTAT} {shift_K:+.2f} K", options, self.inputs)
        record = self.store.finished(cell)
        if record is None:
            ran = follow(cell)
            self.store.write(cell, ran)
            record = ran.record
        kpis: Mapping[str, float] = record["kpis"]
        return kpis
