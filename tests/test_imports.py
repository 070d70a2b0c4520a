"""Modules import one way: nobody imports, over any detour, whoever imports it. Type-checking imports count."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

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
