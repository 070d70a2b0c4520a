"""A commented map to start from, by the names of a table's columns and the sizes of their values."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.files import found_files, head_of

# Words in names of columns, by what they probably are; the first match counts.
_WORDS = (
    ("humidity", r"^rh|hum"),
    ("sun", r"sun|solar|irrad|ghi|glohor|radiation|i_sol"),
    ("outdoor", r"out|ext|ambient|aussen|außen|dry.?bulb|tdrybul"),
    ("price", r"price|tariff|preis|prix"),
    ("lower", r"lower|t_?min|heating.?set"),
    ("upper", r"upper|t_?max|cooling.?set"),
    ("level", r"^u$|level|valve|position|signal|modul|speed|compressor|duty|ove"),
    ("energy", r"k?wh|energy|btu"),
    ("power", r"^p(_|el|$)|power|watt|_w$|_kw$|heat"),
    ("temperature", r"^t\d*([ _]|$)|temp|room|zone|living|kitchen|bath|deg|°|_[cfk]$"),
)
_ROWS = 2000
_COUNTED = "  unit: s  # stamps are numbers\n  since: FILL IN  # what they count from, such as 2016-01-01"


def starting_map(file: str | Path) -> str:
    """The text of a map for the first columns that look like each signal; everything else stands in comments.

    Raises:
        DataError: the file cannot be read, or no column looks like a zone's or the outdoor temperature.
    """
    path = found_files([file])[0]
    head = head_of(path, _ROWS)
    stamps, *columns = [str(column) for column in head.columns]
    found: dict[str, list[str]] = {kind: [] for kind, _ in _WORDS}
    for column in columns:
        numbers = pd.to_numeric(head[column], errors="coerce")
        kind = next((kind for kind, words in _WORDS if re.search(words, column.lower())), None)
        if kind is not None and numbers.notna().any():
            found[kind].append(column)
    if not found["temperature"] and not found["outdoor"]:
        raise DataError(f"{path}: none of {', '.join(columns)} looks like a temperature: write the map by hand")
    return _text(path, stamps, head, found)


def _text(path: Path, stamps: str, head: pd.DataFrame, found: dict[str, list[str]]) -> str:
    def temperature(column: str) -> str:
        return f"{{column: {_quoted(column)}, unit: '{_degrees(head[column])}'}}"

    has_offset = bool(re.search(r"([+-]\d{2}:?\d{2}|Z)$", str(head.iloc[0, 0]).strip()))
    zone = "  # stamps carry an offset; name the building's zone all the same" if has_offset else ""
    outdoor = found["outdoor"][:1]
    counted = pd.api.types.is_numeric_dtype(head.iloc[:, 0])
    lines = [
        f"# Map of {path.name}, guessed from names and sizes of its columns: check every line, then",
        f"#   tf-mpc data check {path.name} --map map.yaml",
        "time:",
        f"  column: {_quoted(stamps)}",
        f"  zone: Europe/Brussels  # FILL IN; Etc/GMT-1 for a clock without summer time{zone}",
        *([_COUNTED] if counted else []),
        "  marks: start  # a row's powers, energies and levels hold from its stamp on (end: until it)",
        "# site: {latitude: 50.8, longitude: 4.4}  # for an estimate of the sun",
        f"outdoor: {temperature(outdoor[0]) if outdoor else 'FILL IN  # outdoor temperature'}",
    ]
    if found["sun"]:
        lines.append(f"sun: {{column: {_quoted(found['sun'][0])}, unit: W/m²}}")
    elif found["humidity"]:
        lines.append(f"# sun: {{estimate: humidity, humidity: {_quoted(found['humidity'][0])}}}  # needs site")
    else:
        lines.append("# sun: {estimate: clear_sky}  # needs site")
    lines.append("zones:")
    rooms = found["temperature"] or ["FILL_IN"]
    for k, column in enumerate(rooms):
        lines.append(f"  {_name(column)}:")
        lines.append(f"    temperature: {temperature(column) if column in head else column}")
        for key in ("lower", "upper"):
            given = _quoted(found[key][0]) if found[key] else {"lower": 20, "upper": 24}[key]
            lines.append(f"    {key}: {given}{'' if k else '  # comfort bound, °C or a column'}")
    acts, power = found["level"][:1], (found["power"] + found["energy"])[:1]
    lines += ["actuators:", "  heater:"]
    if len(rooms) > 1:
        lines.append(f"    zone: {_name(rooms[0])}  # the zone that it serves")
    lines.append("    mode: heating  # or cooling")
    if acts:
        unit = "'%'" if pd.to_numeric(head[acts[0]], errors="coerce").max() > 1.5 else "0-1"
        lines.append(f"    level: {{column: {_quoted(acts[0])}, unit: {unit}}}")
    else:
        lines.append("    # level: {column: ..., unit: '%'}  # without it, power over its 99th percentile")
    lines += ["machines:", "  machine:"]
    if power:
        unit = "Wh per step" if power[0] in found["energy"] else "W"
        unit = "k" + unit if "kw" in power[0].lower() else unit
        lines.append(f"    power: {{column: {_quoted(power[0])}, unit: {unit}}}  # electric power that is paid for")
    else:
        lines.append("    # power: {column: ..., unit: W}  # without it nothing can be planned")
    price = f"{_quoted(found['price'][0])}" if found["price"] else "0.30"
    lines.append(f"    price: {price}  # per kWh, a number or a column")
    text = "\n".join(lines)
    spare = [column for column in head.columns[1:] if str(column) not in text]
    if spare:
        lines.append(f"# not used: {', '.join(map(str, spare))}")
    return "\n".join(lines) + "\n"


def _degrees(column: pd.Series) -> str:
    middle = float(np.nanmedian(pd.to_numeric(column, errors="coerce")))
    return "K" if middle > 200.0 else "°F" if middle > 45.0 else "°C"


def _quoted(column: str) -> str:
    return column if re.fullmatch(r"[A-Za-z_][\w ]*", column) else "'" + column.replace("'", "''") + "'"


def _name(column: str) -> str:
    """A zone's name from that of its column."""
    return re.sub(r"\W+", "_", re.sub(r"_?(deg_?c|°c|temp\w*)$", "", column, flags=re.I)).strip("_").lower() or "zone"
