"""What a stranger installs: wheel and sdist are whole, the wheel works outside the repository, extras are extra."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from places import ROOT

from benchmarks.free_response.scales import SMALLER
from thermoforce_mpc.model.free_response.backbones.loading import shipped_folder

PACKAGES = ("thermoforce_mpc", "controllers", "boptest_client")


def build(source: Path, out: Path, *targets: str) -> list[Path]:
    words = [word for target in targets for word in ("-t", target)]
    command = [sys.executable, "-m", "hatchling", "build", *words, "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=120)
    return sorted(out.iterdir())


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> Path:
    (found,) = build(ROOT, tmp_path_factory.mktemp("sdist"), "sdist")
    return found


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory) -> Path:
    """The wheel as pip makes it of an sdist."""
    unpacked = tmp_path_factory.mktemp("unpacked")
    # `filter` came with Python 3.11.4; Debian 12 has 3.11.2.
    safely: dict[str, Any] = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
    with tarfile.open(sdist) as content:
        content.extractall(unpacked, **safely)
    (source,) = unpacked.iterdir()
    (found,) = build(source, tmp_path_factory.mktemp("wheel"), "wheel")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("site")
    quiet = ["--quiet", "--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *quiet, "--target", str(target), str(wheel)]
    subprocess.run(command, check=True, timeout=120)
    return target


def run(words: list[str], where: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(where)}
    return subprocess.run(words, env=environment, cwd=cwd, capture_output=True, text=True, timeout=300)


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_packages_and_the_configurations(wheel):
    found = set(zipfile.ZipFile(wheel).namelist())
    expected = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix not in (".nbi", ".nbc", ".pyc")
    }
    expected |= {f"thermoforce_mpc/{path.relative_to(ROOT)}" for path in (ROOT / "configs").rglob("*.*")}
    expected.add("thermoforce_mpc/configs/CITATION.cff")
    assert len(expected) > 400
    assert not expected - found
    assert not [name for name in found if name.split("/")[0] in ("benchmarks", "tests", "tools", "examples")]
    beside = {name.split("/")[0] for name in found - expected}
    assert {name.partition("-")[0] for name in beside} == {"thermoforce_mpc"}, "something else is in the wheel"
    (folder,) = beside
    assert {f"{folder}/licenses/LICENSE", f"{folder}/licenses/NOTICE.md"} <= found
    metadata = zipfile.ZipFile(wheel).read(f"{folder}/METADATA").decode()
    assert "License-Expression: MIT" in metadata


def test_the_sdist_holds_what_one_needs_to_join(sdist):
    with tarfile.open(sdist) as content:
        found = {name.partition("/")[2] for name in content.getnames()}
    expected = {
        "README.md",
        "LICENSE",
        "NOTICE.md",
        "CHANGELOG.md",
        "CITATION.cff",
        "CONTRIBUTING.md",
        "pyproject.toml",
        "constraints.txt",
        "requirements.txt",
    }
    expected |= {
        str(path.relative_to(ROOT))
        for folder in ("benchmarks", "tests", "examples", "docs")
        for path in (ROOT / folder).rglob("*.py")
    }
    expected.add("benchmarks/interventions/templates/interventions.html.j2")
    assert not expected - found


@pytest.mark.slow
def test_the_wheel_works_outside_the_repository(installed, tmp_path):
    tf_mpc = [sys.executable, "-c", "from thermoforce_mpc.cli import main; main()"]
    where = run([sys.executable, "-c", "import thermoforce_mpc; print(thermoforce_mpc.__file__)"], installed, tmp_path)
    assert where.stdout.startswith(str(installed)), where.stderr
    cases = run([*tf_mpc, "testcases"], installed, tmp_path)
    assert str(installed / "thermoforce_mpc" / "configs") in cases.stdout, cases.stderr
    assert str(ROOT) not in cases.stdout
    assert run([*tf_mpc, "init"], installed, tmp_path).returncode == 0
    # A generated house: what it steps by is compiled anew here, in a quarter of the time of the emulator of `init`.
    quick = ["--testcase", "generated:7:1", "--controller", "native", "--baselines", "", "--days", "0.1"]
    done = run([*tf_mpc, "run", "--config", "scenario.yaml", *quick, "--quiet", "--out", "done"], installed, tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "done" / "report.html").is_file()


@pytest.mark.slow
def test_benchmarks_are_in_a_checkout_alone_whatever_else_has_their_name(installed, tmp_path):
    tf_mpc = [sys.executable, "-c", "from thermoforce_mpc.cli import main; main()"]
    for name in ("bench", "chaos"):
        assert run([*tf_mpc, name, "--help"], ROOT, tmp_path).stdout.startswith("Usage:")
    other = tmp_path / "other"
    (other / "benchmarks" / "cli").mkdir(parents=True)
    for path in ("__init__.py", "cli/__init__.py", "cli/bench.py", "cli/chaos.py"):
        (other / "benchmarks" / path).write_text("raise SystemExit('of somebody else')\n")
    for words in (["bench"], ["bench", "operator", "--quick"], ["chaos", "--help"]):
        done = run([*tf_mpc, *words], installed, other)
        assert (done.returncode, done.stdout) == (2, "")
        (line,) = done.stderr.splitlines()
        assert line.startswith(f"Error: tf-mpc {words[0]} is not part of the wheel: clone the repository")
        assert "pip install -e '.[bench]'" in line
    assert "  bench  " in run([*tf_mpc, "--help"], installed, other).stdout
    hidden = run([*tf_mpc, "bench"], Path(f"{other}{os.pathsep}{ROOT}"), tmp_path)
    assert hidden.returncode == 2
    assert f"which {other / 'benchmarks' / '__init__.py'} hides" in hidden.stderr


# Refuses modules by their first name, then imports what every user may call.
WITHOUT = """
import sys
refused = set(sys.argv[1].split(","))
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in refused:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
sys.meta_path.insert(0, Refuse())
import thermoforce_mpc, thermoforce_mpc.cli as cli
for name in thermoforce_mpc.__all__:
    getattr(thermoforce_mpc, name)
