"""`python -m benchmarks.zones HOUSE ...`: effects of single valves in emulated houses of rooms."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.zones.effects import PairScore, score_pairs, within_limits
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.identifying import identification_task, run_identification
from thermoforce_mpc.plants.rooms.plant import HouseOfRooms
from thermoforce_mpc.plants.testcases import load_scenario

_PERIOD, _PROBING_DAYS = "cold_week", 3.0


def main(houses: Sequence[str]) -> None:
    """Identify each house with the default configuration from three days of probing, and print its scores.

    Then those against the house as it is, in which valves also take heat from each other.
    """
    columns = ("own", "across", "sign", "across")
    print(f"{'house':18}" + "".join(f"{name:>9}" for name in columns) + "   at the machine's limit too:")
    for house in houses:
        days = {"days": _PROBING_DAYS, "most_days": _PROBING_DAYS}
        scenario = load_scenario(None, {"testcase": house, "period": _PERIOD, "identification": days})
        experiment = Experiment.of(scenario)
        plant = experiment.plant.build()
        assert isinstance(plant, HouseOfRooms)
        model = run_identification(identification_task(scenario, experiment.own.chosen), plant)
        shown: list[float] = []
        for scored in (within_limits(plant), plant):
            scores = score_pairs(scored, model, plant.period(_PERIOD).start_s)
            own, across = ([s for s in scores if s.own is mine] for mine in (True, False))
            shown += [_pooled(own), _pooled(across), _signs(own), _signs(across)]
        print(f"{house:18}" + "".join(f"{value:9.2f}" for value in shown), flush=True)


def _pooled(scores: Sequence[PairScore]) -> float:
    """Error over RMS of the effect, all pairs together."""
    return float(np.sqrt(sum(s.rmse_K**2 for s in scores) / sum(s.effect_rms_K**2 for s in scores)))


def _signs(scores: Sequence[PairScore]) -> float:
    return float(np.nanmean([s.sign_right for s in scores]))


if __name__ == "__main__":
    main(sys.argv[1:])
