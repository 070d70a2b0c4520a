"""Plot of one window of `tf-mpc bench buildings`: temperatures, level and outdoor conditions of all controllers."""

from __future__ import annotations

import io
from collections.abc import Mapping

from thermoforce_mpc.data import DAY_S, ZERO_C_K, Array
from thermoforce_mpc.plants.random_houses import House
from thermoforce_mpc.plants.random_houses.plant import bounds_C


def plot_case(house: House, traces: Mapping[str, Mapping[str, Array]]) -> bytes:
    """PNG of the samples of each controller in `traces` (see `GeneratedHousePlant.recorded`)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 8), layout="constrained")
    FigureCanvasAgg(figure)
    rooms, levels, weather = figure.subplots(3, 1, sharex=True, height_ratios=[3, 1.5, 1])
    any_trace = next(iter(traces.values()))
    lower, upper = bounds_C(house, any_trace["time"])
    day = any_trace["time"] / DAY_S
    rooms.plot(day, lower, "k-", lw=0.8)
    rooms.plot(day, upper, "k-", lw=0.8)
    for name, trace in traces.items():
        rooms.plot(trace["time"] / DAY_S, trace["T_operative"] - ZERO_C_K, lw=1, label=name)
        levels.plot(trace["time"] / DAY_S, trace["level"], lw=0.6, label=name)
    rooms.set_ylim(house.lower_C - 4.0, house.upper_C + 3.0)
    rooms.set_ylabel("operative temperature, °C")
    rooms.legend(loc="upper right")
    levels.set_ylabel("level")
    weather.plot(day, any_trace["T_out"] - ZERO_C_K, "C0", lw=1)
    weather.set_ylabel("outdoors, °C")
    sun = weather.twinx()
    sun.plot(day, any_trace["solar"], "C1", lw=0.7)
    sun.set_ylabel("sun, W/m²")
    weather.set_xlabel("day of the year")
    figure.suptitle(f"{house.name}: {house.words}", fontsize=9)
    png = io.BytesIO()
    figure.savefig(png, dpi=80, format="png")
    return png.getvalue()
