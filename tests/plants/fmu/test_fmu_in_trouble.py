"""An FMU that hangs, creeps, fails or crashes ends in time, or goes on with another tolerance, and it is said."""

from __future__ import annotations

import logging
import time

import numpy as np
import pytest

pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu")
from benchmarks.chaos.fmu.building import build_troubled
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.fmu import FmuPlant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.plants.worker_process import PASSED

pytestmark = pytest.mark.slow
TESTCASE = load_testcase("bestest_hydronic_heat_pump")
PATIENCE_S = 1.0
TROUBLES = {
    "SLEEPS": "the FMU's step from day 30.0104 took more than 1 s and was ended",
    "CREEPS": "the FMU's step from day 30.0208 took more than 1 s and was ended",
    "FAILS": "the FMU could not simulate at day 30.0104",
    "CRASHES": "the FMU's process was ended by signal SIGSEGV at day 30.0104",
}


@pytest.fixture(autouse=True)
def told_by_the_environment(monkeypatch):
    monkeypatch.setenv(PASSED, "FMU_HOUSE_*")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return build_troubled(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="module")
def calm(file):
    return run_for_two_hours(file)


def run_for_two_hours(file):
    with FmuPlant(file, TESTCASE, patience_s=PATIENCE_S) as plant:
        plant.reset(30 * DAY_S, 0.0)
        measurements = [plant.advance(u, HOUR_S) for u in (0.5, 1.0)]
        return measurements, plant.past(900.0), plant.info, plant.restarts


@pytest.mark.parametrize("trouble", TROUBLES)
def test_trouble_at_every_tolerance_ends_in_time_and_says_what_was_tried(file, monkeypatch, trouble):
    monkeypatch.setenv(f"FMU_HOUSE_{trouble}_ON_DAY", "30.02")
    with FmuPlant(file, TESTCASE, patience_s=PATIENCE_S) as plant:
        plant.reset(30 * DAY_S, 0.0)
        began = time.monotonic()
        with pytest.raises(PlantError, match=TROUBLES[trouble]) as caught:
            plant.advance(0.5, HOUR_S)
        assert time.monotonic() - began < 3 * PATIENCE_S + 20.0, "three processes, each with its limit"
        for tolerance in ("1e-07", "1e-05"):
            assert f"restarted with tolerance {tolerance}: {TROUBLES[trouble]}" in str(caught.value)
        with pytest.raises(PlantError, match="reset the plant"):
            plant.advance(0.5, HOUR_S)
        monkeypatch.delenv(f"FMU_HOUSE_{trouble}_ON_DAY")
        plant.reset(30 * DAY_S, 0.0)
        assert plant.advance(0.5, HOUR_S).time_s == 30 * DAY_S + HOUR_S
        assert plant.restarts == ()
        assert plant.info.details["restarts"].count("restarted") == 2, "the run before is not forgotten"


@pytest.mark.parametrize("trouble", ["SLEEPS", "CRASHES"])
def test_it_goes_on_with_a_tighter_tolerance_from_the_same_course(file, calm, monkeypatch, caplog, trouble):
    measurements, past, info, none = calm
    assert none == ()
    assert "restarted" not in info.description
    monkeypatch.setenv(f"FMU_HOUSE_{trouble}_ON_DAY", "30.05")
    monkeypatch.setenv("FMU_HOUSE_TROUBLED_AT", "1e-6")
    with caplog.at_level(logging.WARNING):
        troubled, its_past, info, restarts = run_for_two_hours(file)
    assert troubled[0] == measurements[0], "what was returned before the trouble stays"
    assert troubled[1].T_zone_C == pytest.approx(measurements[1].T_zone_C - 1e-3, abs=1e-9), (
        "1 mK a decade of tolerance"
    )
    np.testing.assert_allclose(its_past.T_zone_C[:, :5], past.T_zone_C[:, :5], atol=1e-9)
    (restart,) = restarts
    assert restart.startswith("restarted with tolerance 1e-07: the FMU")
    assert info.description.endswith(restart)
    assert info.details["restarts"] == restart
    assert "it repeats 0.0833 days" in caplog.text
    assert "s already; it is ended after 1 s" in caplog.text or trouble == "CRASHES"


def test_trouble_while_it_repeats_leads_to_the_looser_tolerance(file, monkeypatch):
    monkeypatch.setenv("FMU_HOUSE_FAILS_ON_DAY", "30.02")
    monkeypatch.setenv("FMU_HOUSE_TROUBLED_AT", "1e-6 1e-7")
    measurements, _, _, restarts = run_for_two_hours(file)
    assert [r.split(":")[0] for r in restarts] == [
        "restarted with tolerance 1e-07",
        "restarted with tolerance 1e-05",
    ]
    assert measurements[-1].time_s == 30 * DAY_S + 2 * HOUR_S


def test_inputs_that_no_tolerance_survives_come_a_minute_later(file, calm, monkeypatch, caplog):
    monkeypatch.setenv("FMU_HOUSE_FAILS_SWITCHED_AT_S", str(30 * DAY_S + HOUR_S))
    with caplog.at_level(logging.WARNING):
        measurements, past, info, restarts = run_for_two_hours(file)
    assert [r.split(":")[0] for r in restarts] == [
        "restarted with tolerance 1e-07",
        "restarted with tolerance 1e-05",
        "restarted with tolerance 1e-07 and its latest inputs 60 s later",
    ]
    assert "its latest inputs 60 s later" in caplog.text
    assert info.details["restarts"].count("restarted") == 3
    assert measurements[0] == calm[0][0], "what was returned before stays"
    assert measurements[1].T_zone_C == pytest.approx(calm[0][1].T_zone_C, abs=0.05)
    assert past.time_s.size == calm[1].time_s.size
    with FmuPlant(file, TESTCASE, patience_s=PATIENCE_S) as plant:  # a run that is repeated comes the same way
        plant.reset(30 * DAY_S, 0.0)
        first = plant.advance(0.5, HOUR_S)
        plant.restart_as(restarts)
        assert [first, plant.advance(1.0, HOUR_S)] == measurements


def test_a_run_that_is_repeated_restarts_where_it_was_told(file, monkeypatch, tmp_path):
    monkeypatch.setenv("FMU_HOUSE_SLEEPS_ON_DAY", "30.05")
    monkeypatch.setenv("FMU_HOUSE_UNLESS", str(tmp_path / "happened"))
    then, _, _, restarts = run_for_two_hours(file)
    assert len(restarts) == 1
    with FmuPlant(file, TESTCASE, patience_s=PATIENCE_S) as plant:
        plant.reset(30 * DAY_S, 0.0)
        first = plant.advance(0.5, HOUR_S)
        plant.restart_as(restarts)
        assert [first, plant.advance(1.0, HOUR_S)] == then
        assert plant.restarts == restarts


def test_a_long_warm_up_is_no_trouble(file, monkeypatch):
    """Five pieces of a warm-up of 0.6 s each take longer than the limit for one."""
    monkeypatch.setenv("FMU_HOUSE_LAGS_S", "0.02")
    with FmuPlant(file, TESTCASE, patience_s=2.0) as plant:
        began = time.monotonic()
        plant.reset(30 * DAY_S, 1.25 * HOUR_S)
        assert time.monotonic() - began > 2.0
        assert plant.restarts == ()
