"""The tutorial and the how-to pages are followed to the letter: commands, files and code, in the order of each page."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from pages import PAGES, blocks
from places import ROOT

HERE = "tests/test_docs_code.py"
FOLLOWED = [page for page in PAGES if any(block.run_by == HERE for block in blocks(page))]


@pytest.fixture(scope="module")
def practice(tmp_path_factory) -> Path:
    """The tutorial's files, and `tf-mpc` and `python` as its reader would have them."""
    folder = tmp_path_factory.mktemp("practice")
    script = ROOT / "examples" / "practice_house.py"
    subprocess.run([sys.executable, str(script), str(folder)], check=True, capture_output=True)
    tutorial = ROOT / "docs" / "tutorial" / "your-building.md"
    (folder / "map.yaml").write_text(next(b.text for b in blocks(tutorial) if b.title == "map.yaml"), encoding="utf-8")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "bin").mkdir()
    for name, command in {"tf-mpc": f"{sys.executable} -m thermoforce_mpc", "python": sys.executable}.items():
        (folder / "bin" / name).write_text(f'#!/bin/sh\nexec {command} "$@"\n', encoding="utf-8")
        (folder / "bin" / name).chmod(0o755)
    return folder


FIGURE = r"[+-]?\d+(?:\.\d+)?"


def worded(line: str) -> str:
    """A line of output without its figures and spaces."""
    return re.sub(r"\s+", " ", re.sub(FIGURE, "0", line)).strip()


def same(line: str, expected: str) -> bool:
    """Whether a line says what a page expects: the same words, and figures nearly the same.

    They differ between machines; more than 10 % and two of the last digit means that the page is no longer true.
    """
    if worded(line) != worded(expected):
        return False
    for ours, theirs in zip(re.findall(FIGURE, expected), re.findall(FIGURE, line), strict=True):
        last_digit = 10.0 ** -len(ours.partition(".")[2])
        if abs(float(ours) - float(theirs)) > 0.1 * abs(float(ours)) + 2 * last_digit:
            return False
    return True


def check_output(expected: list[str], printed: str, command: str) -> None:
    lines = printed.splitlines()
    for line in expected:
        if line == "…":
            continue
        at = next((i for i, ours in enumerate(lines) if same(ours, line)), None)
        assert at is not None, f"{command}\nhas no line (or not in this order)\n{line}\nin\n{printed}"
        del lines[: at + 1]


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED, ids=lambda page: page.stem)
def test_page_is_followed(page, practice, tmp_path):
    folder = tmp_path / "reader"
    shutil.copytree(practice, folder, symlinks=True)
    environment = os.environ | {
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": "110",
    }

    def run(*command: str) -> str:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        return done.stdout

    found = blocks(page)
    for block, after in zip(found, [*found[1:], None], strict=True):
        if block.run_by != HERE:
            continue
        if block.title:
            (folder / block.title).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            assert run(sys.executable, "-c", block.text).strip()
        else:
            output = after.text.splitlines() if after and after.language == "text" and not after.run_by else []
            check_output(output, run("bash", "-ec", block.text), block.text)


def test_pages_are_followed():
    pages = {"your-building", "forecaster", "controller", "optimisation", "connection"}
    assert pages <= {page.stem for page in FOLLOWED}
