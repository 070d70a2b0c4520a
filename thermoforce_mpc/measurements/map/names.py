"""What a name says of its signal: its words, what they mean, its unit, and where it is."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from itertools import pairwise
from typing import get_args

from thermoforce_mpc.data.prices import PriceUnit, price_unit_of
from thermoforce_mpc.measurements.map.mapping import IrradianceUnit, LevelUnit, PowerUnit, TemperatureUnit
from thermoforce_mpc.measurements.map.vocabulary import GENERAL, PAIRS, WORDS
from thermoforce_mpc.measurements.units import COUNTER, PER_STEP, unit_named

_WHOLE = {tag: frozenset(whole.split()) for tag, (whole, _) in WORDS.items()}
_PARTS = {tag: tuple(parts.split()) for tag, (_, parts) in WORDS.items()}
# The heat in the name of a machine is no heat that is measured.
_HEAT_PUMP = re.compile(r"(?<![a-z])(pomp[ae]|bomba)[ _-]*(a|di|de)[ _-]*(chaleur|calore?)(?![a-z])")
# Letters that are no other one with an accent.
_LETTERS = str.maketrans({"ß": "ss", "ø": "o", "æ": "ae", "œ": "oe", "đ": "d", "ł": "l"})
LOADS = tuple(dict.fromkeys(re.sub(f"{PER_STEP}|{COUNTER}", "", unit) for unit in get_args(PowerUnit)))
"""Units of power and energy."""
OTHER_UNITS = ("Hz", "rps", "rpm", "s", "ppm", "hPa", "Pa", "lx", "V", "A", "l/h", "m³", "m³/h", "cfm", "m/s", "km/h")
"""Units of what a map has no place for."""
_KNOWN = frozenset(
    [*LOADS, *OTHER_UNITS]
    + [unit for of in (TemperatureUnit, LevelUnit, IrradianceUnit, PriceUnit) for unit in get_args(of)]
)
# What is before the unit of energy of a price.
_MONEY = "ct|cents?|eurocents?|c|öre|øre|p|pence|euro?|[€$£]"
# Units at the end of a name, behind a space or underscore.
_AT_END = (
    "degc", "degf", "celsius", "fahrenheit", "kwh", "wh", "mwh", "kw", "w", "pct", "percent", "c", "f", "k", "btu", "%",
    "°c", "°f", "kbtu", "mmbtu", "therms", "mbh", "kbtuh", "btuh", "gj", "mj", "kj", "kcal",
)  # fmt: skip


# Units in full at the end of a name, whatever stands before.
_IN_FULL = re.compile(r"(?i)[\W_](percentage|percent|prozent|celsius|fahrenheit|kelvin)$")


# How often EnergyPlus reports a variable, in brackets behind it.
_OFTEN = frozenset(("timestep", "each call", "detailed", "hourly", "daily", "monthly", "runperiod", "annual"))


def _of_brackets(match: re.Match[str]) -> str:
    told = match[1].strip()
    if told.lower() in _OFTEN:
        return " "
    says = re.search(r"[^\W\d_]{4}", told) and not unit_named(told) and "S/N" not in told
    return f" {told} " if says else " "


@lru_cache(maxsize=100_000)
def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case without accents; numbers stand apart, units in brackets are left out.

    What else stands in brackets counts where it has a word of four letters; of a logger's sensor (HOBO) its label does.
    """
    plain = re.sub(r"[\[(](?:[^\])]*LBL: ?)?([^\])]*)[\])]", _of_brackets, name)
    # Units, and not WC and WZ, which are rooms.
    plain = re.sub(r"(?<![A-Za-z])([kM]?)(Wh|W|J)(?![a-z]|[CZ](?![A-Za-z]))", lambda m: m[0].lower(), plain)
    plain = re.sub(r"deg ?([CFK])(?![a-z])|[\b_]([CFK])$", " ", plain)
    plain = re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})", " ", plain)
    folded = "".join(c for c in unicodedata.normalize("NFKD", plain.lower()) if not unicodedata.combining(c))
    folded = _HEAT_PUMP.sub(" heatpump ", folded.translate(_LETTERS))
    return tuple(re.findall(r"co2|[a-z]+|\d+", folded))


