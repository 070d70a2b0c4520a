"""`tf-mpc watch`: the view of a run from its journal as it grows, in the terminal and as a page."""

from __future__ import annotations

import json
import shutil
import threading
from dataclasses import replace

import numpy as np
import pytest
import requests
from click.testing import CliRunner
from faults import FaultyHouse
from rich.console import Console
from run_folders import experiment_on
from simple_house import SimpleHouse, simple_model
from two_houses import TwoHouses, two_model
from waiting import LONG_S

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.live.watch import shown
from thermoforce_mpc.data import DAY_S, HOUR_S, Period, PlanStatus
from thermoforce_mpc.errors import InputError, PlantError
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.records.journal import Journal, JournalError, JournalTail, read_journal
from thermoforce_mpc.records.run_folder import LOCK, in_use, sole_use
from thermoforce_mpc.report.live_view import LiveRun, ZoneNow
from thermoforce_mpc.service.live_page import page_server
from thermoforce_mpc.service.server import running

OPTIONS = {"step_s": 3600, "horizon_h": 12, "gate": {"enabled": False}, "free_response": {"name": "linear_weather"}}


def run(folder, plant, model, hours: float = 12):
    folder.mkdir(exist_ok=True)
    book = RunBook.begin(folder, experiment_on(plant), ["tf-mpc", "run"])
    journaled = book.connect()
    journaled.noted("loop", {"controller": "thermoforce_mpc"})
    controller = ThermoForceMPC(model, MPCConfig(**OPTIONS))
    result = run_closed_loop(
        journaled, controller, Period("test", 10 * DAY_S, hours * HOUR_S, 2 * DAY_S), keeper=journaled
    )
    book.journal.close()
    return result


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    folder = tmp_path_factory.mktemp("single")
    return folder, run(folder, SimpleHouse(), simple_model())


def cut(folder, there, kind: bytes, number: int):
    """The journal as it was right after the `number`th record of a kind."""
    lines = (folder / "journal.jsonl").read_bytes().split(b"\n")
    at = [i for i, line in enumerate(lines) if b'"kind":"%s"' % kind in line][number]
    there.mkdir(exist_ok=True)
    (there / "journal.jsonl").write_bytes(b"\n".join(lines[: at + 1]) + b"\n")
    return there


def cheap_heat(house, boundary):
    """Heat comes by a carrier at a tenth of the price of electricity."""
    return replace(boundary, heating_price_per_kWh=0.1 * boundary.price_per_kWh)


def test_what_heats_with_a_carrier_of_its_own_costs_its_price(tmp_path):
    result = run(tmp_path / "gas", FaultyHouse(says=cheap_heat), simple_model(), hours=6)
    view = LiveRun(tmp_path / "gas").now()
    assert view.energy_kWh == pytest.approx(result.kpis["ener_tot"])
    assert view.cost == pytest.approx(0.1 * 0.25 * result.kpis["ener_tot"])


def test_cost_energy_and_discomfort_so_far_are_those_of_the_plant(single):
    folder, result = single
    view = LiveRun(folder).now()
    assert view.discomfort_Kh == pytest.approx(result.kpis["tdis_tot"], abs=1e-6)
    assert view.energy_kWh == pytest.approx(sum(s.power_W[0] * s.duration_s for s in result.samples) / 3.6e6)
    paid = sum(s.power_W[0] * s.duration_s / 3.6e6 * s.price_per_kWh[0] for s in result.samples)
    assert view.cost == pytest.approx(paid)
    assert view.counts == {"solved": 12}
    assert view.state == "running", "there are no results: as far as the journal says it goes on"
    last = result.samples[-1]
    assert [zone.T_C for zone in view.zones] == last.T_zone_C.tolist()
    assert len(view.past) == 12


