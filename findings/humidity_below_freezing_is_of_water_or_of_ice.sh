#!/usr/bin/env bash
# Below 0 °C the same relative humidity is a fifth more water in MetPy than in PsychroLib, ladybug and CoolProp.
#
# Versions: metpy 1.7.1, psychrolib 2.5.0, CoolProp 8.0.0, ladybug-core 0.44.37; numpy 2.4.6
# A good guess: the four agree to a few tenths of a percent, as they do at 10 °C
# Seen: at -20 °C and 80 % MetPy has 0.617 g of water in a kg of air, the others 0.507 to 0.510: MetPy (as weather services do, by WMO's
# rule) counts from saturation over water unless it is told `phase="auto"`, the others from that over ice and can't be told else
# Why it matters: humidity comes from a weather service and goes into a library of buildings: the air is 5 % too dry at -5 °C and 18 % at
# -20 °C, and an outdoor unit that frosts is said to be dry; 90 % at -10 °C is 99 % over ice
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile metpy==1.7.1 psychrolib==2.5.0 CoolProp==8.0.0 ladybug-core==0.44.37 numpy==2.4.6
"$work/venv/bin/python" - <<'PY'
import metpy.calc
import psychrolib
from CoolProp.HumidAirProp import HAPropsSI
from ladybug.psychrometrics import humid_ratio_from_db_rh
from metpy.units import units

psychrolib.SetUnitSystem(psychrolib.SI)
PRESSURE_PA = 101325


def by_metpy(T_C, share):
    ratio = metpy.calc.mixing_ratio_from_relative_humidity(PRESSURE_PA * units.Pa, T_C * units.degC, share * units.dimensionless)
    return float(ratio.to("").m)


WATER = {
    "metpy": by_metpy,
    "psychrolib": lambda T_C, share: psychrolib.GetHumRatioFromRelHum(T_C, share, PRESSURE_PA),
    "CoolProp": lambda T_C, share: HAPropsSI("W", "T", T_C + 273.15, "R", share, "P", PRESSURE_PA),
    "ladybug": lambda T_C, share: humid_ratio_from_db_rh(T_C, 100 * share, PRESSURE_PA),
}

def by_metpy_over_ice(T_C, share):
    ratio = metpy.calc.mixing_ratio_from_relative_humidity(
        PRESSURE_PA * units.Pa, T_C * units.degC, share * units.dimensionless, phase="auto"
    )
    return float(ratio.to("").m)


more = {}
for T_C in (10, -5, -20):
    grams = {name: 1000 * of(T_C, 0.8) for name, of in WATER.items()}
    print(f"{T_C} °C, 80 %, g/kg:", {name: round(value, 3) for name, value in grams.items()})
    more[T_C] = min(grams["metpy"] / value for name, value in grams.items() if name != "metpy")
    others = [value for name, value in grams.items() if name != "metpy"]
    assert max(others) < 1.01 * min(others)
    assert abs(1000 * by_metpy_over_ice(T_C, 0.8) / grams["psychrolib"] - 1) < 0.01
assert abs(more[10] - 1) < 0.01 and more[-5] > 1.04 and more[-20] > 1.19
PY