def unit_of(name: str) -> str:
    """The unit that a name tells, such as '°F' of 'ZN-T (deg F)'; '' where it tells none."""
    # In brackets behind a unit stands which one of several: the phase A, or the sensor.
    load = re.search(r"\b([kM]?Wh?)\s*[\[(]\w{1,3}[\])]$", name.strip())
    if load:
        return load[1]
    for told in re.findall(r"[\[(]([^\])]*)[\])]", name):
        if unit := unit_named(told) or unit_named(unicodedata.normalize("NFKC", told)):
            return unit if unit in _KNOWN else ""
    if told := re.search(rf"(?:^|[ _])(?:[A-Z]{{3}}|(?i:{_MONEY})) ?/ ?[kM]Wh$", name.strip()):
        return price_unit_of(told[0]) or ""
    if re.search(r"(?i)w[/_ ]?m-?\^?[²2]", name):
        return "W/m²"
    if match := re.search(r"(?:[ _\-/]|\bin )(%|°[CF]|[A-Za-z]+)$", name.strip()):
        told = match[1].lower()
        if told in _AT_END and (len(told) > 1 or told == "%" or match[1].isupper() or "_" in name):
            return unit_named(told)
    if match := _IN_FULL.search(name):
        return unit_named(match[1])
    return ""


@lru_cache(maxsize=100_000)
def tags(name: str) -> frozenset[str]:
    """What the words of a name say of its signal."""
    words = words_of(name)
    found = {tag for tag, whole in _WHOLE.items() if not whole.isdisjoint(words)}
    for word in words:
        if len(word) > 4:
            found |= {tag for tag, parts in _PARTS.items() if any(part in word for part in parts)}
    if any(len(word) > 3 and word.endswith(("sp", "stpt")) for word in words):  # as EFFSP
        found.add("setpoint")
    pairs = {a + b for a, b in pairwise(words)}
    # T_a and T_i are Ta and Ti.
    of_two = {pair for pair in pairs if len(pair) == 2}
    found |= {tag for tag in ("outdoor", "room", "temperature", "heat", "sun") if not of_two.isdisjoint(_WHOLE[tag])}
    of_files = _WHOLE["pv"].intersection(words) <= {"export"} and unit_of(name) not in LOADS
    if found & {"temperature", "humidity"} and of_files:
        found.discard("pv")  # an export of readings, as files are called, is none of electricity
    return frozenset(found | {tag for pair, tag in PAIRS.items() if pair in pairs})


# A day, with or without a time, in the name of a file.
_DAY_IN_NAME = re.compile(r"20\d{6}(\d{4}|\d{6})?")


def place_of(name: str) -> frozenset[str]:
    """The words of `place_in_order`."""
    return frozenset(place_in_order(name))


def place_in_order(name: str) -> tuple[str, ...]:
    """The words of a name that say where or of what its signal is: those without a tag, and names of rooms."""
    words = [word for word in words_of(name) if word not in GENERAL]
    kept = [
        word
        for word in words
        if (word.isdigit() and not _DAY_IN_NAME.fullmatch(word))
        or word
        in _WHOLE["room"] - {"t", "ti", "in", "int", "znt", "spt", "rmt", "zn", "zone", "room", "space", "rm", "raum"}
        or (len(word) > 4 and any(part in word for part in _PARTS["room"]))
        or (
            not any(word in whole for whole in _WHOLE.values())
            and not (len(word) > 4 and any(part in word for parts in _PARTS.values() for part in parts))
        )
    ]
    return tuple(re.sub(r"(temperat\w*|temp|ventil\w*|soll\w*|ist\w*|feucht\w*)$", "", word) or word for word in kept)
