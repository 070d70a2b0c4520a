"""A commented map to start from: what files are taken for, and what their signals probably are."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from zoneinfo import available_timezones

import numpy as np
import pandas as pd
import yaml

from thermoforce_mpc.data import Array
from thermoforce_mpc.data.prices import currency_of
from thermoforce_mpc.errors import DataError, suggestion
from thermoforce_mpc.measurements.map.guesses import Column, Guess, guesses
from thermoforce_mpc.measurements.map.habits import COMFORT_C, SETBACK_K, Habit, bounds_around, habit_of
from thermoforce_mpc.measurements.map.names import place_in_order, tags, unit_of, words_of
from thermoforce_mpc.measurements.tables.clock import all_year, instants, plain
from thermoforce_mpc.measurements.tables.files import (
    all_readings,
    found_files,
    head_of,
    named_after,
    named_before,
    stamps_of,
)
from thermoforce_mpc.measurements.tables.forms import CsvFormat, TableForm, TimeStampRules
from thermoforce_mpc.measurements.tables.raw_table import (
    MISSING,
    RawTable,
    as_numbers,
    bad_status,
    raw_table,
    unit_of_cells,
    with_offset,
)
from thermoforce_mpc.measurements.tables.recognition import (
    Recognised,
    recognised,
    told_beside,
    units_of_points,
    written_alike,
)
from thermoforce_mpc.measurements.units import converted

# Rows of a file that are looked at where its columns are signals, and readings of a signal where rows are readings.
_ROWS, _READINGS, _FEW = 20_000, 5_000, 20
_CHECK = "CHECK: "
# An hour that a clock shows twice has so many times the rows of the one before and after, at least.
_HOUR, _REPEATED = pd.Timedelta("1h"), 1.5
_HEAT_PAID = "heat, as no electric power is metered: so district heat is billed; of a boiler or heat pump set factor"
# Words amid numbers that a map says to be empty cells, at most; and what may be a number that is written otherwise.
_MOST_MISSING, _NUMBER = 6, re.compile(r"\d[.,' ]?\d|^\W*\d\W*$")
UTC = "UTC"
_ANEW = "write this map anew with --zone and the building's, such as --zone Europe/Brussels"
# Zones of time of people who write so.
_ZONES = {
    "de": "Europe/Berlin", "fr": "Europe/Paris", "nl": "Europe/Amsterdam", "en": "Europe/Brussels",
    "°F": "America/New_York",
}  # fmt: skip
_LANGUAGES = {
    "de": "zimmer|aussen|temperatur$|vorlauf|raum|ventil(?!at)|leistung|strahlung|feucht|datum|zeit|pumpe|kuche|"
    "buro|wohn",
    "fr": "exterieur|chambre|salon|puissance|vanne|consigne|cuisine|sejour|horodat|ensoleil|chauffage",
    "nl": "buiten|kamer|temperatuur|vermogen|klep|keuken|verbruik|tijd|straling|vocht|badkamer",
}
# Words of what a meter tells of an interval beside its mean, and of what is not billed.
_OF_INTERVALS = frozenset(("max", "min", "peak", "aprt", "apparent", "reactive", "react", "fund", "ret", "returned"))
_IN_FORCE = frozenset(("eff", "effective", "active"))
# Which of the counters of a meter with two tariffs, as 'Import T1 kWh' or 'electricity_delivered_2'.
_REGISTER = re.compile(r"(?i)(?<![a-z])(t|tari[ef]+|rate|delivered)[ _]?[12](?!\d)")
# Which phase of a meter, as 'Heat pump L1 (W)', 'phase_a_power' or '3EM c total (kWh)', and which there are of one. A
# letter alone is one of a name, such as 'Heater A', but in brackets at the end, and before what a meter has of each.
_PHASE = re.compile(
    r"(?i)(?<![a-z0-9])(?:(?:phase|ph|l)[ _]?([123abc])|([abc])(?=[ _](?:total|act)|[\])]$))(?![a-z0-9])"
)
_PHASES = ({"1", "2", "3"}, {"a", "b", "c"})
_PUT_LAST = re.compile(r"pump|pomp|fan|relay|switch|status|stat$|enable", re.I)


def starting_map(files: str | Path | Sequence[str | Path], zone: str | None = None) -> str:
    """The text of a map for files of one building, with what is not certain marked by CHECK.

    `zone`: the building's time zone, such as Europe/Brussels; None: as the files tell, or UTC where stamps are of it.

    Raises `DataError` where a file cannot be read, nothing in it looks like a temperature, or there is no such zone.
    """
    if zone is not None and zone not in (known := available_timezones()):
        of_city = [name for name in sorted(known) if name.endswith("/" + zone.replace(" ", "_").title())]
        meant = f", did you mean '{of_city[0]}'?" if of_city else suggestion(zone, known)
        raise DataError(f"zone: there is no time zone {zone!r}{meant}; names are as Europe/Brussels")
    paths = found_files([files] if isinstance(files, str | Path) else list(files))
    kinds = [recognised(of_kind) for of_kind in written_alike(paths)]
    read = [_columns(kind) for kind in kinds]
    for k, kind in enumerate(kinds):
        others = {column.name for j, other in enumerate(read) if j != k for column in other}
        if kind.table.point is None and kind.table.by_file is None and others & {column.name for column in read[k]}:
            # The same names in files of another kind are of other rooms.
            kinds[k] = replace(kind, table=kind.table.model_copy(update={"by_file": "prefix"}))
            read[k] = _columns(kinds[k])
    columns = list({column.name: column for of_kind in read for column in of_kind}.values())
    found = guesses(columns)
    used = {guess.name for guess in found if guess.role not in ("", "mode")}
    for k, kind in enumerate(kinds):
        words = dict.fromkeys(word for column in read[k] if column.name in used for word in column.words)
        kinds[k] = replace(kind, csv=kind.csv.model_copy(update={"missing": tuple(words)[:_MOST_MISSING]}))
    taken = kinds[0]
    if not any(guess.role in ("zone", "outdoor") for guess in found):
        names = ", ".join(column.name for column in columns[:20]) + (", …" if len(columns) > 20 else "")
        raise DataError(
            f"{paths[0]}: taken for {taken.words}; none of {names} looks like a temperature of a room or outdoors: "
            "write the map by hand"
        )
    return _Text(paths, kinds, columns, found, zone).written()


def doubt_of_zone(text: str) -> str:
    """What is not certain of the zone of a map that `starting_map` wrote, in a line for people; '' where nothing is."""
    told = re.search(rf"(?m)^  zone: (\S+)  # {_CHECK}(.*)$", text)
    return f"time.zone of the map is {told[1]}: {told[2]}" if told else ""


def _columns(taken: Recognised) -> list[Column]:
    """First readings of all signals of files."""
    if taken.table.point is not None:
        units: dict[str, str] = {}
        of_utc = taken.clock.unit is not None or _have_offsets(taken.paths[0], taken)
        clock = UTC if of_utc else taken.clock.zone or ""
        values = taken.table.values
        of_all = unit_of(values[0]) if len(values) == 1 else ""  # as 'USAGE (kWh)'
        for path in taken.paths:
            units |= units_of_points(head_of(path, _ROWS, taken.csv), taken.table, taken.csv.decimal)
        return [
            Column(
                name,
                at[:: -(-at.size // _READINGS)],
                values[:: -(-at.size // _READINGS)],
                sum(words.values()) > np.isfinite(values).sum(),
                unit_of(f"({units.get(name, '')})") or of_all,
                words=tuple(word for word in words if word and not _NUMBER.search(word)),
                clock=clock,
            )
            for name, (at, values, words) in all_readings(taken.paths, taken.clock, taken.csv, taken.table).items()
            if at.size
        ]
    found: dict[str, Column] = {}
    for path in taken.paths:
        head = head_of(path, _ROWS, taken.csv)
        units, divisors = told_beside(path, taken.csv)
        table = raw_table(head, taken.clock.column, [], str(path))
        time_s = _seconds(table, taken.clock)
        bad = bad_status(head, taken.table)
        stamps = taken.clock.column or str(head.columns[0])
        beside = {stamps} if isinstance(stamps, str) else set(stamps)
        for name in map(str, head.columns):
            if name in beside or name == taken.table.status or not name:
                continue
            numbers = as_numbers(head[name], taken.csv.decimal).to_numpy(dtype=np.float64)
            filled = head[name].notna().to_numpy()
            words = bool(filled.any() and np.isfinite(numbers[filled]).mean() < 0.5)
            cells = head[name][filled & np.isnan(numbers)].astype(str).str.strip().unique()[:_MOST_MISSING]
            texts = tuple(cell for cell in cells if cell.lower() not in MISSING and not _NUMBER.search(cell))
            numbers = np.where(bad[: numbers.size], np.nan, numbers)
            key = _key(name, path, taken)
            if key is not None and key not in found:
                below = next((u for u in (unit_of(f"({units.get(name, '').strip('()[]')})"),) if u), "")
                unit = unit_of_cells(head[name], taken.csv.decimal) or unit_of(name) or below
                by = 1.0 / divisors.get(name, 1.0)
                found[key] = Column(key, time_s, numbers * by, words, unit, by, texts, UTC if taken.clock.zone else "")
    return list(found.values())


def _key(column: str, path: Path, taken: Recognised) -> str | None:
    if name := named_before(path, taken.csv, taken.table):
        return f"{name} {column}"
    if taken.table.by_file == "point":
        return named_after(path, taken.csv) if column in taken.table.values else None
    return column


def _seconds(table: RawTable, clock: TimeStampRules) -> np.ndarray:
    try:
        at = instants(table, clock.model_copy(update={"ambiguous": "first", "nonexistent": "gap"}), []).sort_index()
    except DataError:  # a form that is still to be filled in
        return np.arange(len(table.stamps)) * 900.0
    at = at if at.dt.tz is None else at.dt.tz_convert("UTC").dt.tz_localize(None)
    seconds = np.asarray((at - pd.Timestamp(0)).dt.total_seconds(), dtype=np.float64)
    return seconds if seconds.size == len(table.stamps) else np.arange(len(table.stamps)) * 900.0


def _have_offsets(path: Path, kind: Recognised) -> bool:
    """Whether the stamps of a file say themselves how far they are from UTC."""
    stamps = raw_table(head_of(path, _FEW, kind.csv), kind.clock.column, [], str(path)).stamps
    if pd.api.types.is_datetime64_any_dtype(stamps):
        return getattr(stamps.dtype, "tz", None) is not None
    return bool(with_offset(plain(stamps.dropna().astype(str), kind.clock.format)).all())


def _follows_summer_time(path: Path, clock: TimeStampRules, form: CsvFormat, zone: str) -> bool | None:
    """Whether stamps leave out and repeat the hours that a clock of `zone` does; None where they do not tell."""
    try:
        times = instants(stamps_of(path, clock.column, form), clock, [])
    except DataError:
        return None
    if times.dt.tz is not None:
        return None
    at = pd.DatetimeIndex(times)
    hours = pd.date_range(at.min().floor("D"), at.max(), freq="1h")
    known = hours.tz_localize(zone, ambiguous="NaT", nonexistent="shift_forward")
    exists = hours.tz_localize(zone, ambiguous=np.ones(len(hours), dtype=bool), nonexistent="NaT")
    skipped = hours[exists.isna()]
    for hour in skipped.union(hours[known.isna()]):
        before, within, after = (
            int(((at >= start) & (at < start + _HOUR)).sum()) for start in (hour - _HOUR, hour, hour + _HOUR)
        )
        if not before or not after:
            continue
        if hour in skipped:
            return within == 0
        if within == before == after:
            return False
        if within > _REPEATED * max(before, after):
            return True
    return None


class _Text:
    """The lines of a map."""

    def __init__(
        self, paths: Sequence[Path], kinds: Sequence[Recognised], columns: Sequence[Column], found: Sequence[Guess],
        home: str | None,
    ) -> None:  # fmt: skip
        self.paths, self.taken, self.others, self.found = paths, kinds[0], kinds[1:], list(found)
        self.home = home
        self.column = {column.name: column for column in columns}
        self.used: set[str] = set()
        self.clocks = {path: self._told_by(kind, path) for kind in kinds for path in kind.paths}
        self.zone, self.why_zone = self._zone()
        modes = self.of("mode")
        self.mode = modes[0] if len(modes) == 1 else None

    def of(self, *roles: str) -> list[Guess]:
        """Guesses of these roles, the sure ones first."""
        return sorted((g for g in self.found if g.role in roles), key=lambda g: (roles.index(g.role), not g.sure))

    def written(self) -> str:
        names = ", ".join(path.name for path in self.paths[:4]) + (" …" if len(self.paths) > 4 else "")
        quoted = " ".join(f"'{p.name}'" if " " in p.name else p.name for p in self.paths)
        words = "; ".join(dict.fromkeys(kind.words for kind in (self.taken, *self.others)))
        signals = f", {len(self.found)} signals" if len(self.found) > 1 else ""
        lines = [
            f"# Map of {names}, taken for: {words}{signals}. Guessed from names and values: check every line,",
            f"# above all those with {_CHECK.strip(': ')}, then",
            f"#   tf-mpc data check {quoted} --map map.yaml",
            *self._time(),
            *self._files(),
            *self._written_otherwise(),
            "# site: {latitude: 50.8, longitude: 4.4}  # for an estimate of the sun",
            *self._weather(),
            *self._zones(),
            *self._acting(),
        ]
        spare = [
            guess.name + (f" ({guess.doubt})" if guess.doubt and not guess.role else "")
            for guess in self.found
            if guess.name not in self.used
        ]
        if spare:
            lines.append(f"# not used: {', '.join(spare)}")
        return "\n".join(lines) + "\n"

    def _time(self) -> list[str]:
        clock, note = self.taken.clock, self.taken.notes["time"]
        lines = ["time:"]
        if clock.column is not None:
            told = (
                _quoted(clock.column) if isinstance(clock.column, str) else f"[{', '.join(map(_quoted, clock.column))}]"
            )
            lines.append(f"  column: {told}")
        if clock.unit is not None:
            lines += [f"  unit: {clock.unit}  # stamps are numbers", f"  since: '{clock.since}'"]
        elif note.startswith("? stamps are numbers"):
            lines += ["  unit: s  # stamps are numbers", "  since: FILL IN  # what they count from, such as 2016-01-01"]
        if clock.year is not None:
            lines.append(f"  year: {clock.year}  # {_CHECK}{note}")
        lines.append(f"  zone: {self.zone}  # {self.why_zone}")
        if note.startswith("? stamps such"):
            lines.append(f"  format: FILL IN  # of {note[2:]}")
        elif clock.format is not None:
            lines.append(f"  format: '{clock.format}'" + (f"  # {_CHECK}{note}" if note else ""))
        if clock.marks == "end":
            note = f"{_CHECK}days end at 24:00: a row's powers, energies and levels hold until its stamp"
            lines.append(f"  marks: end  # {note} (start: from it on)")
        else:
            lines.append("  marks: start  # a row's powers, energies and levels hold from its stamp on (end: until it)")
        return lines

    def _zone(self) -> tuple[str, str]:
        """The zone of the map, whose hours are those of comfort and prices, and what is said of it."""
        if self.home is not None:
            return self.home, "the building's, of hours of comfort and prices"
        others = [kind for kind in (self.taken, *self.others) if kind.clock.zone != UTC]
        if not others:
            if (guessed := self._of_names()) is not None:
                return (
                    guessed,
                    f"{_CHECK}the building's? The stamps are in UTC, names and units are of there; else {_ANEW}",
                )
            return UTC, f"{_CHECK}the stamps are in UTC, and so are all hours here, comfort's too: {_ANEW}"
        zone, paths = others[0].clock.zone, others[0].paths
        if zone is not None:
            return zone, "of the stamps; name the building's all the same, such as Europe/Brussels"
        usual = self._of_wall_clocks(), "the building's; Etc/GMT-1 for a clock without summer time"
        zone, why = next((one for path in paths if (one := self.clocks[path]) is not None), usual)
        return zone, f"{_CHECK}{why}"

    def _told_by(self, kind: Recognised, path: Path) -> tuple[str, str] | None:
        """The zone of a file whose header, or change of summer time, tells it where its stamps do not, and a note."""
        zone, clock = self._of_wall_clocks(), kind.clock
        if clock.unit is not None or kind.notes["time"].startswith("?"):
            return None
        if clock.zone is not None:  # by their offsets, or by what stands above them
            return None if _have_offsets(path, kind) else (clock.zone, "")
        follows = _follows_summer_time(path, clock, kind.csv, zone)
        if follows is None:
            return None
        if follows:
            return zone, "the building's, whose summer time the stamps follow"
        return (
            all_year(zone, pd.Timestamp("2025-01-01")),
            f"the stamps know no summer time; {zone} where a row is wrong",
        )

    def _of_wall_clocks(self) -> str:
        """The zone of stamps without one."""
        return self.home or self._of_names() or _ZONES["en"]

    def _of_names(self) -> str | None:
        """The zone of those who write names and units so; None where these tell none."""
        words = [word for guess in self.found for word in words_of(guess.name)]
        counts = {code: sum(bool(re.search(told, word)) for word in words) for code, told in _LANGUAGES.items()}
        best = max(counts, key=lambda code: counts[code])
        if counts[best] > 0:
            return _ZONES[best]
        return _ZONES["°F"] if any(guess.unit == "°F" for guess in self.found) else None

    def _written_otherwise(self) -> list[str]:
        """Lines of the files that are not written as the first one is, or by another clock."""
        lines = []
        for kind in (self.taken, *self.others):
            for path in kind.paths:
                own = self.clocks[path]
                other_zone = own is not None and own[0] != self.zone
                if kind is not self.taken or other_zone:
                    lines.append(self._otherwise(kind, path, own if other_zone else None))
        return ["files:  # those that are written otherwise than the lines above say", *lines] if lines else []

    def _otherwise(self, kind: Recognised, path: Path, other_zone: tuple[str, str] | None) -> str:
        """The line of one such file; `other_zone`: its own, and why, where its stamps tell it."""
        clock, note = kind.clock, kind.notes["time"]
        told = [f"column: {_value(clock.column)}"] if clock.column is not None else []
        told += [
            f"{key}: {_value(getattr(clock, key))}"
            for key in ("unit", "since", "year", "zone", "marks")
            if getattr(clock, key) not in (None, "start") and not (key == "zone" and other_zone is not None)
        ]
        why = ""
        if other_zone is not None:
            told.append(f"zone: {other_zone[0]}")
            why = other_zone[1]
        elif clock.zone is None and (zone := self._of_wall_clocks()) != self.zone:
            told.append(f"zone: {zone}")
            why = "the zone"
        if note.startswith("?"):
            told.append("format: FILL IN" if "stamps such" in note else "since: FILL IN")
        elif clock.format is not None:
            told.append(f"format: '{clock.format}'")
        form = f"csv: {{{', '.join(_told(kind.csv))}}}, " if kind.csv != self.taken.csv else ""
        table = f", table: {{{', '.join(_told(kind.table))}}}" if kind.table != self.taken.table else ""
        doubt = "; ".join(part for part in (why, note.removeprefix("? ")) if part)
        return f"  {_quoted(path.name)}: {{{form}time: {{{', '.join(told)}}}{table}}}{_comment(doubt)}"

    def _files(self) -> list[str]:
        form, table, lines = self.taken.csv, self.taken.table, []
        other = _told(form)
        if self.mode is not None:
            words = self.column[self.mode.name].words
            numbers = [f"{_quoted(word)}: {int('hot water' in tags(word))}" for word in words]
            other.append(f"words: {{{', '.join(numbers)}}}")
        if other:
            note = self.taken.notes["csv"][2:] or ("words for an empty cell?" if form.missing else "")
            lines.append(f"csv: {{{', '.join(other)}}}{_comment(note)}")
        if numbered := self.taken.notes["names"]:
            lines.append(f"# {_CHECK}{numbered}")
        if sheets := "; ".join(kind.notes["sheets"] for kind in (self.taken, *self.others) if kind.notes["sheets"]):
            lines.append(f"# {_CHECK}{sheets}")
        if told := _told(table):
            lines.append(f"table: {{{', '.join(told)}}}")
        return lines

    def _signal(self, guess: Guess, *more: str) -> str:
        columns = self._registers(guess)
        self.used.update(columns)
        unit = [f"unit: '{guess.unit}'"] if guess.unit and guess.unit != "0-1" else []
        factor = self._factor(guess) * self.column[guess.name].by
        by = [f"factor: {factor:.4g}"] if abs(factor - 1.0) > 1e-9 and not more else []
        column = _quoted(guess.name) if len(columns) == 1 else _value(columns)
        told = ", ".join([f"column: {column}", *unit, *by, *more])
        return f"{{{told}}}"

    def _registers(self, guess: Guess) -> tuple[str, ...]:
        """The columns of a signal: of a meter with a counter for each tariff, or of three phases, all of them."""
        if phases := self._phases(guess):
            return phases

        def of(name: str) -> str:
            return _REGISTER.sub(r"\1", name)

        if not guess.unit.endswith("counter") or of(guess.name) == guess.name:
            return (guess.name,)
        return tuple(g.name for g in self.found if (of(g.name), g.unit) == (of(guess.name), guess.unit))

    def _phases(self, guess: Guess) -> tuple[str, ...]:
        """The columns of the three phases of which a power is one; none where rooms have such names."""
        of_rooms = sum(_PHASE.search(one.name) is not None for one in self.found if one.role == "zone") > 1
        if guess.role != "power" or of_rooms or (told := _PHASE.search(guess.name)) is None:
            return ()
        of = _PHASE.sub("", guess.name, count=1)
        alike = {g.name: _PHASE.search(g.name) for g in self.found if (g.role, g.unit) == (guess.role, guess.unit)}
        alike = {name: one for name, one in alike.items() if one and _PHASE.sub("", name, count=1) == of}
        which = {(one[1] or one[2]).lower() for one in alike.values() if one}
        return tuple(alike) if told and which in _PHASES and len(alike) == len(which) else ()

    def _has_total(self, guess: Guess) -> bool:
        """Whether a power is one of three phases, and another column is what all of them take, by the words of both."""
        phases, of = self._phases(guess), set(words_of(_PHASE.sub("", guess.name, count=1)))
        return bool(phases) and any(
            of <= set(words_of(one.name)) for one in self.found if one.role == guess.role and one.name not in phases
        )

    def _weather(self) -> list[str]:
        lines = []
        outdoor = self.of("outdoor")
        if outdoor:
            others = [g.name for g in outdoor[1:]]
            note = outdoor[0].doubt or (f"or {', '.join(others)}" if others else "")
            lines.append(f"outdoor: {self._signal(outdoor[0])}{_comment(note)}")
        else:
            lines.append(f"outdoor: FILL IN  # {_CHECK}no column looks like the outdoor temperature")
        sun = self.of("sun")
        if sun:
            others = [g.name for g in sun[1:]]
            lines.append(
                f"sun: {self._signal(sun[0])}{_comment(sun[0].doubt or ('or ' + ', '.join(others) if others else ''))}"
            )
        elif humidity := self.of("humidity of outdoors"):
            lines.append(f"# sun: {{estimate: humidity, humidity: {_quoted(humidity[0].name)}}}  # needs site")
        else:
            lines.append("# sun: {estimate: clear_sky}  # needs site")
        return lines

    def _zones(self) -> list[str]:
        lines = ["zones:"]
        self.zones: dict[str, Guess] = {}
        for guess in (g for g in self.found if g.role == "zone"):
            name = _name(guess.name)
            while name in self.zones:
                name += "_"
            self.zones[name] = guess
        by_hour = self._comfort_by_hour()
        for k, (name, guess) in enumerate(self.zones.items()):
            lines += [f"  {_value(name)}:", f"    temperature: {self._signal(guess)}{_comment(guess.doubt)}"]
            if not by_hour:
                lines += self._comfort(name, guess, "" if k else "  # comfort bound, °C or a column")
            if (contact := self._only_one("window", name)) is not None:
                lines.append(f"    window: {self._signal(contact)}  # open: nothing is learned, and heat pauses")
        if not self.zones:
            lines += ["  room:", f"    temperature: FILL IN  # {_CHECK}no column looks like the temperature of a room"]
        return lines + by_hour

    def _comfort_by_hour(self) -> list[str]:
        """Bounds of all zones by the hour of the day, where people set one lower in some hours; else nothing."""
        habits: dict[str, Habit | None] = {}
        for name, zone in self.zones.items():
            if any(self._bound(key, name, zone) for key in ("lower", "upper")):
                return []
            asked = self._only_one("setpoint", name)
            habits[name] = None if asked is None else habit_of(self.column[asked.name], asked.unit, self.zone)
        if not any(habits.values()):
            return []
        clock = "UTC, not of the building's clock" if self.home is None and self.zone == UTC else "time.zone"
        note = f"{_CHECK}°C, from what is usually set in these hours of {clock}; as 'weekdays 6-22 …, else …' too"
        lines = [f"comfort:  # {note}", "  schedule:"]
        for name, habit in habits.items():
            if habit is not None:
                cool_C = self._cooled_from_C(name)
                by_day, by_night = (bounds_around(one, cool_C) for one in (habit.high_C, habit.low_C))
                spans = [f"{days}{begin}-{end} {by_day[0]:g}-{by_day[1]:g}" for days, begin, end in habit.spans]
                lines.append(f"    {_value(name)}: {', '.join(spans)}, else {by_night[0]:g}-{by_day[1]:g}")
            else:
                low, high = self._usual_bounds(name)[:2]
                lines.append(f"    {_value(name)}: else {low:g}-{high:g}")
        return lines

    def _bound(self, key: str, name: str, zone: Guess) -> Guess | None:
        """The column that is a comfort bound of a zone."""
        sure = [g for g in self.of(key) if g.sure]
        bound = sure if len(self.zones) == 1 else self._there([g for g in sure if g.place & zone.place], name)
        return bound[0] if bound else None

    def _usual_bounds(self, name: str) -> tuple[float, float, Array | None]:
        """Numbers below and above what is usually set in a zone, °C, and 10 and 90 % of what is set there, if known."""
        if (asked := self._only_one("setpoint", name)) is None:
            return *COMFORT_C, None
        low_set, usual, high_set = _over_time(self.column[asked.name], asked.unit, (0.1, 0.5, 0.9))
        return *bounds_around(usual, self._cooled_from_C(name)), np.array([low_set, high_set])

    def _cooled_from_C(self, name: str) -> float | None:
        """The usual set-point of a zone's cooling, °C; None without one."""
        cooling = self._only_one("cooling setpoint", name)
        return None if cooling is None else _over_time(self.column[cooling.name], cooling.unit, (0.5,))[0]

    def _comfort(self, name: str, zone: Guess, note: str) -> list[str]:
        """Both bounds of a zone: columns that say so, else numbers below and above what people usually set there."""
        low, high, asked_C = self._usual_bounds(name)
        by_hour = ""
        if asked_C is not None:
            note = f"  # {_CHECK}from what is usually set"
            if np.ptp(asked_C) >= SETBACK_K:
                by_hour = f", {asked_C[0]:.3g} to {asked_C[1]:.3g} °C: bounds by the hour are the key comfort"
        lines = []
        for key, number in (("lower", low), ("upper", high)):
            bound = self._bound(key, name, zone)
            told = self._signal(bound) if bound else f"{number:g}"
            said = note + (by_hour if key == "lower" else "")
            lines.append(f"    {key}: {told}{said if not bound or 'usually' not in note else ''}")
        return lines

    def _acting(self) -> list[str]:
        acting = self._actuators()
        machines = self._machines(acting)
        lines: list[str] = []
        if acting:
            lines.append("actuators:")
            for name, (zone, guess, power) in acting.items():
                lines.append(f"  {_value(name)}:")
                if len(self.zones) > 1:
                    shared = "" if self._match(guess or power, zone) else f"  # {_CHECK}the zone that it serves"
                    lines.append(f"    zone: {_value(zone)}{shared}")
                if len(machines) > 1:
                    lines.append(f"    machine: {_value(self._machine_of(zone, machines))}")
                lines.append(f"    mode: {self._mode(guess)}  # heating, cooling or both")
                if guess is None:
                    lines.append("    # level: {column: ..., unit: '%'}  # without it, power over its 99th percentile")
                else:
                    key = "heat" if guess.role == "heat" else "level"
                    lines.append(f"    {key}: {self._signal(guess)}{_comment(guess.doubt)}")
                asked = self._only_one("setpoint", zone) if self._mode(guess) == "heating" else None
                if asked is not None and asked.unit in ("", "°C", "°F"):
                    lines.append(self._command(asked))
        else:
            lines.append("# actuators: {heater: {level: {column: ..., unit: '%'}}}  # nothing looks like what acts")
        price = self.of("price")
        cost = self._signal(price[0]) if price else "0.30"
        lines.append("machines:")
        for name, power in machines.items():
            lines.append(f"  {_value(name)}:")
            if power is not None:
                lines.append(
                    f"    power: {self._signal(power)}{_comment(power.doubt) or '  # electric power that is paid for'}"
                )
            elif (heat := self._heat_paid_for(acting)) is not None:
                lines.append(f"    power: {self._signal(heat)}{_comment(_HEAT_PAID)}")
            else:
                lines.append(
                    "    # power: {column: ..., unit: W}  # without it nothing can be planned; without a meter take"
                )
                lines.append("    #   the column of the level, with factor: the W of a reading of 1")
            if len(machines) == 1 and self.mode is not None:
                lines.append(f"    hot_water: {self._signal(self.mode)}  # while it heats water for taps (csv.words)")
            lines.append(f"    price: {cost}  # per kWh, a number or a column")
        if price and (currency := currency_of(price[0].name)):
            lines.append(f"currency: {currency}")
        return lines

    def _only_one(self, role: str, zone: str) -> Guess | None:
        """The one sure guess of a role at a zone, of several the one in force; None without one."""
        alone = len(self.zones) == 1

        def of_it(guess: Guess) -> bool:
            return self._match(guess, zone) or (alone and not (guess.place and self.zones[zone].place))

        ours = self._there([g for g in self.of(role) if g.sure and of_it(g)], zone)
        if len(ours) > 1:  # of a building automation's, the one in force
            ours = [g for g in ours if not _IN_FORCE.isdisjoint(words_of(g.name))]
        return ours[0] if len(ours) == 1 else None

    def _command(self, asked: Guess) -> str:
        """The line of what people set; commented where the record has it at one value, which teaches nothing."""
        unit = ", unit: °F" if asked.unit == "°F" else ""
        line = f"command: {{kind: setpoint, column: {_quoted(asked.name)}{unit}}}"
        self.used.add(asked.name)
        if self._still(asked):
            return f"    # {line}  # set it to other values at times: from one nothing is learned"
        return f"    {line}  # what people set; without it plans are levels"

    def _heat_paid_for(self, acting: Mapping[str, tuple[str, Guess | None, Guess | None]]) -> Guess | None:
        """The heat meter that tells what is paid for where no power is metered; None without one, or of several."""
        metered = [guess for _, guess, _ in acting.values() if guess is not None and guess.role == "heat"]
        metered = metered or self.of("heat")
        return metered[0] if len(metered) == 1 else None

    def _factor(self, guess: Guess) -> float:
        """What the readings of a level are multiplied by: its seconds or turns over the most of them."""
        most = float(np.nanmax(self.column[guess.name].values))
        over = guess.factor == 1.0 and guess.role == "level" and guess.unit == "%" and most > 100.5
        return 100.0 / most if over else guess.factor

    def _actuators(self) -> dict[str, tuple[str, Guess | None, Guess | None]]:
        """Actuators by name: the zone, what tells its level (None: the power of its machine), and that power."""
        levels = [g for g in self.of("level") if not self._still(g)]
        heats = self.of("heat")
        zones = list(self.zones)
        found: dict[str, tuple[str, Guess | None, Guess | None]] = {}
        if not zones:
            return found
        for candidates in (levels, heats):
            for zone in zones:
                if any(zone == taken for taken, _, _ in found.values()):
                    continue
                ours = self._there([g for g in candidates if self._match(g, zone) and len(zones) > 1], zone)
                if ours:
                    best = max(ours, key=lambda g: (self._worth(g), len(g.place & self.zones[zone].place), g.sure))
                    found[self._unique(_name(best.name), found)] = (zone, best, None)
            alone = [zone for zone in zones if not any(zone == taken for taken, _, _ in found.values())]
            of_no_zone = [
                g for g in candidates
                if "valve" in tags(g.name) and not any(g == one or self._match(g, z) for z, one, _ in found.values())
            ]  # fmt: skip
            if len(alone) == len(of_no_zone) == 1 and found:
                found[self._unique(_name(of_no_zone[0].name), found)] = (alone[0], of_no_zone[0], None)
        if found:
            return found
        powers = self.of("power")
        near = {z: self._there([p for p in powers if self._match(p, z)], z) for z in zones if len(zones) > 1}
        each = {z: ours[-1] for z, ours in near.items() if ours}
        if len(each) > 1 and len({power.name for power in each.values()}) == len(each):
            return {self._unique(f"{zone}_heater", found): (zone, None, power) for zone, power in each.items()}
        best_of = sorted([*levels, *heats], key=lambda g: -self._worth(g))
        if best_of:
            return {_name(best_of[0].name): (zones[0], best_of[0], None)}
        if powers:
            return {"heater": (zones[0], None, None)}
        return {}

    def _unique(self, name: str, taken: dict[str, tuple[str, Guess | None, Guess | None]]) -> str:
        while name in taken:
            name += "_"
        return name

    def _still(self, guess: Guess) -> bool:
        values = self.column[guess.name].values
        known = values[np.isfinite(values)]
        return bool(not known.size or np.ptp(known) == 0.0)

    def _worth(self, guess: Guess) -> float:
        """How much a signal tells of what acts: a valve or a machine more than a pump."""
        t = tags(guess.name)
        last = bool(_PUT_LAST.search(guess.name))
        machine = bool(re.search(r"(?i)compress|verdicht|modul|heiz|heat|burner|brenn|chauff|wp|hp", guess.name))
        return (
            3.0 * ("valve" in t)
            + 2.0 * machine
            + 1.0 * guess.sure
            - 1.5 * last
            - 2.0 * ("cooling" in t)
            - 1.0 * ("other" in t)
        )

    def _match(self, guess: Guess | None, zone: str) -> bool:
        if guess is None or zone not in self.zones:
            return False
        place = self.zones[zone].place
        # What all rooms are called says of none what is there.
        shared = frozenset.intersection(*(one.place for one in self.zones.values()))
        return bool(guess.place & (place - shared or place))

    def _there(self, guesses: Sequence[Guess], zone: str) -> Sequence[Guess]:
        """Those of `guesses` whose place is that of the zone to the word and in its order; all where none is."""
        words = place_in_order(self.zones[zone].name)
        return [g for g in guesses if place_in_order(g.name) == words] or guesses

    def _machines(self, acting: dict[str, tuple[str, Guess | None, Guess | None]]) -> dict[str, Guess | None]:
        each = {f"{zone}_meter": power for zone, _, power in acting.values() if power is not None}
        if each:
            return dict(each)

        def worth(guess: Guess) -> tuple[float, ...]:
            t = tags(guess.name)
            return (
                _OF_INTERVALS.isdisjoint(words_of(guess.name)),
                "heating machine" in t,
                not self._has_total(guess),
                not any(self._match(guess, zone) for zone in self.zones),
                guess.sure,
                not guess.unit.endswith("counter"),
                "electric" in t,
            )

        powers = sorted(self.of("power"), key=worth, reverse=True)
        return {"machine": powers[0] if powers else None}

    def _machine_of(self, zone: str, machines: dict[str, Guess | None]) -> str:
        return f"{zone}_meter" if f"{zone}_meter" in machines else next(iter(machines))

    def _mode(self, guess: Guess | None) -> str:
        if guess is None:
            return "heating"
        least = float(np.nanmin(self.column[guess.name].values))
        if guess.role == "level" and least < -0.05:
            return "both"
        t = tags(guess.name)
        warms = bool(re.search(r"(?i)heat|htg|heiz|hw|warm|chauff|radiat|boiler|burner|verwarm", guess.name))
        return "cooling" if "cooling" in t and not warms else "heating"


