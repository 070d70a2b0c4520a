"""Trials with files from elsewhere: damaged journals and tables, folders of others, models made up, FMUs that hang."""

from __future__ import annotations

import gzip
import os
import re
import shlex
import time
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import patch

import numpy as np
from click.testing import CliRunner, Result

from benchmarks.chaos.episode import Outcome
from benchmarks.chaos.fmu.building import build_troubled
from benchmarks.chaos.live import live_faults, torn_table, two_controllers, wrong_wall_clock
from benchmarks.chaos.troubles import Trouble
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError, ThermoForceError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.experiment.run_book import RunBook
from thermoforce_mpc.model.card import Competence, HorizonScore, ModelCard
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.saved import read_model_file, write_model_file
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.fmu import FmuPlant
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.plants.worker_process import PASSED
from thermoforce_mpc.records.journal import NAME

_TESTCASE = "bestest_hydronic_heat_pump"
_WORDS = ("--testcase", _TESTCASE, "--controller", "thermostat", "--baselines", "", "--days", "0.1",
          "--no-equal-comfort", "--quiet")  # fmt: skip
# Begin of the hour of an FMU, its time for a quarter of it, s, and what another tolerance may change, K.
_FMU_DAY, _FMU_PATIENCE_S, _TOLERATED_K = 30, 3.0, 0.01
# Longest time of a refusal, s, and bytes of a table after unpacking.
_MOST_S, _BOMB_BYTES = 60.0, 1_500_000_000
_MAP = "time: {column: time, zone: UTC}\noutdoor: T\nzones: {zone: {temperature: T}}\nactuators: {a: {level: u}}\n"

Trial = Callable[[np.random.Generator, Path], list[str]]


