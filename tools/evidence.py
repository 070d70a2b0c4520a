"""Tables of docs/evidence, each from a JSON file in docs/evidence/tables that says what measured it, when, and at which
revision.

    python -m tools.evidence                        (write the tables into the pages)
    python -m tools.evidence --check                (say which were edited by hand; exit code 1)
    python -m tools.evidence --take NAME RESULT     (take the rows of a bench's --json as those of a table)
    python -m tools.evidence --stale REVISION       (list what is older than a revision, with minutes; run, take it)

A page holds a table between `<!-- evidence NAME -->` and `<!-- /evidence -->`. Its file has `command`, `revision`,
`date`, `minutes` (null where nobody timed it), `columns` (heading and key of the rows, or a format of several keys) and
`rows`. With `across` (two keys, such as controller and window) rows of a first key become one, with the figures of each
second key as `cost_tot 44`. --stale shows, and does not run, commands that write no JSON (not of bench, compare or
paper), and tables with `summary: true`, whose rows a person wrote from what the command printed.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from string import Formatter
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "evidence"
_BLOCK = re.compile(r"(<!-- evidence (\S+) -->\n)(.*?)(<!-- /evidence -->)", re.DOTALL)

Table = dict[str, Any]


def main(words: Sequence[str] | None = None, pages: Path = PAGES) -> int:
    """Do what the words say; the exit code is 1 where something was edited by hand, or could not be run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--check", action="store_true", help="say which tables were edited by hand, and write nothing")
    how.add_argument("--take", nargs=2, metavar=("NAME", "RESULT"), help="take the rows of a bench's JSON")
    how.add_argument("--stale", metavar="REVISION", help="run the commands of tables older than this, and take them")
    given = parser.parse_args(words)
    if given.check:
        edited = [f"{page.name}: {name}" for page, text in _pages(pages) for name in edited_in(text, pages)]
        end = f"{len(edited)} tables differ from their files, from which python -m tools.evidence writes them"
        print("\n".join([*edited, end]))
        return int(bool(edited))
    if given.take:
        name, result = given.take
        take(pages / "tables" / f"{name}.json", json.loads(Path(result).read_text()))
    code = _run_stale(given.stale, pages) if given.stale else 0
    for page, text in _pages(pages):
        page.write_text(rendered(text, pages), encoding="utf-8")
    return code


def _pages(pages: Path) -> Iterator[tuple[Path, str]]:
    for page in sorted(pages.glob("*.md")):
        yield page, page.read_text(encoding="utf-8")


def rendered(text: str, pages: Path = PAGES) -> str:
    """The text of a page with its tables as their files say."""
    return _BLOCK.sub(lambda found: found[1] + table_lines(_read(pages, found[2])) + found[4], text)


def edited_in(text: str, pages: Path = PAGES) -> list[str]:
    """Names of the tables of a page's text that are not as their files say."""
    return [name for _, name, lines, _ in _BLOCK.findall(text) if lines != table_lines(_read(pages, name))]


def _read(pages: Path, name: str) -> Table:
    return dict(json.loads((pages / "tables" / f"{name}.json").read_text(encoding="utf-8")))


def table_lines(table: Mapping[str, Any]) -> str:
    """A table in Markdown, then the date and revision of what it shows; its command stands in its file."""
    titles, keys = zip(*table["columns"].items(), strict=True)
    lines = [f"|{'|'.join(titles)}|", "|---" * len(titles) + "|"]
    lines += [f"|{'|'.join(_cell(key, row) for key in keys)}|" for row in table["rows"]]
    took = "" if table["minutes"] is None else f", {table['minutes']:.0f} min"
    return "\n".join([*lines, "", f"{table['date']}, `{table['revision'][:8]}`{took}.", ""])


