"""Comparisons of the emulators that act through points with records of the real test cases, by kind of record."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.plant.scores import SCORED_S, STEP_S, WINDOW_WARMUP_S, Row, read, recorded_tariff
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.comparison.outcome import Target
from thermoforce_mpc.data import DAY_S, ZERO_C_K, Array, energy_kWh
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded import PointEmulator
from thermoforce_mpc.plants.embedded.cases import CASES, EmulatedCase
from thermoforce_mpc.plants.testcases import load_testcase

_PAIR_WARMUP_S = 5 * DAY_S
# Goals by kind of record: RMSE of the zone temperature, K. Under random set-points a mode that switches a moment
# earlier moves the room by 0.2 K in ten seconds.
_T_RMSE_K = {"native": 0.03, "off": 0.03, "excite_direct": 0.03, "excite_set": 0.15, "excite_mix": 0.15}
_BIAS_K, _POWER_OFF, _ENERGY_OFF, _EFFECT_OFF = 0.01, 0.02, 0.01, 0.03
_KPI_OFF = {"cost_tot": 0.003, "ener_tot": 0.003, "emis_tot": 0.003}
_OTHER_KPI_OFF = {"tdis_tot": 0.01, "idis_tot": 0.01, "pele_tot": 0.01, "pgas_tot": 0.01}
# Energy below which a carrier is not scored, kWh, and share of its largest value below which a KPI is not.
_LEAST_KWH, _LEAST_SHARE = 0.1, 0.01


def case_of(folder: Path) -> EmulatedCase | None:
    """The test case of a folder's records, told by their columns; None where they are not by points."""
    for path in sorted(folder.glob("*_d*.csv.gz")):
        columns = pd.read_csv(path, nrows=0).columns
        for case in CASES.values():
            if _zone(case) in columns and f"{case.overwrites[0][0]}_activate" in columns:
                return case
    return None


def recorded_weather(path: Path, latitude_deg: float, longitude_deg: float, timezone_h: float) -> Weather:
    """The weather year of a record of boundary conditions, `boundary_hourly.csv.gz`, with the file's irradiance."""
    names = ["TDryBul", "TDewPoi", "relHum", "winSpe", "winDir", "nOpa", "nTot", "ceiHei", "HHorIR", "pAtm"]
    table = read(path, [*names, "HGloHor_tab", "HDirNor_tab", "HDifHor_tab"]).iloc[:8760]
    year = {str(name): table[name].to_numpy(dtype=np.float64) for name in table}
    return Weather(
        name=path.parent.name,
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        timezone_h=timezone_h,
        T_dry_C=year["TDryBul"],
        T_dew_C=year["TDewPoi"],
        global_W_m2=year["HGloHor_tab"],
        normal_W_m2=year["HDirNor_tab"],
        diffuse_W_m2=year["HDifHor_tab"],
        wind_m_s=year["winSpe"],
        wind_from_rad=np.minimum(year["winDir"], 2.0 * np.pi),  # the record is rounded
        opaque_cover=year["nOpa"],
        pressure_Pa=year["pAtm"],
        relative_humidity=year["relHum"],
        infrared_W_m2=year["HHorIR"],
        total_cover=year["nTot"],
        ceiling_m=year["ceiHei"],
    )


def recorded_plant(case: EmulatedCase, folder: Path, weather: Path | None) -> PointEmulator:
    """The emulator in the weather and with the prices of a folder's records; raises `DataError` where they lack."""
    boundary = folder / "boundary_hourly.csv.gz"
    if weather is None and not boundary.is_file():
        raise DataError(f"{folder}: has no boundary_hourly.csv.gz, whose weather the records had; give --weather")
    zone_h = case.climate.timezone_h
    year = recorded_weather(boundary, *case.site, zone_h) if weather is None else load_weather(weather)
    spot = recorded_tariff(boundary) if boundary.is_file() else None
    return PointEmulator(load_testcase(case.name), year, highly_dynamic=spot)


