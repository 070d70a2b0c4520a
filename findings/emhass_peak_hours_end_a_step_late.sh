#!/usr/bin/env bash
# EMHASS' peak hours from 06:00 to 10:00 are nine half hours: the step that begins at 10:00 is dear too.
#
# Versions: EMHASS 0.18.7
# A good guess: a period from 06:00 to 10:00 is four hours, and of two that meet at 10:00 the later one has the step that begins
# there; as tariffs are written
# Seen: both ends belong to it: at a step of 30 min 4.5 h are dear, of 60 min five; 22:00 to 06:00 includes the step from 06:00 on
# Why it matters: a plan keeps heat pump, boiler and car off in the first cheap step, where all others begin
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile emhass==0.18.7
cd "$work"
venv/bin/python -W ignore - <<'EOF'
import logging
from pathlib import Path

import pandas as pd
import pytz
from emhass.forecast import Forecast


def dear(begin, end, minutes):
    """The steps of a day that cost the peak price."""
    house = {
        "optimization_time_step": pd.Timedelta(minutes=minutes), "time_zone": pytz.timezone("Europe/Berlin"), "method_ts_round": "nearest",
        "sensor_power_photovoltaics": "pv", "sensor_power_photovoltaics_forecast": "pv_ahead",
        "sensor_power_load_no_var_loads": "load", "Latitude": 52.5, "Longitude": 13.4,
    }
    tariff = {
        "delta_forecast_daily": pd.Timedelta(days=1), "load_peak_hours_cost": 0.4, "load_offpeak_hours_cost": 0.2,
        "load_peak_hour_periods": {"period_hp_1": [{"start": begin}, {"end": end}]},
    }
    paths = {"data_path": Path("."), "root_path": Path(".")}
    forecast = Forecast(house, tariff, {}, {"passed_data": {}}, paths, logging.getLogger("emhass"))
    day = pd.date_range("2025-11-03", periods=24 * 60 // minutes, freq=f"{minutes}min", tz="Europe/Berlin", unit="ns")
    cost = forecast.get_load_cost_forecast(pd.DataFrame({"load": 0.0}, index=day), method="hp_hc_periods")["unit_load_cost"]
    return [f"{at:%H:%M}" for at in cost.index[cost == 0.4]]


morning, hourly, night = dear("06:00", "10:00", 30), dear("06:00", "10:00", 60), dear("22:00", "06:00", 60)
print("06:00 to 10:00, step 30 min:", *morning)
print("06:00 to 10:00, step 60 min:", *hourly)
print("22:00 to 06:00, step 60 min:", *night)
assert (len(morning), morning[-1], hourly[-1], len(night), "06:00" in night) == (9, "10:00", "10:00", 9, True)
EOF
