"""Prices as they are billed: energy, grid fee by time of day and season, levies, tax, fixed fee, peaks and export."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, month_of
from thermoforce_mpc.data.series import means_of
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.scenario.settings import Currency, StrictModel, read_yaml, validate

if TYPE_CHECKING:  # loaded only where a calendar is
    import pandas as pd

SUFFIXES = (".yaml", ".yml")
"""What the name of a file of a bill ends with; other files hold prices."""

_SPAN = re.compile(r"(\d{1,2}):(\d\d)-(\d{1,2}):(\d\d)")
_DAYS = {"daily": range(7), "weekdays": range(5), "weekend": (5, 6)}
_MONTHS_A_YEAR = 12.0


def _span_h(text: str) -> tuple[float, float]:
    """Begin and end of hours such as 17:00-19:00; raises `ValueError`."""
    found = _SPAN.fullmatch(text)
    if found is None or int(found[2]) > 59 or int(found[4]) > 59:
        raise ValueError(f"'{text}': expected hours such as 17:00-19:00, also beyond midnight")
    begin, end = int(found[1]) + int(found[2]) / 60.0, int(found[3]) + int(found[4]) / 60.0
    if max(begin, end) > 24.0 or begin == end:
        raise ValueError(f"'{text}': two different times of day, 0:00 to 24:00; leave hours out for the whole day")
    return begin, end


def _is_span(text: str) -> str:
    _span_h(text)
    return text


class TimeWindow(StrictModel):
    """Hours of days in months, on the clock of the building."""

    hours: Annotated[str, AfterValidator(_is_span)] = Field(
        "0:00-24:00", description="such as 17:00-19:00, also beyond midnight"
    )
    days: Literal["daily", "weekdays", "weekend"] = "daily"
    months: tuple[Annotated[int, Field(ge=1, le=12)], ...] = Field(
        tuple(range(1, 13)), min_length=1, description="months of the year, 1 to 12"
    )

    def holds(self, month: Array, weekday: Array, hour: Array) -> NDArray[np.bool_]:
        """Where it holds (n,), for months 1 to 12, weekdays from 0 for Monday, and hours with their fractions."""
        begin, end = _span_h(self.hours)
        inside = (hour >= begin) & (hour < end) if begin < end else (hour >= begin) | (hour < end)
        return np.asarray(inside & np.isin(weekday, list(_DAYS[self.days])) & np.isin(month, list(self.months)))


class FeeWindow(TimeWindow):
    """A grid fee in a window."""

    per_kWh: float


class Grid(StrictModel):
    """Grid fee per kWh: that of the first window that holds, else `per_kWh`."""

    per_kWh: float = 0.0
    windows: tuple[FeeWindow, ...] = ()


class PeakStep(StrictModel):
    """A monthly fee for peaks up to a power; None: any."""

    up_to_kW: float | None = Field(None, gt=0)
    per_month: float = Field(ge=0)


class Peak(StrictModel):
    """What the peak power of a month costs.

    `highest`: of all steps of `minutes`; `three_days`: the mean of the three highest on distinct days.
    """

    of: Literal["highest", "three_days"]
    minutes: Literal[15, 30, 60] = 15
    per_kW_year: float | None = Field(None, ge=0, description="currency per kW and year; a month is a twelfth")
    least_kW: float = Field(0.0, ge=0, description="a lower peak counts as this")
    steps: tuple[PeakStep, ...] = Field((), description="or fees of a month by steps of power")

    @model_validator(mode="after")
    def _one_price(self) -> Peak:
        if (self.per_kW_year is None) == (not self.steps):
            raise ValueError("peak: give per_kW_year, or steps")
        ends = [step.up_to_kW for step in self.steps]
        if ends and (ends[-1] is not None or None in ends[:-1]):
            raise ValueError("peak.steps: all but the last have up_to_kW, and the last none")
        if any(a >= b for a, b in pairwise(end for end in ends if end is not None)):
            raise ValueError("peak.steps: up_to_kW must rise from step to step")
        return self

    def fee(self, peak_kW: float) -> float:
        """What a month with this peak costs, without tax."""
        peak_kW = max(peak_kW, self.least_kW)
        if self.per_kW_year is not None:
            return self.per_kW_year / _MONTHS_A_YEAR * peak_kW
        return next(step.per_month for step in self.steps if step.up_to_kW is None or peak_kW < step.up_to_kW)

    def per_kW(self, peak_kW: float) -> float:
        """What one kW more than a peak costs in a month, without tax; of steps on average up to the next two."""
        if self.per_kW_year is not None:
            return self.per_kW_year / _MONTHS_A_YEAR
        ends = [0.0, *(step.up_to_kW for step in self.steps if step.up_to_kW is not None)]
        if len(ends) == 1:
            return 0.0
        at = min(int(np.searchsorted(ends, max(peak_kW, self.least_kW), side="right")) - 1, len(ends) - 2)
        return (self.steps[at + 1].per_month - self.steps[at].per_month) / (ends[at + 1] - ends[at])

    def of_days(self, highest_kW: Array) -> float:
        """The peak of a month, kW, from the highest power of each of its days (n,)."""
        known = np.sort(highest_kW[np.isfinite(highest_kW)])[::-1]
        if not known.size:
            return 0.0
        return float(known[0] if self.of == "highest" else known[:3].mean())

    def share(self) -> float:
        """What share of a kW on one day counts."""
        return 1.0 if self.of == "highest" else 1.0 / 3.0


class Dimming(TimeWindow):
    """Power of machines that the grid may hold down to, kW, in a window (§ 14a EnWG: 4.2 kW)."""

    kW: float = Field(4.2, gt=0)


class Bill(StrictModel):
    """Prices of a building's electricity; all without tax, `vat` comes on top of what is bought.

    `energy`: price per kWh, or a file of them beside this one; None: those of the map.
    """

    source: str = Field(min_length=3, description="where the numbers are from")
    currency: Currency = Field("", description="code of three letters; sizes of prices in EUR and USD are checked")
    energy: float | str | None = Field(None, description="price per kWh without fees and tax, or a file of them")
    supplier_per_kWh: float = Field(0.0, description="what the supplier adds")
    levies_per_kWh: float = Field(0.0, description="levies and electricity tax")
    grid: Grid = Grid()
    vat: float = Field(0.0, ge=0, le=1, description="value-added tax as a share")
    fixed_per_month: float = Field(0.0, ge=0)
    peak: Peak | None = None
    dimming: Dimming | None = None
    export_per_kWh: float | str | None = Field(
        None, description="what the grid pays for a kWh, or a file of it; none: exports earn nothing"
    )
    export_only_from: float | None = Field(
        None, description="exports earn nothing while energy, without fees and tax, costs less (§ 51 EEG: 0)"
    )

    def per_kWh(self, energy: Array, month: Array, weekday: Array, hour: Array) -> Array:
        """What a kWh costs (n,), tax included, at prices of `energy` (n,) and times as of `TimeWindow.holds`."""
        fee = np.full(np.shape(energy), self.grid.per_kWh)
        for window in reversed(self.grid.windows):
            fee[window.holds(month, weekday, hour)] = window.per_kWh
        return np.asarray((energy + self.supplier_per_kWh + self.levies_per_kWh + fee) * (1.0 + self.vat))

    def over_year(self, energy: Array, time_s: Array) -> Array:
        """`per_kWh` at `time_s` (n,), s since 1 January, of years of 365 days that begin on a Tuesday."""
        day = np.floor(np.asarray(time_s) / DAY_S)
        return self.per_kWh(energy, month_of(time_s), (day + 1) % 7, (time_s - day * DAY_S) / HOUR_S)

    def at(self, energy: Array, stamps: pd.DatetimeIndex) -> Array:
        """`per_kWh` at instants of a calendar (n,), on the clock of their zone."""
        return self.per_kWh(energy, *_on_clock(stamps))

    @model_validator(mode="after")
    def _costs(self) -> Bill:
        if isinstance(self.energy, float) and self.energy < 0.0:  # hours may, in a file
            raise ValueError(f"energy: {self.energy:g} is no price of every kWh")
        return self

    @model_validator(mode="after")
    def _earns_from_a_price(self) -> Bill:
        if self.export_only_from is not None:
            if self.export_per_kWh is None:
                raise ValueError("export_only_from: needs export_per_kWh, what exports earn else")
            if isinstance(self.energy, float):
                raise ValueError("export_only_from: needs prices of energy that change, a file or the map's (null)")
        return self

    @property
    def of_whole_house(self) -> tuple[str, ...]:
        """Its keys that are of the whole house's exchange with the grid, which power of machines does not tell."""
        return tuple(key for key in ("peak", "dimming", "export_per_kWh") if getattr(self, key) is not None)

    def earns(self, export: Array, energy: Array) -> Array:
        """What a kWh that is fed in earns (n,), of `export` (n,), while `energy` (n,) costs so much without fees."""
        if self.export_only_from is None:
            return export
        return np.where(energy < self.export_only_from, 0.0, export)

    def limit_kW(self, stamps: pd.DatetimeIndex) -> Array:
        """What machines may take while they are dimmed (n,), kW; infinite while they are not."""
        if self.dimming is None:
            return np.full(len(stamps), np.inf)
        return np.where(self.dimming.holds(*_on_clock(stamps)), self.dimming.kW, np.inf)

    def of_month(self, energy: Array, power_kW: Array, stamps: pd.DatetimeIndex) -> dict[str, float]:
        """What a month of equal steps costs, by item, tax included: `energy` (n,) without fees, mean power (n,) bought.

        `peak` is of the means over `Peak.minutes`, which must be whole steps. Raises `ConfigError` where they are not.
        """
        step_h = (stamps[1] - stamps[0]).total_seconds() / HOUR_S
        bought = np.maximum(power_kW, 0.0) * step_h
        plain = np.zeros(bought.size)
        taxed, on_clock = 1.0 + self.vat, _on_clock(stamps)
        fees = self.per_kWh(plain, *on_clock) - taxed * (self.supplier_per_kWh + self.levies_per_kWh)
        items = {
            "energy": float((bought * energy).sum()) * taxed,
            "supplier": float(bought.sum()) * self.supplier_per_kWh * taxed,
            "grid": float((bought * fees).sum()),
            "levies": float(bought.sum()) * self.levies_per_kWh * taxed,
            "fixed": self.fixed_per_month * taxed,
        }
        if self.peak is not None:
            together = self.peak.minutes / 60.0 / step_h
            if together < 1.0 - 1e-6 or abs(together - round(together)) > 1e-6:
                raise ConfigError(f"peak.minutes: {self.peak.minutes} min are no whole steps of {60.0 * step_h:g} min")
            means = means_of(np.maximum(power_kW, 0.0), round(together))
            day = np.asarray(stamps[:: round(together)][: means.size].day_of_year)
            highest = np.array([means[day == one].max() for one in np.unique(day)])
            items["peak"] = self.peak.fee(self.peak.of_days(highest)) * taxed
        return items


def read_bill(path: Path) -> Bill:
    """The bill of a YAML file; raises `ConfigError` naming file, key and what is allowed."""
    return validate(Bill, read_yaml(path), str(path))


def file_beside(path: Path, name: str) -> Path:
    """A file that a bill at `path` names."""
    return Path(name) if Path(name).is_absolute() else path.parent / name


def _on_clock(stamps: pd.DatetimeIndex) -> tuple[Array, Array, Array]:
    hour = np.asarray(stamps.hour + stamps.minute / 60.0, dtype=np.float64)
    return np.asarray(stamps.month), np.asarray(stamps.day_of_week), hour
