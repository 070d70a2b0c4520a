"""A public class has one name, and a name is one class."""

from __future__ import annotations

import ast
from collections import defaultdict

from places import ROOT


def test_no_public_class_name_stands_for_two_things():
    where = defaultdict(list)
    for top in ("thermoforce_mpc", "controllers", "boptest_client"):
        for file in sorted((ROOT / top).rglob("*.py")):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    where[node.name].append(str(file.relative_to(ROOT)))
    assert len(where) > 300
    assert {name: files for name, files in where.items() if len(files) > 1} == {}
