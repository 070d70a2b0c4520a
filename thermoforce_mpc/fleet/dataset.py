"""The dataset of a fleet: one row a run, as Parquet with a schema of its own."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from thermoforce_mpc.comparison.store import DONE
from thermoforce_mpc.data import PlanStatus
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import pyarrow_for, write_plain
from thermoforce_mpc.fleet.runs import FleetRun

NAME = "runs.parquet"
# Increased whenever a column changes its meaning, its type or its name.
FORMAT = "1"
_FORMAT_KEY = b"thermoforce_mpc.fleet"

_TEXT = ("building", "source", "emitter", "machine", "mass", "description", "window", "price", "variant", "controller",
         "uncertainty", "status", "reason", "plant", "weather", "key", "identification", "version", "code")  # fmt: skip
# Units: areas m²; costs currency/m²; energy kWh/m²; emissions kg/m²; peaks kW/m²; discomfort K·h per zone; times s.
_NUMBERS = ("area_m2", "days", "start_day", "cost_tot", "tdis_tot", "ener_tot", "emis_tot", "pele_tot", "pgas_tot",
            "pdih_tot", "seconds", "plan_median_s", "plan_longest_s")  # fmt: skip
_PLANS = tuple(f"plans_{status.value}" for status in PlanStatus)


@cache
def schema() -> Any:
    """Columns and types of the dataset; raises `ConfigError` where pyarrow is not installed."""
    pa = pyarrow_for(NAME, ConfigError)
    texts = [pa.field(name, pa.string(), nullable=False) for name in _TEXT]
    numbers = [pa.field(name, pa.float64()) for name in _NUMBERS]
    whole = [pa.field(name, pa.int64(), nullable=False) for name in (*_PLANS, "plans_refused")]
    seed = pa.field("seed", pa.int64(), nullable=False)
    return pa.schema([*texts, seed, *numbers, *whole], metadata={_FORMAT_KEY: FORMAT.encode()})


def row_of(run: FleetRun, record: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a run with its record; what a failed run has not is missing."""
    cell = run.cell
    plans, kpis, seconds = (record.get(name) or {} for name in ("fallback_levels", "kpis", "seconds"))
    plant = record.get("plant") or {}
    row = _place(run) | {
        "controller": cell.scenario.controller.name,
        "days": cell.scenario.days,
        "status": record["status"],
        "reason": record["reason"],
        "plant": plant.get("kind", ""),
        "weather": plant.get("weather", ""),
        "key": cell.key,
        # That of the model the run had: after a change of the source the cell's key is another.
        "identification": record["model"] if cell.identification_key else "",
        "version": record["version"],
        "code": record["source"],
        "start_day": record.get("start_day"),
        "seconds": seconds.get("total"),
        "plan_median_s": seconds.get("plan_median"),
        "plan_longest_s": seconds.get("plan_longest"),
    }
    row |= {name: kpis.get(name) for name in _NUMBERS if name.endswith("_tot")}
    return row | {name: plans.get(name.removeprefix("plans_"), 0) for name in (*_PLANS, "plans_refused")}


def _place(run: FleetRun) -> dict[str, Any]:
    """Where a run stands in its fleet: the building and the axes."""
    building, cell = run.building, run.cell
    of_building = ("source", "emitter", "machine", "mass", "description", "area_m2")
    place = {"building": building.name} | {name: getattr(building, name) for name in of_building}
    of_cell = {name: getattr(cell, name) for name in ("window", "price", "uncertainty", "variant")}
    return place | of_cell | {"seed": cell.scenario.seed}


def finished_rows(datasets: Iterable[Path]) -> dict[str, dict[str, Any]]:
    """Rows of the finished runs of datasets (folders or files), by key; raises `ConfigError` for another schema."""
    by_key: dict[str, dict[str, Any]] = {}
    for path in datasets:
        rows = read_dataset(path)
        finished = rows[rows["status"] == DONE].astype(object)
        by_key |= {row["key"]: row for row in finished.where(finished.notna(), None).to_dict("records")}
    return by_key


def reused_row(run: FleetRun, row: Mapping[str, Any]) -> dict[str, Any]:
    """The `row` of a run with the same inputs as a row of this run."""
    return {**row, **_place(run)}


def write_dataset(folder: Path, rows: Iterable[Mapping[str, Any]]) -> Path:
    """Write the rows (`row_of`) in the order given as `runs.parquet`, whole or not at all; raises `StorageError`."""
    path, content = folder / NAME, io.BytesIO()
    pa = pyarrow_for(path, ConfigError)
    pa.parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema=schema()), content)
    write_plain(path, content.getvalue())
    return path


def check_dataset(path: Path) -> None:
    """Refuse a dataset, the file or its folder, of another schema; raises `ConfigError`."""
    pa, path = pyarrow_for(path, ConfigError), _file(path)
    if not path.exists():
        return
    try:
        found = pa.parquet.read_schema(path)
    except (OSError, pa.ArrowException) as error:
        raise ConfigError(f"{path}: is no dataset of a fleet ({error}); give another folder, or remove it") from error
    version = (found.metadata or {}).get(_FORMAT_KEY, b"none").decode(errors="replace")
    if version != FORMAT or found.names != schema().names or found.types != schema().types:
        version += " with other columns" if version == FORMAT else ""
        raise ConfigError(
            f"{path}: its schema is {version}, this release writes {FORMAT}; give another folder, or remove it to have "
            "it written anew from the runs beside it"
        )


def read_dataset(path: Path) -> pd.DataFrame:
    """The dataset in a fleet's folder or file, one row a run; raises `ConfigError` for another one."""
    path = _file(path)
    if not path.exists():
        raise ConfigError(f"{path}: is missing; make it with `tf-mpc fleet`")
    check_dataset(path)
    try:
        return pd.read_parquet(path)
    except (OSError, pyarrow_for(path, ConfigError).ArrowException) as error:
        raise ConfigError(f"{path}: is damaged ({str(error).strip()}); remove it, or give another dataset") from error


def _file(path: Path) -> Path:
    return path if path.suffix == ".parquet" else path / NAME
