"""Boundary conditions of the steps ahead, the input of a controller, and the forecast it makes of the free response."""

from __future__ import annotations

import math
import warnings
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data.clock import CLOCK_ROUNDING_S, CLOCK_TOLERANCE_S, HOUR_S, Array, check_clock
from thermoforce_mpc.data.limits import ZONE_C
from thermoforce_mpc.data.names import AXIS, SINGLE, Names, frozen
from thermoforce_mpc.data.prices import currency_of, price_doubt, price_unit_of
from thermoforce_mpc.data.record import Record
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.files import DoubtfulInput

if TYPE_CHECKING:  # loaded only where tables come in
    import pandas as pd

# Signals of a `Boundary`.
CONDITIONS = (
    "time_s", "T_out_C", "solar_W_m2", "occupancy", "lower_C", "upper_C", "price_per_kWh", "emission_kg_per_kWh",
    "heating_price_per_kWh",
)  # fmt: skip

# By how much a comfort bound is wider than at its tightest when it is set back, and how much one gets tighter that
# begins, K. Set on seven days of the small office of EnergyPlus, `peak_heat_day` and `cold_day` (1.71 and 2.03 K·h,
# before 2.27 and 2.51; 2026-11-23); setbacks of programmes and of BOPTEST are 2 K and more.
SET_BACK_K = 0.5

# What there may be at the meter of the building.
AT_THE_METER = ("others_W", "export_per_kWh", "limit_W")


def excess(value: Array | float, lower: Array | float, upper: Array | float) -> Array:
    """How far `value` lies outside its bounds, 0 inside, in its unit; of shapes that broadcast."""
    return np.asarray(np.maximum(np.maximum(lower - value, value - upper), 0.0))


