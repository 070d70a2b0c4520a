"""The command line as a user meets it, run in a process of its own where the exit code or the imports matter."""

from __future__ import annotations

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import click
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from simple_house import SimpleHouse, simple_model

from thermoforce_mpc.cli import cli, main
from thermoforce_mpc.cli.options import scenario_from
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.identification.validation import competence
from thermoforce_mpc.plants import registry as plants_registry
from thermoforce_mpc.plants.registry import ChosenPlant

TESTCASE = "bestest_hydronic_heat_pump"
# Nothing is known of the building but that its heater heats.
WEAK_PRIORS = (
    "--set",
    "identification.options.heat_input=identity",
    "--set",
    "identification.options.modulation=linear",
    "--set",
    "identification.options.late_sensor=false",
)

cli_identify = importlib.import_module("thermoforce_mpc.cli.building.identify")


@pytest.fixture
def tf_mpc(monkeypatch, capsys, tmp_path):
    """`tf-mpc` by its entry point in this process, in an empty folder: gives exit code and what it said on stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    before = signal.getsignal(signal.SIGTERM)

    def call(*words: str) -> tuple[object, str]:
        monkeypatch.setattr(sys, "argv", ["tf-mpc", *words])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().err

    yield call
    signal.signal(signal.SIGTERM, before)


def test_what_a_message_quotes_does_nothing_to_the_terminal(tf_mpc, tmp_path):
    file = tmp_path / "\x1b[31m\x9bred.yaml"
    file.write_text("testcase: bestest_hydronic_heat_pump\n\x00")
    code, said = tf_mpc("validate", str(file))
    assert code == 2
    assert "[31mred.yaml" in said
    assert "\x1b" not in said
    assert "\x9b" not in said


@pytest.fixture
def simple(monkeypatch, tmp_path):
    """`tf-mpc run` on the simple house, in an empty folder; gives a function that runs it in this process."""
    house = SimpleHouse()
    monkeypatch.setattr(ChosenPlant, "build", lambda *_: house)
    monkeypatch.chdir(tmp_path)

    def call(*words: str):
        return CliRunner().invoke(cli, ["run", "--testcase", TESTCASE, *words], catch_exceptions=True)

    call.house = house
    return call


def test_help_lists_every_command_without_loading_the_heavy_ones():
    code = (
        "import sys; sys.argv=['tf-mpc','--help']\n"
        "from thermoforce_mpc.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy={'torch','casadi','chronos','numba','matplotlib','pandas'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("run", "identify", "inspect", "validate", "controllers", "testcases", "bench"):
        assert name in done.stdout


@pytest.mark.parametrize(("given", "taken"), [(None, "1"), ("2", "2")])
def test_blas_computes_on_one_thread_unless_told_otherwise(given, taken):
    code = (
        "import os, sys; sys.argv=['tf-mpc', '--version']\n"
        "from thermoforce_mpc.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "assert 'numpy' not in sys.modules  # which reads it when it is loaded\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if given is None else {"OPENBLAS_NUM_THREADS": given}
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == taken


@pytest.mark.slow
def test_a_folder_in_which_nobody_may_look_is_one_message_with_its_path(tmp_path):
    """Path.exists raises there, in any command that looks for a file (root, as in CI, may look anywhere)."""
    code = (
        "import pathlib, sys, thermoforce_mpc.cli as cli\nstat = pathlib.Path.stat\n"
        "def refused(path, **options):\n    if path.name == 'closed.csv':\n"
        "        raise PermissionError(13, 'Permission denied', str(path))\n    return stat(path, **options)\n"
        "pathlib.Path.stat = refused\nsys.argv = ['tf-mpc', 'data', 'map', 'closed.csv']\ncli.main()"
    )
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, capture_output=True, text=True, timeout=60, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "Error: closed.csv: Permission denied: ask its owner for the right to it, or name another\n"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here, which is a full disk")
@pytest.mark.parametrize("words", [["schema", "map"], ["testcases"], ["--help"]])
def test_what_is_printed_to_a_full_disk_is_one_message_and_exit_code_6(words):
    code = "from thermoforce_mpc.cli import main; main()"
    with Path("/dev/full").open("w") as full:
        call = [sys.executable, "-c", code, *words]
        done = subprocess.run(call, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    said = "Cannot be written: No space left on device; make room or write elsewhere\n"
    assert (done.returncode, done.stderr) == (6, said)


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no terminal is hung up here")
def test_a_closed_terminal_ends_a_command_as_a_signal_to_end_does():
    """It ended the process where it was: a comparison left its workers' semaphores and did not say how to go on."""
    code = (
        "import os, signal, sys, thermoforce_mpc.cli as cli\n"
        "def main(**_):\n    try: os.kill(os.getpid(), signal.SIGHUP)\n    finally: print('given back')\n"
        "cli.cli.main = main\nos.close(2)\ncli.main()"
    )
    ours = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # inherited, and ignored where the tests run under nohup
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False, env=buffered
    )
    signal.signal(signal.SIGHUP, ours)
    assert (done.returncode, done.stdout) == (129, "given back\n")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("MemoryError()", "Out of memory: close other programs"),
        ("RuntimeError('std::bad_alloc')", "Out of memory: close other programs"),
        ("OSError(28, 'No space left on device', 'kept/law')", "Cannot be written: kept/law: No space left on device;"),
    ],
)
def test_a_machine_that_is_full_is_one_message_and_exit_code_6(error, said):
    code = f"import thermoforce_mpc.cli as cli\ndef main(**_): raise {error}\ncli.cli.main = main\ncli.main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 6
    assert done.stderr.startswith(said)
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "resume", "report", "identify", "inspect", "init", "doctor", "control"])
def test_help_of_a_command_loads_nothing_that_it_would_need_to_run(name):
    code = (
        "import sys; sys.argv=['tf-mpc', sys.argv[1], '--help']\n"
        "from thermoforce_mpc.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy={'torch','casadi','numba','matplotlib','pandas','pydantic','scipy','numpy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code, name], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout


@pytest.mark.parametrize("name", ["run", "identify", "inspect", "validate", "controllers", "testcases", "bench"])
def test_every_command_has_help(name):
    done = CliRunner().invoke(cli, [name, "--help"])
    assert done.exit_code == 0
    assert len(done.output.splitlines()) > 5


def test_no_option_takes_what_is_no_number_or_an_endless_one():
    """Each option with a fraction; those of a scenario are refused by its model, by the name of the option."""
    of_scenario = {"--days", "--probe-days"}
    taken = []
    commands = {"cli": cli}
    while commands:
        name, command = commands.popitem()
        if isinstance(command, click.Group):
            at = click.Context(command)
            inside = ((one, command.get_command(at, one)) for one in command.list_commands(at))
            commands |= {f"{name} {one}": found for one, found in inside if found is not None}
        for option in command.params:
            if isinstance(option.type, click.types.FloatParamType) and option.opts[0] not in of_scenario:
                for value in ("nan", "inf", "-inf"):
                    try:
                        option.type.convert(value, option, None)
                        taken.append(f"{name} {option.opts[0]} {value}")
                    except click.BadParameter:
                        pass
    assert not taken


def test_a_stretch_longer_than_a_year_is_refused_by_its_option():
    words = ["counterfactual", "--model", ".", "--data", "a.csv", "--map", "m.yaml", "--start", "2026-01-01"]
    done = CliRunner().invoke(cli, [*words, "--level", "1", "--hours", "1e300"])
    assert done.exit_code == 2
    assert "'--hours'" in done.output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run"], "no test case: give --testcase"),
        (["run", "--testcase", "bestest_hydronic_heatpump"], f"did you mean '{TESTCASE}'"),
        (["run", "--testcase", TESTCASE, "--controller", "termostat"], "did you mean 'thermostat'"),
        (["run", "--testcase", TESTCASE, "--price", "cheap"], "'constant', 'dynamic' or 'highly_dynamic'"),
        (["run", "--testcase", TESTCASE, "--days", "-1"], "greater than 0"),
        (["run", "--testcase", TESTCASE, "--set", "controller.options.horizn_h=3"], "did you mean 'horizon_h'"),
        (["run", "--testcase", TESTCASE, "--weather", "nowhere.mos"], "nowhere.mos"),
        (["run", "--testcase", TESTCASE, "--period", "peak_day"], "peak_heat_day"),
        (["run", "--config", "absent.yaml"], "absent.yaml: no such file"),
        (["nonsense"], "No such command 'nonsense'"),
        (["inspect", "absent"], "absent"),
        (["identify", "--data", __file__, __file__, "--map", "map.yaml"], "--data stands before each file: --data"),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(words, message, tf_mpc, tmp_path):
    code, said = tf_mpc(*words)
    assert code == 2, said
    assert message in said
    assert "Traceback" not in said
    assert not list(tmp_path.glob("runs/*")), "nothing half-written"


def test_an_unreachable_service_is_exit_code_3(tf_mpc, unhurried):
    code, said = tf_mpc("run", "--testcase", TESTCASE, "--url", "http://127.0.0.1:9", "--quiet")
    assert code == 3, said
    assert "127.0.0.1:9" in said
    assert "Traceback" not in said


@pytest.mark.slow
def test_a_run_leaves_a_complete_folder_and_prints_the_comparison(simple, tmp_path):
    done = simple("--controller", "thermostat", "--baselines", "native", "--days", "2")
    assert done.exit_code == 0, done.output
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name == f"{TESTCASE}-peak_heat_day-constant-thermostat-001"
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "scenario.yaml", "trajectory.csv", "trajectory_native.csv", "steps.csv", "kpis.json", "manifest.json",
        "report.html", "journal.jsonl", "log.jsonl", "kpis.csv", "times.csv",
    }  # fmt: skip
    kpis = json.loads((folder / "kpis.json").read_text())
    assert set(kpis) == {
        "testcase", "plant", "weather", "period", "start_day", "scored_days", "price", "controller", "kpis",
        "baselines", "equal_comfort", "gate", "power_cap",
    }  # fmt: skip
    assert kpis["kpis"]["ener_tot"] > 0
    assert kpis["baselines"]["native"]["ener_tot"] > 0
    assert f"{kpis['kpis']['ener_tot']:#.3g}" in done.output
    # Where nothing can be overwritten, a loop has a line, with the plant's own KPIs.
    for who, found in (("thermostat", kpis["kpis"]), ("native", kpis["baselines"]["native"])):
        (phase,) = (line for line in done.output.splitlines() if line.startswith(f"{who}: 2 days in "))
        assert phase.endswith(f"  {found['cost_tot']:.4f} EUR/m²  {found['tdis_tot']:.2f} K·h")
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["environment"]["numpy"]
    assert manifest["planning"]["thermostat"]["in_words"] == "nothing was planned"
    assert "nothing was planned" not in done.output, "a rule plans nothing"
    assert "\nthermostat: " in done.output
    assert "comfort missed by" in done.output
    table = pd.read_csv(folder / "kpis.csv", index_col="controller")
    assert table.loc["native", "ener_tot"] == pytest.approx(kpis["baselines"]["native"]["ener_tot"])
    assert set(manifest["sha256"]) == names - {"manifest.json", "report.html"}
    resolved = yaml.safe_load((folder / "scenario.yaml").read_text())
    assert resolved["controller"]["name"] == "thermostat"


