"""Comparisons of the embedded plant with records of the real test case, one function for each kind of record."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary.tariffs import Tariff, held_prices
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import EmbeddedPlant

STEP_S = 900.0
SCORED_S = 14 * DAY_S
# Native control before the records begin; as long as in the records, since the ground has a memory of weeks.
REPLAY_WARMUP_S, WINDOW_WARMUP_S = 5 * DAY_S, 7 * DAY_S
_POWERS = ["reaPHeaPum_y", "reaPFan_y", "reaPPumEmi_y"]
_HIGHLY_DYNAMIC = "PriceElectricPowerHighlyDynamic"
Row = dict[str, Any]


@dataclass(frozen=True)
class Thermostat:
    """On/off thermostat run on the real test case: centre of the dead band, °C (±0.1 K), level, energy, kWh/m²."""

    start_day: int
    centre_C: float
    level: float
    ener_tot: float


# On/off thermostats at 15-min steps after 7 days of native control, recorded on the real test case (BOPTEST 0.9 series)
# with its own weather; energy in kWh/m².
THERMOSTATS = (
    Thermostat(16, 21.3, 1.0, 2.543),
    Thermostat(44, 21.3, 1.0, 2.316),
    Thermostat(108, 21.3, 1.0, 1.199),
    Thermostat(16, 21.3, 0.8, 2.655),
    Thermostat(108, 21.3, 0.8, 1.243),
    Thermostat(16, 22.0, 1.0, 2.738),
    Thermostat(108, 22.0, 1.0, 1.326),
)


def read(path: Path, columns: list[str]) -> pd.DataFrame:
    """Read a CSV file with at least `columns`; raises `DataError` naming the file and missing columns."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read as CSV ({error})") from error
    missing = [name for name in columns if name not in table]
    if missing or table.empty:
        raise DataError(f"{path}: " + (f"columns missing: {', '.join(missing)}" if missing else "no rows"))
    return table


def replay(plant: EmbeddedPlant, path: Path, warmup_s: float, *, native: bool = False) -> tuple[Row, Array, Array]:
    """Apply the recorded level (or native control) and compare temperature and electric power.

    Returns:
        Table row, errors of the zone temperature, K, and their times, days since the start.
    """
    real = read(path, ["time", "reaTZon_y", "oveHeaPumY_u", *_POWERS])
    start_s = float(real.time.iloc[0]) - STEP_S
    plant.reset(start_s, warmup_s)
    measured = [plant.advance(None if native else float(u), STEP_S) for u in real.oveHeaPumY_u]
    error = np.array([m.T_zone_C[0] for m in measured]) - real.reaTZon_y.to_numpy()
    row: Row = {
        "T_rmse_K": rms(error),
        "T_bias_K": float(error.mean()),
        "last_day_bias_K": float(error[-96:].mean()),
    }
    power, truth = np.array([m.power_W[0] for m in measured]), real[_POWERS].sum(axis=1).to_numpy()
    if truth.sum() > 0:
        row["energy_off"] = float(power.sum() / truth.sum() - 1)
        hours = power.size // 4
        hourly = (power - truth)[: hours * 4].reshape(hours, 4).mean(axis=1)
        row["power_hourly_rmse"] = rms(hourly) / float(truth.mean())
    return row, error, (real.time.to_numpy() - start_s) / DAY_S