@pytest.mark.slow
@pytest.mark.parametrize("lacking", [("price_per_kWh", "heating_price_per_kWh"), ("lower_C",)])
def test_what_a_forecast_does_not_say_counts_as_in_the_run(tmp_path, lacking):
    def says(house, boundary):
        """Neither price nor bound of the present hour."""
        known = {name: getattr(boundary, name).copy() for name in lacking}
        for values in known.values():
            values[..., 0] = np.nan
        return replace(boundary, **known)

    result = run(tmp_path / "holes", FaultyHouse(says=says), simple_model(), hours=24)
    view = LiveRun(tmp_path / "holes").now()
    assert view.cost == pytest.approx(0.25 * view.energy_kWh)
    assert view.discomfort_Kh == pytest.approx(result.kpis["tdis_tot"], abs=0.02)
    assert result.kpis["tdis_tot"] > 0.1


def test_a_zone_without_bounds_is_not_said_to_be_outside_them():
    zone = ZoneNow("living", 21.0, float("nan"), float("nan"))
    assert np.isnan(zone.outside_K)
    assert ZoneNow("living", float("nan"), 20.0, 24.0).outside_K == 0.0
    assert ZoneNow("living", 19.0, 20.0, 24.0).outside_K == 1.0


def test_a_run_is_followed_as_it_grows_to_the_same_view(single, tmp_path):
    folder, _ = single
    live = None
    for number in range(12):
        for kind in (b"step", b"done"):
            there = cut(folder, tmp_path / "growing", kind, number)
            with (there / "journal.jsonl").open("ab") as file:
                file.write(b'{"n": 99, "ki')  # a record that is being written
            live = live or LiveRun(there)
            view = live.now()
            assert sum(view.counts.values()) == number + (kind == b"done")
            assert view.time_s == 10 * DAY_S + HOUR_S * (number + (kind == b"done"))
            assert view.plan[0].time_s == 10 * DAY_S + HOUR_S * (number + 1)
    assert live.now().to_json() | {"run": ""} == LiveRun(folder).now().to_json() | {"run": ""}


def test_several_zones_and_a_step_under_way(tmp_path):
    run(tmp_path / "whole", TwoHouses(), two_model(), hours=3)
    view = LiveRun(cut(tmp_path / "whole", tmp_path / "cut", b"step", 2)).now()
    assert [zone.name for zone in view.zones] == ["bath", "hall"]
    assert view.actuators == ("radiator", "floor")
    assert len(view.levels) == len(view.acting) == len(view.plan[0].u) == 2
    done = CliRunner().invoke(cli, ["watch", str(tmp_path / "cut"), "--once"])
    assert done.exit_code == 0, done.output
    for word in ("bath", "hall", "radiator", "floor", "outdoors", "acts: ", "Plan", "so far: cost"):
        assert word in done.output


def test_without_a_power_meter_there_is_no_cost(tmp_path):
    house = FaultyHouse(shows=lambda house, seen: replace(seen, power_W=np.array([np.nan])))
    run(tmp_path, house, simple_model(), hours=2)
    view = LiveRun(tmp_path).now()
    assert np.isnan([view.cost, view.energy_kWh]).all()
    told = CliRunner().invoke(cli, ["watch", str(tmp_path), "--once"]).output
    assert "so far: cost –, energy –, discomfort 0." in told


def test_less_than_an_hour_of_a_plan_is_its_first_steps(single):
    told = CliRunner().invoke(cli, ["watch", str(single[0]), "--once", "--hours", "0.1"]).output
    assert f"{LiveRun(single[0]).now().plan[0].T_C[0]:.2f}" in told.split("bounds")[-1]
    told = CliRunner().invoke(cli, ["explain", str(single[0]), "--hours", "0.1"]).output
    assert "day 10 12:00" in told.split("Alternatives")[0].split("Plan, the first 0.1")[1]


