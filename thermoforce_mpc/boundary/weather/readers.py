"""Readers for Modelica's `.mos` weather tables (TMY3 layout) and EnergyPlus' `.epw`."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.errors import WeatherError

_HOURS = 8760

# Columns by position, counted from 0, in either layout.
_MOS_COLUMNS = {
    "T_dry_C": 1,
    "T_dew_C": 2,
    "relative_humidity": 3,
    "pressure_Pa": 4,
    "infrared_W_m2": 7,
    "global_W_m2": 8,
    "normal_W_m2": 9,
    "diffuse_W_m2": 10,
    "wind_from_rad": 15,
    "wind_m_s": 16,
    "total_cover": 17,
    "opaque_cover": 18,
    "ceiling_m": 20,
}
_EPW_COLUMNS = {
    "T_dry_C": 6,
    "T_dew_C": 7,
    "relative_humidity": 8,
    "pressure_Pa": 9,
    "infrared_W_m2": 12,
    "global_W_m2": 13,
    "normal_W_m2": 14,
    "diffuse_W_m2": 15,
    "wind_from_rad": 20,
    "wind_m_s": 21,
    "total_cover": 22,
    "opaque_cover": 23,
    "ceiling_m": 25,
}


def load_weather(path: Path) -> Weather:
    """Read a weather year from a `.mos` or `.epw` file.

    Raises:
        WeatherError: the file is missing, of another kind, truncated, or holds values that cannot be; the message
            names the file and what to do.
    """
    path = Path(path)
    readers = {".mos": _read_mos, ".epw": _read_epw}
    if path.suffix.lower() not in readers:
        raise WeatherError(f"{path}: weather files end in .mos (Modelica TMY3) or .epw (EnergyPlus)")
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise WeatherError(f"{path}: cannot be read ({error.strerror or error})") from error
    name = f"{path.name} (sha256 {hashlib.sha256(raw).hexdigest()[:12]})"
    return readers[path.suffix.lower()](path, name, raw.decode("latin-1").splitlines())


def _read_mos(path: Path, name: str, lines: list[str]) -> Weather:
    """Header lines start with '#' (`#LOCATION,...`) or declare the table; rows start with the time in seconds."""
    location = next((line for line in lines if line.upper().startswith("#LOCATION")), None)
    if location is None:
        raise WeatherError(f"{path}: no '#LOCATION' line, so latitude and longitude are unknown")
    rows = [line.split() for line in lines if line[:1].isdigit() or line[:1] == "-"]
    # Some years repeat midnight of the next 1 January as a last row.
    table = _table(path, rows[: _HOURS + 1], min_columns=max(_MOS_COLUMNS.values()) + 1)
    if not np.allclose(table[:_HOURS, 0], np.arange(_HOURS) * HOUR_S):
        raise WeatherError(f"{path}: the time column is not hourly from 0 s; this reader needs 8760 hourly rows")
    return _weather(path, name, location, table[:_HOURS], _MOS_COLUMNS)


def _read_epw(path: Path, name: str, lines: list[str]) -> Weather:
    """Eight header lines, then rows for hours 1 to 24; the row of hour h is the state at h o'clock."""
    if len(lines) < 9 or not lines[0].upper().startswith("LOCATION"):
        raise WeatherError(f"{path}: does not start with a LOCATION line, so it is not an EPW file")
    rows = [line.split(",") for line in lines[8:] if line.strip()]
    if len(rows) == 8784:  # a leap year: 29 February is dropped, the year of the plant has 365 days
        rows = [row for row in rows if (row[1].strip(), row[2].strip()) != ("2", "29")]
    # Column 5 is the file's own flags, text: made a number so that the rest can be one table.
    numbers = [[*row[:5], "0", *row[6:]] for row in rows]
    table = _table(path, numbers, min_columns=max(_EPW_COLUMNS.values()) + 1)
    # Hour 24 of 31 December is midnight, which is where the year begins.
    return _weather(path, name, lines[0], np.roll(table, 1, axis=0), _EPW_COLUMNS)


def _table(path: Path, rows: list[list[str]], min_columns: int) -> Array:
    if len(rows) < _HOURS:
        raise WeatherError(f"{path}: {len(rows)} hourly rows, a year has {_HOURS}; the file is truncated")
    short = next((i for i, row in enumerate(rows) if len(row) < min_columns), None)
    if short is not None:
        raise WeatherError(f"{path}: hourly row {short + 1} has {len(rows[short])} columns, expected {min_columns}")
    try:
        return np.array([[float(cell) for cell in row[:min_columns]] for row in rows])
    except ValueError as error:
        raise WeatherError(f"{path}: a cell is not a number ({error})") from error


def _weather(path: Path, name: str, location: str, table: Array, columns: dict[str, int]) -> Weather:
    """Pick the columns: angles to radians, cover from tenths, humidity from per cent; the place from the header."""
    if table.shape[0] != _HOURS:
        raise WeatherError(f"{path}: {table.shape[0]} hourly rows, a year has {_HOURS}")
    cells = [cell.strip() for cell in location.split(",")]
    try:
        latitude, longitude, zone = (float(cell) for cell in cells[6:9])
    except ValueError as error:
        raise WeatherError(f"{path}: latitude, longitude or time zone missing in '{location[:80]}'") from error
    data = {key: table[:, index].copy() for key, index in columns.items()}
    data["wind_from_rad"] = np.deg2rad(data["wind_from_rad"])
    data["opaque_cover"] /= 10.0
    data["total_cover"] /= 10.0
    data["relative_humidity"] /= 100.0
    return Weather(name=name, latitude_deg=latitude, longitude_deg=longitude, timezone_h=zone, **data)