def _call(*words: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


def flipped_bits(rng: np.random.Generator, folder: Path) -> list[str]:
    """One to three bits of a journal: the run goes on to the same bytes, if need be by the command that is said."""
    whole, run = folder / "whole", folder / f"run{rng.integers(10**9)}"
    run.mkdir()
    content = bytearray((whole / NAME).read_bytes())
    for at in rng.integers(0, len(content), size=int(rng.integers(1, 4))):
        content[at] ^= 1 << int(rng.integers(8))
    (run / NAME).write_bytes(content)
    done = _call("resume", run, "--quiet")
    said = re.search(r"tf-mpc (resume .* --from \d+)", str(done.exception))
    if done.exit_code and said:
        done = _call(*shlex.split(said[1]), "--quiet")
    if isinstance(done.exception, InputError) and "start the run again" in str(done.exception):
        return []  # the first line, which says what the run is
    if done.exit_code:
        return _unnamed(done) or [f"ended with {done.exception}"]
    same = (run / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    return [] if same else ["step lost: another trajectory than without the fault"]


def foreign_folder(rng: np.random.Generator, folder: Path) -> list[str]:
    """A folder with a link, a pipe or somebody's address in it: refused, and nothing outside it is written."""
    run, victim = folder / f"foreign{rng.integers(10**9)}", folder / "victim"
    victim.write_text("mine")
    kind = str(rng.choice(["link", "pipe", "address"]))
    run.mkdir()
    plant = {"kind": "boptest", "url": "http://127.0.0.1:9"} if kind == "address" else {}
    keys = {"testcase": _TESTCASE, "controller": {"name": "thermostat"}, "plant": plant}
    RunBook.begin(run, Experiment.of(load_scenario(None, keys)), ["tf-mpc", "run"]).journal.close()
    if kind == "link":
        (run / "log.jsonl").symlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(run / str(rng.choice(["log.jsonl", "report.html"])))
    refused = _refused(_call("resume", run, "--quiet"))
    return refused + (["a file outside was written"] if victim.read_text() != "mine" else [])


def endless_table(rng: np.random.Generator, folder: Path) -> list[str]:
    """A table that unpacks without end, a device or a pipe: refused in time."""
    made = folder / f"table{rng.integers(10**9)}"
    kind = str(rng.choice(["bomb", "device", "pipe"]))
    table, map_file = made.with_suffix(".csv.gz" if kind == "bomb" else ".csv"), folder / "map.yaml"
    map_file.write_text(_MAP)
    if kind == "bomb":
        rows = b"2026-01-01 00:00:00,20.0,0.5\n" * 100_000
        # A gzip file may have several members: the same rows are packed once.
        table.write_bytes(gzip.compress(b"time,T,u\n") + gzip.compress(rows) * (_BOMB_BYTES // len(rows)))
    elif kind == "device":
        table = Path("/dev/zero")
    else:
        os.mkfifo(table)
    try:
        return _refused(_call("data", "check", table, "--map", map_file, "--no-fit", "--plot", folder / "p.png"))
    finally:
        if kind != "device":
            table.unlink()


def hanging_fmu(rng: np.random.Generator, folder: Path) -> list[str]:
    """An FMU that hangs, creeps, fails or crashes: at one tolerance it goes on; at all it ends in time, named."""
    how, passing = str(rng.choice(["SLEEPS", "CREEPS", "FAILS", "CRASHES"])), rng.random() < 0.5
    trouble = {f"FMU_HOUSE_{how}_ON_DAY": f"{_FMU_DAY + rng.uniform(0.0, 0.03):.4f}"}
    testcase = load_testcase(_TESTCASE)
    with closing(FmuPlant(folder / "wrapped.fmu", testcase, patience_s=_FMU_PATIENCE_S)) as plant:
        calm = _hour_of(plant)
        with patch.dict(
            os.environ, {PASSED: "FMU_HOUSE_*"} | trouble | ({"FMU_HOUSE_TROUBLED_AT": "1e-6"} if passing else {})
        ):
            try:
                troubled = _hour_of(plant)
            except PlantError as error:
                return [f"ended with {error}"] if passing else _restarts_missing(error)
        if not passing:
            return ["ended with no error, and no step could be made"]
        apart_K = max(abs(a - b) for a, b in zip(calm, troubled, strict=True))
        return [] if apart_K < _TOLERATED_K else [f"a step is lost: {apart_K:.3g} K from the run without the fault"]


def _hour_of(plant: FmuPlant) -> list[float]:
    """Zone temperatures of an hour, °C; without a warm-up, which would take most of the time."""
    plant.reset(_FMU_DAY * DAY_S, 0.0)
    return [plant.advance(0.5, HOUR_S / 4).T_zone_C.item() for _ in range(4)]


def _restarts_missing(error: PlantError) -> list[str]:
    restarts = str(error).count("restarted with tolerance")
    return [] if restarts == 2 else [f"ended with {error}: {restarts} restarts of 2 are told"]


def absurd_model(rng: np.random.Generator, folder: Path) -> list[str]:
    """A model with right hashes whose heat cannot be, or whose card says what its arrays do not: refused."""
    made = folder / f"model{rng.integers(10**9)}"
    operator = linear_operator(np.array([0.9]), np.array([0.4]), step_s=HOUR_S)
    known = {f"step_response_{h}h_K": 4.0 * (1.0 - 0.9**h) for h in (1, 2, 4, 8, 12, 24, 48)}
    scores = tuple(HorizonScore(hours, 0.2, 0.5, 0.4, 3.0, 9) for hours in (1.0, 6.0))
    verdict = Competence(True, horizons=scores, effect_K=known["step_response_8h_K"], effect_sd_K=0.2)
    card = ModelCard(source="probing", uncertainty=known, competence=verdict)
    ThermalModel.single(operator, card=card).save(made / "true")
    if (done := _call("inspect", made / "true")).exit_code:
        return [f"ended with {done.exception}, and the model is right"]
    content, arrays = read_model_file(made / "true")
    said = content["actuators"][0]["card"]
    kind = str(rng.choice(["gains", "gains without a card", "card", "verdict"]))
    if kind.startswith("gains"):
        arrays["pair.0.0.gains"] = arrays["pair.0.0.gains"] * 10.0 ** rng.uniform(2.0, 9.0)
    if kind == "gains without a card":
        said |= {"uncertainty": {}, "competence": None}
    elif kind == "card":
        said["uncertainty"][str(rng.choice(list(known)))] *= float(rng.choice([-1.0, 0.1, 1.5, 1e6]))
    elif kind == "verdict":
        said["competence"] |= {str(rng.choice(["effect_sd_K", "effect_K"])): float(rng.choice([5.0, 1e6]))}
    write_model_file(made / "made", content, arrays)
    refused = _call("inspect", made / "made")
    return _refused(refused) if refused.exit_code else [f"a model that cannot be right was taken ({kind})"]


def damaged_table(rng: np.random.Generator, folder: Path) -> list[str]:
    """A table of readings with some of its bytes, lines or stamps changed: read or refused, in time, by name."""
    made, map_file = folder / f"damaged{rng.integers(10**9)}.csv", folder / "damaged.yaml"
    map_file.write_text(_MAP)
    hours = np.arange(200)
    stamps = [f"2026-01-{1 + h // 24:02d} {h % 24:02d}:00:00" for h in hours]
    lines = [f"{stamp},{21 + np.sin(h):.2f},{h % 2}\n" for stamp, h in zip(stamps, hours, strict=True)]
    for _ in range(int(rng.integers(1, 6))):
        line, other = (int(i) for i in rng.integers(0, len(lines), 2))
        kind = str(rng.choice(["swap", "double", "cut", "nul", "future", "words", "header", "quote", "comma"]))
        lines[line] = {
            "swap": lines[other], "double": 2 * lines[line], "cut": lines[line][: int(rng.integers(0, 12))],
            "nul": lines[line].replace("21", "\0"), "future": lines[line].replace("2026", "2126"),
            "words": lines[line].replace("2026", "twenty"), "header": "time,T,u\n", "quote": '"' + lines[line],
            "comma": lines[line].replace(".", ","),
        }[kind]  # fmt: skip
    made.write_text("time,T,u\n" + "".join(lines))
    return _unnamed(_call("data", "check", made, "--map", map_file, "--no-fit", "--plot", folder / "damaged.png"))


TRIALS: dict[str, Trial] = {
    "flipped bits": flipped_bits, "foreign folder": foreign_folder, "endless table": endless_table,
    "hanging FMU": hanging_fmu, "absurd model": absurd_model, "damaged table": damaged_table,
    "torn table": torn_table, "wrong wall clock": wrong_wall_clock, "two controllers": two_controllers,
    "live faults": live_faults,
}  # fmt: skip
TRIAL_CLASSES = {
    "files": ("flipped bits", "foreign folder", "endless table", "damaged table"), "plant": ("hanging FMU",),
    "models": ("absurd model",), "live": ("torn table", "wrong wall clock", "two controllers", "live faults"),
}  # fmt: skip


def run_trial(kind: str, seed: tuple[int, int], folder: Path) -> Outcome:
    """A trial of one kind, as an episode without steps."""
    began = time.perf_counter()
    try:
        faults = TRIALS[kind](np.random.default_rng(seed), folder)
    except Exception as error:  # of a trial itself, too
        faults = [f"ended with {type(error).__name__}: {error}"]
    seconds = time.perf_counter() - began
    if seconds > _MOST_S:
        faults.append(f"took {seconds:.0f} s")
    return Outcome((Trouble(kind, 0.0, 0.0),), "done", "", {kind: 1}, 0, 0, 0.0, seconds, tuple(faults))


def prepared(folder: Path) -> Path:
    """The folder of all trials, with an FMU and a finished run whose journal they damage."""
    if missing := [name for name in ("fmpy", "pythonfmu") if find_spec(name) is None]:
        raise ConfigError(f"trials with an FMU need {' and '.join(missing)}: pip install -e '.[dev]'")
    build_troubled(folder)
    done = _call("run", *_WORDS, "--out", folder / "whole")
    if done.exit_code:
        raise ThermoForceError(f"the run without faults ended with {done.exception}")
    return folder


def _refused(done: Result) -> list[str]:
    if isinstance(done.exception, InputError):
        return []
    return _unnamed(done) or [f"ended with {done.exception or 'no error'}, and should have been refused"]


def _unnamed(done: Result) -> list[str]:
    """An error that is none of the package's: a traceback for the user."""
    if done.exception is None or isinstance(done.exception, ThermoForceError | SystemExit):
        return []
    return [f"ended with {type(done.exception).__name__}: {done.exception}"]