def _told(form: CsvFormat | TableForm) -> list[str]:
    """Keys and values of a form that are not the usual ones."""
    usual = type(form)()
    keys = [key for key in type(form).model_fields if key != "bad"]
    return [f"{key}: {_value(getattr(form, key))}" for key in keys if getattr(form, key) != getattr(usual, key)]


def _over_time(column: Column, unit: str, shares: Sequence[float]) -> list[float]:
    """Quantiles of a set-point over time, °C, each reading for as long as it holds: it is often stored on change."""
    known = np.isfinite(column.values)
    celsius, time_s = converted(column.values[known], unit or "°C"), column.time_s[known]
    lasts_s = np.diff(time_s, append=time_s[-1:] + 1.0)
    order = np.argsort(celsius, kind="stable")
    until = np.cumsum(lasts_s[order])
    return [float(celsius[order][np.searchsorted(until, share * until[-1])]) for share in shares]


def _comment(doubt: str) -> str:
    return f"  # {_CHECK}{doubt}" if doubt else ""


def _quoted(column: str) -> str:
    plain = re.fullmatch(r"[A-Za-z_][\w .]*", column) and not column.endswith(" ") and yaml.safe_load(column) == column
    return column if plain else "'" + column.replace("'", "''") + "'"


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_quoted(str(one)) for one in value)}]"
    if value is None:
        return "null"
    return _quoted(value) if isinstance(value, str) else str(value)


def _name(column: str) -> str:
    plain = re.sub(r"^(sensor|binary_sensor|climate|number|switch|input_number|valve)\.", "", column)
    labelled = re.search(r"LBL: ?([^\])]*)", plain)
    of_object = re.match(r"([^:]+):[^:]*\[.*?\]\(\w+\)$", plain)  # as EnergyPlus writes it
    plain = of_object[1] if of_object else plain
    plain = labelled[1] if labelled else re.sub(r"[\[(].*?[\])]", "", plain).strip()
    shorter = re.sub(r"[_ ]?(deg_?c|°c|temp[a-z]*|ist|ist-?wert)$", "", plain, flags=re.I)
    name = re.sub(r"\W+", "_", shorter or plain).strip("_").lower()
    return name or "zone"
