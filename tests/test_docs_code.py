"""The tutorial and the how-to pages are followed to the letter: commands, files and code, in the order of each page."""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from click.testing import CliRunner
from pages import PAGES, CodeBlock, blocks
from places import ROOT

from thermoforce_mpc.cli import cli

HERE = "tests/test_docs_code.py"
FOLLOWED = [page for page in PAGES if any(block.run_by == HERE for block in blocks(page))]


@pytest.fixture(scope="module")
def practice(tmp_path_factory) -> Path:
    """The tutorial's files, and `python` as its reader would have it."""
    folder = tmp_path_factory.mktemp("practice")
    script = ROOT / "examples" / "practice_house.py"
    subprocess.run([sys.executable, str(script), str(folder)], check=True, capture_output=True)
    tutorial = ROOT / "docs" / "tutorial" / "your-building.md"
    (folder / "map.yaml").write_text(next(b.text for b in blocks(tutorial) if b.title == "map.yaml"), encoding="utf-8")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "bin").mkdir()
    python = folder / "bin" / "python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n', encoding="utf-8")
    python.chmod(0o755)
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


class Reader:
    """Who follows a page in a folder of the tutorial's files: writes its files, runs its commands and its Python.

    `tf-mpc` and Python run in this process: starting each anew took longer than what most of them do.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def follows(self, block: CodeBlock) -> str:
        """What is printed."""
        if block.title:
            (self.folder / block.title).write_text(block.text, encoding="utf-8")
            return ""
        if block.language == "python":
            with redirect_stdout(io.StringIO()) as printed:
                exec(compile(block.text, str(self.folder), "exec"), {"__name__": "__main__"})
            assert printed.getvalue().strip()
            return printed.getvalue()
        return "".join(self._line(line) for line in block.text.replace("\\\n", " ").splitlines())

    def _line(self, line: str) -> str:
        program, *words = shlex.split(line)
        if program != "tf-mpc":
            return self._shell(line)
        words, into = (words[:-2], words[-1]) if ">" in words else (words, None)
        done = CliRunner().invoke(cli, words)
        assert done.exit_code == 0, f"{line}\n{done.output}{done.exception}"
        if into is None:
            return done.stdout
        (self.folder / into).write_text(done.stdout, encoding="utf-8")
        return ""

    def _shell(self, text: str) -> str:
        done = subprocess.run(
            ["bash", "-ec", text], cwd=self.folder, capture_output=True, text=True, timeout=300, check=False
        )
        assert done.returncode == 0, f"{text}\n{done.stdout}{done.stderr}"
        return done.stdout


@pytest.fixture
def reader(practice, tmp_path, monkeypatch, computed_here) -> Iterator[Reader]:
    folder = tmp_path / "reader"
    shutil.copytree(practice, folder, symlinks=True)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PATH", f"{folder / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("COLUMNS", "110")
    yield Reader(folder)
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(f"{folder}/"):  # what the reader wrote
            del sys.modules[name]


@pytest.mark.slow
@pytest.mark.usefixtures("identified_once")
@pytest.mark.filterwarnings("default")  # as a user's Python has it
@pytest.mark.parametrize("page", FOLLOWED, ids=lambda page: page.stem)
def test_page_is_followed(page, reader):
    found = blocks(page)
    for block, after in zip(found, [*found[1:], None], strict=True):
        if block.run_by != HERE:
            continue
        printed = reader.follows(block)
        if block.language == "bash" and after and after.language == "text" and not after.run_by:
            check_output(after.text.splitlines(), printed, block.text)


def test_pages_are_followed():
    pages = {"your-building", "forecaster", "controller", "optimisation", "connection"}
    assert pages <= {page.stem for page in FOLLOWED}
