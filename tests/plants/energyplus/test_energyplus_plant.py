"""The engine as a plant: steps of a controller, its clock, its record, its end."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT
from waiting import LONG_S, children, wait_for

from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.energyplus.engine import is_available
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import Scenario

pytestmark = pytest.mark.slow

needs_engine = pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed")
HEATED, COOLED = load_testcase("energyplus:heating_chicago"), load_testcase("energyplus:cooling_phoenix")


def plant_of(testcase):
    from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant

    return EnergyPlusPlant(testcase)


@needs_engine
def test_it_is_a_plant_that_remembers_what_it_was_told():
    with plant_of(HEATED) as plant:
        assert isinstance(plant, Plant)
        first = plant.reset(20.25 * DAY_S, 0.5 * DAY_S)
        assert first.time_s == 20.25 * DAY_S
        assert np.isnan(first.u)
        assert plant.kpis() == dict.fromkeys(plant.kpis(), 0.0), "nothing counts before the warm-up is over"
        warm = plant.advance(1.0, HOUR_S)
        assert (warm.time_s, warm.u[0], warm.heat_W[0]) == (20.25 * DAY_S + HOUR_S, 1.0, 4000.0)
        assert warm.T_zone_C > first.T_zone_C + 1.0
        cold = plant.advance(0.0, HOUR_S)
        assert cold.T_zone_C < warm.T_zone_C - 1.0
        assert cold.power_W == 0.0
        native = plant.advance(None, 900.0)
        past = plant.past(900.0)
        assert past.n_steps == 12 * 4 + 9
        assert past.time_s[-1] == native.time_s
        assert (past.u[0, -9:-5] == 1.0).all()
        assert (past.u[0, -5:-1] == 0.0).all()
        assert past.T_zone_C[0, -1] == pytest.approx(native.T_zone_C)
        kpis = plant.kpis()
        # An hour at 4 kW of heat, at the efficiency of -10 to 5 °C outdoors, and nothing but the thermostat since.
        assert 4.0 / 48 / 4.2 < kpis["ener_tot"] < 4.0 / 48 / 2.5
        assert kpis["ener_tot"] == pytest.approx(past.power_W[0, -9:].sum() / 4 / 1e3 / 48)
        assert kpis["pele_tot"] == pytest.approx(past.power_W[0, -9:].max() / 1e3 / 48)
        assert kpis["cost_tot"] == pytest.approx(0.2535 * kpis["ener_tot"])


@needs_engine
def test_electric_power_is_that_of_the_machine_described():
    from thermoforce_mpc.plants.energyplus.zone import electric_power_W

    heat = electric_power_W(HEATED.energyplus, "heating", np.array([4000.0]), np.array([-5.0]))
    assert heat == pytest.approx(4000.0 * 40.0 / (0.40 * 308.15))
    cold = electric_power_W(COOLED.energyplus, "cooling", np.array([-3500.0, -3500.0]), np.array([42.0, 15.0]))
    assert cold == pytest.approx([3500.0 * 30.0 / (0.30 * 285.15), 3500.0 * 15.0 / (0.30 * 285.15)])


@needs_engine
def test_the_forecast_is_the_weather_that_comes_and_the_bounds_are_those_of_the_thermostat():
    with plant_of(COOLED) as plant:
        plant.reset(186 * DAY_S, 0.0)
        context = plant.forecast(DAY_S, HOUR_S)
        plant.advance(None, DAY_S)
        came = plant.past(HOUR_S)
        assert context.T_out_C == pytest.approx(came.T_out_C, abs=0.5)
        assert np.abs(context.solar_W_m2 - came.solar_W_m2).max() < 60.0
        assert context.upper_C[0, 0] == 27.0
        assert context.upper_C[0, 12] == 25.0
        assert (context.lower_C == 22.0).all()
        day = came.T_zone_C[0, 8:23]
        assert np.abs(day - 24.7).mean() < 0.4, "the plant's own thermostat keeps inside the bound"
        assert (came.heat_W <= 0.0).all()


@needs_engine
def test_the_same_actions_give_the_same_bits():
    def run(plant):
        plant.reset(20 * DAY_S, 6 * HOUR_S, "dynamic")
        for u in (0.3, None, 0.8):
            plant.advance(u, 900.0)
        return plant.past(900.0)

    with plant_of(HEATED) as plant:
        a, b = run(plant), run(plant)
        assert a.T_zone_C.tobytes() == b.T_zone_C.tobytes()
        assert a.u.tobytes() == b.u.tobytes()


@needs_engine
def test_what_cannot_be_done_is_refused_and_the_process_ends_with_the_plant():
    before, plant = children(), plant_of(HEATED)
    with pytest.raises(InputError, match="call reset"):
        plant.advance(0.5, 900.0)
    plant.reset(0.0, 0.0)
    with pytest.raises(InputError, match="step of 300 s"):
        plant.advance(0.5, 450.0)
    with pytest.raises(InputError, match="from 0 to 1"):
        plant.advance(1.5, 900.0)
    with pytest.raises(InputError, match="unknown tariff"):
        plant.reset(0.0, 0.0, "free")
    with pytest.raises(InputError, match="peak_heat_day"):
        plant.period("peak_cool_day")
    (process,) = children() - before
    os.kill(process, signal.SIGKILL)
    with pytest.raises(PlantError, match="EnergyPlus' process was ended by signal SIGKILL at day 0"):
        plant.advance(0.5, 900.0)
    with pytest.raises(PlantError, match="reset the plant"):
        plant.advance(0.5, 900.0)
    plant.reset(0.0, 0.0)
    plant.close()
    plant.close()
    assert children() == before


@needs_engine
def test_a_scenario_runs_to_its_end(tmp_path):
    before = children()
    out = tmp_path / "run"
    command = ["run", "--testcase", "energyplus:heating_chicago", "--period", "20", "--days", "0.25", "--quiet"]
    done = CliRunner().invoke(cli, [*command, "--controller", "thermostat", "--baselines", "native", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert (out / "report.html").is_file()
    assert children() == before


def test_without_the_engine_it_says_what_to_install(monkeypatch):
    from thermoforce_mpc.experiment.experiment import Experiment
    from thermoforce_mpc.plants.energyplus import engine

    monkeypatch.setattr(engine.importlib.util, "find_spec", lambda name: None)
    scenario = Scenario(testcase="energyplus:heating_chicago")
    with pytest.raises(ConfigError, match=r"pip install 'thermoforce-mpc\[energyplus\]'"):
        Experiment.of(scenario)


def test_its_own_weather_is_not_replaced_in_silence():
    from thermoforce_mpc.experiment.experiment import Experiment

    scenario = Scenario(testcase="energyplus:heating_chicago", plant={"weather": "Brussels.mos"})
    with pytest.raises(ConfigError, match=r"plant\.weather"):
        Experiment.of(scenario)


@needs_engine
@pytest.mark.parametrize(
    ("hangs_at", "what"), [(-1, "EnergyPlus' warm-up before day 20"), (15, "EnergyPlus' step from day 20.0521")]
)
def test_an_engine_that_hangs_is_ended_in_time(monkeypatch, caplog, hangs_at, what):
    import hanging_zone

    from thermoforce_mpc.plants.energyplus import process, zone

    before = children()
    monkeypatch.setenv("PYTHONPATH", str(Path(hanging_zone.__file__).parent))
    monkeypatch.setattr(zone, "ZoneActing", lambda job: hanging_zone.Hanging(job, hangs_at))
    monkeypatch.setattr(process, "START_S", 20.0 if hangs_at > 0 else 2.0)
    with zone.EnergyPlusPlant(HEATED, patience_s=2.0) as hanging:
        began = time.monotonic()
        with pytest.raises(PlantError, match=f"{what} took more than 2 s and was ended.*patience_min"):
            hanging.reset(20.25 * DAY_S, 0.25 * DAY_S)
        assert time.monotonic() - began < 20.0
        assert re.search(rf"{what} takes 1(\.\d+)? s already; it is ended after 2 s", caplog.text)
    assert children() == before


@needs_engine
def test_an_engine_that_hangs_ends_with_a_run_that_is_killed(tmp_path, monkeypatch):
    import hanging_zone

    mark = tmp_path / "hangs"
    monkeypatch.setenv("PYTHONPATH", str(Path(hanging_zone.__file__).parent))
    run = multiprocessing.get_context("spawn").Process(target=hanging_zone.hang, args=(str(mark),))
    run.start()
    wait_for("the engine's warm-up", lambda: mark.exists() and mark.read_text())
    engine = Path("/proc") / mark.read_text()
    assert engine.exists()
    run.kill()
    run.join()
    wait_for("the end of the engine's process", lambda: not engine.exists())


@needs_engine
def test_a_script_needs_no_guard(tmp_path):
    """The engine's process does not import the script that started it."""
    script = tmp_path / "script.py"
    script.write_text(
        "from thermoforce_mpc.plants.energyplus.zone import EnergyPlusPlant\n"
        "from thermoforce_mpc.plants.testcases import load_testcase\n"
        "with EnergyPlusPlant(load_testcase('energyplus:heating_chicago')) as plant:\n"
        "    print(plant.reset(0.0, 0.0).time_s)\n"
    )
    done = subprocess.run(
        [sys.executable, script],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "0.0\n", "")
