"""Functions that are kept compiled are those of the sources that are there."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from waiting import LONG_S

import thermoforce_mpc
from thermoforce_mpc.data.compiled import sources_hash, sources_of

PACKAGE = Path(thermoforce_mpc.__file__).parent
LAW = """
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.zz_numbers import FACTOR

@njit(cache=True)
def law(x):
    return FACTOR * x
"""
PLANT = """
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants import zz_law
from thermoforce_mpc.plants.zz_law import law

@njit(cache=True)
def step(x):
    return 0.5 * (law(x) + zz_law.law(x))
"""
DOUBLED = """
from thermoforce_mpc.data.compiled import njit

@njit(cache=True)
def doubled(x):
    return 2.0 * x
"""
ASK = """
from thermoforce_mpc.plants.zz_plant import step
print(step(1.0), sum(step.dispatcher.stats.cache_hits.values()))
"""


def asked(root: Path, cache: Path) -> tuple[float, int]:
    """What the compiled plant answers in a process of its own, and how often it was found compiled."""
    environment = os.environ | {"PYTHONPATH": str(root), "XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-c", ASK], cwd=root, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    answer, hits = done.stdout.split()
    return float(answer), int(hits)


@pytest.mark.slow
def test_a_plant_whose_laws_are_changed_in_another_file_is_compiled_again(tmp_path):
    """numba looks at the caller's file alone: after `git pull` the plant went on with the law as it was."""
    root, cache = tmp_path / "root", tmp_path / "cache"
    shutil.copytree(PACKAGE, root / "thermoforce_mpc", ignore=shutil.ignore_patterns("__pycache__", "configs"))
    plants = root / "thermoforce_mpc" / "plants"
    (plants / "zz_numbers.py").write_text("FACTOR = 2.0\n")
    (plants / "zz_law.py").write_text(LAW)
    (plants / "zz_plant.py").write_text(PLANT)
    assert asked(root, cache) == (2.0, 0)
    assert asked(root, cache) == (2.0, 1)
    (plants / "zz_numbers.py").write_text("FACTOR = 3.0\n")
    assert asked(root, cache) == (3.0, 0)
    assert not list(root.rglob("*.nbi")), "nothing is kept beside the sources"
    no_folder = tmp_path / "file"
    no_folder.write_text("")
    assert asked(root, no_folder) == (3.0, 0), "where nothing can be kept it is compiled each time"


@pytest.mark.parametrize("trouble", ["full disk", "cut short"])
def test_what_cannot_be_kept_or_read_is_compiled_again(tmp_path, monkeypatch, trouble):
    """A full disk ended the command without naming a file, and a file that a power cut left empty every command."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    (tmp_path / "law.py").write_text(DOUBLED)

    def doubled() -> float:
        spec = importlib.util.spec_from_file_location("law", tmp_path / "law.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.doubled(1.5)

    if trouble == "full disk":
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
        try:
            assert doubled() == 3.0
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert not list((tmp_path / "kept").rglob("*.nbc"))
    else:
        assert doubled() == 3.0
        kept = list((tmp_path / "kept").rglob("*.nb?"))
        assert len(kept) == 2
        for file in kept:
            file.write_bytes(b"")
    assert doubled() == 3.0
    assert all(file.stat().st_size for file in (tmp_path / "kept").rglob("*.nb?")), "it is kept once more"


@pytest.mark.slow
def test_of_two_processes_that_begin_together_one_compiles(tmp_path):
    ask = (
        "import sys, numba\n"
        "from thermoforce_mpc.plants.embedded.schedule import is_occupied\n"
        "print('here', flush=True); sys.stdin.readline(); is_occupied(0.0)\n"
        "print(sum(is_occupied.dispatcher.stats.cache_hits.values()))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    two = [
        subprocess.Popen([sys.executable, "-c", ask], env=environment, stdin=-1, stdout=-1, text=True) for _ in range(2)
    ]
    for process in two:
        assert process.stdout.readline() == "here\n"
    for process in two:
        process.stdin.write("\n")
        process.stdin.flush()
    assert sorted(process.communicate(timeout=LONG_S)[0] for process in two) == ["0\n", "1\n"]


def test_sources_are_those_of_all_modules_that_are_imported():
    names = {path.relative_to(PACKAGE).as_posix() for path in sources_of(PACKAGE / "plants" / "embedded" / "kernel.py")}
    assert {"plants/embedded/kernel.py", "plants/embedded/heat_pump.py", "data/record.py"} <= names
    assert not any(name.startswith(("cli/", "identification/")) for name in names)


def test_the_version_of_a_package_whose_functions_are_taken_in_counts(monkeypatch):
    taking, without = (str(PACKAGE / file) for file in ("service/points.py", "plants/embedded/kernel.py"))
    ask = sources_hash.__wrapped__
    before = ask(taking), ask(without)
    monkeypatch.setattr("thermoforce_mpc.data.compiled.version", lambda package: f"another {package}")
    assert (ask(taking) == before[0], ask(without) == before[1]) == (False, True)


def test_only_one_module_knows_numba():
    knows = re.compile(r"^\s*(?:from|import)\s+numba\b", re.M)
    found = [path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if knows.search(path.read_text())]
    assert [name for name in found if "doctor" not in name] == ["data/compiled.py"]


@pytest.mark.slow
def test_nothing_is_compiled_and_numba_is_not_loaded_before_a_function_is_called():
    ask = (
        "import sys, numpy as np; from thermoforce_mpc.model.operator.building import driven_rollout; "
        "import thermoforce_mpc.plants.embedded; assert 'numba' not in sys.modules; "
        "from thermoforce_mpc.plants.embedded.schedule import is_occupied; is_occupied(0.0); "
        "assert 'numba' in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_loop_at_a_building_plans_without_numba_and_http():
    """numba and LLVM were a quarter of what the loop took, 97 of 381 MB; requests and tenacity are 11 MB."""
    ask = (
        "import sys; from thermoforce_mpc.cli.inside.loop_load import main; main(); "
        "assert not {'numba', 'requests', 'tenacity'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    load = json.loads(done.stdout)
    assert load["planned"] == 5
    assert load["MB"] < 340.0


def test_what_is_compiled_returns_numbers():
    """A signal that comes while numba makes a named tuple crashes the process; of an array it makes a SystemError."""
    returned = {
        f"{file.stem}.{function.name}": ast.unparse(function.returns)
        for package in (PACKAGE, PACKAGE.parent / "controllers")
        for file in package.rglob("*.py")
        if "njit(" in (text := file.read_text(encoding="utf-8"))
        for function in ast.walk(ast.parse(text))
        if isinstance(function, ast.FunctionDef) and function.returns is not None
        if any(ast.unparse(decorator).startswith("njit(") for decorator in function.decorator_list)
    }
    assert len(returned) > 30
    number = r"(?:float|int|bool)"
    for name, of_type in returned.items():
        assert re.fullmatch(rf"None|{number}|tuple\[{number}(?:, {number})*\]", of_type), f"{name} returns {of_type}"
