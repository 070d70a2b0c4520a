"""`tf-mpc bench plant`: accuracy of the embedded plants against records of the real test cases, and their speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plant import point_scores, scores
from benchmarks.plant.speed import scaling, two_weeks_s
from thermoforce_mpc.boundary.periods import published_windows
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import Array
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import EmbeddedPlant

_T_RMSE_K = {"excite": 0.10, "off": 0.15, "native": 0.10}


def run_plant_bench(
    references: Path | Sequence[Path],
    weather: Path | None = None,
    *,
    quick: bool = False,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> dict[str, Any]:
    """Score the embedded plants against all records in `references` (layout in docs/evidence/plant.md).

    Args:
        references: a folder for each test case, which its records' columns tell, with any of excite_*.csv.gz,
            off_*.csv.gz, native_*.csv.gz, baseline_kpis*.csv, pairs/.
        weather: the records' weather file; by default the only .mos file in a folder, or its boundary_hourly.csv.gz.
        quick: the first replay of each kind, every eighth native window, two thermostats, no scaling.
        out: folder for the plot `plant_replay.png`.
        progress: callback for progress lines.

    Raises:
        DataError: no records in the folder, a column is missing, or there is no weather file.
    """
    rows: list[scores.Row] = []
    targets: list[Target] = []
    errors: dict[str, tuple[Array, Array]] = {}
    for folder in [references] if isinstance(references, Path) else references:
        case = point_scores.case_of(folder)
        if case is None:
            of_folder = _heat_pump(folder, weather, quick, progress)
        else:
            plant = point_scores.recorded_plant(case, folder, weather)
            of_folder = point_scores.score(plant, folder, quick=quick, progress=progress)
            seconds = two_weeks_s(plant)
            of_folder[0].append({"what": f"{case.name} speed: 7 + 14 days at 15 min", "seconds": seconds})
            of_folder[1].append(Target(f"{case.name} speed: 7 + 14 days at 15 min, s", seconds, 2.0))
        rows += of_folder[0]
        targets += of_folder[1]
        errors |= of_folder[2]
    if out is not None and errors:
        _plot(errors, out)
    return results_json("plant", rows, targets)


def _heat_pump(
    reference: Path, weather: Path | None, quick: bool, progress: Callable[[str], None]
) -> tuple[list[scores.Row], list[Target], dict[str, tuple[Array, Array]]]:
    """Score the records of `bestest_hydronic_heat_pump` in a folder: rows, targets, days and errors of each replay."""
    if weather is None:
        found = sorted(reference.glob("*.mos"))
        if len(found) != 1:
            raise DataError(f"{reference}: expected one .mos file there, found {len(found)}; give --weather")
        weather = found[0]
    boundary = reference / "boundary_hourly.csv.gz"
    spot = scores.recorded_tariff(boundary) if boundary.is_file() else None
    plant = EmbeddedPlant(load_weather(weather), highly_dynamic=spot)
    rows: list[scores.Row] = []
    targets: list[Target] = []
    errors: dict[str, tuple[Array, Array]] = {}
    for kind, limit_K in _T_RMSE_K.items():
        for path in sorted(reference.glob(f"{kind}_*.csv.gz")):
            name = path.name.removesuffix(".csv.gz")
            progress(f"replaying {name}")
            warmup_s = scores.REPLAY_WARMUP_S if kind == "excite" else scores.WINDOW_WARMUP_S
            row, error, day = scores.replay(plant, path, warmup_s, native=kind == "native")
            rows.append({"what": name} | row)
            errors[name] = (day, error)
            targets.append(Target(f"{name}: T RMSE, K", row["T_rmse_K"], limit_K))
            if "energy_off" in row:
                targets.append(Target(f"{name}: energy off by", abs(row["energy_off"]), 0.01))
                targets.append(Target(f"{name}: hourly power RMSE", row["power_hourly_rmse"], 0.03))
    tariffs = ["constant", "dynamic"] + (["highly_dynamic"] if spot else [])
    for path in sorted(reference.glob("baseline_kpis*.csv")):
        progress(f"native windows of {path.name}")
        native_rows, native_targets = scores.native_windows(plant, path, tariffs, every=8 if quick else 1)
        rows += native_rows
        targets += native_targets
    for what, effect in _effects(plant, reference / "pairs", progress).items():
        rmse = rms(np.concatenate(effect))
        rows.append({"what": f"effect of {len(effect)} {what}", "T_rmse_K": rmse})
        targets.append(Target(f"{what}: effect RMSE, K", rmse, 0.03))
    if not rows:
        raise DataError(f"{reference}: nothing to score (no excite_*, off_*, native_*, baseline_kpis* or pairs/)")
    if published_windows(plant.case.name, plant.weather):  # the thermostat runs were recorded in this weather
        progress("thermostats")
        for thermostat in scores.THERMOSTATS[:: 4 if quick else 1]:
            off = scores.thermostat_energy(plant, thermostat) / thermostat.ener_tot - 1
            what = f"thermostat {thermostat.centre_C:g} °C, u = {thermostat.level:g}, from day {thermostat.start_day}"
            rows.append({"what": what, "energy_off": off})
            targets.append(Target(f"{what}: energy off by", abs(off), 0.01))
    progress("speed")
    seconds = two_weeks_s(plant)
    rows.append({"what": "speed: 7 + 14 days at 15 min", "seconds": seconds})
    targets.append(Target("speed: 7 + 14 days at 15 min, s", seconds, 2.0))
    if not quick:
        rows += scaling(plant.weather)
    return rows, targets, errors


def _effects(plant: EmbeddedPlant, folder: Path, progress: Callable[[str], None]) -> dict[str, list[Array]]:
    """Errors of the effects of interventions, K, for each kind of record in `folder`."""
    effects: dict[str, list[Array]] = {}
    if (folder / "pairs.csv").is_file():
        progress("paired interventions")
        effects["paired interventions"] = list(scores.pair_errors(plant, folder))
    if (folder / "pairs_1h.csv.gz").is_file():
        progress("hourly paired interventions")
        effects["hourly pairs"] = list(scores.hourly_pair_errors(plant, folder / "pairs_1h.csv.gz"))
    return effects


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