@dataclass(frozen=True)
class Boundary:
    """Boundary conditions at `N + 1` equally spaced instants, the first being *now*.

    Shape (N + 1,): `time_s` s, `T_out_C` °C, `solar_W_m2` global horizontal W/m².
    Shape (Z, N + 1): `occupancy` persons, `lower_C` and `upper_C` comfort bounds °C.
    Shape (M, N + 1): `price_per_kWh` currency/kWh and `emission_kg_per_kWh` kg CO2/kWh of each machine's energy;
    `heating_price_per_kWh` where the heating of a machine that also cools has a carrier of its own, else the same.
    Shape (N + 1,) or empty where there is none: `others_W`, what else the building takes behind the same meter, less
    its own generation, W (below 0: a surplus); `export_per_kWh`, what a kWh that is fed in earns; `limit_W`, what all
    machines together may take (inf: anything).
    `guessed`: which values of a signal, by its name and shape, nobody gave, and its source of data made up by a rule.
    Raises `DataError` for another shape, no instant, or instants that do not go up in equal steps.
    """

    time_s: Array
    T_out_C: Array
    solar_W_m2: Array
    occupancy: Array
    lower_C: Array
    upper_C: Array
    price_per_kWh: Array
    emission_kg_per_kWh: Array
    heating_price_per_kWh: Array = field(default_factory=lambda: np.empty(0))
    names: Names = SINGLE
    guessed: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    others_W: Array = field(default_factory=lambda: np.empty(0))
    export_per_kWh: Array = field(default_factory=lambda: np.empty(0))
    limit_W: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        n = np.size(self.time_s)
        for name in AT_THE_METER:
            if np.size(getattr(self, name)) not in (0, n):
                raise DataError(f"{name} has shape {np.shape(getattr(self, name))}, expected ({n},) or none")
            values = np.array(getattr(self, name), dtype=np.float64)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if n < 1:
            raise DataError("a boundary needs at least one instant")
        if not np.size(self.heating_price_per_kWh):
            object.__setattr__(self, "heating_price_per_kWh", self.price_per_kWh)
        for name in CONDITIONS:
            object.__setattr__(self, name, frozen(getattr(self, name), name, n, self.names))
        check_clock(self.time_s, "boundary")

    @classmethod
    def from_dataframe(
        cls,
        df: pd.DataFrame,
        record: Record,
        *,
        outdoor: str,
        solar: str | None = None,
        lower: str | float | None = None,
        upper: str | float | None = None,
        price: str | float | None = None,
        occupancy: str | float = 0.0,
        emission: str | float = 0.0,
    ) -> Boundary:
        """The forecast that follows `record`: one row per step boundary, the first at the record's last time stamp.

        Args:
            df: forecast with a `DatetimeIndex` in any zone; hourly rows are interpolated to the step of `record`.
            record: what was measured until now.
            outdoor: column of the outdoor temperature, °C.
            solar: column of the global horizontal irradiance, W/m²; None where the record has none either.
            lower: lower comfort bound, °C; a column, or one number. A plan needs both bounds, a prediction does not.
            upper: upper comfort bound, °C; the same.
            price: energy price, currency/kWh; the same. One that is unusual in euros and dollars gives a warning.
            occupancy: persons; a column, or one number.
            emission: kg CO2/kWh; a column, or one number.

        Raises:
            DataError: `df` is no data frame, a column is missing or most of it impossible in its unit, a bound or price
                is neither a column nor a number, a price is of no kWh by the name of its column, rows are not in order
                or do not begin at the end of `record`, `record` is one instant, or a bound is no room temperature in °C
                or the lower one above the upper one.
        """
        import pandas as pd

        from thermoforce_mpc.data.dataframes import check_table, measured_column, seconds_since, series, stamps

        check_table(df, "forecast")
        check_kind(record, Record, "forecast: record")
        if record.origin is None:
            raise DataError("forecast: the record has no time stamps; make it with Record.from_dataframe")
        if not record.n_steps:
            raise DataError("forecast: the record is of one instant, whose step is not known: give two rows or more")
        at_s = seconds_since(record.origin, df.index, "forecast")
        if at_s.size < 2 or not (np.diff(at_s) > 0).all():
            raise DataError("forecast: it needs two rows or more, in order of time; use df.sort_index()")
        now_s, step_s = float(record.time_s[-1]), record.step_s
        if not at_s[0] <= now_s + CLOCK_ROUNDING_S < at_s[-1]:
            now = (
                ". A record ends with a row of now, in which temperatures and weather are known and levels and "
                "power are "
                f"empty: append one at {record.stamps()[-1] + pd.Timedelta(seconds=step_s)} to the table, e.g. "
                "df.loc[now] = {zone: T, outdoor: T_out, ...}"
                if abs(at_s[0] - now_s - step_s) <= CLOCK_ROUNDING_S
                else ""
            )
            raise DataError(
                f"forecast: it goes from {df.index[0]} to {df.index[-1]}, the record ends at {record.stamps()[-1]}: "
                f"the rows must begin there (or before) and go on{now}"
            )
        steps = np.arange(np.floor((at_s[-1] - now_s + CLOCK_ROUNDING_S) / step_s) + 1.0)
        time_s = now_s + steps * step_s
        # Temperatures go straight between two rows; what follows a schedule holds until the next row.
        held = np.clip(np.searchsorted(at_s, time_s + CLOCK_ROUNDING_S, side="right") - 1, 0, at_s.size - 1)

        def line(name: str, argument: str, signal: str) -> Array:
            return np.interp(time_s, at_s, measured_column(df, name, "forecast", argument, signal))

        def step(source: str | float | None, argument: str) -> Array:
            return series(df, source, "forecast", argument)[held]

        ahead = cls(
            time_s,
            line(outdoor, "outdoor", "T_out_C"),
            np.zeros(time_s.size) if solar is None else line(solar, "solar", "solar_W_m2"),
            step(occupancy, "occupancy"),
            step(lower, "lower"),
            step(upper, "upper"),
            step(price, "price"),
            step(emission, "emission"),
        )
        ahead._check_bounds(stamps(time_s, record.origin))
        if price is not None:
            ahead._check_price(price)
        return ahead

    def _check_price(self, source: str | float) -> None:
        """Raises `DataError` where a price is of no kWh by the name of its column, or below 0 as a number.

        Warns with `DoubtfulInput` of one that is unusual in euros and dollars.
        """
        name = source if isinstance(source, str) else ""
        parts = {None: 1, "per kWh": 1, "cent per kWh": 100, "per MWh": 1000, "cent per MWh": 100_000}
        if (over := parts[unit := price_unit_of(name)]) != 1:
            raise DataError(
                f"forecast: price: column '{name}' is {unit} by its name: divide by {over}, call it 'price per kWh'"
            )
        if not name and self.price_per_kWh[0, 0] < 0.0:  # hours may cost less than nothing, not all of them
            raise DataError(f"forecast: price is {self.price_per_kWh[0, 0]:g}: no price of every kWh is below 0")
        if doubt := price_doubt(self.price_per_kWh, currency_of(name)):
            other = "give a price per kWh; name the column for another currency, as 'price JPY/kWh'"
            warnings.warn(f"forecast: price: {doubt} If so {other}", DoubtfulInput, stacklevel=3)

    def _check_bounds(self, at: pd.Index) -> None:
        """Raises `DataError` where a bound is no room temperature in °C, or the lower one is above the upper."""
        for name in ("lower", "upper"):
            bound = getattr(self, f"{name}_C")[0]
            # Comfort bounds lie where zone temperatures do: °F and K do not.
            wrong = (bound < ZONE_C[0]) | (bound > ZONE_C[1])
            if wrong.any():
                k = int(np.argmax(wrong))
                raise DataError(
                    f"forecast: {name} is {bound[k]:g} at {at[k]}: a comfort bound is a temperature between "
                    f"{ZONE_C[0]:g} and {ZONE_C[1]:g} °C; convert °F or K"
                )
        crossed = self.lower_C[0] > self.upper_C[0]
        if crossed.any():
            k = int(np.argmax(crossed))
            raise DataError(
                f"forecast: at {at[k]} the lower bound, {self.lower_C[0, k]:g} °C, is above the upper one, "
                f"{self.upper_C[0, k]:g} °C: exchange lower and upper, or mend the row"
            )

    @classmethod
    def measured(cls, record: Record) -> Boundary:
        """Measured weather as a perfect forecast; the other boundary conditions are NaN."""
        names, n = record.names, record.time_s.size
        of_zone, of_machine = (np.full((len(rows), n), np.nan) for rows in (names.zones, names.machines))
        return cls(
            record.time_s, record.T_out_C, record.solar_W_m2, of_zone, of_zone, of_zone, of_machine, of_machine,
            names=names,
        )  # fmt: skip

    @property
    def n_steps(self) -> int:
        """Number of steps N."""
        return int(self.time_s.size - 1)

    @property
    def step_s(self) -> float:
        """Length of a step, s."""
        return float(self.time_s[1] - self.time_s[0])

    def check(self, *names: str) -> None:
        """Raises `DataError` where one of the signals `names` has a value that is no number; says which and when."""
        for name in names:
            if np.isfinite(getattr(self, name)).all():
                continue
            for row, values in enumerate(np.atleast_2d(getattr(self, name))):
                missing = np.flatnonzero(~np.isfinite(values))
                if missing.size:
                    label = self.names.label(name, row) if name in AXIS else name
                    raise DataError(
                        f"boundary forecast: {label} is missing at {missing.size} of {self.time_s.size} instants, "
                        f"first at {self.time_s[missing[0]]:.10g} s "
                        f"({(self.time_s[missing[0]] - self.time_s[0]) / HOUR_S:g} h ahead): check its source"
                    )

    def part(self, zone: int, machine: int = 0) -> Boundary:
        """The boundary conditions of one zone and one machine."""
        names = Names((self.names.zones[zone],), machines=(self.names.machines[machine],))
        row = {"zones": zone, "machines": machine}
        return Boundary(
            **{
                name: getattr(self, name)[row[AXIS[name]]] if name in AXIS else getattr(self, name)
                for name in CONDITIONS
            },
            **{name: getattr(self, name) for name in AT_THE_METER},
            names=names,
            guessed={
                name: values[row[AXIS[name]]][None] if name in AXIS else values for name, values in self.guessed.items()
            },
        )

    def at_prices(self, price_per_kWh: Array) -> Boundary:
        """The same at other prices (M, N + 1), of heating too."""
        return replace(self, price_per_kWh=price_per_kWh, heating_price_per_kWh=np.empty(0))

    def outside_K(self, T_C: Array, first: int = 0) -> Array:
        """How far temperatures (Z, n) at the ends of n steps from `first` on lie outside the bounds, K (Z, n)."""
        ends = slice(first + 1, first + 1 + T_C.shape[-1])
        return excess(T_C, self.lower_C[:, ends], self.upper_C[:, ends])

    def head(self, n_steps: int) -> Boundary:
        """The first `n_steps` steps; itself where there are no more."""
        if n_steps == self.n_steps:
            return self
        return Boundary(
            **{name: getattr(self, name)[..., : n_steps + 1] for name in (*CONDITIONS, *AT_THE_METER)},
            names=self.names,
            guessed={name: values[..., : n_steps + 1] for name, values in self.guessed.items()},
        )


