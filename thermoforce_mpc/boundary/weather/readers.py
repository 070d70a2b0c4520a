"""Readers for Modelica `.mos` weather tables (TMY3 layout) and EnergyPlus `.epw` files; what cannot be is refused.

The weather year of the BOPTEST test case can be downloaded.
"""

from __future__ import annotations

import codecs
import datetime
import hashlib
import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.year import LIMITS, STEFAN_BOLTZMANN_W_M2_K4, Weather, black_body_sky_C
from thermoforce_mpc.data import HOUR_S, ZERO_C_K, Array
from thermoforce_mpc.errors import WeatherError
from thermoforce_mpc.files import DoubtfulInput, plain_number, read_bounded, storage_errors, written

# Mean of a year, °C: the extremes on Earth are Vostok (-55) and Dallol (35).
_MEAN_C = (-60.0, 40.0)
_USUAL_MEAN_C = (-25.0, 32.0)
# An hour is dark if the sun is so far below the horizon in its middle: 7.5 degrees to its end, and astronomical dusk.
_DARK_DEG = -12.0
_MOST_IN_THE_DARK = 0.01
_STUCK_H = 72
_HOURS = 8760
# Rows more that a leap year has, with and without midnight of the next one.
_LEAP = (24, 25)
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
# What stands for a missing value (EnergyPlus, Auxiliary Programs, "EPW CSV Format"), and the range of others, both in
# the units of the files.
_MISSING = {
    "T_dry_C": 99.9, "T_dew_C": 99.9, "relative_humidity": 999.0, "pressure_Pa": 999999.0, "infrared_W_m2": 9999.0,
    "global_W_m2": 9999.0, "normal_W_m2": 9999.0, "diffuse_W_m2": 9999.0, "wind_from_rad": 999.0, "wind_m_s": 999.0,
    "total_cover": 99.0, "opaque_cover": 99.0, "ceiling_m": 99999.0,
}  # fmt: skip
_CALLED = {
    "T_dry_C": "dry bulb", "T_dew_C": "dew point", "relative_humidity": "relative humidity", "pressure_Pa": "pressure",
    "infrared_W_m2": "infrared", "global_W_m2": "global irradiance", "normal_W_m2": "direct irradiance",
    "diffuse_W_m2": "diffuse irradiance", "wind_from_rad": "wind direction", "wind_m_s": "wind speed",
    "total_cover": "total cover", "opaque_cover": "opaque cover", "ceiling_m": "ceiling",
}  # fmt: skip
# Scales from the units of files to those inside.
_SCALE = {"wind_from_rad": np.pi / 180.0, "opaque_cover": 0.1, "total_cover": 0.1, "relative_humidity": 0.01}
# What the building feels most is bridged for so many hours and never made up.
_NEEDED, _BRIDGED_H = ("T_dry_C", "global_W_m2", "normal_W_m2", "diffuse_W_m2"), 12
# Columns that no building model uses: nothing is said of them.
_UNUSED = ("relative_humidity", "infrared_W_m2", "total_cover", "ceiling_m")
# Taken for a column that is missing throughout: half a cover, and a light wind from the south-west.
_COVER, _WIND_M_S, _WIND_FROM_DEG = 5.0, 3.0, 225.0
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
    raw = read_bounded(path, _MOST_BYTES, WeatherError).removeprefix(codecs.BOM_UTF8)
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
    time_s = columns.pop("time_s")
    first = round(float(time_s[0]) / HOUR_S)
    hourly = (first + np.arange(time_s.size)) * HOUR_S
    wrong = np.flatnonzero(~np.isclose(time_s, hourly))
    if wrong.size or abs(first) > 1:
        row = int(wrong[0]) if wrong.size else 0
        raise WeatherError(
            f"{path}: hourly row {row + 1} is at {time_s[row]:.10g} s, expected "
            f"{hourly[row] if not abs(first) > 1 else 0.0:.10g}; "
            "this reader needs 8760 hourly rows from 0 s or 3600 s"
        )
    if time_s.size - _HOURS in _LEAP:
        raise WeatherError(
            f"{path}: {time_s.size} hourly rows, a year has {_HOURS}; of a leap year leave out 29 February"
        )
    if time_s.size > _HOURS + 1:  # many files repeat midnight of the next 1 January
        beyond = time_s.size - _HOURS
        warnings.warn(
            f"{path}: {beyond} rows beyond the year, from {time_s[_HOURS]:.10g} s on, are not used",
            DoubtfulInput,
            stacklevel=4,
        )
    # A year is periodic: what stands at its end is its first hour.
    return _weather(path, name, location, {key: np.roll(values[:_HOURS], first) for key, values in columns.items()})


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
    height_m = float(cells[9]) if len(cells) > 9 and re.fullmatch(r"-?[0-9.]+", cells[9]) else 0.0
    columns = _without_missing(path, columns, height_m)
    for key, (low, high) in LIMITS.items():
        scale = _SCALE.get(key, 1.0)
        bad = np.flatnonzero(~((columns[key] * scale >= low) & (columns[key] * scale <= high)))
        if bad.size:
            hour = int(bad[0])
            raise WeatherError(
                f"{path}: {key} is {columns[key][hour]:.10g} at day {hour // 24 + 1}, hour {hour % 24} "
                f"({_CALLED[key]}), expected "
                f"{low / scale:g} to {high / scale:g}, or {_MISSING[key]:g} where it is missing ({bad.size} such "
                "rows); "
                "repair the file or use another"
            )
    columns = {key: values * _SCALE.get(key, 1.0) for key, values in columns.items()}
    return Weather(name=name, latitude_deg=latitude, longitude_deg=longitude, timezone_h=zone, **columns)


