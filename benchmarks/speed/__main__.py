"""This checkout beside another one: `python -m benchmarks.speed --against PATH` prints what each row costs in both.

Each row is a command that both checkouts know, or work that both know from within (`work.py`), run in a process of its
own with the checkout first on the path: by the Python of its `.venv`, else by this one. They take turns, so that other
load affects both; medians are shown. Processor time counts the processes that a command started and waited for.
"""

from __future__ import annotations

import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from benchmarks.cli.show import show
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.registry import names_in

_ROOT = Path(__file__).resolve().parents[2]
_WORK = Path(__file__).with_name("work.py")
_TF_MPC = ("-m", "thermoforce_mpc")
_RUN = (*_TF_MPC, "run", "--testcase", "bestest_hydronic_heat_pump", "--quiet")
_NAMES = "import thermoforce_mpc as tf\nfor name in tf.__all__: getattr(tf, name)"
_AS_A_SHELL = "import sys\nfrom thermoforce_mpc.cli import main\nsys.argv = ['tf-mpc']\nmain()"
_TAB = {"_TF_MPC_COMPLETE": "bash_complete", "COMP_WORDS": "tf-mpc run --testcase b", "COMP_CWORD": "3"}
_SAME = 1e-6

# A process begins with the peak memory of the one that starts it: this one is small.
_STARTER = """
import json, os, sys, time
began = time.perf_counter()
process = os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ)
_, status, used = os.wait4(process, 0)
wall_s = time.perf_counter() - began
found = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, wall_s, used.ru_maxrss / 1024
json.dump(found, open(sys.argv[1], "w"))
"""
PROCESSOR, WALL, PEAK = "processor, s", "wall, s", "peak memory, MB"


@dataclass(frozen=True)
class Row:
    """Arguments of Python to measure; `goals`: of the ratio of a figure to the other checkout's.

    `own`: goals of a figure of this checkout alone; `longer`: the arguments with `--long`; `fresh`: nothing that an
    earlier run compiled is there.
    """

    name: str
    command: Sequence[str]
    goals: Mapping[str, float] = field(default_factory=dict)
    own: Mapping[str, float] = field(default_factory=dict)
    longer: Sequence[str] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    fresh: bool = False


def _work(*words: str) -> tuple[str, ...]:
    return ("-P", str(_WORK), *words)


_STEP_GOALS = {"median step": 0.45, "mean step": 0.25, "of it: all but forecast and solve": 0.4, "one forecast": 0.4}
_GROWTH_GOALS = {"last day's step over the second's": 1.05, "report of 10 times the days": 8.0}
_MANY_GOALS = {"processor of a plan": 209 / 450, "all processes, MB": 0.4}
ROWS = (
    Row("help: tf-mpc --help", (*_TF_MPC, "--help"), own={PROCESSOR: 0.1}),
    Row("tab: a value by TAB", ("-c", _AS_A_SHELL), own={PROCESSOR: 0.1}, environment=_TAB),
    Row("names: import of all public names", ("-c", _NAMES), own={PROCESSOR: 0.6}),
    Row("step: the default run", _work("step", "1"), _STEP_GOALS, longer=_work("step", "14")),
    Row("five: rooms by Ipopt", _work("rooms", "5"), {"one solve": 0.5}),
    Row("twenty: rooms by the QP", _work("rooms", "20"), {"one solve": 0.5}),
    Row("main: job of a day, of 14 with --long", (*_RUN, "--days", "1"), {PROCESSOR: 0.5, PEAK: 0.55}, longer=_RUN),
    Row("first: that job after installing", (*_RUN, "--days", "1"), {PROCESSOR: 0.6}, longer=_RUN, fresh=True),
    Row("control: one decision", _work("control"), own={"memory of control, MB": 300.0}),
    Row("plans: of 50 houses, 1000 with --long", _work("many", "50"), _MANY_GOALS, longer=_work("many", "1000")),
    Row(
        "identify: a room of all19, all nine with --long",
        _work("rooms_identified", "1"),
        {"identification": 0.3},
        longer=_work("rooms_identified", "9"),
    ),
    Row("growth: of 6 days, 60 with --long", _work("growth", "6"), own=_GROWTH_GOALS, longer=_work("growth", "60")),
    Row("peers: one room, 96 steps", _work("peers"), own={"Ipopt over do-mpc": 1 / 12, "Ipopt over AgentLib-MPC": 0.2}),
)


