"""Point lists of BOPTEST's two test cases of several zones that have no FMU here: names, units, limits.

Sources, github.com/ibpsa/project1-boptest: testcases/*/doc/*.html and models/kpis.json, testing/references/*/
get_inputs.json, get_measurements.json, get_forecast_points.json, and releasenotes.md for `oveTSetPumBoi` of
`multizone_residential_hydronic` (release 0.7; `oveTSetPum` before, with the same limits).
"""

from __future__ import annotations

from documented_points import WEATHER, Documented, inputs_of, points_of

HOUSE_ROOMS = ("Liv", "Ro1", "Ro2", "Ro3", "Bth")  # with a valve; the hall has none
_HOUSE_ZONES = (*HOUSE_ROOMS, "Hal")
OFFICE_ZONES = ("Cor", "Sou", "Eas", "Nor", "Wes")

_ZONE_FORECAST = {
    "InternalGainsCon": "W", "InternalGainsRad": "W", "InternalGainsLat": "W", "LowerSetp": "K", "UpperSetp": "K",
    "UpperCO2": "ppm", "Occupancy": "number of people",
}  # fmt: skip
_ELECTRICITY = {
    "EmissionsElectricPower": "kgCO2/kWh", "PriceElectricPowerConstant": "($/Euro)/kWh",
    "PriceElectricPowerDynamic": "($/Euro)/kWh", "PriceElectricPowerHighlyDynamic": "($/Euro)/kWh",
}  # fmt: skip
_GAS = {"EmissionsGasPower": "kgCO2/kWh", "PriceGasPower": "($/Euro)/kWh"}


def _station(prefix: str) -> dict[str, str]:
    return {f"{prefix}_reaWea{name[0].upper()}{name[1:]}_y": unit for name, unit in WEATHER.items()}


def _forecast(zones: tuple[str, ...], prices: dict[str, str]) -> dict[str, str]:
    of_zones = {f"{name}[{zone}]": unit for zone in zones for name, unit in _ZONE_FORECAST.items()}
    return WEATHER | of_zones | prices


def _house() -> Documented:
    inputs = {"boi_oveBoi": ("1", 0.0, 1.0), "oveEmiPum": ("1", 0.0, 1.0), "oveMixValSup": ("1", 0.0, 1.0)}
    inputs |= {name: ("K", 283.15, 368.15) for name in ("oveTSetPumBoi", "oveTSetSup")}
    for zone in _HOUSE_ZONES:
        inputs |= {f"conCoo{zone}_oveCoo": ("1", 0.0, 1.0), f"conCoo{zone}_oveTSetCoo": ("K", 283.15, 303.15)}
    for room in HOUSE_ROOMS:
        inputs |= {f"conHea{room}_oveActHea": ("1", 0.0, 1.0), f"conHea{room}_oveTSetHea": ("K", 283.15, 368.15)}
    measured = {"boi_reaGasBoi_y": "W", "boi_reaPpum_y": "W", "reaTAti_y": "K", "reaTGar_y": "K", "reaTHal_y": "K"}
    measured |= {"reaTSetCoo_y": "K", "reaTSetHea_y": "K", "reaTSup_y": "K"}
    measured |= {f"conHea{room}_reaTZon_y": "K" for room in HOUSE_ROOMS}
    for zone in _HOUSE_ZONES:
        measured |= {f"conCoo{zone}_reaPCoo_y": "W", f"reaHea{zone}_y": "W"}
        measured[f"{'ext' if zone in ('Liv', 'Bth') else 'inf'}{zone}_reaCO2RooAir_y"] = "ppm"
    forecast = _forecast(_HOUSE_ZONES, _ELECTRICITY | _GAS)
    return Documented(inputs_of(inputs), points_of(measured | _station("weatherStation")), points_of(forecast))


def _office() -> Documented:
    inputs = {"hvac_oveAhu_TSupSet": ("K", 285.15, 313.15), "hvac_oveAhu_dpSet": ("Pa", 50.0, 410.0)}
    for name in ("yCoo", "yFan", "yHea", "yOA", "yPumCoo", "yPumHea", "yRet"):
        inputs[f"hvac_oveAhu_{name}"] = ("1", 0.0, 1.0)
    measured = {"V_flow_ret": "m3/s", "V_flow_sup": "m3/s", "dp_sup": "Pa"}
    measured |= {name: "W" for name in ("PFanSup", "PPumCoo", "PPumHea")}
    measured |= {name: "K" for name in ("TCooCoiRet", "TCooCoiSup", "THeaCoiRet", "THeaCoiSup", "TMix", "TRet", "TSup")}
    measured = {f"hvac_reaAhu_{name}_y": unit for name, unit in measured.items()}
    for plant, power in (("chi", "PChi"), ("heaPum", "PHeaPum")):
        own = {power: "W", "PPumDis": "W", "FloSup": "m3/s", "TRet": "K", "TSup": "K"}
        measured |= {f"{plant}_rea{name}_y": unit for name, unit in own.items()}
    for zone in OFFICE_ZONES:
        inputs |= {f"hvac_oveZonAct{zone}_{name}": ("1", 0.0, 1.0) for name in ("yDam", "yReaHea")}
        inputs |= {f"hvac_oveZonSup{zone}_{name}": ("K", 285.15, 313.15) for name in ("TZonCooSet", "TZonHeaSet")}
        own = {"CO2Zon": "ppm", "TSup": "K", "TZon": "K", "V_flow": "m3/s"}
        measured |= {f"hvac_reaZon{zone}_{name}_y": unit for name, unit in own.items()}
    forecast = _forecast(tuple(zone.lower() for zone in OFFICE_ZONES), _ELECTRICITY)
    return Documented(inputs_of(inputs), points_of(measured | _station("weaSta")), points_of(forecast))


MULTIZONE = {"multizone_residential_hydronic": _house(), "multizone_office_simple_air": _office()}
