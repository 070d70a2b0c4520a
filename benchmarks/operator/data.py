"""Reader of reference records of a building (single runs, paired interventions) in the layout of the operator bench.

excite_*.csv.gz        15-min runs with excitation, samples at the ends of the steps, BOPTEST names
pairs/pairs_1h.csv.gz  hourly pairs (columns pair, start_day, kind, h0, hour, uA, uB, TA_start, ... QA_W, PA_W, ...)
boundary_hourly.csv.gz weather of the pairs, hourly from 1 January
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.records import Pair

FLOOR_AREA_M2 = 192.0
"""Heated floor area of the reference building, m² (BOPTEST test case documentation)."""

_POWERS = ["reaPHeaPum_y", "reaPFan_y", "reaPPumEmi_y"]


@dataclass(frozen=True)
class ReferencePair:
    """A pair (first run with the intervention, second without), its start day and start hour of the intervention."""

    start_day: int
    kind: str
    window_start: int
    pair: Pair


def read_table(path: Path) -> pd.DataFrame:
    """Read a CSV; raises `DataError` naming the file."""
    try:
        return pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read as CSV ({error})") from error


def read_run(path: Path) -> Record:
    """Read a 15-min record of the test case. Samples are at the ends of the steps, so the first step is dropped.

    Raises:
        DataError: the file is missing, or lacks a column.
    """
    frame = read_table(path)
    try:
        return Record(
            time_s=frame["time"].to_numpy(),
            T_zone_C=frame["reaTZon_y"].to_numpy(),
            T_out_C=frame["weaSta_reaWeaTDryBul_y"].to_numpy(),
            solar_W_m2=frame["weaSta_reaWeaHGloHor_y"].to_numpy(),
            u=frame["oveHeaPumY_u"].to_numpy()[1:],
            power_W=frame[_POWERS].sum(axis=1).to_numpy()[1:],
            heat_W=frame["reaQHeaPumCon_y"].to_numpy()[1:],
        )
    except KeyError as error:
        raise DataError(f"{path}: column {error} is missing") from error


def cut(history: Record, first_day: float, days: float) -> Record:
    """`days` days of a run, starting `first_day` days after its beginning."""
    per_day = DAY_S / history.step_s
    start, n = round(first_day * per_day), round(days * per_day)
    return history.slice(start, start + n)


def read_hourly_pairs(folder: Path) -> list[ReferencePair]:
    """The hourly pairs of a reference folder, in the order of the file; raises `DataError`."""
    frame = read_table(folder / "pairs" / "pairs_1h.csv.gz")
    weather = read_table(folder / "boundary_hourly.csv.gz")
    try:
        return [_hourly_pair(str(number), group, weather) for number, group in frame.groupby("pair")]
    except (KeyError, IndexError) as error:
        raise DataError(f"{folder}: the pairs or their weather lack {error}") from error


def _hourly_pair(label: str, group: pd.DataFrame, weather: pd.DataFrame) -> ReferencePair:
    day = int(group["start_day"].iloc[0])
    first = day * 24 + int(group["hour"].iloc[0])
    index = np.arange(first, first + len(group) + 1)

    def run(side: str) -> Record:
        return Record(
            time_s=index.astype(np.float64) * HOUR_S,
            T_zone_C=np.append(group[f"T{side}_start"].to_numpy(), group[f"T{side}_end"].iloc[-1]),
            T_out_C=weather["TDryBul"].to_numpy()[index],
            solar_W_m2=weather["HGloHor"].to_numpy()[index],
            u=group[f"u{side}"].to_numpy(),
            power_W=group[f"P{side}_W"].to_numpy(),
            heat_W=group[f"Q{side}_W"].to_numpy(),
        )

    return ReferencePair(
        start_day=day,
        kind=str(group["kind"].iloc[0]),
        window_start=int(group["h0"].iloc[0]),
        pair=Pair(run("B"), run("A"), label=label),
    )
