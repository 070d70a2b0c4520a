"""What a step and its answer cost does not grow with the steps before."""

from __future__ import annotations

import tracemalloc

import pytest

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.service.sessions import Session


def memory_of(work) -> int:
    """Most memory that `work` holds besides what there was, B: what it reads in one go. The least of some tries."""
    found = []
    tracemalloc.start()
    try:
        for _ in range(6):
            before, _ = tracemalloc.get_traced_memory()
            tracemalloc.reset_peak()
            work()
            found.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
    return min(found)


@pytest.mark.slow
def test_neither_a_step_nor_its_kpis_read_the_steps_before():
    plant = EmbeddedPlant(synthetic_weather())
    session = Session(plant, plant.period)
    session.initialize({"start_time": 20 * 86400, "warmup_period": 0})
    session.set_step({"step": 30})
    count = 0

    def step():
        nonlocal count
        count += 1
        session.advance({"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": count % 2, "ovePum_activate": 0})

    def run(steps):
        for _ in range(steps):
            step()
            session.kpi()

    run(60)
    first = [memory_of(step), memory_of(session.kpi)]
    run(1494)  # to the same place in a peak window, whose samples are read until it ends
    now_s = plant.now_s
    body = {"point_names": ["oveHeaPumY_activate", "reaTZon_y"], "start_time": now_s - 300, "final_time": now_s}
    last = [memory_of(step), memory_of(session.kpi)]
    assert last == pytest.approx(first, rel=0.5), "bytes of a step and of its KPIs, early and late"
    # And it is still right: of the last ten samples every other one was overwritten.
    on = session.results(body).payload["oveHeaPumY_activate"]
    assert on == [float((count - 10 + i) % 2) for i in range(11)]
    between = session.results(body | {"start_time": now_s - 299, "final_time": now_s - 271}).payload
    assert between == {"oveHeaPumY_activate": [], "reaTZon_y": [], "time": []}
