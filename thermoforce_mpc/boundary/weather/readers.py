"""Readers for Modelica `.mos` weather tables (TMY3 layout) and EnergyPlus `.epw` files; what cannot be is refused."""

from __future__ import annotations

import datetime
import hashlib
import warnings
from pathlib import Path

import numpy as np

from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.errors import WeatherError
from thermoforce_mpc.files import DoubtfulInput, plain_number, read_bounded

# Mean of a year, °C: the extremes on Earth are Vostok (-55) and Dallol (35).
_MEAN_C = (-60.0, 40.0)
_USUAL_MEAN_C = (-25.0, 32.0)
# An hour is dark if the sun is so far below the horizon in its middle: 7.5 degrees to its end, and astronomical dusk.
_DARK_DEG = -12.0
_MOST_IN_THE_DARK = 0.01
_STUCK_H = 72
_HOURS = 8760
# A year of EPW has 1.6 MB.
_MOST_BYTES = 10_000_000
_MOST_LINES = 20_000
_MOST_CELLS = 40
_EPW_HEADER = 8
# Column positions, from 0. An EPW has them in the same order, behind date, hour, minute and flags.
_COLUMNS = {
    "T_dry_C": 1, "T_dew_C": 2, "relative_humidity": 3, "pressure_Pa": 4, "infrared_W_m2": 7, "global_W_m2": 8,
    "normal_W_m2": 9, "diffuse_W_m2": 10, "wind_from_rad": 15, "wind_m_s": 16, "total_cover": 17, "opaque_cover": 18,
    "ceiling_m": 20,
}  # fmt: skip
_MOS_COLUMNS = {"time_s": 0, **_COLUMNS}
_EPW_COLUMNS = {"month": 1, "day": 2, "hour": 3, **{name: place + 5 for name, place in _COLUMNS.items()}}


def check_plausible(weather: Weather, path: Path) -> None:
    """Raise `WeatherError` for a year of no place on Earth; `DoubtfulInput` warns of an improbable one."""
    mean_C = float(weather.T_dry_C.mean())
    if not _MEAN_C[0] <= mean_C <= _MEAN_C[1]:
        raise WeatherError(
            f"{path}: the year's mean temperature is {mean_C:.1f} °C, that of no place on Earth; is the column in °C?"
        )
    sun = weather.global_W_m2 + weather.normal_W_m2 + weather.diffuse_W_m2
    shining = float(sun.sum())
    if shining > 0:
        # Rows are means over the hour that ends there.
        middle_s: Array = (np.arange(float(sun.size)) - 0.5) * HOUR_S
        zenith = sun_position(middle_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h).zenith
        share = float(sun[np.rad2deg(zenith) > 90.0 - _DARK_DEG].sum()) / shining
        if share > _MOST_IN_THE_DARK:
            raise WeatherError(
                f"{path}: {100 * share:.0f} % of the year's sun shines in the dark at latitude "
                f"{weather.latitude_deg:g}, longitude {weather.longitude_deg:g}, time zone {weather.timezone_h:g} h; "
                "these are wrong, or the rows are shifted"
            )
    for doubt in _doubts(weather, mean_C, shining):
        warnings.warn(f"{path}: {doubt}", DoubtfulInput, stacklevel=3)


def _doubts(weather: Weather, mean_C: float, shining: float) -> list[str]:
    doubts = []
    if not _USUAL_MEAN_C[0] <= mean_C <= _USUAL_MEAN_C[1]:
        doubts.append(f"the year's mean temperature is {mean_C:.1f} °C: few people live there")
    if shining == 0:
        doubts.append("the sun never shines in it: the columns of irradiance are empty")
    changes = np.flatnonzero(np.diff(weather.T_dry_C) != 0)
    stuck = np.diff(np.concatenate([[-1], changes, [weather.T_dry_C.size - 1]]))
    if stuck.max() > _STUCK_H:
        first = int(np.concatenate([[0], changes + 1])[int(stuck.argmax())])
        doubts.append(
            f"the temperature is {weather.T_dry_C[first]:g} °C for {int(stuck.max())} hours from day {first // 24 + 1}"
        )
    return doubts


def load_weather(path: Path) -> Weather:
    """Read a weather year from a `.mos` or `.epw` file; `DoubtfulInput` warns of one that is improbable.

    Raises `WeatherError`, naming the file and what to do, for a file that is missing, of another type, truncated, not
    hourly, or has values or a place that cannot be.
    """
    path = Path(path)
    readers = {".mos": _read_mos, ".epw": _read_epw}
    if path.suffix.lower() not in readers:
        raise WeatherError(f"{path}: weather files end in .mos (Modelica TMY3) or .epw (EnergyPlus)")
    raw = read_bounded(path, _MOST_BYTES, WeatherError)
    name = f"{path.name} (sha256 {hashlib.sha256(raw).hexdigest()[:12]})"
    if (count := raw.count(b"\n") + raw.count(b"\r")) > 2 * _MOST_LINES:
        raise WeatherError(f"{path}: {count} lines, a year has {_HOURS} hours; this reader needs hourly rows")
    # Split as bytes: as text, a place name in Latin-1 could hold what Unicode takes for the end of a line.
    lines = [line.decode("latin-1") for line in raw.splitlines()]
    weather = readers[path.suffix.lower()](path, name, lines)
    check_plausible(weather, path)
    return weather


