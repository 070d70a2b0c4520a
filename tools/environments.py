"""Try what is shipped as a stranger gets it: the wheel in a clean environment, alone and with each extra.

    python -m tools.environments                     (all; some minutes, and some GB in the folder)
    python -m tools.environments --only core,gym --python python3.12

The wheel is built once. `core` is an environment with nothing but the wheel and what it requires. Each extra gets an
environment of its own above it, which sees what `core` has, so that an extra adds its own packages only.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_HOUSE = "bestest_hydronic_heat_pump"
_DAY = f"tf-mpc run --testcase {_HOUSE} --days 1 --baselines ''"
_IMPORTS = "python -c 'import thermoforce_mpc, controllers, boptest_client; thermoforce_mpc.ThermoForceMPC'"
# The benchmarks are not in the wheel.
_CHECKOUT = "sh -c 'cd {root} && python -m thermoforce_mpc"
# What is tried of each: commands, run in an empty folder with {root} for the sources (examples and tools are there).
TRIED: dict[str, tuple[str, ...]] = {
    "core": (_IMPORTS, "tf-mpc doctor", "tf-mpc testcases", _DAY),
    "serve": ("tf-mpc doctor --only serving", f"{_CHECKOUT} chaos --episodes 1 --seed 1 --days 0.25'"),
    "fmu": ("python -c 'import fmpy, thermoforce_mpc.plants.fmu'", "tf-mpc plants fmu"),
    "energyplus": (
        "tf-mpc run --testcase energyplus:heating_chicago --controller thermostat --baselines native --days 1",
    ),
    "bench": (f"{_CHECKOUT} bench controller --quick'",),
    "fracast": (f"{_DAY} --backbone fracast",),
    "gym": (
        "python -c 'import gymnasium, thermoforce_mpc.gym as g; e = gymnasium.make(g.ID); e.reset(seed=1); "
        "print(e.step(e.action_space.sample())[1])'",
    ),
    "rl": ("python {root}/examples/train_agent.py --steps 300 --days 1 --without-mpc",),
    "fleet": ("python -c 'import distributed; from thermoforce_mpc.execution import DaskEngine'",),
    "docs": ("sh -c 'cd {root} && python -m tools.site'",),
}


def main(words: Sequence[str] | None = None) -> int:
    """Try them and print a table; the exit code is the number of environments in which something failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(TRIED), help="names, separated by commas")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the environments")
    parser.add_argument("--folder", type=Path, help="where they are made, and kept; by default made and removed")
    given = parser.parse_args(words)
    names = given.only.split(",")
    if unknown := set(names) - set(TRIED):
        parser.error(f"unknown: {', '.join(unknown)}; there are {', '.join(TRIED)}")
    folder = (given.folder or Path(tempfile.mkdtemp(prefix="environments-"))).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        wheel = _built(folder / "wheel")
        core = _made(folder / "core", given.python)
        print(f"core: {_installed(core, str(wheel)):.0f} s to install", flush=True)
        failed = [name for name in names if not _tried(name, core, wheel, folder, given.python)]
    finally:
        if given.folder is None:
            shutil.rmtree(folder, ignore_errors=True)
    print(f"failed: {', '.join(failed)}" if failed else "nothing failed")
    return len(failed)


def _tried(name: str, core: Path, wheel: Path, folder: Path, python: str) -> bool:
    """Whether all commands of an environment went well; prints what did not."""
    where = core
    if name != "core":
        where = _made(folder / name, python)
        for site in where.glob("lib/python*/site-packages"):
            (beneath,) = core.glob("lib/python*/site-packages")
            (site / "core.pth").write_text(f"{beneath}\n", encoding="utf-8")
        print(f"{name}: {_installed(where, f'{wheel}[{name}]', '--ignore-installed', '--no-deps'):.0f} s", end=" ")
        print(f"+ {_installed(where, *_requirements(core, name)):.0f} s to install", flush=True)
    for command in TRIED[name]:
        began = time.perf_counter()
        with tempfile.TemporaryDirectory(dir=folder) as here:
            done = subprocess.run(
                shlex.split(command.format(root=ROOT)),
                cwd=here,
                env={"PATH": f"{where / 'bin'}:/usr/bin:/bin", "HOME": here, "OMP_NUM_THREADS": "1"},
                capture_output=True,
                text=True,
                timeout=1200,
            )
        verdict = "ok" if done.returncode == 0 else f"FAILED with {done.returncode}"
        print(f"  {verdict}, {time.perf_counter() - began:.0f} s: {command}", flush=True)
        if done.returncode:
            print(f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}", flush=True)
            return False
    return True


def _built(folder: Path) -> Path:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return max(folder.glob("*.whl"), key=lambda wheel: wheel.stat().st_mtime)


def _made(where: Path, python: str) -> Path:
    subprocess.run([python, "-m", "venv", "--clear", str(where)], check=True)
    return where


def _installed(where: Path, *what: str) -> float:
    """Install with pip; returns the time it took, s."""
    began = time.perf_counter()
    done = subprocess.run([where / "bin" / "pip", "install", "--quiet", *what], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"pip install {' '.join(what)}:\n{done.stdout}{done.stderr}")
    return time.perf_counter() - began


def _requirements(core: Path, extra: str) -> list[str]:
    """What an extra requires besides the package, itself with other extras included."""
    code = (
        "import sys; from importlib.metadata import requires; from packaging.requirements import Requirement\n"
        "def of(extra):\n"
        "    for line in requires('thermoforce-mpc'):\n"
        "        one = Requirement(line)\n"
        "        of_it, of_all = (one.marker is None or one.marker.evaluate({'extra': e}) for e in (extra, ''))\n"
        "        if of_all or not of_it:\n"
        "            continue\n"
        "        if one.name == 'thermoforce-mpc':\n"
        "            for other in one.extras: yield from of(other)\n"
        "        else:\n"
        "            yield f'{one.name}{one.specifier}'\n"
        "print(*dict.fromkeys(of(sys.argv[1])), sep='\\n')\n"
    )
    done = subprocess.run([core / "bin" / "python", "-c", code, extra], check=True, capture_output=True, text=True)
    return done.stdout.split()


if __name__ == "__main__":
    sys.exit(main())
