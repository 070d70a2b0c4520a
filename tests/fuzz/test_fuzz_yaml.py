"""Whatever stands in a YAML file or behind `--set`: a valid configuration or one named error."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from fuzzing import fuzz, mutated, result_or_error, tampered
from hypothesis import given
from hypothesis import strategies as st

from controllers.registry import controller_config
from thermoforce_mpc.comparison.cells import load_comparison
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.files import configs_folder, named_configs
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.scenario.settings import parse_overrides

FILES = [path for kind in ("testcases", "scenarios", "comparisons") for path in named_configs(kind).values()]


def load(path: Path) -> None:
    """Read a file as what its folder says."""
    kinds = {
        "testcases": lambda: load_testcase(str(path)).points,
        "scenarios": lambda: Experiment.of(load_scenario(path, {})),
        "comparisons": lambda: load_comparison(str(path)),
    }
    result_or_error(InputError, kinds[path.parent.name], most=20_000)


@pytest.fixture
def beside(tmp_path):
    for kind in ("testcases", "scenarios", "comparisons"):
        (tmp_path / kind).mkdir()
    return lambda path: tmp_path / path.parent.name / path.name


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_bytes_that_were_changed(beside, path):
    @fuzz(8)
    @given(content=mutated(path.read_bytes()))
    def check(content):
        beside(path).write_bytes(content)
        load(beside(path))

    check()


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_values_that_were_changed(beside, path):
    @fuzz(12)
    @given(document=tampered(yaml.safe_load(path.read_text())))
    def check(document):
        try:
            text = yaml.safe_dump(document, allow_unicode=True)
        except (yaml.YAMLError, ValueError):
            return  # PyYAML cannot write it (an integer of 400 digits, half a surrogate)
        beside(path).write_text(text, encoding="utf-8", errors="replace")
        load(beside(path))

    check()


@pytest.mark.slow
@fuzz(60)
@given(words=st.lists(st.text(max_size=30) | st.builds("{}={}".format, st.text(max_size=8), st.text()), max_size=3))
def test_assignments_of_any_text(words):
    path = configs_folder() / "scenarios" / "peak_heat_day.yaml"
    result_or_error(InputError, lambda: load_scenario(path, parse_overrides(words)))


@fuzz(80)
@given(options=tampered({"horizon_h": 24, "objective": {"comfort": 1.0}, "actuation": {"mode": "auto"}, "seed": 1}))
def test_options_of_the_controller(options):
    if isinstance(options, dict):
        testcase = load_testcase("bestest_hydronic_heat_pump")
        result_or_error(InputError, lambda: controller_config("thermoforce_mpc", options, testcase), most=20_000)
