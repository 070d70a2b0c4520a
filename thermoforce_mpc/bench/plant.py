"""How near the embedded plant comes to records of the real test case: replays, native windows, paired interventions."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thermoforce_mpc.bench.result import Target, bench_result
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.types import DAY_S, Array
from thermoforce_mpc.weather import load_weather

_STEP_S = 900.0
_SCORED_S = 14 * DAY_S
_POWERS = ["reaPHeaPum_y", "reaPFan_y", "reaPPumEmi_y"]
Row = dict[str, Any]


def run_plant_bench(
    reference: Path,
    weather: Path | None = None,
    *,
    quick: bool = False,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Score the emulator against whatever `reference` holds of the layout in docs/plant.md.

    Args:
        reference: folder with excite_*.csv.gz, off_*.csv.gz, baseline_kpis*.csv, pairs/.
        weather: the records' weather file; by default the only .mos file in `reference`.
        quick: every eighth native window.
        out: folder for the plot `plant_replay.png`.
        progress: told what is being done.

    Raises:
        DataError: the folder holds nothing to score, or no weather file.
    """
    if weather is None:
        found = sorted(reference.glob("*.mos"))
        if len(found) != 1:
            raise DataError(f"{reference}: expected one .mos file there, found {len(found)}; give --weather")
        weather = found[0]
    plant = EmbeddedPlant(load_weather(weather))
    rows: list[Row] = []
    targets: list[Target] = []
    errors: dict[str, tuple[Array, Array]] = {}
    for path in [*sorted(reference.glob("excite_*.csv.gz")), *sorted(reference.glob("off_*.csv.gz"))]:
        name = path.name.removesuffix(".csv.gz")
        progress(f"replaying {name}")
        row, error, day = _replay(plant, pd.read_csv(path), 7 if name.startswith("off") else 5)
        rows.append({"what": name} | row)
        errors[name] = (day, error)
        targets.append(Target(f"{name}: T RMSE, K", row["T_rmse_K"], 0.15 if name.startswith("off") else 0.10))
        if "power_ratio" in row:
            targets.append(Target(f"{name}: energy off by", abs(row["power_ratio"] - 1), 0.01))
            targets.append(Target(f"{name}: hourly power RMSE", row["power_hourly_rmse"], 0.03))
    for path in sorted(reference.glob("baseline_kpis*.csv")):
        progress(f"native windows of {path.name}")
        rows_native, targets_native = _native(plant, pd.read_csv(path), 8 if quick else 1)
        rows += rows_native
        targets += targets_native
    if (reference / "pairs" / "pairs.csv").is_file():
        progress("paired interventions")
        effect = list(_pairs(plant, reference / "pairs"))
        rmse = float(np.sqrt(np.mean(np.concatenate(effect) ** 2)))
        rows.append({"what": f"effect of {len(effect)} paired interventions", "T_rmse_K": rmse})
        targets.append(Target("pairs: effect RMSE, K", rmse, 0.03))
    if not rows:
        raise DataError(f"{reference}: nothing to score (no excite_*, off_*, baseline_kpis* or pairs/pairs.csv)")
    rows.append({"what": "speed: 7 + 14 days at 15 min", "seconds": _speed(plant)})
    if out is not None:
        _plot(errors, out)
    return bench_result("plant", rows, targets)


def _replay(plant: EmbeddedPlant, real: pd.DataFrame, warmup_days: float) -> tuple[Row, Array, Array]:
    """Open loop: the recorded level is applied, temperature and power are compared."""
    start_s = float(real.time.iloc[0]) - _STEP_S
    plant.reset(start_s, min(warmup_days * DAY_S, start_s))
    measured = [plant.advance(float(u), _STEP_S) for u in real.oveHeaPumY_u]
    error = np.array([m.T_zone_C for m in measured]) - real.reaTZon_y.to_numpy()
    row: Row = {
        "T_rmse_K": float(np.sqrt(np.mean(error**2))),
        "T_bias_K": float(error.mean()),
        "last_day_bias_K": float(error[-96:].mean()),
    }
    power, truth = np.array([m.power_W for m in measured]), real[_POWERS].sum(axis=1).to_numpy()
    if truth.sum() > 0:
        row["power_ratio"] = float(power.sum() / truth.sum())
        hours = power.size // 4
        hourly = (power - truth)[: hours * 4].reshape(hours, 4).mean(axis=1)
        row["power_hourly_rmse"] = float(np.sqrt(np.mean(hourly**2)) / truth.mean())
    return row, error, (real.time.to_numpy() - start_s) / DAY_S


def _native(plant: EmbeddedPlant, published: pd.DataFrame, every: int) -> tuple[list[Row], list[Target]]:
    """Published KPIs of the native controller, window by window; the tariff that cannot ship is left out."""
    priced = published[published.price != "highly_dynamic"]
    days = sorted(priced.centre_day.unique())[::every]
    off: dict[str, list[float]] = {key: [] for key in ("ener_tot", "cost_tot", "tdis_tot", "pele_tot")}
    for day in days:
        for _, window in priced[priced.centre_day == day].iterrows():
            start_s = (float(day) - 7) * DAY_S
            plant.reset(start_s, min(7 * DAY_S, start_s), str(window.price))
            plant.advance(None, _SCORED_S)
            kpis = plant.kpis()
            for key, errors in off.items():
                if window[key] > 0:
                    errors.append(abs(kpis[key] / float(window[key]) - 1))
    limits = {"ener_tot": 0.01, "cost_tot": 0.01, "tdis_tot": 0.05, "pele_tot": 0.02}
    rows = [
        {"what": f"native {key}, {len(days)} windows", "median_off": float(np.median(e)), "worst_off": float(np.max(e))}
        for key, e in off.items()
    ]
    targets = [Target(f"native {key}: median off by", float(np.median(off[key])), goal) for key, goal in limits.items()]
    targets += [
        Target(f"native {key}: worst off by", float(np.max(off[key])), 0.03) for key in ("ener_tot", "cost_tot")
    ]
    return rows, targets


def _pairs(plant: EmbeddedPlant, folder: Path) -> Iterator[Array]:
    """Error of the effect B − A of each recorded pair, K."""
    for number in pd.read_csv(folder / "pairs.csv").pair.astype(int):
        effects = []
        for side in ("A", "B"):
            real = pd.read_csv(folder / f"pair{number:02d}_{side}.csv.gz")
            start_s = float(real.time.iloc[0]) - _STEP_S
            plant.reset(start_s, min(5 * DAY_S, start_s))
            T = np.array([plant.advance(float(u), _STEP_S).T_zone_C for u in real.oveHeaPumY_u])
            effects.append((T, real.reaTZon_y.to_numpy()))
        (T_a, real_a), (T_b, real_b) = effects
        yield (T_b - T_a) - (real_b - real_a)


def _speed(plant: EmbeddedPlant) -> float:
    """Seconds for two weeks at 15 minutes after a week of warm-up, best of three."""
    best = np.inf
    for _ in range(3):
        began = time.perf_counter()
        plant.reset(16 * DAY_S, 7 * DAY_S)
        for _ in range(14 * 96):
            plant.advance(None, _STEP_S)
        best = min(best, time.perf_counter() - began)
    return best


def _plot(errors: dict[str, tuple[Array, Array]], out: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axis = figure.subplots()
    for name, (day, error) in errors.items():
        axis.plot(day, error, linewidth=1.0, label=name)
    axis.axhline(0.0, color="#8a939c", linewidth=0.8)
    axis.set_xlabel("days of replay")
    axis.set_ylabel("emulator minus real test case, K")
    axis.legend(frameon=False)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "plant_replay.png", dpi=120)
