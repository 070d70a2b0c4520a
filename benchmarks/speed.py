"""This checkout beside another one: `python -m benchmarks.speed --against PATH` prints what each row costs in both.

Each row is a command that both checkouts know, run in a process of its own by the same Python with the checkout first
on the path. They take turns, so that other load affects both; medians are shown. Processor time counts the processes
that a command started and waited for.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from benchmarks.cli.show import show
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.errors import ConfigError

_ROOT = Path(__file__).resolve().parents[1]
_TF_MPC = (sys.executable, "-m", "thermoforce_mpc")
_RUN = (*_TF_MPC, "run", "--testcase", "bestest_hydronic_heat_pump", "--quiet")
_NAMES = "import thermoforce_mpc as tf\nfor name in tf.__all__: getattr(tf, name)"
# Three days of a room with a heater, by numbers alone.
_IDENTIFY = """
import numpy as np, pandas as pd, thermoforce_mpc as tf
rng, n = np.random.default_rng(0), 288
at = pd.date_range("2026-01-10", periods=n, freq="15min", tz="UTC")
hour = np.arange(n) / 4
outdoor, sun = 4 + 3 * np.sin(hour / 3.8) + 2 * np.sin(hour / 11), np.maximum(0, 300 * np.sin((hour - 8) / 24 * 6.283))
u = np.repeat(rng.choice([0, 0.4, 0.7, 1.0], n // 6), 6)
fast, slow, T = 0.0, 5.0, []
for v, o, s in zip(u, outdoor, sun):
    T.append(o + fast + slow + 4 + 0.02 * rng.normal())
    fast, slow = fast * 0.92 + 0.16 * v, slow * 0.996 + 0.1 * v + 0.001 * s / 100
df = pd.DataFrame({"T": T, "out": outdoor, "sun": sun, "u": u, "P": 3000 * u}, index=at)
record = tf.Record.from_dataframe(df, zone="T", outdoor="out", solar="sun", level="u", power="P")
tf.identify(record)
"""


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


@dataclass(frozen=True)
class Row:
    """A command to measure, and the goals of the ratios of its processor time and its peak memory."""

    name: str
    command: Sequence[str]
    goal: float | None = None
    memory_goal: float | None = None
    environment: Mapping[str, str] = field(default_factory=dict)


_AS_A_SHELL = "import sys\nfrom thermoforce_mpc.cli import main\nsys.argv = ['tf-mpc']\nmain()"
_TAB = {"_TF_MPC_COMPLETE": "bash_complete", "COMP_WORDS": "tf-mpc run --testcase b", "COMP_CWORD": "3"}
ROWS = (
    Row("help: tf-mpc --help", (*_TF_MPC, "--help")),
    Row("tab: a value by TAB", (sys.executable, "-c", _AS_A_SHELL), environment=_TAB),
    Row("names: import of all public names", (sys.executable, "-c", _NAMES)),
    Row("identify: three days of one room", (sys.executable, "-c", _IDENTIFY), 0.3),
    Row("day: main job with one day of control", (*_RUN, "--days", "1", "--baselines", "")),
    Row("main: main job, whole", _RUN, 0.5, 0.55),
    Row("plans: bench fleet --only plan --quick", (*_TF_MPC, "bench", "fleet", "--only", "plan", "--quick"), 0.5, 0.4),
    Row("steps: bench controller --quick", (*_TF_MPC, "bench", "controller", "--quick")),
)


@dataclass(frozen=True)
class Cost:
    """What a command took: processor and wall time, s, and the memory of its largest process, MB."""

    processor_s: float
    wall_s: float
    peak_MB: float


def measured(row: Row, checkout: Path) -> Cost:
    """Run the command of a row by a checkout, once; raises `ConfigError` where it fails."""
    own = {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", **row.environment}
    with TemporaryDirectory() as folder, TemporaryDirectory() as beside:
        found = Path(beside) / "found.json"
        call = [sys.executable, "-S", "-c", _STARTER, str(found), *row.command]
        done = subprocess.run(call, cwd=folder, env=os.environ | own, capture_output=True, text=True, check=True)
        code, *used = json.loads(found.read_text(encoding="utf-8"))
    if code:
        raise ConfigError(f"{row.name}: failed in {checkout}: {(done.stdout + done.stderr)[-2000:]}")
    return Cost(*used)


def compared(
    rows: Sequence[Row], against: Path, times: int, progress: Callable[[str], None] = lambda line: None
) -> dict[str, Any]:
    """Each row by this checkout and by `against`, in turns; the first run of each, which compiles, is not counted."""
    if not (against / "thermoforce_mpc" / "__init__.py").is_file():
        raise ConfigError(f"--against {against}: no checkout, it holds no thermoforce_mpc")
    found, targets = [], []
    for row in rows:
        costs: dict[Path, list[Cost]] = {against.resolve(): [], _ROOT: []}
        for number in range(times + 1):
            for checkout, kept in costs.items():
                cost = measured(row, checkout)
                if number:
                    kept.append(cost)
            progress(f"{row.name}: {number} of {times}")
        there, here = (
            [statistics.median(getattr(cost, name) for cost in kept) for name in ("processor_s", "wall_s", "peak_MB")]
            for kept in costs.values()
        )
        processor, wall, peak = (ours / theirs for ours, theirs in zip(here, there, strict=True))
        of_both = {"processor_s": (there[0], here[0]), "wall_s": (there[1], here[1]), "peak_MB": (there[2], here[2])}
        found.append(
            {"row": row.name, **{name: f"{a:.3g} → {b:.3g}" for name, (a, b) in of_both.items()}}
            | {"processor": processor, "wall": wall, "peak": peak}
        )
        if row.goal is not None:
            targets.append(Target(f"{row.name}: processor time", processor, row.goal))
        if row.memory_goal is not None:
            targets.append(Target(f"{row.name}: peak memory", peak, row.memory_goal))
    return results_json("speed", found, targets)


@click.command()
@click.option("--against", required=True, type=click.Path(path_type=Path, exists=True), help="Another checkout.")
@click.option("--times", type=click.IntRange(min=1), default=5, show_default=True, help="Runs of each that count.")
@click.option("--only", multiple=True, metavar="NAME", help="Only rows whose name begins so; repeatable.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the result to this JSON file.")
def main(against: Path, times: int, only: tuple[str, ...], json_file: Path | None) -> None:
    """Print what commands cost in this checkout beside another one: medians, and ours as a share of theirs."""
    rows = [row for row in ROWS if not only or row.name.startswith(only)]
    if not rows:
        raise click.UsageError(f"--only: no row begins so; there are {', '.join(r.name.split(':')[0] for r in ROWS)}")
    show(compared(rows, against, times, lambda line: click.echo(line, err=True)), json_file)


if __name__ == "__main__":
    main()
