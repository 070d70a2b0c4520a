"""The journal of a run at a real building: explained, watched and reported as a simulated one, and never in the way."""

from __future__ import annotations

import errno
import json
import os
import re
from itertools import count
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from simple_house import power_W, simple_model
from simulated_building import RULES, START, SimulatedBuilding, mpc

from thermoforce_mpc.cli import cli
from thermoforce_mpc.experiment.explaining import alternatives_of, decision_at
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.live.building import real_run
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.screening import ReadingLimits, screened_history
from thermoforce_mpc.records.live_journal import LiveJournal
from thermoforce_mpc.report.live_view import LiveRun

HOUR = pd.Timedelta("1h")
MAP = MeasurementMap.model_validate(RULES)


def recorded(folder: Path, house, steps, controller=None, rules=MAP):
    """Control with a journal in `folder`; returns what the controller saw, by the hour of the run."""
    controller, seen = controller or mpc(), {}
    plan = controller.plan

    def looked(observation, state=None):
        seen[round((house.at - START) / HOUR)] = observation.history
        return plan(observation, state)

    controller.plan = looked
    if not (folder / "given").exists():
        simple_model().save(folder / "given")
    journal = LiveJournal(
        folder, real_run(folder, folder / "given", Path("my_house.yaml"), rules, controller.config, "x")
    )
    control(LiveBuilding(house, rules, 3600.0), controller, clock=house, steps=steps, journal=journal)
    return seen


def test_what_is_behind_the_meter_is_told_again(tmp_path):
    """The house took 400 W beside the machine, and will take 900; alternatives are above the peak that was read."""
    house = SimulatedBuilding()
    of_machine, ahead = house.measurements, house.forecast
    house.measurements = lambda: of_machine().assign(grid=lambda table: table["P"] + 400.0)
    house.forecast = lambda: ahead().assign(load=900.0)
    rules = MeasurementMap.model_validate(RULES | {"meter": "grid", "forecast": {"load": "load"}})
    peaks = {"peak_price_per_kW": 1000.0, "peak_of": "month", "at_the_meter": True}
    seen = recorded(tmp_path, house, 3, mpc(objective=peaks), rules)
    for hour in (0, 2):
        decision = decision_at(tmp_path, at(hour))
        told = decision.observation
        assert told.history.meter_W == pytest.approx(seen[hour].meter_W, nan_ok=True)
        assert told.history.meter_W[-2:] == pytest.approx(told.history.power_W[0, -2:] + 400.0, nan_ok=True)
        assert told.boundary.others_W == pytest.approx(np.full(told.boundary.time_s.size, 900.0))
        found = alternatives_of(tmp_path, decision)
        full = next(course for course in found.courses if course.name == "full")
        above_W = power_W(1.0) + 900.0 - np.nanmax(seen[hour].meter_W)
        assert above_W > 100.0
        assert full.parts["peak"] == pytest.approx(above_W, rel=0.02)


def kinds(folder):
    return [json.loads(line)["kind"] for line in (folder / "journal.jsonl").read_text().splitlines()]


def at(hour):
    return f"{START + hour * HOUR:%Y-%m-%d %H:%M}"


@pytest.mark.slow
def test_what_the_controller_saw_is_told_again_though_readings_came_late(tmp_path):
    """The logger gives the temperature of the last hour an hour late, and once a wrong one that it corrects."""
    house = SimulatedBuilding()
    live = house.measurements

    def late():
        table = live().reset_index(drop=True)
        table.loc[table["time"] > house.at - pd.Timedelta("40min"), "P"] = np.nan
        if round((house.at - START) / HOUR) == 5:
            table.loc[table["time"] >= house.at - pd.Timedelta("2h"), "out"] = 9.0
        return table

    house.measurements = late
    seen = recorded(tmp_path, house, 27)
    for hour in (0, 5, 6, 7, 23, 25, 26):
        told = decision_at(tmp_path, at(hour)).observation.history
        expected = screened_history(seen[hour], ReadingLimits(u_min=-1.0))[0]
        for name in ("time_s", "T_zone_C", "T_out_C", "u", "power_W"):
            known = getattr(expected, name)
            np.testing.assert_array_equal(getattr(told, name)[..., -known.shape[-1] :], known, err_msg=f"{name} {hour}")
    assert kinds(tmp_path).count("past") == 2


