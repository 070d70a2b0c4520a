"""What a map says of its files: how they are written, how stamps are read, and where the names of signals stand."""

from __future__ import annotations

from datetime import date
from typing import Any, Literal
from zoneinfo import ZoneInfo

import pandas as pd
from pydantic import Field, field_validator, model_validator

from thermoforce_mpc.scenario.settings import StrictModel

# What counts from before this year counts days of a calendar, not time that has passed.
_FIRST_CLOCK = 1970


def each_column(given: str | tuple[str, ...] | None) -> tuple[str, ...]:
    """The columns that a key names: one, several or none."""
    return (given,) if isinstance(given, str) else given or ()


class TimeStampRules(StrictModel):
    """How time stamps are read."""

    column: str | tuple[str, ...] | None = Field(
        None,
        description="column of the time stamps; default: the first, or the table's index. [Date, Time] for a date "
        "and a "
        "time of day that stand in two columns",
    )
    format: str | None = Field(
        None,
        description="strptime format, such as %d.%m.%Y %H:%M; default: ISO 8601. Names of months in English, "
        "German, French, Dutch, Italian or Spanish are %b or %B; CET, CEST and the like are %z",
    )
    zone: str | None = Field(
        None,
        description="time zone of stamps without an offset, such as Europe/Brussels (with daylight saving), UTC or "
        "Etc/GMT-1 (an hour ahead of UTC all year); stamps with an offset are converted to it",
    )
    year: int | None = Field(
        None, ge=1990, le=2100, description="year of the first of stamps that have none, of the form 01/31 14:30"
    )
    unit: Literal["s", "ms", "us", "ns", "min", "h", "D"] | None = Field(
        None, description="unit of stamps that are numbers"
    )
    since: str | None = Field(None, description="what they count from, such as 2016-01-01 or 1970-01-01 in UTC")
    marks: Literal["start", "end"] = Field(
        "start", description="end of the interval for which powers, energies and levels hold that a stamp marks"
    )
    ambiguous: Literal["infer", "first", "second", "gap"] = Field(
        "infer",
        description="the hour that summer time's end repeats; infer: by the order of the rows; first or second: all "
        "its rows are the first (summer time) or second one; gap: leave them out",
    )
    nonexistent: Literal["refuse", "gap"] = Field(
        "refuse", description="rows in the hour that summer time's beginning skips: refuse, or leave them out"
    )
    order: Literal["refuse", "sort"] = Field("refuse", description="rows that are not in the order of time")
    duplicates: Literal["refuse", "first", "last"] = Field(
        "refuse", description="rows with the same time stamp: refuse, or keep the first or last one"
    )

    @field_validator("since", mode="before")
    @classmethod
    def _as_text(cls, value: Any) -> Any:
        return str(value) if isinstance(value, date) else value  # YAML reads dates

    @field_validator("zone")
    @classmethod
    def _known_zone(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                ZoneInfo(value)
            except (KeyError, ValueError, OSError) as error:
                raise ValueError("no such time zone; use a name such as Europe/Brussels, Etc/GMT-1 or UTC") from error
        return value

    @field_validator("format")
    @classmethod
    def _filled_in(cls, value: str | None) -> str | None:
        if value is not None and "%" not in value:
            raise ValueError(f"'{value}' has no %: write how a stamp looks, such as '%d.%m.%Y %H:%M'")
        return value

    @model_validator(mode="after")
    def _numbers_count_from(self) -> TimeStampRules:
        if (self.unit is None) != (self.since is None):
            raise ValueError("unit and since belong together: stamps that are numbers need both")
        if self.since is not None:
            self.counted_from()
        return self

    def lenient(self) -> TimeStampRules:
        """The clock of a table that a machine appends to: what a person would be asked is decided."""
        kept = self.duplicates if self.duplicates != "refuse" else "last"
        return self.model_copy(update={"order": "sort", "duplicates": kept, "nonexistent": "gap"})

    @property
    def of_calendar(self) -> bool:
        """Whether numbers are days of a calendar, as spreadsheets count them: the time that a clock shows."""
        return self.unit == "D" and self.since is not None and self.counted_from().year < _FIRST_CLOCK

    def counted_from(self) -> pd.Timestamp:
        """The instant `since`, in `zone` where it has no offset; of an hour that comes twice the first is meant.

        Raises `ValueError` for what is no date, or does not exist on that clock.
        """
        try:
            since = pd.Timestamp(str(self.since))
        except ValueError as error:
            raise ValueError(f"since is no date: {self.since}") from error
        if pd.isna(since):
            raise ValueError(f"since is no date: {self.since}")
        if since.tz is not None or self.zone is None or since.year < _FIRST_CLOCK:
            return since
        localised = since.tz_localize(self.zone, ambiguous=True, nonexistent="NaT")
        if not isinstance(localised, pd.Timestamp):  # NaT
            raise ValueError(f"since does not exist in {self.zone}, where summer time begins: {self.since}")
        return localised


class CsvFormat(StrictModel):
    """How CSV files are written."""

    separator: str | None = Field(None, description="between cells; default: of comma, semicolon, tab the commonest")
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    skip_lines: int = Field(0, ge=0, description="lines before the line of column names")
    missing: tuple[str, ...] = Field((), description="texts that stand for an empty cell besides NaN, n/a and the like")
    words: dict[str, float] = Field(
        {},
        description="numbers of words besides on and off, as of an operating mode: {dhw: 1, heating: 0}",
    )
    skip_after: int = Field(0, ge=0, description="lines between that of column names and the first row, as of units")
    comment: str | None = Field(
        "#", min_length=1, description="lines that begin with this are left out; null: none are"
    )
    sheet: str | None = Field(
        None,
        description="sheet of a workbook; default: the first. A file of prices is read from its longest, as is a "
        "forecast whose stamps stand in another column",
    )


class TableForm(StrictModel):
    """Where the names of signals stand: by default a column is a signal, named by its header."""

    point: str | tuple[str, ...] | None = Field(
        None,
        description="column that names the signal of a row, where each row is one reading; of several the names are "
        "joined by a space",
    )
    value: str | tuple[str, ...] | None = Field(
        None, description="column of the reading; of several the first that is not empty, as [mean, sum]"
    )
    by_file: Literal["point", "prefix", "folder"] | None = Field(
        None,
        description="point: each file is one signal, with the name that its line `history:` or else the file has; "
        "prefix: files have the same columns, and that name stands before theirs, as in 'bath temperature'; "
        "folder: that of its folder does, where files of several folders are called alike",
    )
    status: str | None = Field(None, description="column that says whether a reading is good")
    bad: tuple[str, ...] = Field(
        ("stale", "down", "fault", "null", "disabled", "bad", "invalid", "error", "offline", "unreliable"),
        description="words that stand there of those that are not",
    )

    @model_validator(mode="after")
    def _belong_together(self) -> TableForm:
        if self.point is not None and self.value is None:
            raise ValueError("point needs value: the column of the readings")
        if self.point is not None and self.by_file is not None:
            raise ValueError("give point (a column names the signal) or by_file (the file does), not both")
        if self.by_file == "point" and self.value is None:
            raise ValueError("by_file: point needs value: the column of the readings")
        return self

    @property
    def points(self) -> tuple[str, ...]:
        """The columns that name the signal of a row."""
        return each_column(self.point)

    @property
    def values(self) -> tuple[str, ...]:
        """The columns of the reading."""
        return each_column(self.value)


class Written(StrictModel):
    """How a file is written: its stamps, its cells, and where the names of signals stand."""

    time: TimeStampRules = TimeStampRules()
    csv: CsvFormat = CsvFormat()
    table: TableForm = TableForm()


class WrittenOtherwise(StrictModel):
    """Where files differ from what a map says of all; a key that is given holds in the place of the map's whole one."""

    time: TimeStampRules | None = Field(None, description="the zone is that of the map, where it names none")
    csv: CsvFormat | None = None
    table: TableForm | None = None

    def of(self, usual: Written) -> Written:
        """How these files are written, where others are as `usual`."""
        time = self.time or usual.time
        return Written(
            time=time.model_copy(update={"zone": time.zone or usual.time.zone}),
            csv=self.csv or usual.csv,
            table=self.table or usual.table,
        )
