"""Modules import one way, type-checking imports counted, and tests stand in rooms and use public names."""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

from places import ROOT


def _modules() -> dict[str, Path]:
    packages = [init.parent for init in ROOT.glob("*/__init__.py")]
    files = [file for package in packages for file in package.rglob("*.py")]
    return {".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file for file in files}


def _imported(file: Path, known: dict[str, Path]) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else node.module for name in inside}
    return found & known.keys()


def test_no_imports_go_in_a_circle():
    known = _modules()
    assert len(known) > 100
    # Raises CycleError with the circle.
    TopologicalSorter({name: _imported(file, known) - {name} for name, file in known.items()}).prepare()


def _contracts() -> list[dict[str, Any]]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return list(settings["tool"]["importlinter"]["contracts"])


def test_every_room_has_its_place_in_the_order_of_rooms():
    """A room that no contract names may import whatever it likes; inside rooms `exhaustive` says so, here this test."""
    rooms = next(one for one in _contracts() if one["name"] == "Rooms import downwards")
    placed = {name for layer in rooms["layers"] for name in layer.split(" | ")}
    there = {
        f"thermoforce_mpc.{path.stem}"
        for path in (ROOT / "thermoforce_mpc").iterdir()
        if (path / "__init__.py").exists() or (path.suffix == ".py" and not path.stem.startswith("__"))
    }
    assert len(there) > 20
    assert there - placed == set()


def test_the_order_inside_a_room_leaves_no_module_out():
    inside = [one for one in _contracts() if "containers" in one]
    assert len(inside) >= 9
    assert [one["name"] for one in inside if not one.get("exhaustive")] == []


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name != "_"


def _called(function: ast.expr) -> str:
    return str(getattr(function, "attr", getattr(function, "id", "")))


def _reached(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Lines on which a module reaches for a private name of something else, and the names."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and _is_private(node.attr):
            if ast.unparse(node.value) not in ("self", "cls", "super()", "os"):
                yield node.lineno, node.attr
        elif isinstance(node, ast.ImportFrom):
            parts = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            yield from ((node.lineno, part) for part in parts if _is_private(part))
        elif isinstance(node, ast.Call) and _called(node.func) in ("setattr", "getattr", "delattr"):
            named = [arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
            yield from ((node.lineno, name) for name in named if _is_private(name.split(".")[-1]))


def test_tests_and_benches_reach_for_no_private_name():
    """What a test or a bench replaces is an argument of something public, and what it looks at comes out of it."""
    files = [file for folder in ("tests", "benchmarks") for file in sorted((ROOT / folder).rglob("*.py"))]
    assert len(files) > 200
    reached = [
        f"{file.relative_to(ROOT)}:{line}: {name}"
        for file in files
        for line, name in _reached(ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert reached == []


def test_a_folder_of_tests_holds_a_dozen_modules_and_their_names_differ():
    """Test modules are imported by their names alone, and five at most stand in no room."""
    files = [file for file in (ROOT / "tests").rglob("*.py") if file.name != "conftest.py"]
    of_folder = Counter(file.parent.relative_to(ROOT) for file in files)
    assert of_folder[Path("tests")] <= 5
    assert {str(folder): n for folder, n in of_folder.items() if n > 14} == {}
    assert [name for name, n in Counter(file.name for file in files).items() if n > 1] == []


def test_a_folder_of_the_product_holds_a_dozen_modules_and_few_stand_loose():
    for folder, most in (("controllers", 3), ("thermoforce_mpc", 8), ("thermoforce_mpc/identification", 4)):
        loose = [file for file in (ROOT / folder).glob("*.py") if file.name != "__init__.py"]
        assert len(loose) <= most, folder
    packages = [ROOT / name for name in ("thermoforce_mpc", "controllers", "boptest_client", "benchmarks")]
    files = [file for package in packages for file in package.rglob("*.py") if file.name != "__init__.py"]
    of_folder = Counter(str(file.parent.relative_to(ROOT)) for file in files)
    assert len(of_folder) > 50
    assert {folder: n for folder, n in of_folder.items() if n > 14} == {}
