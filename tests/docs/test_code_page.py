"""The page about the code is true: every file, folder and name that it mentions is there."""

from __future__ import annotations

import importlib
import re
from functools import reduce
from pathlib import Path

import pytest
from places import ROOT

PAGES = [ROOT / "docs" / "how-it-works" / "code.md", ROOT / "CONTRIBUTING.md"]
SPAN = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"(?:[\w.-]+/)+(?:[\w.-]+)?")
# `file.py`: `name` says that the name is in that file.
NAMED = re.compile(r"`([\w/]+\.py)`: `([A-Za-z_][\w.]*)`")


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


def test_the_seven_questions_have_answers():
    page = PAGES[0].read_text(encoding="utf-8")
    questions = page.split("## Seven questions", 1)[1].split("##", 1)[0]
    rows = [row for row in questions.splitlines() if row.startswith("| ") and "?" in row]
    assert len(rows) == 7
    assert all(SPAN.search(row) for row in rows)


def test_every_room_of_the_controllers_is_on_the_map():
    page = PAGES[0].read_text(encoding="utf-8")
    rooms = [path for top in ("controllers", "thermoforce_mpc") for path in (ROOT / top).iterdir()]
    folders = [str(path.relative_to(ROOT)) for path in rooms if (path / "__init__.py").exists()]
    assert len(folders) > 20
    assert [folder for folder in folders if f"`{folder}/`" not in page] == []