def native_windows(
    plant: EmbeddedPlant, path: Path, tariffs: Collection[str], every: int = 1
) -> tuple[list[Row], list[Target]]:
    """Compare with published KPIs of the native controller for every `every`-th window, and costs under `tariffs`."""
    published = read(path, ["price", "centre_day", "ener_tot", "cost_tot", "tdis_tot", "pele_tot"])
    published = published[published.price.isin(tariffs)]
    days = sorted(published.centre_day.unique())[::every]
    off: dict[str, list[float]] = {"ener_tot": [], "tdis_tot": [], "pele_tot": []}
    for day in days:
        start_s = (float(day) - 7) * DAY_S
        plant.reset(start_s, WINDOW_WARMUP_S)
        plant.advance(None, SCORED_S)
        # The native controller does not use prices: one simulation is valid for all tariffs.
        windows = published[published.centre_day == day]
        kpis = plant.kpis()
        for key in ("ener_tot", "tdis_tot", "pele_tot"):
            off[key].append(_relative(kpis[key], windows[key].iloc[0]))
        for price, cost in zip(windows.price, windows.cost_tot, strict=True):
            plant.use(str(price), None)
            off.setdefault(f"cost_tot {price}", []).append(_relative(plant.kpis()["cost_tot"], cost))
    limits = {"ener_tot": 0.01, "cost_tot": 0.01, "tdis_tot": 0.05, "pele_tot": 0.02}
    rows, targets = [], []
    for key, errors in off.items():
        known = np.array([error for error in errors if np.isfinite(error)])
        median, worst = float(np.median(known)), float(known.max())
        rows.append({"what": f"native {key}, {known.size} windows", "median_off": median, "worst_off": worst})
        kpi = key.split()[0]
        targets.append(Target(f"native {key}: median off by", median, limits[kpi]))
        if kpi in ("ener_tot", "cost_tot"):
            targets.append(Target(f"native {key}: worst off by", worst, 0.03))
    return rows, targets


def thermostat_energy(plant: EmbeddedPlant, thermostat: Thermostat) -> float:
    """Energy of a thermostat run over two weeks, kWh/m²."""
    measured = plant.reset(thermostat.start_day * DAY_S, WINDOW_WARMUP_S)
    on = False
    for _ in range(round(SCORED_S / STEP_S)):
        T_zone_C = float(measured.T_zone_C[0])
        if abs(T_zone_C - thermostat.centre_C) > 0.1:
            on = T_zone_C < thermostat.centre_C
        measured = plant.advance(thermostat.level if on else 0.0, STEP_S)
    return plant.kpis()["ener_tot"]


def pair_errors(plant: EmbeddedPlant, folder: Path) -> Iterator[Array]:
    """Error of the effect B − A of each 15-min pair that `pairs.csv` lists, K."""
    for number in read(folder / "pairs.csv", ["pair"]).pair.astype(int):
        ours, truth = [], []
        for side in ("A", "B"):
            real = read(folder / f"pair{number:02d}_{side}.csv.gz", ["time", "reaTZon_y", "oveHeaPumY_u"])
            start_s = float(real.time.iloc[0]) - STEP_S
            plant.reset(start_s, REPLAY_WARMUP_S)
            ours.append(np.array([plant.advance(float(u), STEP_S).T_zone_C[0] for u in real.oveHeaPumY_u]))
            truth.append(real.reaTZon_y.to_numpy())
        yield (ours[1] - ours[0]) - (truth[1] - truth[0])


def hourly_pair_errors(plant: EmbeddedPlant, path: Path) -> Iterator[Array]:
    """Error of the effect B − A of each hourly pair, K; both sides branch from one snapshot of the plant."""
    table = read(path, ["pair", "start_day", "hour", "uA", "uB", "TA_end", "TB_end"])
    for _, real in table.groupby("pair"):
        start_s = float(real.start_day.iloc[0]) * DAY_S
        plant.reset(start_s, REPLAY_WARMUP_S)
        here = plant.snapshot()
        ours, effect = [], real.sort_values("hour")
        for column in ("uA", "uB"):
            plant.restore(here)
            ours.append(np.array([plant.advance(float(u), HOUR_S).T_zone_C[0] for u in effect[column]]))
        yield (ours[1] - ours[0]) - (effect.TB_end - effect.TA_end).to_numpy()


def recorded_tariff(path: Path) -> Tariff | None:
    """The highly dynamic tariff in a record of the boundary conditions; None if there is none."""
    table = read(path, ["time"])
    if _HIGHLY_DYNAMIC not in table:
        return None
    return held_prices(table.time.to_numpy(dtype=np.float64), table[_HIGHLY_DYNAMIC].to_numpy(dtype=np.float64))


def _relative(value: float, truth: float) -> float:
    """|value / truth − 1|, NaN where the truth is zero."""
    return abs(value / float(truth) - 1) if truth else float("nan")
