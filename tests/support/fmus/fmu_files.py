"""Builds FMUs of rooms as BOPTEST's compiler leaves them; that of the house is in `benchmarks.chaos.fmu`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
from documented_points import DOCUMENTED

from benchmarks.chaos.fmu.building import bare_fmu, rewritten
from thermoforce_mpc.data import DAY_S, HOUR_S

HERE = Path(__file__).parent
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


def build_room(name: str, script: str, folder: Path) -> Path:
    """An FMU of one of the rooms, with units, limits, boundary data, KPI signals and days as BOPTEST's have them."""
    bare = bare_fmu(HERE / script, folder / f"{name}_bare.fmu")
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
