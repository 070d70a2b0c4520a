"""The page of what is assumed of others: every file, test and finding that it names is there."""

from __future__ import annotations

from places import ROOT

PAGE = (ROOT / "docs" / "how-it-works" / "assumptions.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("| ") and not line.startswith("| relied on")
]


def test_a_row_says_what_where_how_it_is_known_and_what_it_would_cost():
    assert len(ROWS) >= 120
    assert [row for row in ROWS if len(row) != 4 or not all(row)] == []


def test_files_tests_and_findings_are_there():
    missing = []
    for _, where, known, _ in ROWS:
        file, _, name = known.strip("`").partition("::")
        there = (ROOT / where.strip("`")).exists() and (ROOT / file).is_file()
        if not there or (name and f"\ndef {name}(" not in (ROOT / file).read_text(encoding="utf-8")):
            missing.append((where, known))
    assert missing == []


def test_every_finding_is_a_script_that_says_what_it_is_about():
    findings = sorted((ROOT / "findings").glob("*.sh"))
    heads = ("# Versions:", "# A good guess:", "# Seen:", "# Why it matters:")
    assert len(findings) >= 15
    texts = {script.name: script.read_text(encoding="utf-8") for script in findings}
    assert [name for name, text in texts.items() if not all(head in text for head in heads)] == []