def score(
    plant: PointEmulator, folder: Path, *, quick: bool, progress: Callable[[str], None]
) -> tuple[list[Row], list[Target], dict[str, tuple[Array, Array]]]:
    """Score all records of a folder: rows, targets, and days and errors of each replay."""
    name = plant.case.name
    rows: list[Row] = []
    targets: list[Target] = []
    errors: dict[str, tuple[Array, Array]] = {}
    for kind, limit_K in _T_RMSE_K.items():
        for path in sorted(folder.glob(f"{kind}_d*.csv.gz"))[: 1 if quick else None]:
            what = f"{name} {path.name.removesuffix('.csv.gz')}"
            progress(f"replaying {what}")
            row, day, error = _replay(plant, path)
            rows.append({"what": what} | row)
            errors[what] = day, error
            targets.append(Target(f"{what}: T RMSE, K", row["T_rmse_K"], limit_K))
            targets.append(Target(f"{what}: T bias, K", abs(row["T_bias_K"]), _BIAS_K))
            for key, value in row.items():
                if key.endswith("_rmse"):
                    targets.append(Target(f"{what}: {key[: -len('_rmse')]}, RMSE over mean", value, _POWER_OFF))
                elif key.endswith("_energy_off"):
                    energy = key[: -len("_energy_off")]
                    targets.append(Target(f"{what}: {energy}, energy off by", abs(value), _ENERGY_OFF))
    if (folder / "baseline_kpis.csv").is_file():
        progress(f"native scenarios of {name}")
        of_kpi = _native_kpis(plant, folder / "baseline_kpis.csv")
        for kpi, off in of_kpi.items():
            rows.append({"what": f"{name} native {kpi}, {len(off)} scenarios", "worst_off": max(off)})
            limit = (_KPI_OFF | _OTHER_KPI_OFF)[kpi.split()[0]]
            targets.append(Target(f"{name} native {kpi}: worst off by", max(off), limit))
    if (folder / "pairs" / "pairs.csv").is_file():
        progress(f"paired interventions of {name}")
        off = list(_effects_off(plant, folder / "pairs"))
        rows.append({"what": f"{name} effect of {len(off)} paired interventions", "worst_off": max(off)})
        targets.append(
            Target(f"{name} paired interventions: worst RMSE over the largest effect", max(off), _EFFECT_OFF)
        )
    return rows, targets, errors


def _zone(case: EmulatedCase) -> str:
    return next(name for name, column in case.measurements.items() if column == case.zone)


def _replay(plant: PointEmulator, path: Path) -> tuple[Row, Array, Array]:
    """Replay a record's inputs and compare zone temperature and powers.

    Powers are compared step by step where a mode lasts for the step: a mode that switches within it does so a moment
    earlier or later, and what is left is the energy of the whole record. `*_any_mode`: over all steps.
    """
    case = plant.case
    powers = [name for name, column in case.measurements.items() if column in _billed(case)]
    real = _read(plant, path, powers)
    T_C, means = _run(plant, real, WINDOW_WARMUP_S, powers)
    error = T_C - real[_zone(case)].to_numpy()
    row: Row = {"T_rmse_K": rms(error), "T_bias_K": float(error.mean()), "T_worst_K": float(np.abs(error).max())}
    steady = np.ones(len(real), dtype=bool)
    if "int_coolMode" in real:
        steady = real.int_coolMode.isin((0, 1)).to_numpy()
        row["T_rmse_steady_mode_K"] = rms(error[steady])
    for name in powers:
        truth, ours = real[name].to_numpy(), means[name]
        if energy_kWh(float(truth.sum()), STEP_S) < _LEAST_KWH:
            continue
        on = truth > 0.01 * truth.max()
        row[f"{name}_rmse"] = rms((ours - truth)[on & steady]) / float(truth[on & steady].mean())
        if not steady.all():
            row[f"{name}_rmse_any_mode"] = rms((ours - truth)[on]) / float(truth[on].mean())
        row[f"{name}_energy_off"] = float(ours.sum() / truth.sum() - 1)
    return row, (real.time.to_numpy() - real.time.iloc[0] + STEP_S) / DAY_S, error


