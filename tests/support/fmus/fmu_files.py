"""Builds FMUs as BOPTEST's compiler leaves them: units in the description, data and JSON files in the resources."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from documented_points import DOCUMENTED
from pythonfmu.builder import FmuBuilder

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.plants.embedded import schedule
from thermoforce_mpc.plants.embedded.emulator import OVERWRITES

HERE = Path(__file__).parent
KPIS = {
    "OperativeZoneTemperature[1]": ["reaTZon_y"],
    "ElectricPower": ["reaPFan_y", "reaPHeaPum_y", "reaPPumEmi_y"],
    "CO2Concentration[1]": ["reaCO2RooAir_y"],
}
DAYS = {"peak_heat_day": 23, "typical_heat_day": 115}
ROOM_KPIS = {
    "bestest_air": {
        "AirZoneTemperature[1]": ["zon_reaTRooAir_y"],
        "ElectricPower": ["fcu_reaPCoo_y", "fcu_reaPFan_y"],
        "GasPower": ["fcu_reaPHea_y"],
        "CO2Concentration[1]": ["zon_reaCO2RooAir_y"],
    },
    "bestest_hydronic": {
        "OperativeZoneTemperature[1]": ["reaTRoo_y"],
        "ElectricPower": ["reaPPum_y"],
        "GasPower": ["reaQHea_y"],
        "CO2Concentration[1]": ["reaCO2RooAir_y"],
    },
}
ROOM_DAYS = {
    "peak_heat_day": 341,
    "typical_heat_day": 51,
    "peak_cool_day": 289,
    "typical_cool_day": 153,
    "mix_day": 350,
}
CONFIG = {"name": "bestest_hydronic_heat_pump", "area": 192.0, "start_time": 0.0, "warmup_period": 0.0, "step": 3600.0}


def build_house(folder: Path) -> Path:
    """The emulator as an FMU, with a synthetic year in its resources."""
    bare = _bare("fmu_house.py", folder / "bare.fmu")
    time_s = np.arange(0.0, 365 * 86400.0 + 1.0, 900.0)
    weather = synthetic_weather()
    T_out = weather.at("T_dry_C", time_s)
    lower, upper = schedule.bounds_C(time_s)
    files = {
        "weather.csv": _csv(time_s, TDryBul=T_out + 273.15, HGloHor=weather.at("global_W_m2", time_s)),
        "setpoints.csv": _csv(
            time_s, **{"LowerSetp[1]": lower + 273.15, "UpperSetp[1]": upper + 273.15,
                       "UpperCO2[1]": np.full(time_s.shape, schedule.CO2_LIMIT_PPM)},
        ),
        "occupancy.csv": _csv(time_s, **{"Occupancy[1]": schedule.PEOPLE * schedule.occupied_sample(time_s)}),
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


def build_room(name: str, script: str, folder: Path) -> Path:
    """An FMU of one of the rooms, with units, limits, boundary data, KPI signals and days as BOPTEST's have them."""
    bare = _bare(script, folder / f"{name}_bare.fmu")
    points = DOCUMENTED[name][1]
    known = {**points.inputs, **points.measurements}

    def describe(root):
        for variable in root.iter("ScalarVariable"):
            point, real = known.get(variable.get("name", "")), variable.find("Real")
            if real is None or point is None:
                continue
            real.set("unit", point.unit)
            if point.minimum is not None:
                real.set("min", str(point.minimum))
                real.set("max", str(point.maximum))

    time_s = np.arange(0.0, 365 * DAY_S + 1.0, HOUR_S)
    constant = {
        "HGloHor": 0.0, "LowerSetp[1]": 294.15, "UpperSetp[1]": 297.15, "UpperCO2[1]": 894.0, "Occupancy[1]": 2.0,
        "PriceElectricPowerConstant": 0.2, "PriceElectricPowerDynamic": 0.3, "PriceElectricPowerHighlyDynamic": 0.4,
        "PriceGasPower": 0.05, "EmissionsElectricPower": 0.17, "EmissionsGasPower": 0.18,
    }  # fmt: skip
    outdoor = 288.15 - 8.0 * np.cos(2 * np.pi * time_s / DAY_S)
    files = {
        "all.csv": pd.DataFrame({"time": time_s, "TDryBul": outdoor} | constant).to_csv(index=False),
        "kpis.json": json.dumps(ROOM_KPIS[name]),
        "days.json": json.dumps(ROOM_DAYS),
        "config.json": json.dumps({"name": name, "area": 48.0}),
    }
    return rewritten(bare, folder / f"{name}.fmu", {f"resources/{n}": text for n, text in files.items()}, describe)


def _bare(script: str, file: Path) -> Path:
    """The FMU as PythonFMU builds it of one of the scripts here."""
    return FmuBuilder.build_FMU(HERE / script, file, project_files=[HERE / "fmu_points.py"])


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


def _csv(time_s: np.ndarray, **columns: np.ndarray) -> str:
    return pd.DataFrame({"time": time_s, **columns}).to_csv(index=False)


def _describe(root: ElementTree.Element) -> None:
    """Units and limits, which PythonFMU does not write."""
    limits = {f"{name}_u": (low, high) for name, low, high in OVERWRITES}
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