for name in cli.cli.list_commands(None):
    assert callable(cli.cli.get_command(None, name)), name
import controllers.registry, thermoforce_mpc.plants.registry
"""


@pytest.mark.slow
def test_without_any_extra_everything_can_be_imported_that_is_named(wheel, installed, tmp_path):
    """Those parts that need an extra say so when they are used, see the tests of `serve`, `--fmu` and EnergyPlus."""
    (folder,) = installed.glob("thermoforce_mpc-*.dist-info")
    lines = re.findall(r"^Requires-Dist: (.*)$", (folder / "METADATA").read_text(), flags=re.M)
    wanted = [Requirement(line) for line in lines]
    always = {one.name.lower() for one in wanted if one.marker is None}
    extra = {one.name.lower() for one in wanted if one.marker is not None} - always - {"thermoforce-mpc"}
    provides = packages_distributions()
    modules = {module for module, names in provides.items() if {name.lower() for name in names} & extra}
    assert {"flask", "fmpy", "pyarrow", "statsmodels"} <= modules
    done = run(
        [sys.executable, "-c", WITHOUT, ",".join(sorted(modules - {"packaging", "jsonschema"}))], installed, tmp_path
    )
    assert done.returncode == 0, done.stderr


def test_importing_the_package_loads_nothing_heavy():
    heavy = {
        "numpy",
        "pandas",
        "torch",
        "casadi",
        "matplotlib",
        "numba",
        "scipy",
        "pydantic",
        "pyarrow",
        "requests",
        "yaml",
    }
    code = f"import sys, thermoforce_mpc; print(*sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60, check=True
    )
    assert done.stdout.strip() == ""


def test_the_notices_are_of_the_weights_that_ship():
    notice = (ROOT / "NOTICE.md").read_text(encoding="utf-8")
    for folder in (shipped_folder(), shipped_folder("shipped_weather"), *SMALLER.values()):
        assert hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest() in notice
        assert (folder / "DATA_CARD.md").is_file()
    assert "MIT License" in (ROOT / "LICENSE").read_text(encoding="utf-8")


def test_the_citation_is_of_this_version():
    """The keys that the schema of cff-version 1.2.0 requires, and what must agree with pyproject.toml."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0"
    assert cited["type"] == "software"
    assert cited["message"]
    assert cited["title"]
    for authors in (cited["authors"], *(one["authors"] for one in cited["references"])):
        assert all(set(author) >= {"name"} or set(author) >= {"family-names", "given-names"} for author in authors)
    assert all({"type", "title", "authors"} <= set(one) for one in cited["references"])
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f'\nversion = "{cited["version"]}"\n' in project
    assert f'\nlicense = "{cited["license"]}"\n' in project
