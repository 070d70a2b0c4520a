"""What columns probably are, by name and size: a commented map to start from, and rooms that a map leaves out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.entries import CsvFormat, converted
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.tables.files import found_files, guessed_form, head_of
from thermoforce_mpc.measurements.tables.raw_table import as_numbers

# Words in names of columns, by what they probably are; the first match counts.
_WORDS = (
    ("humidity", r"^rh|hum|feuchte"),
    ("sun", r"sun|solar|irrad|ghi|glohor|radiation|i_sol|strahlung|w/m"),
    ("outdoor", r"out|ext|ambient|aussen|außen|dry.?bulb|tdrybul"),
    ("price", r"price|tariff|preis|prix"),
    ("lower", r"lower|t_?min|heating.?set"),
    ("upper", r"upper|t_?max|cooling.?set"),
    ("other", r"set.?point|(^|[_ ])set([_ ]|$)|target|soll|supply|return|vorlauf|rücklauf|ruecklauf|\b[vr]l\b"),
    ("level", r"^u$|level|valve|position|signal|modul|speed|compressor|duty|ove|ventil|stell|drehzahl|verdichter"),
    ("energy", r"k?wh|energ|btu"),
    ("power", r"^p(_|el|$)|power|watt|_w$|_kw$|heat|leistung|[\[(]k?w[\])]"),
    ("temperature", r"^t\d*([ _]|$)|temp|room|zone|living|kitchen|bath|deg|°|_[cfk]$|raum|zimmer"),
)
# What is only on or off acts where its column is named so.
_SWITCHED = r"heat|heiz|boiler|burner|brenner|pump|cool|kühl|relay|relais"
# Stamps that are not ISO 8601; of those that fit all rows, in the order of time, the first counts.
_STAMPS = tuple(
    f"{day} {clock}"
    for day in ("%d.%m.%Y", "%d.%m.%y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d")
    for clock in ("%H:%M", "%H:%M:%S", "%I:%M %p", "%I:%M:%S %p")
)
ROWS = 2000
"""Rows of a table that are looked at."""
_COUNTED = "  unit: s  # stamps are numbers\n  since: FILL IN  # what they count from, such as 2016-01-01"
# Median of the temperature of a room that is lived in, °C.
_ROOM_C = (14.0, 30.0)


def starting_map(file: str | Path) -> str:
    """The text of a map for the first columns that look like each signal; everything else stands in comments.

    Raises `DataError` where the file cannot be read, or no column looks like a temperature.
    """
    path = found_files([file])[0]
    form = guessed_form(path)
    head = head_of(path, ROWS, form)
    if head.columns.has_duplicates:
        name = head.columns[head.columns.duplicated()][0]
        raise DataError(f"{path}: there is more than one column '{name}'; give each a name of its own")
    if head.empty:
        raise DataError(f"{path}: the table has no rows")
    stamps, *columns = [str(column) for column in head.columns]
    by_kind: dict[str, list[str]] = {kind: [] for kind, _ in _WORDS}
    for column in columns:
        numbers = as_numbers(head[column], form.decimal)
        kind = kind_of(column)
        if kind in (None, "power") and set(numbers.dropna()) == {0.0, 1.0}:
            kind = "level" if re.search(_SWITCHED, column.lower()) else kind
        if kind is not None and numbers.notna().any():
            by_kind[kind].append(column)
    if not by_kind["temperature"] and not by_kind["outdoor"]:
        raise DataError(f"{path}: none of {', '.join(columns)} looks like a temperature: write the map by hand")
    return _text(path, stamps, head, form, by_kind)


def kind_of(column: str) -> str | None:
    """What a column probably is, by its name."""
    return next((kind for kind, words in _WORDS if re.search(words, column.lower())), None)


def _text(path: Path, stamps: str, head: pd.DataFrame, form: CsvFormat, by_kind: dict[str, list[str]]) -> str:
    def temperature(column: str) -> str:
        return f"{{column: {_quoted(column)}, unit: '{_degrees(head[column])}'}}"

    has_offset = bool(re.search(r"([+-]\d{2}:?\d{2}|Z)$", str(head.iloc[0, 0]).strip()))
    zone = "  # stamps carry an offset; name the building's zone all the same" if has_offset else ""
    outdoor = by_kind["outdoor"][:1]
    counted = pd.api.types.is_numeric_dtype(head.iloc[:, 0])
    lines = [
        f"# Map of {path.name}, guessed from names and sizes of its columns: check every line, then",
        f"#   tf-mpc data check {path.name} --map map.yaml",
        "time:",
        f"  column: {_quoted(stamps)}",
        f"  zone: Europe/Brussels  # FILL IN; Etc/GMT-1 for a clock without summer time{zone}",
        *([_COUNTED] if counted else _stamp_format(head.iloc[:, 0])),
        "  marks: start  # a row's powers, energies and levels hold from its stamp on (end: until it)",
        *_written(form),
        "# site: {latitude: 50.8, longitude: 4.4}  # for an estimate of the sun",
        f"outdoor: {temperature(outdoor[0]) if outdoor else 'FILL IN  # outdoor temperature'}",
    ]
    if by_kind["sun"]:
        lines.append(f"sun: {{column: {_quoted(by_kind['sun'][0])}, unit: W/m²}}")
    elif by_kind["humidity"]:
        lines.append(f"# sun: {{estimate: humidity, humidity: {_quoted(by_kind['humidity'][0])}}}  # needs site")
    else:
        lines.append("# sun: {estimate: clear_sky}  # needs site")
    lines.append("zones:")
    rooms = by_kind["temperature"] or ["FILL_IN"]
    for k, column in enumerate(rooms):
        lines.append(f"  {_name(column)}:")
        lines.append(f"    temperature: {temperature(column) if column in head else column}")
        for key in ("lower", "upper"):
            value = _quoted(by_kind[key][0]) if by_kind[key] else {"lower": 20, "upper": 24}[key]
            lines.append(f"    {key}: {value}{'' if k else '  # comfort bound, °C or a column'}")
    acts, power = by_kind["level"][:1], (by_kind["power"] + by_kind["energy"])[:1]
    lines += ["actuators:", "  heater:"]
    if len(rooms) > 1:
        lines.append(f"    zone: {_name(rooms[0])}  # the zone that it serves")
    lines.append("    mode: heating  # or cooling")
    if acts:
        unit = "'%'" if as_numbers(head[acts[0]], form.decimal).max() > 1.5 else "0-1"
        lines.append(f"    level: {{column: {_quoted(acts[0])}, unit: {unit}}}")
    else:
        lines.append("    # level: {column: ..., unit: '%'}  # without it, power over its 99th percentile")
    lines += ["machines:", "  machine:"]
    if power:
        unit = "W" if power[0] in by_kind["power"] else "Wh counter" if _counts(head[power[0]]) else "Wh per step"
        unit = "k" + unit if "kw" in power[0].lower() else unit
        lines.append(f"    power: {{column: {_quoted(power[0])}, unit: {unit}}}  # electric power that is paid for")
    else:
        lines.append("    # power: {column: ..., unit: W}  # without it nothing can be planned; without a meter take")
        lines.append("    #   the column of the level, with factor: the W of a reading of 1")
    price = f"{_quoted(by_kind['price'][0])}" if by_kind["price"] else "0.30"
    lines.append(f"    price: {price}  # per kWh, a number or a column")
    text = "\n".join(lines)
    spare = [column for column in head.columns[1:] if str(column) not in text]
    if spare:
        lines.append(f"# not used: {', '.join(map(str, spare))}")
    return "\n".join(lines) + "\n"


def _stamp_format(column: pd.Series) -> list[str]:
    """The line for stamps that are not ISO 8601; none for those that are."""
    stamps = column.dropna()
    if pd.to_datetime(stamps, format="ISO8601", utc=True, errors="coerce").notna().all():
        return []
    fitting = []
    for form in _STAMPS:
        times = pd.to_datetime(stamps, format=form, errors="coerce")
        if times.notna().all() and (times.diff() < pd.Timedelta(0)).sum() <= 1:  # the end of summer time goes back
            fitting.append(form)
    if not fitting:
        return [f"  format: FILL IN  # of stamps such as {stamps.iloc[0]}: %d day, %m month, %Y year, %H:%M"]
    other = f"  # or '{fitting[1]}': both fit" if fitting[1:] else ""
    return [f"  format: '{fitting[0]}'{other}"]


def _written(form: CsvFormat) -> list[str]:
    """The line on how the file is written, where that is not the default."""
    other = {"decimal": f"'{form.decimal}'", "encoding": form.encoding}
    options = [f"{key}: {value}" for key, value in other.items() if getattr(form, key) != getattr(CsvFormat(), key)]
    return [f"csv: {{{', '.join(options)}}}"] if options else []


def _counts(column: pd.Series) -> bool:
    """Whether an energy is the reading of a counter, which only rises, rather than one per step."""
    numbers = pd.to_numeric(column, errors="coerce").dropna()
    return bool(len(numbers) > 10 and numbers.is_monotonic_increasing and numbers.iloc[-1] > numbers.iloc[0])


def _degrees(column: pd.Series) -> str:
    middle = float(np.nanmedian(pd.to_numeric(column, errors="coerce")))
    return "K" if middle > 200.0 else "°F" if middle > 45.0 else "°C"


def _quoted(column: str) -> str:
    return column if re.fullmatch(r"[A-Za-z_][\w ]*", column) else "'" + column.replace("'", "''") + "'"


def _name(column: str) -> str:
    plain = re.sub(r"[\[(].*?[\])]", "", column).strip()
    plain = re.sub(r"[_ ]?(deg_?c|°c|temp\w*|ist|ist-?wert)$", "", plain, flags=re.I)
    return re.sub(r"\W+", "_", plain).strip("_").lower() or "zone"


def rooms_beside(head: pd.DataFrame, rules: MeasurementMap) -> tuple[str, ...]:
    """What the first rows of a table tell of rooms outside the map, in words, by names and size of readings."""
    named = {column for _, signal in rules.signals() for column in signal.columns}
    units: set[str] = {zone.temperature.unit for zone in rules.zones.values()}
    rooms = [
        str(column)
        for column in head.columns.drop_duplicates(keep=False)
        if str(column) not in named and kind_of(str(column)) == "temperature" and _of_a_room(head[column], rules, units)
    ]
    return (_of_rooms(rooms, list(rules.zones)),) if rooms else ()


def _of_a_room(column: pd.Series, rules: MeasurementMap, units: set[str]) -> bool:
    numbers = np.asarray(as_numbers(column, rules.csv.decimal), dtype=np.float64)
    known = numbers[np.isfinite(numbers)]
    if not known.size or np.ptp(known) == 0.0:
        return False
    return any(_ROOM_C[0] <= converted(np.array([np.median(known)]), unit)[0] <= _ROOM_C[1] for unit in units)


def _of_rooms(rooms: Sequence[str], zones: Sequence[str]) -> str:
    many = len(rooms) > 1
    return (
        f"neighbours left out: {', '.join(rooms)} {'look like rooms' if many else 'looks like a room'} beside "
        f"{', '.join(zones)} and stand{'' if many else 's'} outside the map: where {'they are' if many else 'it is'} "
        "heated, that heat is taken for the own; name them as zones, with what heats them"
    )
