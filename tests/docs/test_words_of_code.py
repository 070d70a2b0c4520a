"""A public class has one name, and a name is one class."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest
from places import ROOT


@pytest.fixture(scope="module")
def trees() -> dict[Path, ast.Module]:
    """The product's files, parsed."""
    tops = (ROOT / top for top in ("thermoforce_mpc", "controllers", "boptest_client"))
    return {file: ast.parse(file.read_text(encoding="utf-8")) for top in tops for file in sorted(top.rglob("*.py"))}


@pytest.mark.slow
def test_no_public_class_name_stands_for_two_things(trees):
    where = defaultdict(list)
    for file, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].append(str(file.relative_to(ROOT)))
    assert len(where) > 300
    assert {name: files for name, files in where.items() if len(files) > 1} == {}


# What has a term of the field, and the term: for modules, public classes, functions and arguments.
BANNED = {
    "foreign": "other", "rung": "fallback level", "ladder": "fallback", "nats": "information", "poisoned": "left out",
    "dear": "expensive", "temp": "T", "setpt": "setpoint", "timestep": "step", "lookahead": "horizon",
}  # fmt: skip
# Names that users write, or whose files are saved, keep them; none of these is a module.
KEPT = {"foreign_loads", "foreign_heat", "foreign"}


@pytest.mark.slow
def test_public_names_are_the_words_of_the_page(trees):
    found = set()
    for file, tree in trees.items():
        names = [file.stem]
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                names.append(node.name)
                if isinstance(node, ast.FunctionDef):
                    names += [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]
        for name in names:
            words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)
            if name not in KEPT and BANNED.keys() & {word.lower() for word in words}:
                found.add(f"{file.relative_to(ROOT)}: {name}")
    assert found == set()
