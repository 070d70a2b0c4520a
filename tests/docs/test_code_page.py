"""The page about the code is true: every file, folder and name that it mentions is there."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterable
from functools import reduce
from pathlib import Path

import pytest
from places import ROOT

from thermoforce_mpc.comparison.outcome import KPIS

PAGES = [ROOT / "docs" / "how-it-works" / "code.md", ROOT / "CONTRIBUTING.md"]
SPAN = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"(?:[\w.-]+/)+(?:[\w.-]+)?")
# `file.py`: `name` says that the name is in that file.
NAMED = re.compile(r"`([\w/]+\.py)`: `([A-Za-z_][\w.]*)`")

# What looks like a module and is none: files, groups of entry points, and what a variable of the name holds.
ENDINGS = ("csv", "html", "json", "md", "onnx", "parquet", "safetensors", "txt", "yaml")
NOT_CODE = ("thermoforce_mpc.controllers", "thermoforce_mpc.free_responses", "boundary.n_steps")


def spans() -> list[str]:
    return [span for page in PAGES for span in SPAN.findall(page.read_text(encoding="utf-8"))]


def test_every_file_and_folder_is_there():
    rooms = [ROOT, *(ROOT / room for room in ("thermoforce_mpc/model", "thermoforce_mpc/identification"))]
    rooms += [ROOT / "thermoforce_mpc" / room for room in ("measurements", "plants", "cli", "execution")]
    rooms += [ROOT / "thermoforce_mpc/model/free_response"]
    paths = [span for span in spans() if PATH.fullmatch(span) and not span.startswith("../")]
    assert len(paths) > 60
    missing = [path for path in paths if not any((room / path).exists() for room in rooms)]
    assert missing == []


@pytest.mark.parametrize(("file", "name"), sorted(set(NAMED.findall(PAGES[0].read_text(encoding="utf-8")))))
def test_every_name_is_in_its_file(file: str, name: str):
    module_name = str(Path(file).with_suffix("")).replace("/", ".")
    module = importlib.import_module(module_name)
    owner = getattr(module, name.partition(".")[0])
    assert owner.__module__ == module_name, "it stands there, not only its import"
    assert reduce(getattr, name.split("."), module)


def test_the_ten_questions_have_answers():
    page = PAGES[0].read_text(encoding="utf-8")
    questions = page.split("## Ten questions", 1)[1].split("##", 1)[0]
    rows = [row for row in questions.splitlines() if row.startswith("| ") and "?" in row]
    assert len(rows) == 10
    assert all(SPAN.search(row) for row in rows)


def test_every_room_of_the_controllers_is_on_the_map():
    page = PAGES[0].read_text(encoding="utf-8")
    rooms = [path for top in ("controllers", "thermoforce_mpc") for path in (ROOT / top).iterdir()]
    folders = [str(path.relative_to(ROOT)) for path in rooms if (path / "__init__.py").exists()]
    assert len(folders) > 20
    assert [folder for folder in folders if f"`{folder}/`" not in page] == []


PRODUCT = ("thermoforce_mpc", "controllers", "boptest_client")


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """The product's modules by their dotted names."""
    files = [file for top in (*PRODUCT, "benchmarks") for file in (ROOT / top).rglob("*.py")]
    named = {".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file for file in files}
    return {name: ast.parse(file.read_text(encoding="utf-8")) for name, file in named.items()}


def _bound(statements: Iterable[ast.stmt]) -> set[str]:
    """Names that statements define or import."""
    names: set[str] = set()
    for one in statements:
        if isinstance(one, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names.add(one.name)
        elif isinstance(one, ast.Assign | ast.AnnAssign):
            targets = one.targets if isinstance(one, ast.Assign) else [one.target]
            names |= {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
        elif isinstance(one, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in one.names}
        elif isinstance(one, ast.If):
            names |= _bound(one.body)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("place", ["how-it-works/code.md", "reference/words.md"])
def test_every_name_on_the_page_is_one_of_the_code(place, trees):
    page = (ROOT / "docs" / place).read_text(encoding="utf-8")
    known = {part for name in trees for part in name.split(".")} | set(KPIS)
    for tree in trees.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef):
                known |= _bound(node.body)
    names = [span for span in SPAN.findall(page) if re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", span)]
    assert len(names) > 30
    files = {"pyproject.toml"} | {file.name for top in PRODUCT for file in (ROOT / top).rglob("*.py")}
    unknown = [name for name in names if name not in files and not set(name.split(".")) <= known]
    assert unknown == []


@pytest.mark.slow
def test_the_page_says_who_imports_the_controllers(trees):
    page = PAGES[0].read_text(encoding="utf-8")
    (sentence,) = re.findall(r"`controllers` is known to ([^.]*) and the public names only", page)
    rooms = set()
    for name, tree in trees.items():
        of = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        if name.startswith("thermoforce_mpc.") and any(module.partition(".")[0] == "controllers" for module in of):
            rooms.add(name.split(".")[1])
    assert set(SPAN.findall(sentence)) == rooms


@pytest.mark.slow
def test_every_dotted_name_in_a_docstring_is_there(trees):
    """Such as `identification.pipeline`, or with a name in the module at its end; `prices.csv` is a file."""
    rooms = {name.split(".")[1] for name in trees if name.startswith("thermoforce_mpc.")}
    bound = {name: _bound(tree.body) for name, tree in trees.items()}

    def there(span: str) -> bool:
        for name in (span, f"thermoforce_mpc.{span}"):
            module, _, last = name.rpartition(".")
            owner, _, inner = module.rpartition(".")
            if name in trees or last in bound.get(module, ()) or inner in bound.get(owner, ()):
                return True
        return False

    missing, seen = [], 0
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                for span in SPAN.findall(ast.get_docstring(node) or ""):
                    parts = span.split(".")
                    dotted = re.fullmatch(r"[a-z_]+(\.[A-Za-z_]\w*)+", span) and parts[-1] not in ENDINGS
                    if dotted and parts[0] in (*PRODUCT, *rooms) and span not in NOT_CODE:
                        seen += 1
                        missing += [f"{name}: {span}"] * (not there(span))
    assert seen > 20
    assert missing == []
