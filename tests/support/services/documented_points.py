"""Point lists of BOPTEST test cases as their documentation and reference replies give them: names, units, limits.

Sources, github.com/ibpsa/project1-boptest: testcases/*/doc/index.html and testing/references/*/get_inputs.json,
get_measurements.json, get_forecast_points.json. Limits of the zones' set-points differ between releases: both are here.
"""

from __future__ import annotations

from dataclasses import dataclass

from boptest_client import Point

WEATHER = {
    "TDryBul": "K", "TWetBul": "K", "TDewPoi": "K", "TBlaSky": "K", "HGloHor": "W/m2", "HDirNor": "W/m2",
    "HDifHor": "W/m2", "HHorIR": "W/m2", "pAtm": "Pa", "lon": "rad", "lat": "rad", "relHum": "1", "nTot": "1",
    "nOpa": "1", "ceiHei": "m", "winSpe": "m/s", "winDir": "rad", "cloTim": "s", "solTim": "s", "solZen": "rad",
    "solAlt": "rad", "solDec": "rad", "solHouAng": "rad",
}  # fmt: skip
_SURROUNDINGS = {
    "EmissionsElectricPower": "kgCO2/kWh", "EmissionsGasPower": "kgCO2/kWh", "PriceGasPower": "($/Euro)/kWh",
    "PriceElectricPowerConstant": "($/Euro)/kWh", "PriceElectricPowerDynamic": "($/Euro)/kWh",
    "PriceElectricPowerHighlyDynamic": "($/Euro)/kWh", "LowerSetp[1]": "K", "UpperSetp[1]": "K",
    "UpperCO2[1]": "ppm", "Occupancy[1]": "number of people", "InternalGainsRad[1]": "W",
    "InternalGainsCon[1]": "W", "InternalGainsLat[1]": "W",
}  # fmt: skip


@dataclass(frozen=True)
class Documented:
    """What `/inputs`, `/measurements` and `/forecast_points` of one release answer."""

    inputs: dict[str, Point]
    measurements: dict[str, Point]
    forecast: dict[str, Point]


def points_of(units: dict[str, str]) -> dict[str, Point]:
    return {name: Point(name, unit, "", None, None) for name, unit in units.items()}


def inputs_of(limits: dict[str, tuple[str, float, float]]) -> dict[str, Point]:
    acting = {f"{name}_u": Point(f"{name}_u", unit, "", low, high) for name, (unit, low, high) in limits.items()}
    return acting | {f"{name}_activate": Point(f"{name}_activate", None, "", None, None) for name in limits}


def _station(prefix: str) -> dict[str, str]:
    return {f"{prefix}weaSta_reaWea{name[0].upper()}{name[1:]}_y": unit for name, unit in WEATHER.items()}


def _hydronic(heating: tuple[float, float], cooling: tuple[float, float]) -> Documented:
    measured = {
        "reaTSetHea_y": "K", "reaTSetCoo_y": "K", "reaTSetSup_y": "K", "reaQHea_y": "W", "reaPum_y": "1",
        "reaPPum_y": "W", "reaCO2RooAir_y": "ppm", "reaTRoo_y": "K",
    }  # fmt: skip
    inputs = {
        "oveTSetHea": ("K", *heating), "oveTSetCoo": ("K", *cooling), "oveTSetSup": ("K", 293.15, 353.15),
        "ovePum": ("1", 0.0, 1.0),
    }  # fmt: skip
    return Documented(inputs_of(inputs), points_of(measured | _station("")), points_of(WEATHER | _SURROUNDINGS))


def _air(heating: tuple[float, float], cooling: tuple[float, float]) -> Documented:
    measured = {
        "zon_reaPLig_y": "W", "zon_reaPPlu_y": "W", "zon_reaCO2RooAir_y": "ppm", "fcu_reaPCoo_y": "W",
        "fcu_reaPHea_y": "W", "fcu_reaFloSup_y": "kg/s", "zon_reaTRooAir_y": "K", "fcu_reaPFan_y": "W",
    }  # fmt: skip
    inputs = {
        "fcu_oveTSup": ("K", 285.15, 313.15), "fcu_oveFan": ("1", 0.0, 1.0),
        "con_oveTSetHea": ("K", *heating), "con_oveTSetCoo": ("K", *cooling),
    }  # fmt: skip
    return Documented(inputs_of(inputs), points_of(measured | _station("zon_")), points_of(WEATHER | _SURROUNDINGS))


_NARROW = ((288.15, 296.15), (296.15, 303.15))
_WIDE = ((278.15, 308.15), (278.15, 308.15))
DOCUMENTED = {
    "bestest_hydronic": (_hydronic(*_NARROW), _hydronic(*_WIDE)),
    "bestest_air": (_air(*_NARROW), _air(*_WIDE)),
}
