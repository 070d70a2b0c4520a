"""Builds FMUs as BOPTEST's compiler leaves them: units in the description, data and JSON files in the resources."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import Array
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP
from thermoforce_mpc.plants.embedded.schedule import CO2_LIMIT_PPM

_HERE = Path(__file__).parent
KPIS = {
    "OperativeZoneTemperature[1]": ["reaTZon_y"],
    "ElectricPower": ["reaPFan_y", "reaPHeaPum_y", "reaPPumEmi_y"],
    "CO2Concentration[1]": ["reaCO2RooAir_y"],
}
DAYS = {"peak_heat_day": 23, "typical_heat_day": 115}
CONFIG = {"name": "bestest_hydronic_heat_pump", "area": 192.0, "start_time": 0.0, "warmup_period": 0.0, "step": 3600.0}


def build_house(folder: Path) -> Path:
    """The emulator as an FMU, with a synthetic year in its resources."""
    return _with_a_year("fmu_house.py", folder, 900.0)


def build_troubled(folder: Path) -> Path:
    """A small house that fails where the environment says, see `fmu_troubled.py`, with the year in hours."""
    return _with_a_year("fmu_troubled.py", folder, 3600.0)


def _with_a_year(script: str, folder: Path, step_s: float) -> Path:
    bare = bare_fmu(_HERE / script, folder / "bare.fmu")
    time_s = np.arange(0.0, 365 * 86400.0 + 1.0, step_s)
    weather = synthetic_weather()
    T_out = weather.at("T_dry_C", time_s)
    lower, upper = HEAT_PUMP.schedule.bounds_C(time_s)
    files = {
        "weather.csv": _csv(time_s, TDryBul=T_out + 273.15, HGloHor=weather.at("global_W_m2", time_s)),
        "setpoints.csv": _csv(
            time_s, **{"LowerSetp[1]": lower + 273.15, "UpperSetp[1]": upper + 273.15,
                       "UpperCO2[1]": np.full(time_s.shape, CO2_LIMIT_PPM)},
        ),
        "occupancy.csv": _csv(time_s, **{"Occupancy[1]": HEAT_PUMP.schedule.occupants(time_s)}),
        "prices.csv": _csv(
            time_s,
            PriceElectricPowerConstant=tariffs.constant(time_s),
            PriceElectricPowerDynamic=tariffs.dynamic(time_s),
            PriceElectricPowerHighlyDynamic=tariffs.synthetic_spot()(time_s),
        ),
        "emissions.csv": _csv(time_s, EmissionsElectricPower=np.full(time_s.shape, tariffs.EMISSION_KG_PER_KWH)),
        "notes.csv": "remark\nnot a series: it has no column of that name\n",
        "kpis.json": json.dumps(KPIS),
        "days.json": json.dumps(DAYS),
        "config.json": json.dumps(CONFIG),
    }  # fmt: skip
    return rewritten(bare, folder / "wrapped.fmu", {f"resources/{n}": text for n, text in files.items()}, _describe)


def bare_fmu(script: Path, file: Path) -> Path:
    """The FMU as PythonFMU builds it of a script that imports `fmu_points`."""
    from pythonfmu.builder import FmuBuilder

    sys.path.insert(0, str(_HERE))  # PythonFMU finds what a script imports from another folder no other way
    try:
        built: Path = FmuBuilder.build_FMU(script, file, project_files=[_HERE / "fmu_points.py"])
    finally:
        sys.path.remove(str(_HERE))
    return built


def rewritten(
    source: Path,
    target: Path,
    changed: Mapping[str, str | None],
    describe: Callable[[ElementTree.Element], None] = lambda root: None,
) -> Path:
    """A copy of an FMU with some of its files replaced, added or (None) left out, and another description."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                root = ElementTree.fromstring(content)
                describe(root)
                content = ElementTree.tostring(root)
            if name not in changed:
                new.writestr(name, content)
        for name, text in changed.items():
            if text is not None:
                new.writestr(name, text)
    return target


def _csv(time_s: Array, **columns: Array) -> str:
    return pd.DataFrame({"time": time_s, **columns}).to_csv(index=False)


def _describe(root: ElementTree.Element) -> None:
    """Units and limits, which PythonFMU does not write."""
    limits = {f"{name}_u": (low, high) for name, low, high in HEAT_PUMP.overwrites}
    for variable in root.iter("ScalarVariable"):
        name, real = variable.get("name", ""), variable.find("Real")
        if real is None:
            continue
        kelvin = name.startswith(("reaT", "oveTSet")) or "TDryBul" in name
        power = name.startswith(("reaP", "reaQ"))
        real.set("unit", "K" if kelvin else "W" if power else "W/m2" if "HGloHor" in name else "1")
        if name in limits:
            real.set("min", str(limits[name][0]))
            real.set("max", str(limits[name][1]))