def _cell(key: str, row: Mapping[str, Any]) -> str:
    """A value by its key, or several in a format such as '{cost_tot:.3f} / {tdis_tot:.2f}'; – without one."""
    if "{" in key:
        known = all(row.get(name) is not None for _, name, _, _ in Formatter().parse(key) if name)
        return (key.format(**row) if known else "") or "–"
    value = row[key]
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def take(file: Path, result: Mapping[str, Any], minutes: float | None = None) -> None:
    """Take the rows of a bench's result as those of a table, with its command, and the revision and date it names.

    An older bench's result names neither: then this revision and today.
    """
    table = json.loads(file.read_text(encoding="utf-8"))
    needed = {name for key in table["columns"].values() for name in re.findall(r"{([^{}:!]+)", key) or [key]}
    found = _wide(result["rows"], *table["across"]) if "across" in table else result["rows"]
    rows = [row for row in found if needed <= row.keys()]
    if not rows:
        raise SystemExit(f"{file.name}: no row of the result has {', '.join(sorted(needed))}")
    kept = [{key: value for key, value in row.items() if key in needed} for row in rows]
    minutes = result.get("minutes") if minutes is None else minutes
    table |= {"rows": kept, "command": _plain(result["command"]), "minutes": minutes}
    table["revision"] = result.get("revision") or _git("rev-parse", "HEAD")
    table["date"] = result.get("date") or datetime.now(UTC).date().isoformat()
    file.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _wide(rows: Sequence[Mapping[str, Any]], of: str, over: str) -> list[Mapping[str, Any]]:
    """One row for each value of the key `of`, with the figures of each value of `over` named after it."""
    wide: dict[Any, dict[str, Any]] = {}
    for row in (row for row in rows if of in row and over in row):
        one = wide.setdefault(row[of], {of: row[of]})
        one |= {f"{key} {row[over]}": value for key, value in row.items()}
    return list(wide.values())


def _plain(command: object) -> str:
    """A command in words, without where it wrote its JSON."""
    words = command if isinstance(command, str) else shlex.join(map(str, command if isinstance(command, list) else []))
    return re.sub(r" --(json|out|jobs) \S+", "", words)


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


def is_older(revision: str, than: str) -> bool:
    """Whether a revision does not hold another."""
    command = ["git", "merge-base", "--is-ancestor", than, revision.removesuffix("-dirty")]
    return subprocess.run(command, cwd=ROOT, check=False, capture_output=True).returncode != 0


# The file in a command's folder that `take` reads, and the option that names the folder or file, by what is run.
_ANSWERS = {"bench": ("--json", "result.json"), "compare": ("--out", "results.json"), "paper": ("--out", "tables.json")}


def _run_stale(revision: str, pages: Path) -> int:
    files = sorted((pages / "tables").glob("*.json"))
    tables = {file: json.loads(file.read_text(encoding="utf-8")) for file in files}
    stale = {file: table for file, table in tables.items() if is_older(table["revision"], revision)}
    for file, table in stale.items():
        took = "not timed" if table["minutes"] is None else f"{table['minutes']:.0f} min"
        by_hand = "" if _answer(table) else "; by hand"
        print(f"{file.stem}: {table['command']} ({took}{by_hand})", flush=True)
    failed = any(not _answer(table) for table in stale.values())
    # One command may give the rows of several tables.
    for command in dict.fromkeys(table["command"] for table in stale.values() if _answer(table)):
        failed |= not _renew(command, [file for file, table in stale.items() if table["command"] == command])
    return int(failed)


def _renew(command: str, files: Sequence[Path]) -> bool:
    """Whether a command ran and all tables that name it could take its rows."""
    answer = _answer({"command": command})
    assert answer, "only commands that answer in JSON are run"
    option, name = answer
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        place = folder if option == "--out" else str(Path(folder) / name)
        ran = subprocess.run([*shlex.split(command), option, place], cwd=ROOT, check=False)
        if not (result := Path(folder) / name).exists():
            print(f"{command}: failed with exit code {ran.returncode}")
            return False
        found = json.loads(result.read_text(encoding="utf-8")) | {"command": command}
    taken = True
    for file in files:
        try:
            take(file, found, (time.monotonic() - began) / 60.0)
        except SystemExit as error:
            print(error)
            taken = False
    return taken


def _answer(table: Mapping[str, Any]) -> tuple[str, str] | None:
    """The option and file by which a table's command gives its rows in JSON; None where a person writes them."""
    program, *words = shlex.split(table["command"])
    return _ANSWERS.get(words[0]) if program == "tf-mpc" and words and not table.get("summary") else None


if __name__ == "__main__":
    sys.exit(main())