def test_a_narrow_terminal_shows_all_figures(tmp_path, monkeypatch):
    run(tmp_path, TwoHouses(), two_model(), hours=3)
    view = LiveRun(tmp_path).now()
    monkeypatch.setenv("COLUMNS", "60")
    told = CliRunner().invoke(cli, ["watch", str(tmp_path), "--once"]).output
    assert "…" not in told
    assert max(map(len, told.splitlines())) <= 60
    for zone, planned in zip(view.zones, view.plan[7].T_C, strict=True):
        for figure in (f"{zone.T_C:.2f} °C", f"{zone.lower_C:g}–{zone.upper_C:g}", f"{planned:.2f}"):
            assert figure in told


def test_the_end_of_a_run_is_said(single, tmp_path):
    shutil.copy(single[0] / "journal.jsonl", tmp_path)
    (tmp_path / "INCOMPLETE.txt").write_text("This run did not finish: the plant is gone\n")
    view = LiveRun(tmp_path).now()
    assert view.state == "ended early"
    assert "the plant is gone" in CliRunner().invoke(cli, ["watch", str(tmp_path)]).output
    for name in ("manifest.json", "report.html"):
        (tmp_path / name).touch()
    assert LiveRun(tmp_path).now().state == "finished"
    assert shown(view, 3.0, Console())


def test_a_run_that_was_killed_is_not_under_way(single, tmp_path):
    shutil.copy(single[0] / "journal.jsonl", tmp_path)
    with sole_use(tmp_path):
        assert LiveRun(tmp_path).now().state == "running"
    assert LiveRun(tmp_path).now().state == "running", "nothing says how it ended, as of a copy"
    (tmp_path / LOCK).touch()  # a process that is killed leaves it
    for _ in range(2):  # looking changes nothing
        view = LiveRun(tmp_path).now()
        assert view.state == "ended early"
        assert f"it was killed, or its machine stopped; `tf-mpc resume {tmp_path}` goes on" in view.said


def test_who_looks_whether_a_folder_is_in_use_keeps_nobody_out(tmp_path):
    """`watch` looks again and again, while a run is resumed."""
    (tmp_path / LOCK).touch()
    ends = threading.Event()

    def look():
        while not ends.is_set():
            in_use(tmp_path)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        for _ in range(100):
            with sole_use(tmp_path):
                pass
            (tmp_path / LOCK).touch()
    finally:
        ends.set()
        looking.join()


def test_a_finished_run_shows_its_controller_and_names_the_baselines(tmp_path):
    book = RunBook.begin(tmp_path, experiment_on(SimpleHouse()), ["tf-mpc", "run"])
    journaled = book.connect()
    for name in ("thermoforce_mpc", "thermostat"):
        journaled.noted("loop", {"controller": name})
        controller = ThermoForceMPC(simple_model(), MPCConfig(**OPTIONS))
        run_closed_loop(journaled, controller, Period("test", 10 * DAY_S, 2 * HOUR_S, 2 * DAY_S), keeper=journaled)
    book.journal.close()
    assert LiveRun(tmp_path).now().controller == "thermostat"  # as it runs, the latest
    for name in ("manifest.json", "report.html"):
        (tmp_path / name).touch()
    view = LiveRun(tmp_path).now()
    assert (view.controller, view.counts) == ("thermoforce_mpc", {"solved": 2})
    assert "thermostat" in view.said
    assert LiveRun(tmp_path, "thermostat").now().controller == "thermostat"


def test_what_cannot_be_watched_is_refused(single, tmp_path):
    assert isinstance(CliRunner().invoke(cli, ["watch", str(tmp_path)]).exception, JournalError)
    with pytest.raises(InputError, match="pi: did not run yet; there are thermoforce_mpc"):
        LiveRun(single[0], "pi").now()
    first = (single[0] / "journal.jsonl").read_bytes().split(b"\n")[0] + b"\n"
    (tmp_path / "journal.jsonl").write_bytes(first)
    with pytest.raises(JournalError, match="no step was decided yet"):
        LiveRun(tmp_path).now()
    live = LiveRun(single[0])
    live.now()
    shutil.copytree(single[0], tmp_path / "other")
    other = LiveRun(tmp_path / "other")
    other.now()
    with (tmp_path / "other" / "journal.jsonl").open("ab") as file:
        file.write(b'{"n": 0, "kind": "run", "crc": "00000000"}\n')
    with pytest.raises(JournalError, match="damaged"):
        other.now()


