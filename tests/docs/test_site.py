"""The documentation site builds strictly, and its links, anchors and files are right."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import click
import markdown
import pytest
from places import ROOT

import thermoforce_mpc as tf

sys.path.insert(0, str(ROOT))

from tools.site import check


@pytest.fixture(scope="module")
def site() -> Path:
    done = subprocess.run([sys.executable, "-m", "tools.site"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return ROOT / "site"


class _Text(HTMLParser):
    def __init__(self, page: Path) -> None:
        super().__init__()
        self.text = ""
        self.feed(page.read_text(encoding="utf-8"))

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.slow
def test_the_command_line_reference_has_every_command_and_its_options(site):
    from thermoforce_mpc.cli import cli

    text = _Text(site / "reference" / "cli.html").text
    for name in cli.list_commands(click.Context(cli)):
        assert f"tf-mpc {name}" in text, name
    assert "--forecast-uncertainty" in text
    assert "130  interrupted by Ctrl-C" in text


@pytest.mark.slow
def test_the_python_reference_has_every_public_name(site):
    text = _Text(site / "reference" / "python.html").text
    page = (site / "reference" / "python.html").read_text(encoding="utf-8")
    for name in set(tf.__all__) - {"__version__"}:
        assert name in text, name
    assert 'id="thermoforce_mpc.Plan"' in page


@pytest.mark.slow
def test_the_scenario_reference_has_every_key_with_default_and_limits(site):
    from thermoforce_mpc.scenario.scenario import Scenario

    page = (site / "reference" / "scenario.html").read_text(encoding="utf-8")
    for key in Scenario.model_fields:
        assert f"<code>{key}</code>" in page, key
    assert "≤ 365" in page
    assert 'href="#scenario-plantspec"' in page


@pytest.mark.slow
def test_formulas_are_mathml_and_equations_carry_the_labels_of_the_paper(site):
    page = (site / "how-it-works" / "index.html").read_text(encoding="utf-8")
    for label in ("eq:compose", "eq:operator", "eq:mod", "eq:paired", "eq:effect"):
        assert f'id="{label}"' in page
    assert page.count("<math") > 20
    for built in (site / "how-it-works").glob("*.html"):
        left = re.search(r"\\(mathrm|gamma|sum|Delta|lambda|hat)", built.read_text(encoding="utf-8"))
        assert left is None, (built, left)


def test_an_equation_that_is_not_closed_is_refused():
    with pytest.raises(ValueError, match="equation without its end"):
        markdown.markdown("$$ eq:x\na = b\n\nc\n$$", extensions=["tools.site.mathml"])
    assert "<math" not in markdown.markdown("`$x$` costs 5 $ or 6 $", extensions=["tools.site.mathml"])[:12]


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ('<a href="no.html">x</a>', "dead link no.html"),
        ('<a href="other.html#no">x</a>', "no such anchor other.html#no"),
        ('<script src="https://cdn.example/x.js"></script>', "loads https://cdn.example/x.js"),
        ('<img src="no.png">', "loads no.png, which is not there"),
    ],
)
def test_what_is_wrong_in_a_page_is_found(tmp_path, page, message):
    (tmp_path / "other.html").write_text('<h1 id="there">x</h1>')
    (tmp_path / "index.html").write_text('<a href="other.html#there">right</a>' + page)
    assert [line.split(": ", 1)[1] for line in check.of_site(tmp_path)] == [message]


def test_dead_links_and_missing_files_of_markdown_pages_are_found(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "b.md").write_text("# Title of `b`\n")
    page = tmp_path / "README.md"
    page.write_text(
        "[x](docs/b.md#title-of-b) [y](docs/b.md#no) [z](docs/c.md) `examples/no.py`\n```\n[q](no.md)\n```\n"
    )
    found = list(check.of_markdown(tmp_path, [page]))
    assert [line.removeprefix("README.md: ") for line in found] == [
        "no such heading docs/b.md#no",
        "dead link docs/c.md",
        "no file examples/no.py",
    ]


def test_pages_that_the_code_names_are_there():
    files = [*ROOT.glob("*.toml"), *ROOT.glob("configs/**/*.yaml")]
    files += [
        path
        for top in ("thermoforce_mpc", "controllers", "boptest_client", "examples")
        for path in (ROOT / top).rglob("*.py")
    ]
    named = {
        (path, page) for path in files for page in re.findall(r"docs/[\w/-]+\.md", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 10
    assert [(path, page) for path, page in named if not (ROOT / page).is_file()] == []
