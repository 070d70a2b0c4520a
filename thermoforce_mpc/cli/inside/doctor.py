"""`tf-mpc doctor`, `weather` and `cite`: is all there that a run needs, a weather file, the papers as BibTeX."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import yaml

from thermoforce_mpc.cli.options import PATH

_MARKS = {"ok": "ok      ", "warning": "WARNING ", "failed": "FAILED  ", "skipped": "skipped "}


@click.command()
@click.option("--url", metavar="URL", help="A BOPTEST service to check too.")
@click.option("--testcase", metavar="NAME", default="bestest_hydronic_heat_pump", help="Its test case.")
@click.option("--out", type=PATH, default=Path("runs"), help="Folder of runs.")
@click.option("--only", metavar="A,B", help="These checks alone.")
@click.option("--json", "json_file", type=PATH, help="Write the findings to this JSON file.")
def doctor(url: str | None, testcase: str, out: Path, only: str | None, json_file: Path | None) -> None:
    """Check what a run needs, by using it, and say what to do where something is wrong.

    Packages, what they would report to others, the embedded plant, each solver on a small problem, the forecaster,
    memory and time of a loop at a real building, a service (--url), the clock, and the disk where runs are written.
    Exit code 1 where a check failed; warnings do not count.

    \b
    Examples:
      tf-mpc doctor
      tf-mpc doctor --url http://127.0.0.1:8000 --only service,clock
    """
    from rich.console import Console

    from thermoforce_mpc.cli.inside.installation import Finding, examine
    from thermoforce_mpc.files import write_json
    from thermoforce_mpc.records.run_folder import environment
    from thermoforce_mpc.registry import names_in

    console = Console(highlight=False, markup=False, soft_wrap=True)
    findings: list[Finding] = []
    for finding in examine(testcase=testcase, url=url, folder=out, only=names_in(only)):
        findings.append(finding)
        console.print(f"{_MARKS[finding.state]}{finding.name}: {finding.told} ({finding.seconds:.1f} s)")
        if finding.todo and finding.state != "ok":
            console.print(f"          → {finding.todo}")
    if json_file:
        content = {"environment": environment(), "findings": [asdict(finding) for finding in findings]}
        write_json(json_file, content, follow=True)
    failed = sum(finding.state == "failed" for finding in findings)
    console.print(f"{failed} failed" if failed else "Nothing failed.")
    if failed:
        raise SystemExit(1)


@click.group()
def weather() -> None:
    """Weather files for the emulator. Without a file it uses a synthetic year that represents no real place."""


@weather.command("fetch")
@click.option("--out", type=PATH, help="Folder for the file.  [default: the user's cache folder]")
@click.option("--url", metavar="URL", help="URL of another copy of the file, such as a mirror.")
def fetch_command(out: Path | None, url: str | None) -> None:
    """Download BOPTEST's Brussels weather year (IWEC, by ASHRAE: for your own use) and print its path.

    The file is downloaded once, its values are checked against a pinned fingerprint, and it is cached; later calls
    need no network.

    \b
    Example:
      tf-mpc run --testcase bestest_hydronic_heat_pump --weather "$(tf-mpc weather fetch)"
    """
    from thermoforce_mpc.boundary.weather.readers import URL, fetch_brussels
    from thermoforce_mpc.dependencies import cache_folder

    path = fetch_brussels(out or cache_folder(), url or URL)
    click.echo(str(path))
    click.echo(f"Use it with --weather {shlex.quote(str(path))}", err=True)


# In a checkout, and in the wheel.
_PLACES = (Path(__file__).parents[3] / "CITATION.cff", Path(__file__).parents[2] / "configs" / "CITATION.cff")


@click.command()
def cite() -> None:
    """Print BibTeX of this software and of the paper that it implements; CITATION.cff has the same for services.

    Say with results which version you used (tf-mpc --version), and the command: a run's manifest.json has both.
    """
    file = next(path for path in _PLACES if path.exists())
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    papers = [(paper, "unpublished", "thermoforce") for paper in content["references"]]
    for entry, kind, key in ((content, "software", "thermoforce-mpc"), *papers):
        click.echo(bibtex(entry, kind, key))


def bibtex(entry: dict[str, Any], kind: str, key: str) -> str:
    """One entry of CITATION.cff as BibTeX."""
    authors = [
        one["name"] if "name" in one else f"{one['family-names']}, {one['given-names']}" for one in entry["authors"]
    ]
    # An entity's name in braces is no given and family name.
    names = " and ".join(f"{{{name}}}" if "," not in name else name for name in authors)
    fields = {
        "author": names,
        "title": f"{{{entry['title']}}}",
        "year": str(entry["date-released"])[:4] if "date-released" in entry else entry.get("year"),
        "version": entry.get("version"),
        "license": entry.get("license"),
        "note": entry.get("notes"),
    }
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value is not None]
    return "\n".join([f"@{kind}{{{key},", *lines, "}"])