def _without_missing(path: Path, columns: dict[str, Array], height_m: float) -> dict[str, Array]:
    """Columns (8760,) in the units of files, without the codes for missing values; `DoubtfulInput` says what was done.

    Short gaps are bridged on a straight line. A dew point comes from the humidity, a pressure from the height, an
    opaque cover from the total one or the infrared irradiance. Raises `WeatherError` for longer gaps of what cannot be
    made up.
    """
    gaps = {key: np.isclose(columns[key], code) for key, code in _MISSING.items()}
    gaps = {key: gap for key, gap in gaps.items() if gap.any()}
    known = dict(columns)
    for key, gap in gaps.items():
        known[key] = np.where(gap, np.nan, columns[key])
    told = []
    for key, gap in gaps.items():
        edges = np.flatnonzero(np.diff(np.concatenate([[0], gap.astype(int), [0]])))
        longest = int((edges[1::2] - edges[::2]).max())
        what = f"{_CALLED[key]} is missing ({_MISSING[key]:g}) in {int(gap.sum())} hours"
        if longest <= _BRIDGED_H:
            known[key], how = _bridged(known[key]), "bridged"
        elif key in _NEEDED:
            first = int(edges[::2][np.argmax(edges[1::2] - edges[::2])])
            raise WeatherError(
                f"{path}: {what}, {longest} of them from day {first // 24 + 1}, hour {first % 24} on: "
                f"{_MISSING[key]:g} is the "
                f"code for missing, and at most {_BRIDGED_H} hours are bridged; use another file"
            )
        else:
            known[key], how = _made_up(key, known, gaps, height_m)
        if key not in _UNUSED:
            told.append(f"{what}: {how}")
    if told:
        warnings.warn(f"{path}: {'; '.join(told)}", DoubtfulInput, stacklevel=5)
    return known


def _bridged(values: Array) -> Array:
    """Values (8760,) of a periodic year with NaN replaced on straight lines."""
    hours, known = np.arange(values.size, dtype=np.float64), np.isfinite(values)
    return np.asarray(np.interp(hours, hours[known], values[known], period=float(values.size)))


