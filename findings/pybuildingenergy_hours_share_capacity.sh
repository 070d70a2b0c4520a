#!/usr/bin/env bash
# pybuildingenergy's run_timeseries of a heat pump lets an hour use the capacity that another hour left over.
#
# Versions: pybuildingenergy 2.1.1
# A good guess: each row of a time series is one hour of the machine: what is asked beyond its capacity in that hour is backup
# heat, or unmet
# Seen: rows are put into bins of 1 K of outdoor temperature and summed first: a machine of 5.5 kW meets 11 kWh in one hour,
# without backup, if nothing was asked in some other hour as warm, in whatever week; with 0.6 K between both hours half of
# it is backup. It is the standard's bin method, as the class says, behind a method called run_timeseries
# Why it matters: peaks after a night setback, which an MPC moves, cost nothing in it; a backup heater that runs each morning
# does not appear
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile pybuildingenergy==2.1.1
"$work/venv/bin/python" -W ignore - <<'PY'
import pandas as pd
import pybuildingenergy

machine = pd.DataFrame(
    {
        "source_temperature_C": [-7, -7, 7, 7],
        "sink_temperature_C": [35, 55, 35, 55],
        "capacity_kW": [5.5] * 4,
        "cop": [3.0] * 4,
    }
)


def backup_kWh(outdoor_C):
    hours = pd.date_range("2025-01-01", periods=2, freq="1h")
    asked = pd.DataFrame({"T_ext": outdoor_C, "Q_H_kWh": [0.0, 11.0], "Q_C_kWh": 0.0, "Q_W_kWh": 0.0}, index=hours)
    options = {
        "heating_performance_map": machine,
        "dhw_performance_map": machine,
        "heating_sink_temperature_C": 35,
        "source_type": "air",
        "demand_unit": "kWh",
    }
    result = pybuildingenergy.HeatPumpSystemCalculator(options).run_timeseries(asked)
    return result.summary["QHW_backup_out_kWh"] + result.summary["QHW_unmet_kWh"]


alike, apart = backup_kWh([0.2, 0.4]), backup_kWh([0.9, 1.5])
print("backup of 11 kWh in one hour:", alike, "kWh beside an idle hour as warm,", apart, "kWh beside one in another bin")
assert abs(alike) < 1e-9 and abs(apart - 5.5) < 1e-9
PY
