"""What signals probably are, by their names and their readings together.

A name proposes, readings decide: text is no temperature, a number of a row no time, what only rises is a counter, half
steps between 15 and 26 are a set-point, and what goes with the rooms is no outdoor air. Where name and readings leave
doubt, the guess says why.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from thermoforce_mpc.data import DAY_S, Array
from thermoforce_mpc.data.limits import codes_of_none
from thermoforce_mpc.measurements.map.mapping import IrradianceUnit, MeasurementMap
from thermoforce_mpc.measurements.map.names import LOADS, OTHER_UNITS, place_of, tags, unit_of, words_of
from thermoforce_mpc.measurements.units import UNITS, converted

# Temperatures, °C: of rooms that are lived in (medians), of weather, of water in pipes.
_ROOM_C, _WEATHER_C = (12.0, 31.0), (-40.0, 48.0)
_SETPOINTS_C = (4.0, 32.0)
# Correlation of what moves together, hour by hour.
_TOGETHER = 0.9
# A room is warmer by so much, K, than what is outdoors.
_APART_K = 3.0
# Two names have one sensor where their readings are so near for this share of a day or more, K: one may be rounded to
# tenths, and be stored some seconds later. Thermometers of two rooms at one set-point are further apart more often.
_ROUNDED_K, _SAME_SHARE = 0.051, 0.99
# Tags of what is not the temperature of a room, and temperatures in the short of point lists.
_NO_ROOM = frozenset(
    ("outdoor", "supply", "return", "water", "hot water", "humidity", "power", "energy", "valve", "other", "sun")
)
_ENERGIES = tuple(unit for unit in LOADS if UNITS[unit].quantity == "energy")
_OF_LOADS = frozenset(("energy", "power", "heat", "heating machine", "electric", "gas"))
_TURNS = ("Hz", "rps", "rpm")
_FREQUENCY = re.compile(r"(?i)fr[eé]qu?[ev]n")
# That of the mains, Hz, which is no machine's: it stays within 0.2 Hz in a grid that spans land, and 2 Hz on an island.
_MAINS_HZ, _MAINS_SPAN_HZ = (45.0, 65.0), 2.0
_NEVER_FULL = 0.9  # a level that ends below it, of a machine that is full on cold days, may be something else
_ONES = 1.5  # more than a level of 1 and its noise
_MOST_STAGES = 9.0  # whole numbers up to it are no per cent
# What may be a unit of power or energy, in brackets, that is none here, such as Shelly's Wmin.
_OTHER_LOAD = re.compile(r"[\[(]([kM]?[WJ][A-Za-z·*]{0,5})[\])]")
# Heat rather than what a machine takes for it.
_HEAT = re.compile(
    r"(?i)^q[_ .-]|qdot|therm|w[aä]e?rme(menge|leist)|heat.?(meter|flow|output)|wmz|qh|^phi|^ph\b|heizleist|chaleur|"
    r"warmte|heating (rate|energy)\b"
)
# Temperatures that no thermometer shows: dew point, wet bulb, and what wind and damp make of it.
_MADE_OF_OTHERS = re.compile(
    r"\b(dew ?points?|dpt|wet ?bulb|wind ?chill|heat ?index|humidex|feels|felt|taupunkt\w*|gefue?hlte?|dauwpunt|"
    r"gevoels\w*|point de rosee|ressentie?|punto (de|di) (rocio|rugiada)|dagg ?punkt|dugg ?punkt|kastepiste)\b"
)
# Measured and wanted temperatures of a zone, as evohome's loggers write both: 'Kitchen [A]', 'Kitchen [T]'.
_ACTUAL_OR_TARGET = re.compile(r"(.+ )\[([AT])\]")
# So many signals below one folder say nothing by its name.
_LEAST_SHARING = 3
# Temperatures as 'flowT' or 'T_flow'.
_SHORT_T = re.compile(r"[a-z]T$|_T$|^T_")
_IDS = frozenset(("id", "idx", "row", "uuid", "epoch", "unix"))
_SHORT = ("znt", "spt", "rmt", "sat", "rat", "mat", "dat", "oat", "lwt", "ewt", "degc", "degf")
_LEAST, _PERCENT = 8, 100.5
# Set-points of a thermostat that it does not follow as a rule, or that are none: of the unoccupied, of frost, a step.
_NOT_IN_FORCE = frozenset(("unoccupied", "unocc", "standby", "emergency", "frost", "step", "offset", "default"))
# Set-points for cooling; an air conditioner's own (AC, Klima) is for all that it does.
_COOLS = re.compile(r"cool|clg|^clsp|^csp$|^tcset|kuh?l|kuehl|koel|froid|refriger|raffre|^kyl|kjol|^jaahd")
# Words of what is measured where its thermostat has another temperature too, and entities of such in Home Assistant.
_CURRENT = frozenset(("current", "measured", "actual", "ist", "local"))
_CLIMATE = re.compile(r"climate\.\w+[. ]temperature")
_MEANS = frozenset(("avg", "average", "mean", "mittel", "mittelwert", "moyenne", "moy", "gemiddelde", "gem", "media"))
_EXTREMES = frozenset(("min", "max", "minimum", "maximum", "minimal", "maximal", "std", "stddev", "stdev"))
_OCCUPIED = frozenset(("occupied", "occ"))
# Contacts of windows, in the languages above; a contact is 0 or 1.
_WINDOW = re.compile(r"window|fenster|fenetre|raam|finestra|ventana|fonster|vindu|ikkuna|^okn[oa]$")
# Rooms that are inside whatever else their names hold, such as "indoor ambient", unless these say outdoors.
_INDOORS = frozenset(("indoor", "inside", "innen", "binnen", "interieur", "inomhus", "innendors", "indendors", "sisa"))
_OUTDOORS = frozenset(("outdoor", "outdoors", "outside", "aussen", "exterieur", "buiten", "ute", "utomhus", "ulko"))


@dataclass(frozen=True)
class Guess:
    """What a signal probably is (`role`, '' for nothing that is used), its unit, and why that is so or doubtful ('').

    `factor`: what its readings are multiplied by to be in that unit.
    """

    name: str
    role: str
    unit: str = ""
    doubt: str = ""
    place: frozenset[str] = field(default=frozenset())
    factor: float = 1.0

    @property
    def sure(self) -> bool:
        """Whether there is no doubt."""
        return not self.doubt


@dataclass(frozen=True)
class Column:
    """First readings of a signal: instants (n,) s since 1970, increasing, values (n,) NaN where none.

    `text`: it is mostly words; `unit`: one that its cells, or else name or table, say; `by`: what values were
    multiplied by, where a line above the table says it; `words`: those that stand amid its numbers; `clock`: the zone
    of the clock that instants are of, '' for the building's.
    """

    name: str
    time_s: Array
    values: Array
    text: bool = False
    unit: str = ""
    by: float = 1.0
    words: tuple[str, ...] = ()
    clock: str = ""


def guesses(columns: Sequence[Column]) -> list[Guess]:
    """What each of the signals of one building probably is."""
    called = _called(columns)
    found = _guesses([replace(c, name=called[c.name], unit=_unit_beside(c, called[c.name])) for c in columns])
    name_of = {told: name for name, told in called.items()}
    return [replace(guess, name=name_of[guess.name]) for guess in found]


def _called(columns: Sequence[Column]) -> dict[str, str]:
    """What says of what each signal is, by its name: without the folders that all have, and with what letters mean."""
    folders = [re.split(r"(?<=[/\\\\|])", column.name)[:-1] for column in columns if not column.text]
    alike = [level[0] for level in zip(*folders, strict=False) if len(set(level)) == 1]
    shared = "".join(alike) if len(folders) >= _LEAST_SHARING else ""
    names = {column.name for column in columns}
    out: dict[str, str] = {}
    for name in names:
        letter = _ACTUAL_OR_TARGET.fullmatch(name)
        if letter and {letter[1] + other for other in ("[A]", "[T]")} <= names:
            out[name] = letter[1] + ("temperature" if letter[2] == "A" else "target temperature")
        else:
            out[name] = name.removeprefix(shared) or name
    return out if len(set(out.values())) == len(names) else {name: name for name in names}


def _unit_beside(column: Column, called: str) -> str:
    """The unit of a signal; none of a letter that says that a temperature is actual, not ampere."""
    return "" if column.name.endswith("[A]") and called != column.name else column.unit


def _guesses(columns: Sequence[Column]) -> list[Guess]:
    looks = {column.name: _Look(column) for column in columns}
    fahrenheit = _fahrenheit(looks)
    found = _without_extremes([_guess(look, fahrenheit) for look in looks.values()])
    found = _targets_of_thermostats(found, looks, fahrenheit)
    found = [_with_place(guess) for guess in _outdoor_apart(found, looks)]
    return _rooms_once(found, looks)


def _without_extremes(found: Sequence[Guess]) -> list[Guess]:
    """Guesses without the extremes of what stands beside them as a mean, or by its bare name."""

    def of(name: str) -> tuple[str, ...]:
        return tuple(word for word in words_of(name) if word not in _EXTREMES | _MEANS)

    means = {of(g.name) for g in found if not _EXTREMES & set(words_of(g.name))}
    return [Guess(g.name, "") if _EXTREMES & set(words_of(g.name)) and of(g.name) in means else g for g in found]


def _targets_of_thermostats(found: Sequence[Guess], looks: Mapping[str, _Look], fahrenheit: bool) -> list[Guess]:
    """Guesses with the set-points of thermostats that call them a mere temperature, beside the current one.

    So does Home Assistant: `climate.hall.temperature` is asked for, `climate.hall.current_temperature` measured.
    """
    current = {
        tuple(w for w in words_of(g.name) if w not in _CURRENT)
        for g in found if g.role == "zone" and _CURRENT & set(words_of(g.name))
    }  # fmt: skip
    return [
        Guess(g.name, "setpoint", g.unit)
        if g.role == "zone" and (words_of(g.name) in current or _CLIMATE.fullmatch(g.name))
        and _setpoint(looks[g.name], fahrenheit)
        else g
        for g in found
    ]  # fmt: skip


class _Look:
    """What the readings of a signal look like."""

    def __init__(self, column: Column) -> None:
        self.name, self.tags = column.name, tags(column.name)
        self.unit = column.unit or unit_of(column.name)
        known = np.isfinite(column.values)
        known[known] = ~codes_of_none(column.values[known])
        self.time_s, self.values = column.time_s[known], column.values[known]
        if (np.diff(self.time_s) < 0.0).any():  # the newest may stand first, and a counter falls then
            order = np.argsort(self.time_s, kind="stable")
            self.time_s, self.values = self.time_s[order], self.values[order]
        self.words = column.words
        v = self.values
        self.text = column.text or not v.size
        self.least, self.median, self.most = (
            (float(q) for q in np.quantile(v, (0.0, 0.5, 1.0))) if v.size else (np.nan, np.nan, np.nan)
        )
        self.distinct = np.unique(v)
        self.binary = bool(self.distinct.size <= 2 and set(self.distinct.tolist()) <= {0.0, 1.0})
        self.constant = self.distinct.size < 2
        steps = np.diff(v)
        rises = steps[steps != 0.0]
        falls = float((rises < 0.0).mean()) if rises.size else 0.0
        self.counts = bool(rises.size >= _LEAST and falls < 0.02 and not self.binary and _rises_on(v))
        self.whole = bool(v.size and np.allclose(v, np.round(v)))
        self.halves = bool(v.size and np.allclose(2 * v, np.round(2 * v), atol=1e-6))
        same = float((steps == 0.0).mean()) if steps.size else 1.0
        # A set-point changes seldom; where changes alone are stored, nothing stays.
        self.rests = same > 0.8 or same < 0.05
        self.few = self.rests and bool(v.size >= _LEAST and self.distinct.size <= max(4, min(14, v.size // 12 + 2)))
        self.every_s = float(np.median(np.abs(np.diff(column.time_s)))) if column.time_s.size > 1 else np.nan
        # How many seconds of an interval something ran.
        acts = self.tags & {"level", "heating machine", "cooling", "heat"} and not self.tags & {"power", "setpoint"}
        within = self.whole and self.least >= 0.0 and _PERCENT < self.most <= self.every_s
        self.ran = bool(acts and within and self.unit in ("s", ""))
        self.is_row = bool(v.size >= _LEAST and self.whole and (steps == 1.0).mean() > 0.95)

    @property
    def is_temperature(self) -> bool:
        """Whether a unit says so."""
        return self.unit in ("°C", "°F", "K")

    def celsius(self, fahrenheit: bool) -> tuple[str, Array]:
        """The likely unit of a temperature, and its values, °C."""
        unit = self.unit if self.unit in ("°C", "°F", "K") else ""
        if not unit:
            unit = (
                "K"
                if self.median > 200.0
                else "°F"
                if self.median > 45.0 and (fahrenheit or self.median > 55.0)
                else "°C"
            )
            if fahrenheit and unit == "°C":
                unit = "°F"
        return unit, converted(self.values, unit)


def _rises_on(values: Array) -> bool:
    """Whether values rise in all parts, as a counter does that may begin anew, and not once, as a morning does."""
    before, after = values[:-1], values[1:]
    values = values + np.append(0.0, np.cumsum(np.where((after >= 0.0) & (after < 0.1 * before), before, 0.0)))
    parts = np.array_split(values, 4)
    return all(part.size and part[-1] >= part[0] for part in parts) and sum(part[-1] > part[0] for part in parts) >= 2


def _fahrenheit(looks: Mapping[str, _Look]) -> bool:
    """Whether temperatures without a unit are in °F: those of rooms are."""
    if any(look.unit == "°C" for look in looks.values()):
        return False
    if any(look.unit == "°F" for look in looks.values()):
        return True
    rooms = [
        look for look in looks.values()
        if not look.text and {"room", "temperature"} & look.tags and not _NO_ROOM & look.tags
    ]  # fmt: skip
    medians = [look.median for look in rooms if not look.binary]
    return bool(medians) and 58.0 <= float(np.median(medians)) <= 85.0


def _guess(look: _Look, fahrenheit: bool) -> Guess:
    """What a signal is: of no use, of the weather or a tariff, what people set, what acts, or a temperature."""
    if look.binary and not look.text and any(_WINDOW.search(word) for word in words_of(look.name)):
        return Guess(look.name, "window", "0-1")
    if look.text and any("hot water" in tags(word) for word in look.words):
        return Guess(look.name, "mode")
    if _of_no_use(look, fahrenheit):
        return Guess(look.name, "")
    for asked in (_of_weather_and_price, _of_setpoints, _of_what_acts):
        if (found := asked(look, fahrenheit)) is not None:
            return found
    t = look.tags
    if t & {"outdoor", "room", "temperature", "supply", "return"} or look.is_temperature:
        return _temperature(look, fahrenheit)
    if t & {"hot water", "water"}:
        return Guess(look.name, "")
    if t & {"heating machine", "cooling"} and not look.constant:
        if _shares(look):
            return Guess(look.name, "level", _share_unit(look))
        if not look.unit and look.least >= 0.0 and not look.counts:
            return Guess(look.name, "power", "W", "its name says what it is of: is it a power, in W?")
    return _by_values(look, fahrenheit)


def _of_no_use(look: _Look, fahrenheit: bool) -> bool:
    """Whether a signal is words, the number of a row, or one that no map has a place for."""
    t, words = look.tags, set(words_of(look.name))
    if look.text or look.is_row or (words & _IDS and look.whole):
        return True
    if _MADE_OF_OTHERS.search(" ".join(words_of(look.name))):
        return True
    if look.ran:
        return False
    if look.unit in OTHER_UNITS and not (look.unit in _TURNS and t & {"level", "valve"}):
        return True
    other = "other" in t and look.unit not in LOADS and not look.is_temperature
    if "setpoint" in t and _OCCUPIED & words and not look.unit:
        other = not _setpoint(look, fahrenheit)  # as occupied_heating_setpoint of Zigbee
    # A window is on or off, where a room's temperature may be named by its window.
    if other and not ("temperature" in t and not _shares(look)):
        return True
    of_part = "part of the sun" in t and bool("sun" in t or re.search(r"(?i)d[nh]i|diffus", look.name))
    if of_part and not re.search(r"(?i)global|ghi", look.name) and not t & {"valve", "power", "price"}:
        return True
    of_sun = "sun" in t and t & {"power", "energy"} and look.unit not in ("W/m²", "kW/m²")
    return "pv" in t or bool(of_sun and not re.search(r"(?i)radiation|irradi|strahl|rayonn", look.name))


def _of_weather_and_price(look: _Look, fahrenheit: bool) -> Guess | None:
    t = look.tags
    if ("price" in t and not look.counts) or look.unit.startswith(("per ", "cent per ")):
        told = look.unit if look.unit.startswith(("per ", "cent ")) else ""
        return Guess(look.name, "price", told or ("per kWh" if abs(look.median) < 3.0 else "per MWh"))
    in_full = any("temp" in word for word in words_of(look.name))
    if "humidity" in t and "valve" not in t and (look.unit == "%" or not ("temperature" in t and in_full)):
        return Guess(look.name, "humidity of outdoors" if "outdoor" in t else "humidity", _share_unit(look))
    of_sun = (
        "sun" in t
        and not t & {"valve", "setpoint", "temperature"}
        and (look.unit in ("", "W", *get_args(IrradianceUnit)))
    )
    if not of_sun:
        return None
    if look.least < -30.0 or look.most > 1700.0 or look.counts:
        return Guess(look.name, "")
    told = look.unit if look.unit in get_args(IrradianceUnit) else ""
    sure = bool(told) or _by_day(look) or look.constant
    small = not look.unit and look.most < 2.0
    unit = told or ("kW/m²" if small else "W/m²")
    return Guess(look.name, "sun", unit, "" if sure else "it does not go to 0 at night")


def _of_setpoints(look: _Look, fahrenheit: bool) -> Guess | None:
    t = look.tags
    if "setpoint" not in t or look.unit in LOADS or (t & {"power", "energy"} and look.most > 60.0):
        return None
    if _setpoint(look, fahrenheit) or not _shares(look) or look.is_temperature:
        return Guess(look.name, _asked_for(look), look.celsius(fahrenheit)[0])
    if "valve" in t:
        return Guess(look.name, "level", _share_unit(look), "its name says set-point")
    unit, celsius = look.celsius(fahrenheit)
    warm = look.unit != "%" and celsius.min() > 4.0 and 10.0 < float(np.median(celsius)) < 32.0
    return Guess(look.name, _asked_for(look), unit) if warm else Guess(look.name, "")


def _of_what_acts(look: _Look, fahrenheit: bool) -> Guess | None:
    """A level, a power or an energy; None for what is a temperature or nothing of these."""
    t = look.tags
    if look.unit in LOADS or (look.counts and t & _OF_LOADS and not look.is_temperature):
        return _load(look)
    as_temperature = look.is_temperature or _temperature_word(look, t)
    if look.ran:
        return Guess(look.name, "level", "%", "", factor=100.0 / look.every_s)
    may_act = "valve" in t or ("level" in t and (look.unit == "%" or not t & {"power", "energy"}))
    if look.unit in _TURNS or (_FREQUENCY.search(look.name) and not look.unit and look.most > _ONES):
        low, high = _MAINS_HZ
        if look.unit in ("Hz", "") and low <= look.least and look.most <= min(high, look.least + _MAINS_SPAN_HZ):
            return Guess(look.name, "")
        return Guess(look.name, "level", "%", "a frequency over its largest is a level (factor)")
    if may_act and not as_temperature and _shares(look):
        if _setpoint(look, fahrenheit) and "valve" not in t:
            why = "its values are those of a set-point, in half steps"
            return Guess(look.name, "setpoint", look.celsius(fahrenheit)[0], why)
        if look.constant and "valve" not in t:
            return Guess(look.name, "")
        if {"supply", "return"} & t and "valve" not in t and not look.binary:
            return _temperature(look, fahrenheit)
        doubt = "of hot water for taps, or of the heating?" if "hot water" in t else ""
        if look.whole and not look.unit and _ONES < look.most <= _MOST_STAGES:
            why = f"whole numbers up to {look.most:.0f}: stages, whose largest is full, or numbers of states?"
            return Guess(look.name, "level", "%", why, factor=100.0 / look.most)
        if "heating machine" in t and not look.unit and not look.whole and look.most < _NEVER_FULL:
            doubt = doubt or f"values up to {look.most:.2g}: a level that is never full, or kWh of a step?"
        return Guess(look.name, "level", _share_unit(look), doubt)
    if t & {"power", "energy", "heat"} and not as_temperature:
        return _load(look)
    return None


def _share_unit(look: _Look) -> str:
    return "%" if look.most > 1.5 or look.unit == "%" else "0-1"


def _temperature_word(look: _Look, t: frozenset[str]) -> bool:
    """Whether a name says temperature in full, or in the short of a point list."""
    if "temperature" in t and "valve" not in t and _SHORT_T.search(look.name):
        return True
    return ("temperature" in t and any("temp" in word or word in _SHORT for word in words_of(look.name))) or (
        "temperature" in t and not t & {"power", "energy", "heat", "valve", "level"}
    )  # fmt: skip


def _shares(look: _Look) -> bool:
    """Whether values may be a level: between 0 and 1 or 0 and 100, or as much below 0."""
    return bool(
        look.least >= -100.5
        and look.most <= 100.5
        and (look.least >= -0.01 or look.most <= 1.01 or (look.least >= -100.5 and "level" in look.tags))
    )


def _setpoint(look: _Look, fahrenheit: bool) -> bool:
    """Whether values are steps of half a degree between those that people set, and few of them."""
    _, celsius = look.celsius(fahrenheit)
    if not celsius.size or look.binary:
        return False
    inside = bool(celsius.min() >= _SETPOINTS_C[0] and celsius.max() <= _SETPOINTS_C[1] and look.least > 1.0)
    return (
        inside
        and look.few
        and (look.halves or bool(np.allclose(5 * look.values, np.round(5 * look.values), atol=1e-6)))
    )


def _asked_for(look: _Look) -> str:
    """What a set-point is for: heating or all, cooling, a bound of comfort; '' for one that is not in force."""
    words = set(words_of(look.name))
    if words & _NOT_IN_FORCE:
        return ""
    for bound in ("lower", "upper"):
        if bound in look.tags:
            return bound
    return "cooling setpoint" if "high" in words or any(_COOLS.search(word) for word in words) else "setpoint"


def _load(look: _Look) -> Guess:
    """Power, energy per step or a counter, and of what."""
    t, unit = look.tags, look.unit
    # A plug, or the starts, of what heats is its meter.
    if t & {"hot water", "gas", "pv"} or ("other" in t and "heating machine" not in t):
        return Guess(look.name, "gas" if "gas" in t and "hot water" not in t else "")
    of_machine = t & {"electric", "heating machine"}
    heat = "heat" in t and (not of_machine or bool(_HEAT.search(look.name)))
    role = "heat" if heat else "power"
    strange = "" if unit or (told := _OTHER_LOAD.search(look.name)) is None else told[1]
    if look.counts:
        counted = unit if unit in _ENERGIES else "kWh" if look.most < 1e6 else "Wh"
        doubt = "" if unit in _ENERGIES or "energy" in t else "it only rises: a counter, of kWh or Wh?"
        doubt = f"'{strange}' is no unit that is known: factor to {counted}?" if strange else doubt
        return Guess(look.name, role, f"{counted} counter", doubt)
    if unit in _ENERGIES and look.constant:  # a counter that stands still
        return Guess(look.name, "")
    if unit in _ENERGIES or ("energy" in t and unit not in LOADS and "power" not in t):
        if unit in _ENERGIES:
            return Guess(look.name, role, f"{unit} per step")
        return Guess(look.name, role, f"{'kWh' if look.most < 50.0 else 'Wh'} per step", "energy without a unit")
    if not unit and look.binary:
        return Guess(look.name, "level", "0-1")
    if not unit and 30.0 < look.most <= 100.0 and not look.constant and "power" not in t:
        return Guess(look.name, "level", "%", "its values are between 0 and 100, its name is that of a load")
    if not unit and t & {"heating machine", "level"} and look.whole and look.least >= 0.0 and 95.0 < look.most <= 100.0:
        return Guess(look.name, "level", "%", "its values end at 100: a share of full power, or W?")
    below = look.least < -0.02 * max(look.most, 1.0) and not heat and "electric" not in t
    doubt = "it falls below 0" if below else ""
    return Guess(look.name, role, unit or ("W" if look.most > 60.0 else "kW"), doubt)


def _temperature(look: _Look, fahrenheit: bool) -> Guess:
    t = look.tags
    unit, celsius = look.celsius(fahrenheit)
    if look.binary or (look.constant and not 5.0 <= float(celsius[0]) <= 40.0):
        # On and off under the name of a room: what acts there has another name.
        return Guess(look.name, "level" if t & {"heating machine", "heat"} and not look.constant else "", "0-1")
    inside = _WEATHER_C[0] <= celsius.min() and celsius.max() <= 60.0
    median = float(np.median(celsius))
    if ("hot water" in t or (t & {"supply", "return", "water"} and "room" not in t)) and "outdoor" not in t:
        return Guess(look.name, "return water" if "return" in t else "", unit)
    if "outdoor" in t and inside and not ("room" in t and _room_first(look)):
        return Guess(look.name, "outdoor", unit)
    if not inside or median > 33.0:
        far = f"a median of {median:.0f} °C is not that of a room"
        return Guess(look.name, "zone", unit, far) if "room" in t and inside else Guess(look.name, "", unit)
    if _setpoint(look, fahrenheit) and look.distinct.size <= 6 and "room" not in t and not _full_temperature(look):
        return Guess(look.name, "setpoint", unit, "its values are those of a set-point, in half steps")
    if not _ROOM_C[0] <= median <= _ROOM_C[1]:
        return Guess(
            look.name, "zone" if "room" in t else "", unit, f"a median of {median:.0f} °C is not that of a room"
        )
    known = "room" in t or _full_temperature(look) or look.unit in ("°C", "°F", "K")
    if _setpoint(look, fahrenheit) and look.distinct.size <= 4 and not look.constant:
        return Guess(look.name, "zone", unit, "its few values in half steps may be those of a set-point")
    doubt = "" if known else "its name does not say a room"
    if known and "room" not in t and not place_of(look.name) and float(np.ptp(celsius)) > 15.0:
        doubt = "it spans more than a room does"
    return Guess(look.name, "zone", unit, doubt)


def _full_temperature(look: _Look) -> bool:
    return any("temp" in word or word in ("t", "znt", "ti", "degc", "degf") for word in words_of(look.name))


def _room_first(look: _Look) -> bool:
    """Whether a name with words of rooms and of outdoors is of a room: 'int', 'room' and the like come first."""
    words = words_of(look.name)
    if not _INDOORS.isdisjoint(words) and _OUTDOORS.isdisjoint(words):
        return True
    outdoors = [k for k, word in enumerate(words) if "outdoor" in tags(word)]
    rooms = [k for k, word in enumerate(words) if "room" in tags(word) and "outdoor" not in tags(word)]
    sure = {"outdoor", "outside", "outdoors", "aussen", "exterieur", "exterieure", "buiten", "ambient", "oa", "oat"}
    if any(word in sure or "aussen" in word or "buiten" in word for word in words):
        return False
    return bool(rooms) and (not outdoors or rooms[0] < outdoors[0])


def _by_day(look: _Look) -> bool:
    """Whether values rest at their least for a good part of the time, as those of the sun do."""
    if look.values.size < 24:
        return True
    span = max(look.most - look.least, 1e-9)
    lasts_s = np.append(np.diff(look.time_s), 0.0)
    return bool(np.average((look.values - look.least) < 0.03 * span, weights=np.maximum(lasts_s, 1e-9)) > 0.2)


def _by_values(look: _Look, fahrenheit: bool) -> Guess:
    """What a signal is whose name says nothing: a guess that is never sure."""
    doubt = "its name says nothing: guessed by its values"
    unit, celsius = look.celsius(fahrenheit)
    if look.constant or look.counts or look.binary:
        return Guess(look.name, "", "", "")
    if _setpoint(look, fahrenheit):
        return Guess(look.name, "setpoint", unit, doubt)
    smooth = np.abs(np.diff(celsius)).mean() < 0.1 * max(float(np.ptp(celsius)), 1e-9)
    if (
        smooth
        and 15.0 <= np.median(celsius) <= 27.0
        and np.ptp(celsius) < 12.0
        and celsius.min() > 5.0
        and look.least > 2.0
    ):
        return Guess(look.name, "zone", unit, doubt)
    return Guess(look.name, "")


def _outdoor_apart(found: list[Guess], looks: Mapping[str, _Look]) -> list[Guess]:
    """Doubt an outdoor temperature that goes with the rooms, and say which of several is the likelier one."""
    rooms = [guess for guess in found if guess.role == "zone"]
    outdoors = [guess for guess in found if guess.role == "outdoor"]

    def celsius(guess: Guess) -> tuple[Array, Array]:
        look = looks[guess.name]
        return look.time_s, converted(look.values, guess.unit or "°C")

    changed: dict[str, Guess] = {}
    medians = {guess.name: float(np.median(celsius(guess)[1])) for guess in outdoors}
    if not rooms and len(outdoors) > 1:  # Nest calls what it measures of the room ambient
        warmest = max(outdoors, key=lambda guess: medians[guess.name])
        next_C = max(medians[guess.name] for guess in outdoors if guess is not warmest)
        if _ROOM_C[0] <= medians[warmest.name] <= _ROOM_C[1] and medians[warmest.name] > next_C + _APART_K:
            why = "its name says outdoors, and it is as warm as a room"
            changed[warmest.name] = Guess(warmest.name, "zone", warmest.unit, why)
    for guess in outdoors:
        time_s, values = celsius(guess)
        if not rooms:
            continue
        of_rooms = [celsius(room) for room in rooms]
        warm = float(np.median(np.concatenate([v for _, v in of_rooms])))
        together = [_correlated(time_s, values, *room) for room in of_rooms]
        if max(together) > _TOGETHER and abs(float(np.median(values)) - warm) < 4.0 and len(outdoors) > 1:
            changed[guess.name] = Guess(
                guess.name, "zone", guess.unit, "its name says outdoors, and it goes with the rooms"
            )
        elif max(together) > 0.97 and abs(float(np.median(values)) - warm) < 3.0:
            changed[guess.name] = Guess(guess.name, "outdoor", guess.unit, "it goes with the rooms: is it outdoors?")
    found = [changed.get(guess.name, guess) for guess in found]
    if not any(guess.role == "outdoor" for guess in found):
        # What is colder and moves more than all others.
        free = [g for g in found if g.role == "zone" and not g.sure] + [
            Guess(look.name, "zone", look.celsius(False)[0]) for look in looks.values()
            if not look.text and (look.is_temperature or "temperature" in look.tags) and "other" not in look.tags
            and all(g.name != look.name or g.role == "" for g in found)
            and not look.tags & {"supply", "return", "water", "hot water", "setpoint"} and not look.binary
            and float(np.median(look.celsius(False)[1])) < 33.0
        ]  # fmt: skip
        if free:
            widest = max(free, key=lambda g: float(np.ptp(celsius(g)[1])))
            values = celsius(widest)[1]
            others = [celsius(g)[1] for g in found if g.role == "zone" and g.name != widest.name]
            warm = min((float(np.median(v)) for v in others), default=18.0)
            if float(np.median(values)) < warm - 3.0 and float(np.ptp(values)) > 3.0:
                new = Guess(
                    widest.name,
                    "outdoor",
                    widest.unit,
                    "guessed by its values: colder than the rooms, and it moves more",
                )
                found = [new if g.name == widest.name else g for g in found]
    return found


def _correlated(time_s: Array, values: Array, other_s: Array, others: Array) -> float:
    """Correlation of two temperatures, and of their changes over an hour: the less of both."""
    begin, end = max(time_s[0], other_s[0]), min(time_s[-1], other_s[-1])
    if end - begin < 12 * 3600.0:
        return 0.0
    at = np.arange(begin, end, 3600.0)
    a, b = np.interp(at, time_s, values), np.interp(at, other_s, others)
    if min(np.std(a), np.std(b), np.std(np.diff(a)), np.std(np.diff(b))) <= 0.0:
        return 0.0
    return float(min(np.corrcoef(a, b)[0, 1], np.corrcoef(np.diff(a), np.diff(b))[0, 1]))


def _rooms_once(found: Sequence[Guess], looks: Mapping[str, _Look]) -> list[Guess]:
    """Of rooms that have the same readings one alone is a zone: one that is sure and says where, else the first."""
    zones = [guess for guess in found if guess.role == "zone"]
    kept: list[Guess] = []
    again: dict[str, Guess] = {}
    for guess in sorted(zones, key=lambda g: (not g.sure, not g.place)):
        same = (one for one in kept if _the_same(looks[one.name], one.unit, looks[guess.name], guess.unit))
        if (first := next(same, None)) is None:
            kept.append(guess)
        else:
            again[guess.name] = replace(guess, role="", doubt=f"the same readings as {first.name}")
    return [again.get(guess.name, guess) for guess in found]


def _the_same(one: _Look, unit: str, other: _Look, others_unit: str) -> bool:
    """Whether two temperatures differ by their rounding alone, each reading held until the next one."""
    begin, end = (f(one.time_s[k], other.time_s[k]) for f, k in ((max, 0), (min, -1)))
    if one.constant or other.constant or end - begin < DAY_S:
        return False
    at = np.union1d(one.time_s, other.time_s)
    at = at[(at >= begin) & (at <= end)]
    first, second = (
        converted(look.values, told or "°C")[np.searchsorted(look.time_s, at, side="right") - 1]
        for look, told in ((one, unit), (other, others_unit))
    )
    return _alike(first[:-1], second[:-1], np.diff(at))


def _alike(one_C: Array, other_C: Array, lasts: Array | None = None) -> bool:
    """Whether temperatures (n,), °C, differ by their rounding alone nearly always: for so long `lasts` each (n,)."""
    return bool(np.average(np.abs(one_C - other_C) <= _ROUNDED_K, weights=lasts) >= _SAME_SHARE)


def _with_place(guess: Guess) -> Guess:
    return replace(guess, place=place_of(guess.name))


def rooms_beside(columns: Mapping[str, Array], rules: MeasurementMap) -> tuple[str, ...]:
    """What first readings of signals (n,) tell of rooms outside the map, in words, by names and size of readings."""
    named = {column for _, signal in rules.signals() for column in signal.columns}
    units: set[str] = {zone.temperature.unit for zone in rules.zones.values()}
    of_zones = [
        (columns[column], zone.temperature.unit)
        for zone in rules.zones.values() for column in zone.temperature.columns if column in columns
    ]  # fmt: skip
    called = _called([Column(name, np.empty(0), values) for name, values in columns.items()])
    rooms = [
        name
        for name, values in columns.items()
        if name not in named
        and {"room", "temperature"} & tags(called[name])
        and _temperature_alone(called[name])
        and _of_a_room(values, units)
        and not any(_again(values, known, unit) for known, unit in of_zones)
    ]
    return (_of_rooms(rooms, list(rules.zones)),) if rooms else ()


def _again(values: Array, known: Array, unit: str) -> bool:
    """Whether readings (n,) of one table differ from the known ones, in `unit`, by their rounding alone."""
    both = np.isfinite(values) & np.isfinite(known) if values.size == known.size else np.zeros(values.size, dtype=bool)
    if both.sum() < _LEAST or np.ptp(values[both]) == 0.0:
        return False
    return _alike(converted(values[both], unit), converted(known[both], unit))


def _temperature_alone(name: str) -> bool:
    beside = {
        "outdoor",
        "setpoint",
        "lower",
        "upper",
        "supply",
        "return",
        "water",
        "hot water",
        "valve",
        "power",
        "energy",
    }
    return not (beside | {"sun", "humidity", "price", "other", "pv", "gas"}) & tags(name)


def _of_a_room(values: Array, units: set[str]) -> bool:
    known = values[np.isfinite(values)]
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