def _made_up(
    key: str, known: dict[str, Array], gaps: Mapping[str, NDArray[np.bool_]], height_m: float
) -> tuple[Array, str]:
    """A column with long gaps, and in words where the values there come from."""
    values = known[key]
    gap = ~np.isfinite(values)
    if key == "T_dew_C" and np.isfinite(known["relative_humidity"]).mean() > 0.9:
        humidity = np.clip(_bridged(known["relative_humidity"]), 1.0, 110.0)
        T = _bridged(known["T_dry_C"])
        # Magnus formula over water (WMO, Guide to Instruments and Methods of Observation, annex 4.B).
        gamma = np.log(humidity / 100.0) + 17.62 * T / (243.12 + T)
        return np.where(gap, 243.12 * gamma / (17.62 - gamma), values), "from the relative humidity"
    if key == "pressure_Pa":
        standard = 101325.0 * (1.0 - 2.25577e-5 * height_m) ** 5.25588  # ICAO standard atmosphere
        return np.where(gap, standard, values), f"{standard:.0f} Pa, that of {height_m:g} m"
    if key in ("opaque_cover", "total_cover"):
        other = {"opaque_cover": "total_cover", "total_cover": "opaque_cover"}[key]
        if other not in gaps:
            return np.where(gap, known[other], values), f"the {_CALLED[other]}"
        if "infrared_W_m2" not in gaps and (known["infrared_W_m2"] > 50.0).mean() > 0.9 and "T_dew_C" not in gaps:
            return np.where(gap, _cover(known), values), "from the infrared irradiance"
        return np.where(gap, _COVER, values), f"{_COVER:g} tenths"
    if np.isfinite(values).mean() > 0.5:
        return _bridged(values), "bridged"
    constant = {
        "wind_m_s": _WIND_M_S,
        "wind_from_rad": _WIND_FROM_DEG,
        "relative_humidity": 75.0,
        "T_dew_C": np.nan,
    }.get(key, 0.0)
    if key == "T_dew_C":
        return np.where(gap, _bridged(known["T_dry_C"]) - 5.0, values), "5 K below the dry bulb"
    return np.where(gap, constant, values), f"{constant:g}"


def _cover(columns: dict[str, Array]) -> Array:
    """Opaque cover (8760,), tenths, with which a sky has the infrared irradiance of `columns`.

    See `black_body_sky_C`.
    """
    tenths: Array = np.linspace(0.0, 10.0, 101)
    T, dew = columns["T_dry_C"], columns["T_dew_C"]
    clear = black_body_sky_C(T, dew, np.zeros(T.size)) + ZERO_C_K
    infrared = (columns["infrared_W_m2"] / STEFAN_BOLTZMANN_W_M2_K4) ** 0.25
    factor = 1.0 + 0.0224 * tenths - 0.0035 * tenths**2 + 0.00028 * tenths**3
    return np.asarray(np.interp((infrared / clear) ** 4, factor, tenths))


FILE_NAME = "Brussels.mos"
# Copy in the IDEAS library at a fixed commit; its values are checked as well. Other copies (one more there, one in
# another BOPTEST test case) lack the row of 1 January 01:00.
URL = (
    "https://raw.githubusercontent.com/open-ideas/IDEAS/767bfedefd296b7fb9e319d367dfaacaacd09a95"
    "/IDEAS/Resources/weatherdata/Brussels.mos"
)
FINGERPRINT = "7856f6e4b8b7"
_TIMEOUT_S = 30.0
_MOST_FETCHED_BYTES = 5_000_000


def fetch_brussels(folder: Path, url: str = URL, fingerprint: str = FINGERPRINT) -> Path:
    """The path of the Brussels weather year in `folder`, downloaded if missing; its values are always checked.

    The file is ASHRAE's IWEC data, licensed for your own use, not for redistribution. Raises `WeatherError` without
    network, for unexpected content at `url` or another file of that name (no partial file is left), and `StorageError`.
    """
    path = Path(folder) / FILE_NAME
    if path.exists():
        if load_weather(path).fingerprint != fingerprint:
            raise WeatherError(f"{path}: is not the Brussels year of the test case; move the file and fetch again")
        return path
    content = _download(url)
    with storage_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    with written(path) as aside:
        aside.write_bytes(content)
        try:
            downloaded = load_weather(aside).fingerprint
        except WeatherError as error:
            raise WeatherError(f"{url}: did not answer with a weather file ({error})") from error
        if downloaded != fingerprint:
            raise WeatherError(f"{url}: holds another weather year ({downloaded}, expected {fingerprint})")
    return path


def _download(url: str) -> bytes:
    """Return the body at `url`; raises `WeatherError` beyond 5 MB or if the request fails."""
    import requests

    try:
        with requests.get(url, timeout=_TIMEOUT_S, stream=True) as response:
            response.raise_for_status()
            content = bytearray()
            for chunk in response.iter_content(65536):
                content += chunk
                if len(content) > _MOST_FETCHED_BYTES:
                    raise WeatherError(f"{url}: more than {_MOST_FETCHED_BYTES} bytes, so not a weather file")
            return bytes(content)
    except requests.RequestException as error:
        raise WeatherError(
            f"{url}: cannot be fetched ({type(error).__name__}); with no network, copy {FILE_NAME} from a BOPTEST "
            "checkout or the IDEAS library and pass it with --weather, or use the synthetic year"
        ) from error
