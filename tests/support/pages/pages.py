"""Code blocks of the documentation's pages."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from places import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
_BLOCK = re.compile(r"(?:<!-- run-by-tests: (\S+) -->\n)?^```(\w*)(?: title=\"([^\"]+)\")?\n(.*?)^```$", re.M | re.S)


@dataclass(frozen=True)
class CodeBlock:
    """A fenced block: the test that runs it, if any, its language, file name and text."""

    run_by: str
    language: str
    title: str
    text: str


def blocks(page: Path) -> list[CodeBlock]:
    """All fenced blocks of a page, in order."""
    return [CodeBlock(*(group or "" for group in found)) for found in _BLOCK.findall(page.read_text(encoding="utf-8"))]
