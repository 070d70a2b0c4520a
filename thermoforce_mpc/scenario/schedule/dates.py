"""Dates of a simulated year: it has 365 days, and its number does not count."""

from __future__ import annotations

import datetime
import re

_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}")
_NO_LEAP_YEAR = 2001


def day_of_year(date: str) -> int:
    """Day from 0 of a date such as 2026-01-17; raises `ValueError` where a year of 365 days has none."""
    if not _DATE.fullmatch(date):
        raise ValueError(f"'{date}': expected a date such as 2026-01-17")
    _, month, day = map(int, date.split("-"))
    try:
        return datetime.date(_NO_LEAP_YEAR, month, day).timetuple().tm_yday - 1
    except ValueError as error:
        raise ValueError(f"{date} is no day of a year of 365 days") from error


def window_name(window: str) -> str:
    """The name of a window that was given by its first day as a date: that day of the year, from 0.

    Raises:
        ValueError: there is no such day.
    """
    return str(day_of_year(window)) if _DATE.fullmatch(window) else window