def measured(row: Row, checkout: Path) -> dict[str, Any]:
    """Run a row's command by a checkout, once: its figures; raises `ConfigError` where it fails."""
    own_python = checkout / ".venv" / "bin" / "python"
    python = str(own_python) if own_python.is_file() else sys.executable
    own = {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", **row.environment}
    with TemporaryDirectory() as folder, TemporaryDirectory() as beside:
        if row.fresh:
            own |= {name: beside for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "PYTHONPYCACHEPREFIX")}
        found = Path(beside) / "found.json"
        call = [python, "-S", "-c", _STARTER, str(found), python, *row.command]
        # Users have compiled modules, whatever this shell says: else every process would compile half a second.
        shell = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        done = subprocess.run(call, cwd=folder, env=shell | own, capture_output=True, text=True, check=True)
        code, *used = json.loads(found.read_text(encoding="utf-8"))
    if code:
        raise ConfigError(f"{row.name}: failed in {checkout}: {(done.stdout + done.stderr)[-2000:]}")
    figures = dict(zip((PROCESSOR, WALL, PEAK), used, strict=True))
    return figures | (json.loads(done.stdout.splitlines()[-1]) if str(_WORK) in row.command else {})


def compared(
    rows: Sequence[Row], against: Path, times: int, progress: Callable[[str], None] = lambda line: None
) -> dict[str, Any]:
    """Each row by this checkout and by `against`, in turns; the first run of each, which compiles, is not counted."""
    if not (against / "thermoforce_mpc" / "__init__.py").is_file():
        raise ConfigError(f"--against {against}: no checkout, it holds no thermoforce_mpc")
    found, targets = [], []
    for row in rows:
        runs: dict[Path, list[dict[str, Any]]] = {against.resolve(): [], _ROOT: []}
        for number in range(0 if row.fresh else -1, times):
            for checkout, kept in runs.items():
                figures = measured(row, checkout)
                if number >= 0:
                    kept.append(figures)
            progress(f"{row.name}: {number + 1} of {times}")
        of_row, of_targets = _row_of(row, *runs.values())
        found += of_row
        targets += of_targets
    return results_json("speed", found, targets)


def _row_of(
    row: Row, theirs: Sequence[Mapping[str, Any]], ours: Sequence[Mapping[str, Any]]
) -> tuple[list[dict[str, Any]], list[Target]]:
    """Medians of each figure in both, and ours as a share of theirs; of results, the largest relative difference."""
    found, targets = [], []
    for name, first in ours[0].items():
        if isinstance(first, list):
            before = theirs[0][name]
            apart = max(abs(b - a) / max(abs(a), 1e-9) for b, a in zip(first, before, strict=False))
            apart = apart if len(first) == len(before) else math.inf
            targets.append(Target(f"{row.name}: {name}, relative difference", apart, _SAME))
            continue
        here = statistics.median(one[name] for one in ours)
        there = statistics.median(one[name] for one in theirs) if name in theirs[0] else math.nan
        found.append({"row": row.name, "figure": name, "before": there, "now": here, "share": here / there})
        for goals, value in ((row.goals, here / there), (row.own, here)):
            if name in goals:
                targets.append(Target(f"{row.name}: {name}", value, goals[name]))
    return found, targets


@click.command()
@click.option("--against", required=True, type=click.Path(path_type=Path, exists=True), help="Another checkout.")
@click.option("--times", type=click.IntRange(min=1), default=5, show_default=True, help="Runs of each that count.")
@click.option("--rows", "chosen", metavar="NAME,NAME", default="", help="Only rows whose names begin so.")
@click.option("--long", is_flag=True, help="At full length: 14 and 60 days, nine rooms, 1,000 houses.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the result to this JSON file.")
def main(against: Path, times: int, chosen: str, long: bool, json_file: Path | None) -> None:
    """Print what commands cost in this checkout beside another one: medians, and ours as a share of theirs."""
    names = names_in(chosen)
    rows = [replace(row, command=row.longer) if long and row.longer else row for row in ROWS]
    for name in names:
        if not any(row.name.startswith(name) for row in rows):
            known = ", ".join(row.name.split(":")[0] for row in rows)
            raise click.UsageError(f"--rows {name}: no row begins so; there are {known}")
    rows = [row for row in rows if not names or row.name.startswith(names)]
    show(compared(rows, against, times, lambda line: click.echo(line, err=True)), json_file)


if __name__ == "__main__":
    main()
