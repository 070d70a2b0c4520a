"""Write a table of measurements and a forecast to practise on: house.csv and tomorrow.csv, from the embedded plant.

They look as a home owner's would: names, units and an energy meter of their own, stamps in local time. `your own data`
in the documentation leads from them to a plan. Usage: python practice_house.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.loop.probing import probe
from thermoforce_mpc.plants.embedded import EmbeddedPlant

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
if not folder.is_dir():
    sys.exit(f"{folder}: no such folder\n{__doc__}")
plant = EmbeddedPlant(synthetic_weather())
record = probe(plant, start_s=20 * DAY_S, days=3.0, seed=1)  # levels that change for other reasons than the weather

stamps = pd.date_range("2025-01-21", periods=record.n_steps + 1, freq="15min", name="time")
weather = {"T living": record.T_zone_C[0], "T ambient": record.T_out_C + 273.15, "GHI": record.solar_W_m2}
acting = {"compressor": [*(100 * record.u[0]), np.nan], "kWh heat pump": [*(record.power_W[0] / 4000), np.nan]}
pd.DataFrame(weather | acting, index=stamps).round(4).to_csv(folder / "house.csv")

ahead = plant.forecast(2 * DAY_S, 3600.0)
hours = pd.date_range(stamps[-1], periods=ahead.n_steps + 1, freq="1h", name="time")
forecast = {"T ambient": ahead.T_out_C + 273.15, "GHI": ahead.solar_W_m2}
pd.DataFrame(forecast, index=hours).round(2).to_csv(folder / "tomorrow.csv")

print(f"{folder / 'house.csv'}: {len(stamps)} rows, {stamps[0]} to {stamps[-1]}")
print(f"{folder / 'tomorrow.csv'}: {len(hours)} rows, to {hours[-1]}")