@pytest.mark.slow
def test_a_model_that_is_not_competent_is_saved_with_exit_code_4_and_not_acted_on(simple, tmp_path, monkeypatch):
    """A day of probing does not tell this house's effect as well as is asked for here."""
    monkeypatch.setattr(competence, "MOST_RELATIVE_SD", 0.02)
    monkeypatch.setattr(plants_registry, "build_plant", lambda *_: SimpleHouse())
    quick = ("--set", "identification.most_days=1", "--set", "identification.probing.design=random")
    words = ["identify", "--testcase", TESTCASE, "--probe-days", "1", "--out", "m", *quick]
    done = CliRunner().invoke(cli, [*words, *WEAK_PRIORS])
    assert done.exit_code == cli_identify.NOT_COMPETENT == 4, done.output
    assert "NOT COMPETENT" in done.output
    assert "missed: the effect of 8 h at full level is known to" in done.output
    assert "advice: " in done.output
    done = simple("--model", "m", "--baselines", "native", "--days", "1", "--out", "r")
    assert done.exit_code == 0, done.output
    assert "thermoforce_mpc (gate)" in done.output
    assert "the gate held in 96 of 96 steps: This model may not act" in done.output
    kpis = json.loads((tmp_path / "r" / "kpis.json").read_text())
    assert kpis["gate"]["thermoforce_mpc"]["steps"] == 96
    assert kpis["kpis"]["ener_tot"] == pytest.approx(kpis["baselines"]["native"]["ener_tot"], rel=0.05)
    page = (tmp_path / "r" / "report.html").read_text()
    assert "the gate held in 96 of 96 steps" in page
    assert "What to do:" in page


