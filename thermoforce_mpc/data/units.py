"""What converts between units: hours, days and years in seconds, °C and K, J and kWh."""

from __future__ import annotations

HOUR_S = 3600.0
DAY_S = 86400.0
YEAR_S = 365 * DAY_S
"""A year of weather, prices and schedules, s: it has no 29 February, and repeats."""

ZERO_C_K = 273.15
"""0 °C in K."""

J_PER_KWH = 3.6e6
