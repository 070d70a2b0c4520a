"""The measurement of plans of many buildings counts what it says."""

from __future__ import annotations

from dataclasses import replace

import pytest
from simple_house import SimpleHouse, simple_model

from benchmarks.fleet.plan_many import Situation, in_words, measure
from controllers import MPCConfig
from thermoforce_mpc.data import HOUR_S, Observation
from thermoforce_mpc.model.card import Competence

CONFIG = MPCConfig(step_s=None, horizon_h=24.0, free_response={"name": "linear_weather"})


def instants(n: int) -> tuple[Observation, ...]:
    house = SimpleHouse()
    house.reset(10 * 86400.0, 4 * 86400.0)
    seen = []
    for _ in range(n):
        seen.append(Observation(house.past(HOUR_S), house.forecast(24 * HOUR_S, HOUR_S)))
        house.advance(0.5, HOUR_S)
    return tuple(seen)


def test_rate_shares_and_solved_plans_are_those_of_the_plans_made():
    condemned = replace(simple_model().only.card, competence=Competence(False, reasons=("it errs by 7 K",)))
    models = {f"house {i}": simple_model() for i in range(3)} | {"bad": replace(simple_model(), cards=(condemned,))}
    found = measure({name: Situation(model, CONFIG, instants(3), None) for name, model in models.items()}, 1)
    assert (found.buildings, found.workers) == (4, 1)
    assert found.solved == pytest.approx(0.75)
    assert 0.0 < found.solve_ms + found.forecast_ms < found.plan_ms
    # All else that is done per plan takes time, too.
    assert found.per_second < 1000.0 / found.plan_ms * 1.5
    assert "4 buildings in 1 processes" in in_words(found)
    assert "solved 75.0%" in in_words(found)