@dataclass(frozen=True)
class Observation:
    """Input of a controller: the record until now and the forecast of the boundary conditions.

    `tank_C`: temperature of its tank of hot water now, °C, NaN where it is not known; `tank_charges`: it is charged.
    """

    history: Record
    boundary: Boundary
    tank_C: float = math.nan
    tank_charges: bool = False

    def __post_init__(self) -> None:
        """Raise `DataError` for a history that is no record, and conditions that are none."""
        check_kind(self.history, Record, "observation: history")
        check_kind(self.boundary, Boundary, "observation: boundary")

    @property
    def time_s(self) -> float:
        """Now, s since 1 January."""
        return float(self.history.time_s[-1])

    @property
    def T_zone_C(self) -> Array:
        """Zone temperatures now (Z,), °C (NaN when the sensor is silent); who keeps them does not keep the record."""
        return np.array(self.history.T_zone_C[:, -1])

    @property
    def names(self) -> Names:
        """Names of zones, actuators and machines."""
        return self.history.names

    def check_begin(self) -> None:
        """Raise `DataError` where the boundary conditions do not begin now."""
        ahead_s = float(self.boundary.time_s[0]) - self.time_s
        if abs(ahead_s) <= CLOCK_TOLERANCE_S:
            return
        from thermoforce_mpc.data.dataframes import stamps

        begin, now = stamps(np.array([self.boundary.time_s[0], self.time_s]), self.history.origin)
        raise DataError(
            f"boundary forecast: it begins at {begin}, {abs(ahead_s):.10g} s {'after' if ahead_s > 0 else 'before'} "
            f"now, which is the end of the history, {now}: give the conditions from there on"
        )