def test_a_run_is_watched_explained_and_reported(tmp_path):
    house = SimulatedBuilding()
    recorded(tmp_path, house, 6)
    view = LiveRun(tmp_path).now()
    assert view.at == f"{START + 5 * HOUR:%a %d %b %Y %H:%M}"
    assert view.state == "ended"
    rows = pd.DataFrame(house.rows[house.begun :])
    hours = rows["time"].diff().shift(-1) / HOUR
    metered_kWh = (rows["P"] * hours)[rows["time"] < START + 5 * HOUR].sum() / 1000.0
    assert view.energy_kWh == pytest.approx(metered_kWh, rel=1e-3)
    assert view.cost == pytest.approx(0.25 * view.energy_kWh)
    words = CliRunner().invoke(cli, ["explain", str(tmp_path), "--at", at(3)], catch_exceptions=False)
    assert "step 3: Sun 12 Jan 2025 03:00" in words.output
    assert "loops at the bounds" in words.output
    assert not isinstance(alternatives_of(tmp_path, decision_at(tmp_path)), str)
    assert CliRunner().invoke(cli, ["watch", str(tmp_path), "--once"]).exit_code == 0
    page = CliRunner().invoke(cli, ["report", str(tmp_path)], catch_exceptions=False)
    assert "Sun 12 Jan 2025 00:00 to Sun 12 Jan 2025 05:00" in page.output
    figures = json.loads((tmp_path / "incomplete_kpis.json").read_text())
    assert figures["kpis"]["cost_tot"] == pytest.approx(view.cost / 100.0)
    page = " ".join((tmp_path / "report.html").read_text().split())
    assert "my_house" in page
    assert re.search(r"since \w+ \d+ \w+ \d{4} \d\d:\d\d, [\d.]{1,5} scored days?", page)


def test_a_time_outside_of_the_run_is_refused_with_its_dates(tmp_path):
    recorded(tmp_path, SimulatedBuilding(), 2)
    result = CliRunner().invoke(cli, ["explain", str(tmp_path), "--at", "2025-02-12 06:00"])
    assert "ran from Sun 12 Jan 2025 00:00 to Sun 12 Jan 2025 02:00" in str(result.exception)


def test_a_run_that_was_killed_goes_on_in_its_journal(tmp_path):
    class KilledError(BaseException):
        pass

    house = SimulatedBuilding()
    wait = house.wait_until

    def killed(until):
        wait(until)
        if house.at > START + 3.2 * HOUR:
            house.wait_until = wait
            raise KilledError

    house.wait_until = killed
    with pytest.raises(KilledError):
        recorded(tmp_path, house, 24)
    house.wait_until(START + 5.01 * HOUR)
    recorded(tmp_path, house, 3)
    lines = [json.loads(line) for line in (tmp_path / "journal.jsonl").read_text().splitlines()]
    steps = [line for line in lines if line["kind"] == "step"]
    assert [line["index"] for line in steps] == list(range(7))
    begun = [(line["time_s"] - steps[0]["time_s"]) / 3600.0 for line in steps]
    assert begun == [0, 1, 2, 3, 5, 6, 7]
    assert [line["index"] for line in lines if line["kind"] == "done"] == list(range(6))
    assert [line["kind"] for line in lines].count("run") == 1
    assert LiveRun(tmp_path).now().counts == {"solved": 6}


def test_a_damaged_journal_stops_no_control_and_goes_on_from_its_last_good_record(tmp_path, caplog):
    house = SimulatedBuilding()
    recorded(tmp_path, house, 4)
    path = tmp_path / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    lines[-5] = lines[-5].replace(b"e", b"f", 1)
    path.write_bytes(b"".join(lines))
    assert len(recorded(tmp_path, house, 3)) == 3
    assert "the record is damaged" in caplog.text
    assert (tmp_path / "journal.jsonl.lost").is_file()
    assert decision_at(tmp_path, at(6)).step.before.T_zone_C[0] > 15.0


def test_the_journal_of_another_building_is_moved_aside(tmp_path, caplog):
    recorded(tmp_path, SimulatedBuilding(), 2)
    path = tmp_path / "journal.jsonl"
    path.write_text("no journal at all\n")
    recorded(tmp_path, SimulatedBuilding(), 2)
    assert (tmp_path / "journal.jsonl.1").read_text() == "no journal at all\n"
    assert "begun anew" in caplog.text
    assert kinds(tmp_path).count("step") == 2


@pytest.mark.slow
def test_a_full_disk_stops_no_control(tmp_path, caplog, monkeypatch):
    house, write, writes = SimulatedBuilding(), os.write, count()

    def full(file, data):
        if 20 <= next(writes) < 30:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(file, data)

    monkeypatch.setattr("thermoforce_mpc.records.journal.os.write", full)
    seen = recorded(tmp_path, house, 20)
    assert len(seen) == 20
    assert caplog.text.count("the journal is not written") == 1
    assert caplog.text.count("the journal is written again") == 1
    history = decision_at(tmp_path, at(19)).observation.history
    np.testing.assert_array_equal(history.T_zone_C[0, -12:], seen[19].T_zone_C[0, -12:])


def test_a_journal_that_is_removed_before_the_end_stops_no_control(tmp_path, caplog, monkeypatch):
    """Once what ends it could not be written, closing it ended control with an error of its own."""
    applied = LiveJournal.applied

    def removed(self, block, start_s):
        applied(self, block, start_s)
        (tmp_path / "journal.jsonl").unlink()

    monkeypatch.setattr(LiveJournal, "applied", removed)
    recorded(tmp_path, SimulatedBuilding(), 1)
    assert "was removed during the run" in caplog.text


def test_a_run_at_a_building_is_not_resumed_as_a_simulation(tmp_path):
    recorded(tmp_path, SimulatedBuilding(), 2)
    result = CliRunner().invoke(cli, ["resume", str(tmp_path)])
    assert "start `tf-mpc control` again" in str(result.exception)
