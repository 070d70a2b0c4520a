"""`tf-mpc doctor`: is everything there that a run needs?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

_MARKS = {"ok": "ok      ", "warning": "WARNING ", "failed": "FAILED  ", "skipped": "skipped "}


@click.command()
@click.option("--url", metavar="URL", help="A BOPTEST service to check too.")
@click.option(
    "--testcase", metavar="NAME", default="bestest_hydronic_heat_pump", show_default=True, help="Its test case."
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, help="Folder of runs.")
@click.option("--only", metavar="A,B", help="These checks alone.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the findings to this JSON file.")
def command(url: str | None, testcase: str, out: Path, only: str | None, json_file: Path | None) -> None:
    """Check what a run needs, by using it, and say what to do where something is wrong.

    Packages, the embedded plant, each solver on a small problem, the forecaster, a service (--url), the clock, and the
    disk where runs are written. Exit code 1 where a check failed; warnings do not count.

    \b
    Examples:
      tf-mpc doctor
      tf-mpc doctor --url http://127.0.0.1:8000 --only service,clock
    """
    from rich.console import Console

    from thermoforce_mpc.simulation.doctor import Finding, examine
    from thermoforce_mpc.simulation.folder.run_folder import environment, write_json

    console = Console(highlight=False, markup=False, soft_wrap=True)
    findings: list[Finding] = []
    names = [name.strip() for name in (only or "").split(",") if name.strip()]
    for finding in examine(testcase=testcase, url=url, folder=out, only=names):
        findings.append(finding)
        console.print(f"{_MARKS[finding.state]}{finding.name}: {finding.told} ({finding.seconds:.1f} s)", markup=False)
        if finding.todo and finding.state != "ok":
            console.print(f"          → {finding.todo}", markup=False)
    if json_file:
        write_json(
            json_file,
            {"environment": environment(), "findings": [asdict(finding) for finding in findings]},
            follow=True,
        )
    failed = sum(finding.state == "failed" for finding in findings)
    console.print(f"{failed} failed" if failed else "Nothing failed.")
    if failed:
        raise SystemExit(1)