def test_the_tail_of_a_journal_is_what_is_read_at_once(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal, tail, found = Journal(path), None, []
    for i in range(40):
        journal.write("note", {"value": i, "text": "°C" * (i % 7)})
        tail = tail or JournalTail(path)
        if i % 3 == 0:
            found += tail.more()
    journal.close()
    found += tail.more()
    assert tail.more() == []
    assert [replace(entry, told=entry.content) for entry in read_journal(path).entries] == found


def served(view):
    return running(page_server(view, 0))


def test_the_page_is_for_this_machine_and_tells_the_view(single):
    live = LiveRun(single[0])
    with served(lambda: live.now().to_json()) as url:
        page = requests.get(url, timeout=LONG_S)
        assert page.status_code == 200
        assert "view.json" in page.text
        assert "http" not in page.text.replace("http://www.w3.org/2000/svg", ""), "nothing is fetched from elsewhere"
        told = requests.get(f"{url}/view.json", timeout=LONG_S).json()
        assert told == json.loads(json.dumps(LiveRun(single[0]).now().to_json()))
        assert requests.get(url, headers={"Host": "evil.example"}, timeout=LONG_S).status_code == 403
        assert requests.get(url, headers={"Origin": "http://evil.example"}, timeout=LONG_S).status_code == 403
        assert requests.post(f"{url}/view.json", timeout=LONG_S).status_code == 405
        assert requests.get(f"{url}/../etc/passwd", timeout=LONG_S).status_code == 404
        with pytest.raises(PlantError, match="choose another --port"):
            page_server(dict, int(url.rsplit(":", 1)[1]))


def test_a_view_that_fails_is_told_to_the_page(tmp_path):
    def fails():
        raise JournalError("journal.jsonl, line 7: damaged")

    with served(fails) as url:
        answer = requests.get(f"{url}/view.json", timeout=LONG_S)
        assert answer.status_code == 500
        assert answer.json() == {"error": "journal.jsonl, line 7: damaged"}


@pytest.mark.slow
def test_the_page_draws_what_the_view_tells(tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api", reason="a browser is needed to look at the page")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    run(tmp_path / "whole", TwoHouses(), two_model(), hours=5)
    live = LiveRun(tmp_path / "whole")
    with served(lambda: live.now().to_json()) as url, sync_api.sync_playwright() as browsers:
        browser = browsers.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        try:
            page = browser.new_page()
            page.set_default_timeout(1e3 * LONG_S)
            wrong = []
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
            page.goto(url)
            page.wait_for_selector("svg path")
            assert "thermoforce_mpc" in page.inner_text("#head")
            assert f"{live.now().zones[0].T_C:.2f} °C" in page.inner_text("#tiles")
            assert page.inner_text("#reasons").startswith("A plan was found"), "its own words are folded away"
            page.click("#decided")
            assert live.now().why in page.inner_text("#reasons").replace("\n", " ")
            told = page.evaluate("Object.keys(DECIDED)")
            assert set(told) == {status.value for status in PlanStatus}, "every status is said in plain words"
            assert page.locator("svg").count() == 3, "two zones and the levels"
            drawn = page.locator("svg path[stroke]").evaluate_all("all => all.map(one => one.getAttribute('d').length)")
            assert len(drawn) == 8, "two courses of each zone, two of each actuator"
            assert min(drawn) > 20
            assert wrong == [], "among them no request that the page's own policy refuses"
            page.screenshot(path=str(tmp_path / "page.png"), full_page=True)
        finally:
            browser.close()
