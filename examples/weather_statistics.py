"""Climate statistics of the synthetic year, and of a weather file beside it."""

import sys
from pathlib import Path

from thermoforce_mpc.boundary.weather import Weather, load_weather, synthetic_weather


def statistics(weather: Weather) -> dict[str, str]:
    """Figures of one year as text."""
    daily = weather.T_dry_C.reshape(365, 24)
    months = {"January": (0, 31), "April": (90, 120), "July": (181, 212), "October": (273, 304)}
    return {
        "mean temperature, °C": f"{daily.mean():.1f}",
        "coldest hour, coldest day, hottest hour, °C": (
            f"{daily.min():.1f}, {daily.mean(axis=1).min():.1f}, {daily.max():.1f}"
        ),
        **{f"{name}, °C": f"{daily[a:b].mean():.1f}" for name, (a, b) in months.items()},
        "mean daily range, K": f"{(daily.max(axis=1) - daily.min(axis=1)).mean():.1f}",
        "global horizontal, kWh/m²": f"{weather.global_W_m2.sum() / 1000:.0f}",
        "diffuse horizontal, kWh/m²": f"{weather.diffuse_W_m2.sum() / 1000:.0f}",
        "wind, m/s": f"{weather.wind_m_s.mean():.1f}",
    }


years = [synthetic_weather(), *(load_weather(Path(name)) for name in sys.argv[1:])]
columns = [statistics(year) for year in years]
for key in columns[0]:
    print(f"| {key} | " + " | ".join(column[key] for column in columns) + " |")