def _billed(case: EmulatedCase) -> list[str]:
    return [column for carrier in case.carriers.values() for column in carrier.columns]


def _read(plant: PointEmulator, path: Path, powers: list[str]) -> pd.DataFrame:
    names = [f"{name}_{end}" for name in plant.case.limits for end in ("y", "activate")]
    return read(path, ["time", _zone(plant.case), *names, *powers])


def _run(
    plant: PointEmulator, real: pd.DataFrame, warmup_s: float, powers: list[str]
) -> tuple[Array, dict[str, Array]]:
    """Temperature at the end, °C, and mean powers, W, of each step, averaged as in the records."""
    start_s = float(real.time.iloc[0]) - STEP_S
    plant.reset(start_s, min(warmup_s, start_s))
    T_C: list[float] = []
    means = {name: np.empty(len(real)) for name in powers}
    before: dict[str, float] = {}
    for k, step in enumerate(real.to_dict("records")):
        asked = {name: _in_kelvin(name, step[f"{name}_y"]) for name in plant.case.limits if step[f"{name}_activate"]}
        # The records have a sample one second after a change of inputs.
        pieces = (1.0, 29.0, STEP_S - 30.0) if asked != before else (STEP_S,)
        begin_s, before = plant.now_s + (pieces[0] if len(pieces) > 1 else 0.0), asked
        for piece_s in pieces:
            last = plant.advance_points(asked, piece_s)
        T_C.append(float(last.T_zone_C[0]))
        record = plant.recorded(begin_s, plant.now_s)
        for name in powers:
            power_W = record[plant.case.measurements[name]]
            of_first = power_W[0] * (STEP_S - (plant.now_s - begin_s))
            means[name][k] = (np.trapezoid(power_W, record["time"]) + of_first) / STEP_S
    return np.array(T_C), means


def _in_kelvin(name: str, value: float) -> float:
    return value + ZERO_C_K if "TS" in name else value


def _native_kpis(plant: PointEmulator, path: Path) -> dict[str, list[float]]:
    """|ours / real − 1| of each KPI in each scenario; costs by tariff."""
    names = ["cost_tot", *(name for name in _OTHER_KPI_OFF), "ener_tot", "emis_tot"]
    table = read(path, ["controller", "price", "period", *names])
    table = table[table.controller == "native"]
    largest = table[names].max()
    off: dict[str, list[float]] = {}
    for period, runs in table.groupby("period"):
        window = plant.period(str(period))
        plant.reset(window.start_s, window.warmup_s)
        plant.advance(None, SCORED_S)
        for run in runs.to_dict("records"):
            plant.use(run["price"], None)
            kpis = plant.kpis()
            for name in names if run["price"] == "constant" else ["cost_tot"]:
                if run[name] > _LEAST_SHARE * largest[name]:
                    key = f"{name} {run['price']}" if name == "cost_tot" else name
                    off.setdefault(key, []).append(abs(kpis[name] / run[name] - 1))
    return off


def _effects_off(plant: PointEmulator, folder: Path) -> Iterator[float]:
    """RMSE of the effect B − A of each pair over its largest value."""
    for number in read(folder / "pairs.csv", ["pair"]).pair.astype(int):
        ours, truth = [], []
        for side in ("A", "B"):
            real = _read(plant, folder / f"pair{number:02d}_{side}.csv.gz", [])
            ours.append(_run(plant, real, _PAIR_WARMUP_S, [])[0])
            truth.append(real[_zone(plant.case)].to_numpy())
        effect = truth[1] - truth[0]
        yield rms(ours[1] - ours[0] - effect) / float(np.abs(effect).max())
