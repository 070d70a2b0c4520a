"""Run folder: configuration, trajectories, steps, KPIs, manifest and log of one run. Never overwritten.

`log.jsonl` has one JSON object a line, of messages and of every step with its reason; warnings are shown to people too.
KPIs may be the user's own: functions of a trajectory. What a run at a building saved so far is in the accounts there.
"""

from __future__ import annotations

import json
import logging
import os
import platform
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout

from boptest_client import safe_text
from thermoforce_mpc.data import Names, Plan
from thermoforce_mpc.errors import ArtifactError, ConfigError, InputError, StorageError
from thermoforce_mpc.files import (
    HARD_LINK,
    DoubtfulInput,
    check_plain,
    open_plain,
    read_json,
    storage_errors,
    sweep,
    write_plain,
)
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.registry import plugins
from thermoforce_mpc.scenario.own_code import line_in, own_code
from thermoforce_mpc.version import VERSION, installed

LOCK, LOG = ".lock", "log.jsonl"
# Longer than `in_use` has the lock to see whether it is free.
_LOOK_S = 0.5
_PACKAGES = ("casadi", "torch", "chronos-forecasting", "numpy", "pandas", "requests", "numba", "scipy", "pydantic")


def create_run_folder(out: Path | None, stem: str, root: Path = Path("runs")) -> Path:
    """Create the folder of a run: `out`, or the next free `runs/<stem>-NNN`.

    Raises:
        ConfigError: `out` exists and is not an empty folder.
        StorageError: it cannot be created.
    """
    with storage_errors(out or root):
        if out is not None:
            if out.exists() and not is_empty(out):
                raise ConfigError(f"--out {out}: exists already and is never overwritten; choose another folder")
            out.mkdir(parents=True, exist_ok=True)
            return out
        root.mkdir(parents=True, exist_ok=True)
        for number in range(1, 100_000):
            folder = root / f"{stem}-{number:03d}"
            try:
                folder.mkdir()  # atomic: concurrent runs get different folders
            except FileExistsError:
                continue
            return folder
    raise ConfigError(f"{root}: no free run folder name left for {stem}")


def file_stem(controller: str) -> str:
    """A controller's name as part of a file's: one of the user's own has a path in it."""
    return re.sub(r"[^\w.+-]+", "_", controller)


def is_empty(folder: Path) -> bool:
    """Whether `folder` is a folder without files but for the lock."""
    return folder.is_dir() and all(path.name == LOCK for path in folder.iterdir())


