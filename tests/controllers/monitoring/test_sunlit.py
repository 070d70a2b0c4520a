"""Sun on a zone sensor that did not show in the record of identification is found later, at night."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, simple_model

from controllers import MPCConfig, ThermoForceMPC
from controllers.mpc.config import DeadlineConfig
from controllers.state_classes import STATE_CLASSES
from thermoforce_mpc.data import DAY_S, Boundary, Observation, Plan, PlanStatus, Record
from thermoforce_mpc.execution.beside import CallsBeside
from thermoforce_mpc.loop.probing import Probing
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.state_file import StateFormat

# Three sunny days in March of a very light house whose sensor reads 3.1 K too much in the south sun.
HOUSE, START_S, DAY = draw_house(501, 34), 66 * DAY_S, 96


def _record(house) -> Record:
    plant = GeneratedHousePlant(house)
    run = Probing(plant, START_S, seed=1, layout=plant.testcase.layout)
    run.go_on(3.0)
    return replace(run.record, names=simple_model().names)


@pytest.fixture(scope="module")
def sunlit() -> Record:
    return _record(HOUSE)


@pytest.fixture(scope="module")
def shaded() -> Record:
    return _record(replace(HOUSE, sun_bias_K=0.0))


def irradiation_Wh_m2(record: Record) -> float:
    """Irradiation of a record."""
    return float(record.solar_W_m2.sum() * 0.25)


@pytest.fixture(autouse=True)
def time_to_compile(monkeypatch):
    """The first look compiles what it runs."""
    monkeypatch.setattr(DeadlineConfig, "look_s", 600.0)


def _controller(**options) -> ThermoForceMPC:
    return ThermoForceMPC(simple_model(), MPCConfig(step_s=900.0, **options), free_response=OutdoorResponse())


def _planned(controller: ThermoForceMPC, record: Record, state: object) -> Plan:
    """A plan at the end of `record`, under steady dull weather."""
    time_s = record.time_s[-1] + 900.0 * np.arange(2 * DAY + 1)
    same = np.ones_like(time_s)
    ahead = Boundary(time_s, 5 * same, 0 * same, 5 * same, 20 * same, 24 * same, 0.25 * same, 0.167 * same)
    return controller.plan(Observation(record, ahead), state)


def _looked(controller: ThermoForceMPC, record: Record, state: object) -> tuple[Plan, Plan]:
    """The plan in which a look begins, a step before the end of `record`, and that in which its answer is taken."""
    asks = _planned(controller, record.slice(0, record.n_steps - 1), state)
    return asks, _planned(controller, record, asks.state)


@pytest.fixture(autouse=True)
def calls_beside(monkeypatch) -> CallsBeside:
    """Calls beside the steps, of each test its own: an answer is remembered by what was looked at."""
    calls = CallsBeside()
    monkeypatch.setattr("controllers.monitoring.sun_on_sensors.beside", lambda: calls)
    return calls


@pytest.fixture(scope="module")
def found_at_night(sunlit):
    """Plans of a controller a day before the end of the record, at noon after it and twice in the night at its end."""
    kept: list[Plan] = []

    def plans() -> list[Plan]:
        if not kept:
            controller = _controller()
            for end in (DAY, DAY // 2, 1, 0):
                state = kept[-1].state if kept else None
                kept.append(_planned(controller, sunlit.slice(0, sunlit.n_steps - end), state))
        return kept

    return plans


@pytest.mark.slow
def test_it_is_found_in_the_night_after_it_shone_and_taken_off(sunlit, found_at_night, tmp_path, caplog):
    caplog.set_level("INFO")
    controller, (begun, noon, asks, night) = _controller(), found_at_night()
    assert (begun.state.sun.looked_s, begun.state.sun.found) == (float(sunlit.time_s[-1 - DAY]), (None,))
    assert begun.state.sun.sun_Wh_m2 == 0.0, "nothing was looked at yet"
    assert noon.news == ""
    assert noon.state.sun == begun.state.sun, "in the sun nothing is looked for"
    assert asks.state.sun.found == (None,)
    assert asks.news == ""
    assert "a look for sun on zone sensors runs beside the steps" in caplog.text
    (sun,) = night.state.sun.found
    assert sun.azimuth_deg == 180.0
    assert sun.probability > 0.95
    assert night.news.startswith("the zone sensor stands in the sun from the south")
    assert night.why.startswith(night.news)
    states = StateFormat(STATE_CLASSES)
    states.write(tmp_path / "state.npz", night.state)
    assert states.read(tmp_path / "state.npz").sun == night.state.sun
    # At noon the plan begins from the room, below what the sensor reads.
    again = sunlit.slice(0, sunlit.n_steps - DAY // 2)
    later = _planned(controller, again, replace(night.state, last_s=None))
    plain = _planned(controller, again, None)
    below = plain.T_free_now_C - later.T_free_now_C
    assert below == pytest.approx(sun.part_K(again.time_s, again.solar_W_m2)[-1], abs=0.05)
    assert below > 1.0


@pytest.mark.slow
def test_what_later_days_contradict_is_taken_off_no_longer(shaded, found_at_night):
    controller, found = _controller(), found_at_night()[-1].state.sun
    state = _planned(controller, shaded.slice(0, shaded.n_steps - DAY), None).state
    state = replace(state, sun=replace(found, sun_Wh_m2=state.sun.sun_Wh_m2))
    _, night = _looked(controller, shaded, state)
    assert night.state.sun.found == (None,)
    assert "no sun on the zone sensor any more" in night.news


def test_it_is_looked_for_again_only_after_more_sun_and_where_it_was_asked_for(sunlit):
    controller = _controller()
    begun = _planned(controller, sunlit.slice(0, sunlit.n_steps - DAY), None).state
    seen = replace(begun, sun=replace(begun.sun, sun_Wh_m2=0.8 * irradiation_Wh_m2(sunlit)))
    assert _planned(controller, sunlit, seen).state.sun == seen.sun
    model = simple_model()
    card = replace(model.cards[0], config={**model.cards[0].config, "sun_on_sensor": False})
    unasked = ThermoForceMPC(replace(model, cards=(card,)), MPCConfig(step_s=900.0), free_response=OutdoorResponse())
    for other in (_controller(sensor={"enabled": False}), unasked):
        state = _planned(other, sunlit.slice(0, sunlit.n_steps - DAY), None).state
        _, night = _looked(other, sunlit, state)
        assert night.state.sun.found == (None,)
        assert night.news == ""


def test_a_look_that_fails_costs_no_plan(sunlit, monkeypatch):
    controller = _controller()
    state = _planned(controller, sunlit.slice(0, sunlit.n_steps - DAY), None).state

    def broken(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("controllers.monitoring.sun_on_sensors.sun_on_sensor", broken)
    _, night = _looked(controller, sunlit, state)
    assert night.status is PlanStatus.SOLVED
    assert "sun on the sensors could not be looked for (LinAlgError: Singular matrix)" in night.news
    later = _planned(controller, sunlit, replace(night.state, last_s=None))
    assert later.news == "", "it is tried again in another night"


def test_a_look_runs_beside_the_steps_and_counts_when_it_is_over(sunlit, monkeypatch, calls_beside):
    """No step waits longer than its deadline, and an answer that comes later is not thrown away."""
    monkeypatch.setattr(DeadlineConfig, "look_s", 0.05)
    controller, goes_on = _controller(), threading.Event()
    state = _planned(controller, sunlit.slice(0, sunlit.n_steps - DAY), None).state
    sun = SunOnSensor(2.0, 0.3, 0.995, 180.0, 120.0, 50.0, 43_200.0)

    def found(*_: object) -> SunOnSensor:
        goes_on.wait(20.0)
        return sun

    monkeypatch.setattr("controllers.monitoring.sun_on_sensors.sun_on_sensor", found)
    asks = _planned(controller, sunlit.slice(0, sunlit.n_steps - 2), state)
    late = _planned(controller, sunlit.slice(0, sunlit.n_steps - 1), asks.state)
    assert late.status is PlanStatus.SOLVED
    assert late.news == "the look for sun on zone sensors is not over: its answer counts when it is there"
    assert late.state.sun.found == (None,)
    goes_on.set()
    assert calls_beside.answered(late.state.sun.asked, 20.0)
    there = _planned(controller, sunlit, late.state).state.sun
    assert (there.found, there.asked, there.looked_s) == ((sun,), "", asks.state.sun.asked_s)


def test_a_look_that_was_lost_with_its_process_is_made_again(sunlit, monkeypatch):
    monkeypatch.setattr("controllers.monitoring.sun_on_sensors.sun_on_sensor", lambda *_: None)
    controller = _controller()
    state = _planned(controller, sunlit.slice(0, sunlit.n_steps - DAY), None).state
    asks = _planned(controller, sunlit.slice(0, sunlit.n_steps - 2), state)
    restarted = CallsBeside()
    monkeypatch.setattr("controllers.monitoring.sun_on_sensors.beside", lambda: restarted)
    again, over = _looked(controller, sunlit, asks.state)
    assert again.news == "a look for sun on zone sensors is made again, since its answer was lost"
    assert over.state.sun.asked == ""
    assert over.state.sun.looked_s == again.state.sun.asked_s > asks.state.sun.asked_s


def test_days_that_tell_nothing_change_nothing(sunlit, found_at_night):
    controller, found = _controller(), found_at_night()[-1].state
    unknown = replace(sunlit, u=np.full_like(sunlit.u, np.nan))
    state = replace(found, sun=replace(found.sun, sun_Wh_m2=0.0), last_s=None)
    asks, over = _looked(controller, unknown, state)
    assert asks.state.sun.asked
    assert over.state.sun.asked == ""
    assert over.state.sun.found == found.sun.found
