"""Dates below the courses of a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from thermoforce_mpc.data import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Days of a building that is simulated have no year, and no 29 February.
_NO_YEAR = pd.Timestamp("2001-01-01")
# Labels of years, months, days, hours, minutes, seconds; other ones stand where the next larger of these begins.
_LABELS = ["%Y", "%b", "%d %b", "%H:%M", "%H:%M", "%S"]


def on_dates(time_s: Array, origin: pd.Timestamp | None) -> Any:
    """Instants (n,) for an axis of dates, of times (n,), s since 1 January: on the clock of `origin` without summer
    time, of no certain year where there is no `origin`."""
    begins = _NO_YEAR if origin is None else origin.tz_localize(None)
    return (begins + pd.to_timedelta(time_s, unit="s")).to_numpy()


def date_ticks(axes: Axes, *, years: bool = True) -> None:
    """Days, or hours of them, below `axes` on which times are drawn; where these are seconds, nothing."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    if not axes.xaxis.have_units():
        return
    dates = AutoDateLocator(minticks=3, maxticks=8)
    begins = ["", "%b %Y" if years else "%b", "%d %b", "%d %b", "%H:%M", "%H:%M"]
    axes.xaxis.set_major_locator(dates)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(dates, formats=_LABELS, zero_formats=begins, show_offset=False))


def label_dates(axes: Axes, at: Any, origin: pd.Timestamp | None) -> None:
    """Days, or hours of them, below `axes`, and from when to when `at` (n,) is."""
    date_ticks(axes, years=origin is not None)
    axes.set_xlim(at[0], at[-1])
    first, last = (pd.Timestamp(one) for one in at[[0, -1]])
    zone = "" if origin is None or origin.tz is None else f", standard time of {origin.tz}"
    axes.set_xlabel(
        f"{first:%d %b} to {last:%d %b}" if origin is None else f"{first:%Y-%m-%d} to {last:%Y-%m-%d}{zone}"
    )