@contextmanager
def sole_use(folder: Path) -> Iterator[None]:
    """Keep other runs out of `folder` while the block lasts; a process that dies releases it.

    Raises:
        ConfigError: there is no such folder, another process is using it, or there is a link, pipe or device in it.
        StorageError: it cannot be written.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder")
    check_plain(folder)
    for name in (LOCK, "journal.jsonl", LOG):  # written where they stand; all else is replaced
        with suppress(FileNotFoundError):
            if (folder / name).stat().st_nlink > 1:
                raise ConfigError(f"{folder / name}: {HARD_LINK}")
    lock = FileLock(folder / LOCK, timeout=_LOOK_S)
    try:
        lock.acquire()
    except Timeout as error:
        raise ConfigError(f"{folder}: another run is using this folder; wait for it, or choose another one") from error
    except OSError as error:
        raise StorageError(
            f"{folder}: cannot be written ({error.strerror or error}); choose a folder that can be written, or copy it"
        ) from error
    try:
        sweep(folder, sole=True)
        yield
    finally:
        with suppress(OSError):  # the folder was removed meanwhile
            (folder / LOCK).unlink()
        lock.release()


def in_use(folder: Path) -> bool:
    """Whether another process has the sole use of `folder` now; nothing is written."""
    if not (folder / LOCK).exists():
        return False
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except (Timeout, OSError):
        return True
    lock.release()
    return False


def trajectory_frame(steps: Sequence[StepRecord]) -> pd.DataFrame:
    """One row per applied block: the columns of `Sample` (units in the names), one per zone, actuator and machine."""
    frame = pd.DataFrame([sample.columns() for step in steps for sample in step.samples])
    # A column without any value, such as the levels of native control, is of numbers too.
    return frame.astype({name: np.float64 for name in frame.columns if frame[name].dtype == object})


def steps_frame(steps: Sequence[StepRecord]) -> pd.DataFrame:
    """One row per plan: status, solver status, first predicted step, and reason.

    Temperatures have a column per zone and levels and what acted one per actuator, by `Names.label`.
    """
    rows = []
    for step in steps:
        plan, names = step.plan, step.boundary.names
        by_actuator = zip(names.actuators, step.acting, strict=True) if len(names.actuators) > 1 else ()
        acting = {f"status[{name}]": status.value for name, status in by_actuator}

        def first(column: str, signal: str, names: Names = names, plan: Plan = plan) -> dict[str, float | None]:
            """The first planned value of a signal, by row; None where nothing was planned."""
            values = getattr(plan, signal)
            labels = [column + names.label(signal, row).removeprefix(signal) for row in range(names.rows(signal))]
            return {label: float(values[row].flat[0]) if plan.u.size else None for row, label in enumerate(labels)}

        rows.append(
            {
                "index": step.index,
                "time_s": step.time_s,
                **{names.label("T_zone_C", z): float(T) for z, T in enumerate(step.T_zone_C)},
                "status": plan.status.value,
                **acting,
                "solver_status": plan.solver_status,
                "iterations": plan.iterations,
                "variables": plan.variables,
                "parameters": plan.parameters,
                **first("u_planned", "u"),
                **first("T_free_now_C", "T_free_now_C"),
                **first("T_free_next_C", "T_free_C"),
                **first("T_free_low_next_C", "T_free_low_C"),
                **first("T_free_high_next_C", "T_free_high_C"),
                **first("T_forced_next_K", "T_forced_K"),
                "slack_sum_K": float(plan.slack_K.sum()) if plan.u.size else None,
                "refused": step.refused,
                "why": plan.why,
                "notes": "; ".join(step.notes),
            }
        )
    return pd.DataFrame(rows)


def environment() -> dict[str, str]:
    """Versions of this package, Python, the platform and the packages that affect results."""
    own = {"thermoforce-mpc": VERSION, "python": platform.python_version(), "platform": platform.platform()}
    return own | installed(_PACKAGES) | {f"plugin {name}": version for name, version in plugins().items()}


def times_frame(runs: Mapping[str, Sequence[StepRecord]]) -> pd.DataFrame:
    """Computing times of each plan of each controller, s: of what no two runs have in common."""
    return pd.DataFrame(
        [
            {
                "controller": name,
                "index": step.index,
                "plan_seconds": step.plan_seconds,
                **{f"{part}_seconds": value for part, value in step.plan.seconds.items()},
                "boundary_seconds": step.forecast_seconds,
                "plant_seconds": step.plant_seconds,
            }
            for name, steps in runs.items()
            for step in steps
        ]
    )


def write_partial(folder: Path, records: Mapping[str, Sequence[StepRecord]], reason: str) -> None:
    """Write the steps recorded before a run failed, and `INCOMPLETE.txt` with the reason."""
    for name, steps in records.items():
        if steps:
            stem = file_stem(name)
            write_plain(folder / f"incomplete_trajectory_{stem}.csv", trajectory_frame(steps).to_csv(index=False))
            write_plain(folder / f"incomplete_steps_{stem}.csv", steps_frame(steps).to_csv(index=False))
    write_plain(folder / "INCOMPLETE.txt", f"This run did not finish: {reason}\n")


def clear_partial(folder: Path) -> None:
    """Remove what was written of a run that ended early: it was resumed and has finished."""
    with storage_errors(folder):
        for path in [*folder.glob("incomplete_*"), *folder.glob("INCOMPLETE.txt")]:
            path.unlink(missing_ok=True)


def kept_model(folder: Path, name: object) -> Path:
    """The folder of a model that the journal of a run names; raises `ArtifactError` where that is elsewhere."""
    if not isinstance(name, str) or Path(name).name != name or name == "..":
        raise ArtifactError(f"{folder}: its journal names a model that is not in the folder ({name!r:.200})")
    return folder / name


def is_complete(folder: Path) -> bool:
    """Whether the folder holds a run that has finished: the report is written last."""
    return (folder / "manifest.json").is_file() and (folder / "report.html").is_file()


_LOGGERS = ("thermoforce_mpc", "controllers", "boptest_client")
# A message of ours may name many keys; what it quotes is cut where it enters.
_MOST_SAID = 20_000
_STEPS = logging.getLogger("thermoforce_mpc.step")


class _JsonLines(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """The record as one line of JSON; `fields` are those of a step."""
        content = {
            "at": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            **({} if record.name == _STEPS.name else {"from": record.name}),
            **getattr(record, "fields", {}),
            "message": record.getMessage(),
        }
        if record.exc_info:
            content["exception"] = self.formatException(record.exc_info)
        return json.dumps(content, ensure_ascii=False, separators=(",", ":"))


class _Announcer(logging.Handler):
    """Says warnings, as they come."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        """Say one."""
        self._say(safe_text(f"{record.levelname.lower()}: {record.getMessage()}", _MOST_SAID))


class _Lines(logging.StreamHandler[TextIO]):
    def handleError(self, record: logging.LogRecord) -> None:
        """Say nothing: where the disk is full the journal ends the run, and says so."""

    def close(self) -> None:
        """Close the file; lines that a full disk did not take are lost."""
        super().close()
        with suppress(OSError):
            self.stream.close()


@contextmanager
def logging_to(folder: Path, say: Callable[[str], None] = lambda text: None) -> Iterator[None]:
    """Append what the package logs to `log.jsonl` in `folder`, and `say` warnings; raises `StorageError`."""
    with storage_errors(folder / LOG):
        file = open_plain(folder / LOG, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        file_handler = _Lines(os.fdopen(file, "a", encoding="utf-8", errors="backslashreplace"))
    file_handler.setFormatter(_JsonLines())
    handlers = (file_handler, _Announcer(say))
    levels_before = {name: logging.getLogger(name).level for name in _LOGGERS}
    for name in _LOGGERS:
        for handler in handlers:
            logging.getLogger(name).addHandler(handler)
        logging.getLogger(name).setLevel(logging.INFO)
    try:
        yield
    finally:
        for name, level in levels_before.items():
            for handler in handlers:
                logging.getLogger(name).removeHandler(handler)
            logging.getLogger(name).setLevel(level)
        file_handler.close()


def log_step(controller: str, step: StepRecord) -> None:
    """Log one step: what acted, and why."""
    levels = [sample.u_applied for sample in step.samples]
    log_decision(controller, step.index, step.time_s, step.plan, levels, step.refused, step.notes)


def log_decision(
    controller: str,
    index: int,
    time_s: float,
    plan: Plan,
    levels: Sequence[Sequence[float | None]],
    refused: str,
    notes: Sequence[str],
) -> None:
    """Log what was decided at `time_s`: the levels of each block, and why."""
    fields = {
        "controller": controller,
        "step": index,
        "time_s": time_s,
        "status": plan.status.value,
        "u": [list(block) for block in levels],
    } | {key: value for key, value in (("refused", refused), ("notes", list(notes))) if value}
    _STEPS.info("%s", plan.why, extra={"fields": fields})


_UNIT_AFTER = ", "


@dataclass(frozen=True)
class OwnKpi:
    """A KPI by `key`, its name and unit as `starts_per_day, 1/d`, and the function that computes it."""

    key: str
    function: Callable[[pd.DataFrame], float]

    def of(self, trajectory: pd.DataFrame) -> float:
        """The KPI; NaN with a warning that says where, if the function raises or gives no number."""
        try:
            return float(self.function(trajectory))
        except Exception as error:  # whatever a function of the user raises: the run is over, nothing of it is lost
            at = line_in(self.function.__code__.co_filename, error) if hasattr(self.function, "__code__") else ""
            warnings.warn(f"kpis: {self.key}{at}: {type(error).__name__}: {error}", DoubtfulInput, stacklevel=2)
            return float("nan")


def own_kpis(given: Iterable[str | Callable[[pd.DataFrame], float]]) -> tuple[OwnKpi, ...]:
    """KPIs from functions, or from where they stand (`file.py:name`).

    Name and unit are the function's name, and what follows the last comma of the first line of its docstring:
    `def starts_per_day(trajectory): "Starts of the machine, 1/d"`.

    Raises:
        ConfigError: there is no such function, or two have one name.
    """
    found = []
    for one in given:
        function = own_code(one, "kpis", ConfigError) if isinstance(one, str) else one
        name = getattr(function, "__name__", type(function).__name__)
        words = (function.__doc__ or "").strip().partition("\n")[0]
        unit = words.rpartition(",")[2].strip(" .") if "," in words else ""
        found.append(OwnKpi(f"{name}{_UNIT_AFTER}{unit or '–'}", function))
    twice = {kpi.key for kpi in found if sum(other.key == kpi.key for other in found) > 1}
    if twice:
        raise ConfigError(f"kpis: {', '.join(twice)}: given twice")
    return tuple(found)


def with_own_kpis(result: RunResult, own: Iterable[OwnKpi]) -> RunResult:
    """A result with its KPIs and those of the user's."""
    own = tuple(own)
    if not own:
        return result
    trajectory = trajectory_frame(result.steps)
    return replace(result, kpis=result.kpis | {kpi.key: kpi.of(trajectory) for kpi in own})


def own_of(kpis: Mapping[str, float | None]) -> dict[str, float | None]:
    """Those of `kpis` that are the user's, by name and unit."""
    return {key: value for key, value in kpis.items() if _UNIT_AFTER in key}


# Accounts in the folder of a run, the first one counts: of what was set (`tf-mpc saving`), of what a shadow would have.
VERIFIED, SHADOW = "saving.json", "shadow.json"
MOST_BYTES = 10_000_000
_NOT_KNOWN = "not known yet: --mode shadow says what would be saved, `tf-mpc saving --out` into this folder what was"


def saving_so_far(folder: Path) -> dict[str, Any]:
    """The account in `folder`: `said` in a sentence, and numbers, where there are some."""
    for name in (VERIFIED, SHADOW):
        try:
            told = read_json(folder / name, MOST_BYTES)
            return {key: one for key, one in told.items() if isinstance(one, str | int | float)} | {
                "said": str(told["said"])
            }
        except (InputError, KeyError):
            continue
    return {"said": _NOT_KNOWN}