@dataclass(frozen=True)
class FreeForecast:
    """A free response over `N` steps, of one zone as a method gives it, or of all Z zones (`stacked`).

    `quantiles_C` °C has shape (Q, N) or (Q, Z, N) for the increasing `levels` (Q,); `note` says what made it, and
    `doubt` why it was not the configured method; empty where it was.
    """

    levels: Array
    quantiles_C: Array
    note: str = ""
    doubt: str = ""

    @classmethod
    def stacked(cls, zones: Sequence[FreeForecast]) -> FreeForecast:
        """The forecasts of all zones as one; levels that not all zones have are interpolated."""
        levels = np.asarray(zones[0].levels, dtype=np.float64)
        rows = [
            zone.quantiles_C
            if np.array_equal(zone.levels, levels)
            else np.stack([zone.quantile_C(float(level)) for level in levels])
            for zone in zones
        ]
        note = "; ".join(dict.fromkeys(zone.note for zone in zones))
        doubt = "; ".join(dict.fromkeys(zone.doubt for zone in zones if zone.doubt))
        return cls(levels, np.stack(rows, axis=1), note, doubt)

    def widened(self, sd_K: Array) -> FreeForecast:
        """The same with an error of its own added, normal, of standard deviation `sd_K`, (N,) or (Z, N), K."""
        median = self.median_C
        rows = []
        for level, row in zip(np.asarray(self.levels, dtype=np.float64), self.quantiles_C, strict=True):
            off = np.hypot(row - median, NormalDist().inv_cdf(float(level)) * sd_K)
            rows.append(np.where(sd_K > 0.0, median + math.copysign(1.0, level - 0.5) * off, row))
        rows[self._median_row] = median
        return replace(self, quantiles_C=np.stack(rows))

    @property
    def median_C(self) -> Array:
        """The 0.5 quantile, shape (N,) or (Z, N), °C."""
        return np.asarray(self.quantiles_C[self._median_row], dtype=np.float64)

    @cached_property
    def _median_row(self) -> int:
        return min(range(len(self._levels)), key=lambda row: abs(self._levels[row] - 0.5))

    @cached_property
    def _levels(self) -> list[float]:
        return np.asarray(self.levels, dtype=np.float64).tolist()

    def quantile_C(self, level: float) -> Array:
        """The quantile of `level`, (N,) or (Z, N), °C: linear between levels that were forecast, held beyond them."""
        levels = self._levels
        above = bisect_left(levels, level)
        for at in (above, above - 1):  # levels are decimal fractions, which are rounded
            if 0 <= at < len(levels) and math.isclose(levels[at], level, abs_tol=1e-12):
                return np.asarray(self.quantiles_C[at], dtype=np.float64)
        if above in (0, len(levels)):
            return np.asarray(self.quantiles_C[min(above, len(levels) - 1)], dtype=np.float64)
        share = (level - levels[above - 1]) / (levels[above] - levels[above - 1])
        lower, upper = self.quantiles_C[above - 1], self.quantiles_C[above]
        return np.asarray(lower + share * (upper - lower), dtype=np.float64)
