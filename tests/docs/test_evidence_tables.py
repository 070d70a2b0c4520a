"""Tables of docs/evidence are as their files say, and a cell that somebody edited is found."""

import json
import re

import pytest

from tools import evidence


def test_no_table_was_edited_by_hand(capsys):
    assert evidence.main(["--check"]) == 0, capsys.readouterr().out


def test_every_table_of_figures_comes_from_a_file():
    """Not those of words: other tools, and the columns that a bench reads."""
    of_words = {"alternatives.md": 1, "plant.md": 1}
    for page in sorted(evidence.PAGES.glob("*.md")):
        text = re.sub("<!-- evidence .*?<!-- /evidence -->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        assert len(re.findall(r"^\|[-|]+\|$", text, re.MULTILINE)) == of_words.get(page.name, 0), page.name


def test_files_of_tables_stand_on_a_page():
    shown = re.findall(
        "<!-- evidence (.*) -->", "".join(page.read_text("utf-8") for page in evidence.PAGES.glob("*.md"))
    )
    assert sorted(shown) == sorted(file.stem for file in (evidence.PAGES / "tables").glob("*.json"))


@pytest.fixture
def pages(tmp_path):
    (tmp_path / "tables").mkdir()
    table = {
        "command": "tf-mpc bench x",
        "revision": "0123456789",
        "date": "2026-11-28",
        "minutes": 2.0,
        "columns": {"house": "house", "cost / discomfort": "{cost:.3f} / {tdis:.2f}"},
        "rows": [{"house": 1, "cost": 0.5, "tdis": 2.0}],
    }
    (tmp_path / "tables" / "houses.json").write_text(json.dumps(table))
    (tmp_path / "page.md").write_text("# Page\n\n<!-- evidence houses -->\n<!-- /evidence -->\n\nWords.\n")
    return tmp_path


def test_a_table_is_written_from_its_file_and_an_edit_is_found(pages, capsys):
    assert evidence.main([], pages) == 0
    text = (pages / "page.md").read_text()
    assert "|house|cost / discomfort|\n|---|---|\n|1|0.500 / 2.00|\n" in text
    assert "2026-11-28, `01234567`, 2 min." in text
    assert text.endswith("<!-- /evidence -->\n\nWords.\n")
    assert evidence.main(["--check"], pages) == 0
    (pages / "page.md").write_text(text.replace("0.500", "0.400"))
    assert evidence.main(["--check"], pages) == 1
    assert "page.md: houses" in capsys.readouterr().out


def test_the_rows_of_a_result_are_taken_with_its_command_and_today(pages):
    result = pages / "result.json"
    rows = [{"house": 2, "cost": 0.25, "tdis": 1.0, "more": 3}, {"summary": "another table's"}]
    result.write_text(json.dumps({"command": "tf-mpc bench x --json here.json --quick", "rows": rows}))
    evidence.main(["--take", "houses", str(result)], pages)
    table = json.loads((pages / "tables" / "houses.json").read_text())
    assert table["rows"] == [{"house": 2, "cost": 0.25, "tdis": 1.0}]
    assert table["command"] == "tf-mpc bench x --quick"
    assert table["revision"] != "0123456789"
    assert "|2|0.250 / 1.00|" in (pages / "page.md").read_text()
    measured = {"command": "x", "rows": rows, "revision": "89abcdef0", "date": "2026-11-01"}
    result.write_text(json.dumps(measured))
    evidence.main(["--take", "houses", str(result)], pages)
    assert "2026-11-01, `89abcdef`." in (pages / "page.md").read_text(), "it is of the revision that measured it"
    result.write_text(json.dumps({"command": "x", "rows": [{"house": 2}]}))
    with pytest.raises(SystemExit, match="no row of the result has cost, house, tdis"):
        evidence.main(["--take", "houses", str(result)], pages)


def test_what_a_revision_does_not_hold_is_stale():
    assert evidence.is_older("0" * 40, "HEAD"), "a revision that is not known"
    assert not evidence.is_older("HEAD", "HEAD")


def test_rows_of_controllers_and_windows_become_a_row_of_each_controller(pages):
    file = pages / "tables" / "houses.json"
    table = json.loads(file.read_text())
    table |= {"across": ["controller", "window"], "columns": {"": "controller", "day 44": "{cost_tot 44:.2f}"}}
    file.write_text(json.dumps(table))
    rows = [
        {"controller": name, "window": window, "cost_tot": cost}
        for name, window, cost in (("ours", "44", 0.5), ("ours", "16", 0.6), ("pi", "44", 0.7), ("pi", "16", 0.8))
    ]
    evidence.take(file, {"command": "tf-mpc compare", "rows": rows, "minutes": 3.4})
    evidence.main([], pages)
    assert "||day 44|\n|---|---|\n|ours|0.50|\n|pi|0.70|\n" in (pages / "page.md").read_text()
    assert ", 3 min." in (pages / "page.md").read_text()


def test_what_is_stale_is_listed_with_its_time_then_run(pages, capfd, monkeypatch, tmp_path):
    """A command that answers in JSON is run and taken; one that does not is named, and the exit code says so."""
    tables = pages / "tables"
    by_hand = json.loads((tables / "houses.json").read_text()) | {"command": "python x.py", "minutes": None}
    (tables / "by_hand.json").write_text(json.dumps(by_hand))
    summed_up = by_hand | {"command": "tf-mpc bench y --seed SEED", "summary": True}
    (tables / "summed_up.json").write_text(json.dumps(summed_up))
    of_the_same = json.loads((tables / "houses.json").read_text()) | {"columns": {"discomfort": "tdis"}}
    (tables / "of_the_same.json").write_text(json.dumps(of_the_same))
    not_in_it = of_the_same | {"columns": {"wear": "starts"}}
    (tables / "not_in_it.json").write_text(json.dumps(not_in_it))
    program = tmp_path / "bin" / "tf-mpc"
    program.parent.mkdir()
    answer = json.dumps({"command": "?", "rows": [{"house": 7, "cost": 0.125, "tdis": 1.5}]})
    program.write_text(f"#!/bin/sh\nfor last; do :; done\necho '{answer}' > \"$last\"\necho ran\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=":")
    assert evidence.main(["--stale", "HEAD"], pages) == 1
    said = capfd.readouterr().out
    assert said.index("by_hand: python x.py (not timed; by hand)") < said.index("ran")
    assert "summed_up: tf-mpc bench y --seed SEED (not timed; by hand)" in said
    assert said.index("houses: tf-mpc bench x (2 min)") < said.index("ran")
    assert "|7|0.125 / 1.50|" in (pages / "page.md").read_text()
    assert json.loads((tables / "houses.json").read_text())["command"] == "tf-mpc bench x"
    assert said.count("ran") == 1, "one run gives the rows of two tables"
    assert json.loads((tables / "of_the_same.json").read_text())["rows"] == [{"tdis": 1.5}]
    assert "not_in_it.json: no row of the result has starts" in said
    assert json.loads((tables / "not_in_it.json").read_text()) == not_in_it
