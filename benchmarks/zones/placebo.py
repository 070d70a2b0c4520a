"""`python -m benchmarks.zones.placebo HOUSE ...`: how often is an actuator that does nothing acted on?

Houses of rooms are probed, and each valve's levels and heat are replaced by those of a valve of another of the houses,
shifted in time: whatever the fit then finds is chance. Beside it, the verdicts on the valves as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.identifying import IdentificationTask, identification_task, run_identification
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.testcases import load_scenario

_PERIODS, _PROBING_DAYS, _DRAWS, _SEED = ("cold_week", "sunny_week"), 3.0, 10, 0


def main(houses: Sequence[str]) -> None:
    """Print how many valves are judged competent as they are, and with foreign levels."""
    probed = [probe(house, period) for house in houses for period in _PERIODS]
    own = [verdict for task, record in probed for verdict in verdicts(task, record)]
    rng, foreign = np.random.default_rng(_SEED), []
    for i, (task, record) in enumerate(probed):
        others = [other for k, (_, other) in enumerate(probed) if k // len(_PERIODS) != i // len(_PERIODS)]
        for _ in range(_DRAWS):
            foreign += verdicts(task, with_foreign_levels(record, others, rng))
    for name, found in (("as they are", own), ("foreign levels", foreign)):
        print(f"{name}: {sum(found)} of {len(found)} competent")


def probe(house: str, period: str) -> tuple[IdentificationTask, Record]:
    """Three days of probing before a window."""
    days = {"days": _PROBING_DAYS, "most_days": _PROBING_DAYS}
    scenario = load_scenario(None, {"testcase": house, "period": period, "identification": days})
    experiment, records = Experiment.of(scenario), list[Record]()
    task = identification_task(scenario, experiment.own.chosen)
    run_identification(task, experiment.plant.build(), records.append)
    return task, records[-1]


def with_foreign_levels(record: Record, others: Sequence[Record], rng: np.random.Generator) -> Record:
    """`record` with levels and heat of each actuator from one of `others`, drawn and rotated in time."""
    fitting = [other for other in others if other.n_steps == record.n_steps]
    if not fitting:
        raise DataError("no other record is as long as this one: nothing to take levels from")
    u, heat = record.u.copy(), record.heat_W.copy()
    for a in range(u.shape[0]):
        other, by = fitting[rng.integers(len(fitting))], int(rng.integers(record.n_steps))
        b = int(rng.integers(other.u.shape[0]))
        u[a], heat[a] = np.roll(other.u[b], by), np.roll(other.heat_W[b], by)
    return replace(record, u=u, heat_W=heat)


def verdicts(task: IdentificationTask, record: Record) -> list[bool]:
    """Whether each actuator is judged competent; none is where the record cannot be fitted at all."""
    layout = task.testcase.layout
    try:
        model: ThermalModel = identify(record, config=task.identification, layout=layout, step_s=task.step_s)
    except DataError:
        return [False] * len(layout.home)
    return [card.competence is not None and card.competence.competent for card in model.cards]


if __name__ == "__main__":
    main(sys.argv[1:])
