"""Irradiance of a table: measured, or estimated from the clear sky at the building's place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.signals import SignalReader

if TYPE_CHECKING:  # pvlib is loaded only where an estimate is needed
    from thermoforce_mpc.boundary.weather.solar import Sun


def sunlight(
    rules: MeasurementMap, reader: SignalReader, grid_s: Array, origin: pd.Timestamp
) -> tuple[Array, tuple[str, ...]]:
    """Global horizontal irradiance at `grid_s` (n,), W/m², and what was decided by rule; 0 where there is no sun."""
    if rules.sun is None:
        return np.zeros(grid_s.size), ()
    if rules.sun.signal is not None:
        return reader.irradiance(rules.sun.signal), ()
    from thermoforce_mpc.boundary.weather.clearness import sunlight_from_humidity

    clear, sun = clear_sky(rules, grid_s, origin)
    if rules.sun.humidity is None:
        return clear, ("irradiance: that of a clear sky, every day; clouds count as a disturbance",)
    humidity = np.clip(reader.humidity("sun.humidity", rules.sun.humidity), 0.0, 1.0)
    note = "irradiance: clear sky times one clearness per day, from the relative humidity; RMSE of a day about 0.16"
    return sunlight_from_humidity(grid_s, humidity, sun), (note,)


def clear_sky(rules: MeasurementMap, time_s: Array, origin: pd.Timestamp) -> tuple[Array, Sun]:
    """Clear-sky irradiance (n,), W/m², at the place of the map, and the sun's position."""
    from thermoforce_mpc.boundary.weather.clearness import clear_sky_W_m2
    from thermoforce_mpc.boundary.weather.solar import sun_position

    site, offset = rules.site, origin.utcoffset()
    assert site is not None  # checked by the map
    assert offset is not None
    sun = sun_position(time_s, site.latitude, site.longitude, offset.total_seconds() / HOUR_S)
    return clear_sky_W_m2(sun), sun
