"""Run folder: configuration, trajectories, step log, KPIs and manifest of one run. Never overwritten."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout

from thermoforce_mpc.data import Names, Plan
from thermoforce_mpc.errors import ArtifactError, ConfigError, StorageError
from thermoforce_mpc.files import storage_errors, sweep, write_whole
from thermoforce_mpc.loop.closed_loop import StepRecord
from thermoforce_mpc.records.plain_files import HARD_LINK, check_plain, write_plain
from thermoforce_mpc.registry import plugins
from thermoforce_mpc.version import VERSION, installed

LOCK = ".lock"
_PACKAGES = ("casadi", "torch", "chronos-forecasting", "numpy", "pandas", "requests", "numba", "scipy", "pydantic")


def create_run_folder(out: Path | None, stem: str, root: Path = Path("runs")) -> Path:
    """Create the folder of a run: `out`, or the next free `runs/<stem>-NNN`.

    Raises:
        ConfigError: `out` exists and is not an empty folder.
        StorageError: it cannot be created.
    """
    try:
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
    except OSError as error:
        raise StorageError(f"cannot create the run folder {out or root}: {error.strerror or error}") from error
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
    for name in (LOCK, "journal.jsonl", "log.jsonl"):  # written where they stand; all else is replaced
        with suppress(FileNotFoundError):
            if (folder / name).stat().st_nlink > 1:
                raise ConfigError(f"{folder / name}: {HARD_LINK}")
    lock = FileLock(folder / LOCK, timeout=0)
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


def write_json(path: Path, content: Mapping[str, Any], *, follow: bool = False) -> None:
    """Write standard JSON: NaN and infinities become null; `follow` as of `written`."""
    text = json.dumps(plain_json(content), indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(path, text + "\n", follow=follow)


def plain_json(value: Any) -> Any:
    """`value` in JSON types; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if hasattr(value, "item") and not isinstance(value, str):
        value = value.item()
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value