def _read_mos(path: Path, name: str, lines: list[str]) -> Weather:
    """Read a `.mos` file: header lines start with '#' or declare the table, data rows start with the time in s."""
    location = next((line for line in lines if line.upper().startswith("#LOCATION")), None)
    if location is None:
        raise WeatherError(f"{path}: no '#LOCATION' line, so latitude and longitude are unknown")
    rows = (line.split(None, _MOST_CELLS) for line in lines if line[:1].isdigit() or line[:1] == "-")
    columns = _columns(path, list(rows), _MOS_COLUMNS)
    time_s = columns["time_s"]
    # Some files repeat midnight of the next 1 January as a last row.
    columns = {key: values[:_HOURS] for key, values in columns.items()}
    hourly = np.arange(_HOURS) * HOUR_S
    wrong = np.flatnonzero(~np.isclose(columns.pop("time_s"), hourly))
    if wrong.size:
        row = int(wrong[0])
        raise WeatherError(
            f"{path}: hourly row {row + 1} is at {time_s[row]:.10g} s, expected {hourly[row]:.10g}; this reader needs "
            "8760 hourly rows from 0 s"
        )
    if time_s.size > _HOURS + 1:
        raise WeatherError(
            f"{path}: {time_s.size} hourly rows, a year has {_HOURS}; of a leap year leave out 29 February"
        )
    return _weather(path, name, location, columns)


def _read_epw(path: Path, name: str, lines: list[str]) -> Weather:
    """Read an `.epw` file: eight header lines, then rows for hours 1 to 24; row h is the state at h o'clock.

    pvlib's `read_epw` accepts truncated files and text in cells, refuses Latin-1 place names, and names no row.
    """
    if len(lines) <= _EPW_HEADER or not lines[0].upper().startswith("LOCATION"):
        raise WeatherError(f"{path}: does not start with a LOCATION line, so it is not an EPW file")
    columns = _columns(
        path, [line.split(",", _MOST_CELLS) for line in lines[_EPW_HEADER:] if line.strip()], _EPW_COLUMNS
    )
    # 29 February is dropped: the plant's year has 365 days.
    kept = (columns["month"] != 2) | (columns["day"] != 29)
    columns = {key: values[kept] for key, values in columns.items()}
    date = np.stack([columns.pop(key) for key in ("month", "day", "hour")], axis=1)
    if date.shape[0] != _HOURS:
        raise WeatherError(f"{path}: {date.shape[0]} hourly rows, a year has {_HOURS}")
    days = [datetime.date(2019, 1, 1) + datetime.timedelta(day) for day in range(365)]
    calendar = np.array([(day.month, day.day, hour) for day in days for hour in range(1, 25)])
    wrong = np.flatnonzero((date != calendar).any(axis=1))
    if wrong.size:
        actual, expected = ("month {:g}, day {:g}, hour {:g}".format(*rows[wrong[0]]) for rows in (date, calendar))
        raise WeatherError(
            f"{path}: hourly row {wrong[0] + 1} is {actual}, expected {expected}; this reader needs the hours of one "
            "year in order, 1 to 24 a day"
        )
    # Hour 24 of 31 December is midnight, the first row of the year.
    return _weather(path, name, lines[0], {key: np.roll(values, 1) for key, values in columns.items()})


def _columns(path: Path, rows: list[list[str]], columns: dict[str, int]) -> dict[str, Array]:
    """Return the named columns of `rows`, shape (rows,) each; raises `WeatherError` below 8760 rows."""
    if len(rows) < _HOURS:
        raise WeatherError(f"{path}: {len(rows)} hourly rows, a year has {_HOURS}; the file is truncated")
    width = max(columns.values()) + 1
    table = np.empty((len(rows), len(columns)))
    for i, row in enumerate(rows):
        if len(row) < width:
            raise WeatherError(f"{path}: hourly row {i + 1} has {len(row)} columns, expected {width}")
        try:
            table[i] = [plain_number(row[index]) for index in columns.values()]
        except ValueError as error:
            raise WeatherError(f"{path}: hourly row {i + 1}: a cell is not a number ({error!s:.100})") from error
    return dict(zip(columns, table.T.copy(), strict=True))


def _weather(path: Path, name: str, location: str, columns: dict[str, Array]) -> Weather:
    """Convert units (degrees to rad, tenths and per cent to fractions); read the site from the header line."""
    cells = [cell.strip() for cell in location.split(",")]
    try:
        latitude, longitude, zone = (plain_number(cell) for cell in cells[6:9])
    except ValueError as error:
        raise WeatherError(
            f"{path}: latitude, longitude or time zone missing or no number in '{location[:80]}'"
        ) from error
    columns["wind_from_rad"] = np.deg2rad(columns["wind_from_rad"])
    for key, scale in (("opaque_cover", 10.0), ("total_cover", 10.0), ("relative_humidity", 100.0)):
        columns[key] = columns[key] / scale
    return Weather(name=name, latitude_deg=latitude, longitude_deg=longitude, timezone_h=zone, **columns)