@pytest.mark.slow
def test_a_run_goes_on_under_native_control_where_nothing_can_be_identified(simple, tmp_path):
    simple.house.measure = lambda u=float("nan"): replace(type(simple.house).measure(simple.house, u), T_zone_C=21.0)
    done = simple(
        "--set", "identification.days=1", "--set", "identification.most_days=1", "--baselines", "", "--days", "1",
        "--out", "r",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "No model could be identified" in done.output
    assert "the gate held in 96 of 96 steps" in done.output
    assert {u for u, _ in simple.house.applied} == {None}
    assert "no model could be identified" in (tmp_path / "r" / "report.html").read_text()
    paper = simple("--controller", "thermoforce_paper", "--set", "identification.days=1", "--baselines", "")
    assert isinstance(paper.exception, DataError), "without the gate there is nothing to act on"


@pytest.mark.slow
def test_a_second_run_never_overwrites(simple, tmp_path):
    for _ in range(2):
        assert simple("--controller", "native", "--baselines", "", "--days", "0.5").exit_code == 0
    assert len(list((tmp_path / "runs").iterdir())) == 2
    out = tmp_path / "mine"
    out.mkdir()
    (out / "precious").write_text("x")
    done = simple("--controller", "native", "--out", str(out))
    assert "never overwritten" in str(done.exception)
    assert [path.name for path in out.iterdir()] == ["precious"]


def test_a_plant_that_fails_half_way_loses_nothing(simple, tmp_path):
    simple.house.fail_at_s = 10.5 * 86400
    done = simple("--controller", "thermostat")
    assert "What was recorded until then is in" in str(done.exception)
    (folder,) = (tmp_path / "runs").iterdir()
    rows = (folder / "incomplete_trajectory_thermostat.csv").read_text().splitlines()
    assert len(rows) == 1 + 48
    assert "lost its connection" in (folder / "INCOMPLETE.txt").read_text()


def test_the_report_stands_alone(simple, tmp_path):
    simple("--controller", "thermostat", "--baselines", "native", "--days", "1")
    (page,) = tmp_path.glob("runs/*/report.html")
    text = page.read_text()
    assert "default-src 'none'" in text, "the browser loads nothing"
    for outside in ('src="', 'href="http', "@import", "url("):
        assert outside not in text
    assert "thermostat on simple_house" in text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("period: foo", "'foo' is not a window"),
        ("identification: {model: nomodel}", "nomodel"),
        ("controller: {options: {free_response: {options: {backbone: nope}}}}", "backbone 'nope'"),
    ],
)
def test_validate_refuses_what_a_run_would(tmp_path, text, said):
    path = tmp_path / "scenario.yaml"
    path.write_text(f"testcase: {TESTCASE}\n{text}\n")
    assert said in str(CliRunner().invoke(cli, ["validate", str(path)]).exception)


