"""The documentation stays short, and in words that the field uses."""

from __future__ import annotations

import re

import pytest
from pages import PAGES
from places import ROOT

DOCS = ROOT / "docs"
GUIDES = sorted((DOCS / "how-to").glob("*.md"))
# Words of this project's own, and what to say instead.
PRIVATE = {
    r"nats?": "information, or the interval that is expected",
    r"ladders?|rungs?": "fallback",
    r"poisoned": "failed three times",
    r"spoiled (records?|data|tables?)": "records with errors",
    r"foreign loads?": "other loads",
    r"below the bar|the bar": "not accurate enough to control",
    r"courses of": "trajectories of",
    r"dear(er|est)?": "expensive",
}


def words(text: str) -> int:
    """Words as `wc -w` counts them, those of tables and code too."""
    return len(text.split())


def private(text: str) -> list[str]:
    """Private words of a page; what stands in code marks is the program's."""
    prose = re.sub(r"^```.*?^```|`[^`\n]+`|\]\([^)]*\)", "", text, flags=re.M | re.S)
    found = (re.search(rf"\b({word})\b", prose, re.I) for word in PRIVATE)
    return [one[0] for one in found if one]


def test_the_documentation_is_short():
    assert sum(words(page.read_text(encoding="utf-8")) for page in DOCS.rglob("*.md")) <= 40_000


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.stem)
def test_a_guide_is_short(page):
    assert words(page.read_text(encoding="utf-8")) <= 500


def test_the_first_page_and_the_changelog_are_short():
    assert words((ROOT / "README.md").read_text(encoding="utf-8")) <= 1_000
    assert words((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")) <= 3_100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_words_are_those_of_the_field(page):
    assert private(page.read_text(encoding="utf-8")) == []


def test_private_words_are_found_in_prose_alone():
    assert private("A model below the bar;\n`the bar` [x](the bar)\n```text\n3 nats\n```\n") == ["below the bar"]
    assert private("A bar chart of its natural course.") == []
