"""The engine: what a run records, that it can be repeated and branched, and that nothing vanishes."""

import json
import signal
import sys

import numpy as np
import pytest

from benchmarks.interventions.pool import simulate_all
from benchmarks.interventions.zones import Recorder
from thermoforce_mpc.errors import PlantError, WeatherError
from thermoforce_mpc.execution import LocalEngine
from thermoforce_mpc.plants.energyplus.engine import is_available, run_engine, weather_file
from thermoforce_mpc.plants.energyplus.zone import ZONE_WIRING, ZoneJob, ZoneSpec, zone_model

pytestmark = pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed")

HEATED = ZoneSpec("Chicago-OHare", "heating", capacity_W=4000.0, insulation_m=0.10)
COOLED = ZoneSpec("Phoenix", "cooling", capacity_W=3500.0, insulation_m=0.08)
STEPS = 96 * 2


def job(spec, setpoint, steps=STEPS, **changes):
    return ZoneJob(
        spec, 30 if spec.mode == "heating" else 180, np.full(steps, setpoint), np.full(steps, 0.5), **changes
    )


def shifted(base, at, shift):
    setpoint = base.setpoint_C.copy()
    setpoint[at:] += shift
    return ZoneJob(base.spec, base.first_day, setpoint, base.gains)


@pytest.fixture(scope="module")
def records():
    heated, cooled = job(HEATED, 21.0), job(COOLED, 25.0)
    jobs = [heated, heated, shifted(heated, 140, 2.0), cooled, shifted(cooled, 140, -2.0)]
    with LocalEngine(1) as engine:
        return simulate_all(jobs, engine)


@pytest.mark.slow
def test_same_job_gives_the_same_bits(records):
    for name in ("T_zone_C", "u", "T_out_C", "solar_W_m2"):
        assert getattr(records[0], name).tobytes() == getattr(records[1], name).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(("plain", "moved", "sign"), [(0, 2, 1.0), (3, 4, -1.0)])
def test_a_shift_changes_nothing_before_it_and_the_right_way_after(records, plain, moved, sign):
    a, b = records[plain], records[moved]
    assert a.T_zone_C[0, :141].tobytes() == b.T_zone_C[0, :141].tobytes()
    effect = b.T_zone_C[0, 141:] - a.T_zone_C[0, 141:]
    assert (sign * effect > 0.2).all()
    assert sign * effect[-1] == pytest.approx(2.0, abs=0.3)  # the loop reaches the new set-point
    assert (b.u[0, 140:150].mean() - a.u[0, 140:150].mean()) > 0.05  # more effort, whichever the sign


def test_the_loop_holds_its_set_point_and_heat_has_its_sign(records):
    heated, cooled = records[0], records[3]
    assert np.abs(heated.T_zone_C[0, 97:] - 21.0).mean() < 0.25
    assert np.abs(cooled.T_zone_C[0, 97:] - 25.0).mean() < 0.25
    assert np.allclose(heated.heat_W, 4000.0 * heated.u)
    assert np.allclose(cooled.heat_W, -3500.0 * cooled.u)
    assert heated.u.min() >= 0.0
    assert heated.u.max() <= 1.0


def test_weather_is_of_the_place_and_season(records):
    heated, cooled = records[0], records[3]
    assert heated.T_out_C.max() < 12.0 < 25.0 < cooled.T_out_C.mean()
    assert heated.time_s[0] == 30 * 86400.0
    noon, midnight = 48, 96
    assert cooled.solar_W_m2[noon] > 600.0
    assert cooled.solar_W_m2[midnight] == 0.0


def test_the_first_temperature_is_not_the_zero_of_a_stopped_run(records):
    for record in records:
        assert (record.T_zone_C > 5.0).all()


def test_an_exception_in_a_callback_is_raised():
    class Broken(Exception):
        pass

    def policy(step, T_zone_C):
        if step == 10:
            raise Broken
        return 0.5

    one = job(HEATED, 21.0, steps=96)
    with pytest.raises(Broken):
        run_engine(
            json.dumps(zone_model(HEATED, 30, 1)), weather_file("Chicago-OHare"), Recorder(one, policy), ZONE_WIRING
        )


def test_a_signal_ends_a_run_although_the_engine_holds_the_process():
    """Its handler runs at the edge of a callback, whose exceptions ctypes drops."""

    def policy(step, T_zone_C):
        if step == 10:
            signal.setitimer(signal.ITIMER_REAL, 0.02)
        return 0.5

    one, model = job(HEATED, 21.0, steps=96 * 30), json.dumps(zone_model(HEATED, 30, 30))
    handler_before = signal.signal(signal.SIGALRM, lambda *_: sys.exit(143))
    try:
        with pytest.raises(SystemExit, match="143"):
            run_engine(model, weather_file("Chicago-OHare"), Recorder(one, policy), ZONE_WIRING)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, handler_before)


def test_a_model_the_engine_refuses_names_the_reason():
    model = zone_model(HEATED, 30, 1)
    model["Construction"]["Wall"]["layer_2"] = "no such material"
    one = job(HEATED, 21.0, steps=96)
    with pytest.raises(PlantError, match=r"(?i)no such material"):
        run_engine(json.dumps(model), weather_file("Chicago-OHare"), Recorder(one, lambda step, T: 0.5), ZONE_WIRING)


def test_unknown_weather_names_what_there_is():
    with pytest.raises(WeatherError, match=r"Atlantis.*Chicago"):
        weather_file("Atlantis")


@pytest.mark.slow
def test_inputs_of_different_length_are_refused():
    with LocalEngine(1) as engine, pytest.raises(PlantError, match="differ"):
        simulate_all([ZoneJob(HEATED, 30, np.full(96, 21.0), np.full(95, 0.5))], engine)