@pytest.mark.parametrize(
    ("path", "kind"),
    [("fleets/small.yaml", "fleet"), ("comparisons/baselines.yaml", "comparison"), ("maps/of_a_house.yaml", "map")],
)
def test_validate_knows_each_kind_of_file(tmp_path, path, kind):
    path = tmp_path / path if kind == "map" else Path("configs") / path
    if kind == "map":
        path.parent.mkdir()
        path.write_text("outdoor: out\nzones: {living: {temperature: T, lower: 21, upper: 24}}\n")
    done = CliRunner().invoke(cli, ["validate", str(path)])
    assert done.exit_code == 0, str(done.exception)
    assert f"valid {kind}" in done.output


def test_probing_for_less_than_a_day_is_refused(tmp_path):
    words = ["identify", "--testcase", TESTCASE, "--probe-days", "0.5", "--out", str(tmp_path / "model")]
    done = CliRunner().invoke(cli, words)
    assert isinstance(done.exception, ConfigError)
    assert "identification.days" in str(done.exception)


def test_a_picture_of_no_known_format_is_refused_before_the_work(tmp_path):
    words = {
        "plan": ["--model", "m", "--data", "d", "--map", "m", "--forecast", "f"],
        "data": ["check", "d", "--map", "m"],
        "forecast": [], "counterfactual": [], "saving": ["--data", "d", "--map", "m", "--changed", "2026-01-01"],
    }  # fmt: skip
    for command, others in words.items():
        done = CliRunner().invoke(cli, [command, *others, "--plot", "picture.txt"])
        assert done.exit_code == 2, command
        assert "picture.txt: end the name in .png or .svg" in done.output


