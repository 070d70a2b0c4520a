"""Write an export to practise on: history.csv, 30 days of a house as Home Assistant's history download has it, and
tomorrow.csv, the weather and prices of the two days after it.

One row per reading, stored when the state changes, in UTC; with restarts, a radio that was away, and entities that are
no measurements. Usage: python practice_export.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
if not folder.is_dir():
    sys.exit(f"{folder}: no such folder\n{__doc__}")
rng = np.random.default_rng(4)
minutes = pd.date_range("2026-01-05", periods=30 * 1440, freq="1min", tz="UTC")
hour = (minutes.hour + minutes.minute / 60).to_numpy()
day = np.arange(minutes.size) // 1440

# A house: air and mass, a heat pump that a thermostat with a night setback switches; people turn it up and down.
slow = np.interp(np.arange(minutes.size), np.arange(31) * 1440, rng.normal(0, 4, 31))
outdoor = 1 + slow + 3 * np.sin((hour - 9) / 12 * np.pi)
clouds = rng.uniform(0.2, 1.0, 30)[day]
sun = np.maximum(0, 380 * np.sin((hour - 7) / 9 * np.pi)) * ((hour > 7) & (hour < 16)) * clouds
wanted = np.where((hour > 6) & (hour < 21), 21.0, 18.5) + rng.choice([-0.5, 0.0, 0.5, 1.0], 30)[day]
air, mass, on = 20.5, 20.5, False
room, running = np.empty(minutes.size), np.empty(minutes.size)
for k in range(minutes.size):
    if k % 10 == 0:  # it runs or rests for ten minutes at least
        on = air < wanted[k] + (0.3 if on else -0.3)
    room[k], running[k] = air, on
    air += 60 * ((mass - air) * 450 + (outdoor[k] - air) * 130 + 6500 * on + 1.2 * sun[k]) / 6e6
    mass += 60 * ((air - mass) * 450 + 1.5 * sun[k]) / 5e7
power = np.where(running > 0, 2100 - 18 * outdoor + rng.normal(0, 6, minutes.size), 7.0)
energy = 5120.4 + np.cumsum(power) / 60 / 1000


def on_change(values: np.ndarray, step: float, noise: float, every: int) -> pd.Series:
    """States as a sensor sends them: every so many minutes, rounded to its step, where they differ from the last."""
    seen = np.round((values + rng.normal(0, noise, values.size))[::every] / step) * step
    seen = pd.Series(seen.round(2), index=minutes[::every])
    return seen[seen.diff() != 0].astype(str)


states = {
    "sensor.living_room_temperature": on_change(room, 0.1, 0.03, 5),
    "sensor.outdoor_temperature": on_change(outdoor, 0.1, 0.05, 10),
    "sensor.weather_station_solar_radiation": on_change(sun, 1.0, 0.0, 5),
    "sensor.living_room_target_temperature": on_change(wanted, 0.5, 0.0, 1),
    "sensor.heat_pump_power": on_change(power, 1.0, 0.0, 1),
    "sensor.heat_pump_energy_total": on_change(energy, 0.1, 0.0, 1),
    "binary_sensor.heat_pump_compressor": on_change(running, 1.0, 0.0, 1).map({"1.0": "on", "0.0": "off"}),
    "sensor.heat_pump_operating_mode": pd.Series(["heating", "standby"] * 20, index=minutes[::1080][:40]),
    "binary_sensor.bedroom_window": pd.Series(["off", "on"] * 30, index=minutes[400::700][:60]),
    "sensor.living_room_humidity": on_change(45 + 6 * np.sin(np.arange(minutes.size) / 3000), 1.0, 0.4, 10),
}
away = [(entity, at, at + pd.Timedelta("4min")) for at in minutes[9000::11000] for entity in states]
away += [("sensor.living_room_temperature", minutes[20000], minutes[20000] + pd.Timedelta("5h"))]
rows = []
for entity, told in states.items():
    kept = told.copy()
    for begin, end in ((begin, end) for name, begin, end in away if name == entity):
        before, gone = kept[:begin], pd.Series("unavailable", index=[begin])
        kept = pd.concat([before, gone, pd.Series(before.iloc[-1], index=[end]), kept[kept.index > end]])
    stamps = kept.index + pd.to_timedelta(rng.integers(0, 900, len(kept)), unit="ms")
    text = stamps.strftime("%Y-%m-%dT%H:%M:%S.%f").str[:-3] + "Z"
    rows.append(pd.DataFrame({"entity_id": entity, "state": kept.to_numpy(), "last_changed": text}))
export = pd.concat(rows)
export.to_csv(folder / "history.csv", index=False)
print(f"{folder / 'history.csv'}: {len(export)} rows of {len(states)} entities, 30 days from {minutes[0]:%Y-%m-%d} on")
ahead = pd.date_range(minutes[-1] + pd.Timedelta("1min"), periods=49, freq="1h")
at = ahead.hour.to_numpy()
forecast = {
    "time": ahead.strftime("%Y-%m-%dT%H:%M:%SZ"),
    "temperature": (outdoor[-1] + 3 * np.sin((at - 9) / 12 * np.pi)).round(1),
    "ghi": np.maximum(0, 230 * np.sin((at - 7) / 9 * np.pi)).round(),
    "price": np.select([(at >= 6) & (at < 9) | (at >= 17) & (at < 21), (at >= 11) & (at < 15)], [0.38, 0.19], 0.26),
}
pd.DataFrame(forecast).to_csv(folder / "tomorrow.csv", index=False)
print("next: tf-mpc data map history.csv > map.yaml")
