"""TAB completes values as a shell asks for them, with the names that the registries have, and loads nothing heavy."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import get_args

import pytest
from click.shell_completion import ShellComplete

from controllers.mpc.config import MPCConfig
from controllers.registry import REGISTRY as CONTROLLERS
from thermoforce_mpc.boundary.forecast_error import Level
from thermoforce_mpc.boundary.periods import BOTH_NAMES
from thermoforce_mpc.cli import cli, completion
from thermoforce_mpc.cli.inside.schemas import KINDS
from thermoforce_mpc.connections.registry import REGISTRY as CONNECTIONS
from thermoforce_mpc.files import named_configs
from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as BACKBONES
from thermoforce_mpc.model.free_response.registry import REGISTRY as FREE_RESPONSES
from thermoforce_mpc.plants.drawn_houses import NAMES as WEEKS
from thermoforce_mpc.plants.energyplus.office import PERIODS as OF_OFFICE
from thermoforce_mpc.plants.registry import REGISTRY as PLANTS
from thermoforce_mpc.plants.testcases import MADE_TESTCASES, load_testcase
from thermoforce_mpc.scenario.building import PRICES


def completed(*words: str) -> list[str]:
    """What is offered for the last of the words; FILE where the shell is to look among files."""
    items = ShellComplete(cli, {}, "tf-mpc", "_TF_MPC_COMPLETE").get_completions(list(words[:-1]), words[-1])
    return ["FILE" if item.type == "file" else str(item.value) for item in items]


def test_names_are_those_of_the_registries():
    for names, registry in (
        (completion.CONTROLLERS, CONTROLLERS),
        (completion.FREE_RESPONSES, FREE_RESPONSES),
        (completion.BACKBONES, BACKBONES),
        (completion.PLANTS, PLANTS),
        (completion.CONNECTIONS, CONNECTIONS),
        (completion.MADE_TESTCASES, MADE_TESTCASES),
    ):
        assert list(names) == list(registry.own), f"write the {registry.kind}s of the registry into cli/completion.py"
    assert completion.PRICES == PRICES
    assert set(completion.UNCERTAINTIES) == {"none", *get_args(Level)}
    assert set(completion.PERIODS) == {*BOTH_NAMES, *WEEKS, *OF_OFFICE}
    assert set(completion.SOLVERS) == set(get_args(MPCConfig.model_fields["solver"].annotation))
    assert tuple(KINDS) == completion.SCHEMAS


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("run", "--testcase", "bestest_h"), ["bestest_hydronic", "bestest_hydronic_heat_pump"]),
        (("run", "--testcase", "energyplus:h"), ["energyplus:heating_chicago"]),
        (("run", "--testcase", "gen"), ["generated:"]),
        (("run", "--testcase", "./my"), ["FILE"]),
        (("run", "--controller", "rc"), ["rc_mpc", "rc_mpc_paper"]),
        (("identify", "--period", "typical_h"), ["typical_heat_day"]),
        (("run", "--price", "d"), ["dynamic"]),
        (("run", "--solver", "m"), ["milp"]),
        (("run", "--forecaster", "p"), ["persistence"]),
        (("run", "--forecaster", "chronos-2"), ["chronos-2-small", "chronos-2"]),
        (
            ("run", "--baselines", "native,th"),
            ["native,thermoforce_mpc", "native,thermoforce_paper", "native,thermostat"],
        ),
        (("compare", "--controllers", "pi,na"), ["pi,native"]),
        (("compare", "--variants", "ab"), ["ablation"]),
        (("run", "--weather", "Br"), ["FILE"]),
        (("run", "--days", ""), []),
        (("control", "--connection", "fi"), ["files"]),
        (("controllers", "th"), ["thermoforce_mpc", "thermoforce_paper", "thermostat"]),
        (("schema", "sc"), ["scenario"]),
        (("fleet", "sm"), ["small"]),
        (("serve", "--testcase", "bestest_a"), ["bestest_air"]),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else "",
)
def test_values_are_completed(words, offered):
    assert completed(*words) == offered


def test_what_is_offered_as_a_test_case_is_one():
    assert {one for one in completed("run", "--testcase", "") if ":" not in one} < set(named_configs("testcases"))
    for name in completed("run", "--testcase", "energyplus:"):
        assert load_testcase(name).energyplus is not None or load_testcase(name).zones


def test_run_folders_are_completed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("runs/a-001", "runs/b-001", "kept", "other"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("runs/a-001", "kept"):
        (tmp_path / name / "journal.jsonl").touch()
    (tmp_path / "runs" / "b-001" / "manifest.json").touch()
    for command in ("resume", "report", "explain", "watch"):
        assert completed(command, "") == ["kept", "runs/a-001", "runs/b-001"]
        assert completed(command, "runs/b") == ["runs/b-001"]
        assert completed(command, "oth") == ["FILE"]
    assert completed("run", "--probing", "ke") == ["kept"]
    assert completed("resume", "nowhere/") == ["FILE"]


def test_a_shell_gets_its_answer_without_loading_what_the_names_stand_for():
    code = (
        "import sys\n"
        "from thermoforce_mpc.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy={'torch','casadi','numba','pandas','pydantic','scipy','numpy','yaml'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    asked = {"_TF_MPC_COMPLETE": "bash_complete", "COMP_WORDS": "tf-mpc run --controller thermos", "COMP_CWORD": "3"}
    code = code.replace("import sys\n", "import sys; sys.argv = ['tf-mpc']\n", 1)
    call = [sys.executable, "-c", code]
    done = subprocess.run(call, env=os.environ | asked, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (0, "plain,thermostat\n"), done.stderr