def test_a_run_shorter_than_a_step_of_its_controller_ends_with_a_report(simple, tmp_path):
    simple_model().save(tmp_path / "model")
    words = ("--set", "step_s=3600", "--set", "controller.options.free_response.name=persistence")
    done = simple("--model", "model", "--baselines", "", "--days", "0.02", "--out", "run", *words)
    assert done.exit_code == 0, done.output + str(done.exception)
    assert (tmp_path / "run" / "report.html").exists()


@pytest.mark.parametrize("hours", [240, 287])
def test_prices_that_end_before_the_window_does_are_refused_before_a_step(simple, tmp_path, hours):
    path = tmp_path / "prices.csv"
    path.write_text("time,price\n" + "".join(f"{hour * 3600},0.2\n" for hour in range(hours)))
    words = ["--set", f"plant.prices_file={path}", "--price", "highly_dynamic", "--days", "2"]  # of day 10
    done = simple(*words, "--controller", "thermostat", "--out", "out")
    assert isinstance(done.exception, ConfigError)
    assert f"prices.csv: has prices until day {hours / 24:g}, asked for day 12" in str(done.exception)
    assert not (tmp_path / "out" / "steps.csv").exists()


def test_validate_names_what_is_wrong(tf_mpc, tmp_path):
    good, bad = tmp_path / "good.yaml", tmp_path / "bad.yaml"
    good.write_text(f"testcase: {TESTCASE}\n")
    bad.write_text(f"testcase: {TESTCASE}\ncontroller: {{name: thermostat, options: {{setpoint: 21}}}}\n")
    assert CliRunner().invoke(cli, ["validate", str(good)]).exit_code == 0
    code, said = tf_mpc("validate", str(bad))
    assert code == 2
    assert "setpoint: unknown key, did you mean 'setpoint_C'?" in said


def test_a_connection_lists_its_options_with_their_meaning():
    """Defaults as they are set, and what the docstring's `Args:` says of them."""
    done = CliRunner().invoke(cli, ["connections", "files"])
    assert done.exit_code == 0, done.output
    assert "connection.levels  (default 'levels.json')\n      what is to be set" in done.output
    assert "or an `until` that has passed: the building's own control." in done.output
    assert (
        "connection.forecast  (default 'tomorrow.csv')\n      a file of weather, prices and bounds, or services"
        in done.output
    )


def test_controllers_lists_options_with_defaults():
    done = CliRunner().invoke(cli, ["controllers", "thermoforce_mpc"])
    assert "controller.options.actuation.block_s  (default 300.0)" in done.output
    overview = CliRunner().invoke(cli, ["controllers"]).output
    for name in ("thermoforce_mpc", "rc_mpc", "thermoforce_paper", "thermostat", "native"):
        assert name in overview


def test_names_of_baselines_may_have_spaces_between():
    options = {"testcase": "bestest_hydronic_heat_pump", "baselines": "native, thermostat,"}
    assert scenario_from(options).baselines == ("native", "thermostat")
    assert scenario_from(options | {"baselines": ""}).baselines == ()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--start", "nonsense"), ("--start", "400"), ("--period", "no_day"), ("--price", "free"), ("--days", "-1"),
     ("--forecast-uncertainty", "odd"), ("--url", "htp:/x")],
)  # fmt: skip
def test_an_error_of_an_option_names_that_option(option, value):
    done = CliRunner().invoke(cli, ["run", "--testcase", "bestest_hydronic_heat_pump", option, value])
    assert done.exit_code != 0
    assert re.search(rf"(?m)^\s*{option}: ", str(done.exception)), done.exception


def test_an_error_of_a_file_names_its_key(tmp_path):
    (tmp_path / "s.yaml").write_text("testcase: bestest_hydronic_heat_pump\nperiod: nonsense\n")
    done = CliRunner().invoke(cli, ["run", "--config", str(tmp_path / "s.yaml"), "--days", "1"])
    assert str(done.exception).startswith("period: 'nonsense'")
