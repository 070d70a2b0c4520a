#!/usr/bin/env bash
# demandlib puts the demand of a year into whatever index it is given, and its heat and electricity profiles differ in unit.
#
# Versions: demandlib 0.2.2, pandas 3.0.5
# A good guess: a week of `annual_heat_demand=1000` holds about a week's share of 1000 (in winter some 30); quarter hours of
# heat and of electricity, both by BDEW and of one library, are both kWh a step or both kW
# Seen: one week in January holds 1000, as a year does; of quarter hours the values of heat sum to 1000 (kWh a step), those
# of electricity to 4000 (kW)
# Why it matters: a heat demand that is simulated for the weeks of a study is fifty times too large, and heat and power of
# one house differ by four as soon as prices come by the quarter hour
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile demandlib==0.2.2 pandas==3.0.5 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import pandas as pd
from demandlib import bdew


def heat(hours, step):
    index = pd.date_range("2023-01-01", periods=hours * (4 if step == "15min" else 1), freq=step)
    temperature = pd.Series(8 - 10 * np.cos(2 * np.pi * index.dayofyear / 365), index=index)
    house = bdew.HeatBuilding(
        index, temperature=temperature, shlp_type="EFH", building_class=5, wind_class=0, annual_heat_demand=1000, name="a"
    )
    return float(np.asarray(house.get_bdew_profile()).sum())


year, week, quarters = heat(8760, "h"), heat(168, "h"), heat(8760, "15min")
power = float(bdew.ElecSlp(2023).get_scaled_power_profiles({"h0": 1000})["h0"].sum())
print(f"sum of heat: a year {year:.0f}, one week {week:.0f}, a year of quarter hours {quarters:.0f}; of electricity {power:.0f}")
assert abs(year - 1000) < 1 and abs(week - 1000) < 1 and abs(quarters - 1000) < 1 and abs(power - 4000) < 1
EOF
