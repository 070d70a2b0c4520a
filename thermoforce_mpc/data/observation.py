"""Input of a controller, and the forecast it makes of the free response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data.boundary import Boundary
from thermoforce_mpc.data.clock import CLOCK_TOLERANCE_S, Array
from thermoforce_mpc.data.names import Names
from thermoforce_mpc.data.record import Record
from thermoforce_mpc.errors import DataError


@dataclass(frozen=True)
class Observation:
    """Input of a controller: the record until now and the forecast of the boundary conditions."""

    history: Record
    boundary: Boundary

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

    @property
    def median_C(self) -> Array:
        """The 0.5 quantile, shape (N,) or (Z, N), °C."""
        index = int(np.argmin(np.abs(np.asarray(self.levels) - 0.5)))
        return np.asarray(self.quantiles_C[index], dtype=np.float64)

    def quantile_C(self, level: float) -> Array:
        """The quantile of `level`, (N,) or (Z, N), °C: linear between levels that were forecast, held beyond them."""
        levels = np.asarray(self.levels, dtype=np.float64)
        above = int(np.searchsorted(levels, level))
        for at in (above, above - 1):  # levels are decimal fractions, which are rounded
            if 0 <= at < levels.size and math.isclose(levels[at], level, abs_tol=1e-12):
                return np.asarray(self.quantiles_C[at], dtype=np.float64)
        if above in (0, levels.size):
            return np.asarray(self.quantiles_C[min(above, levels.size - 1)], dtype=np.float64)
        share = (level - levels[above - 1]) / (levels[above] - levels[above - 1])
        lower, upper = self.quantiles_C[above - 1], self.quantiles_C[above]
        return np.asarray(lower + share * (upper - lower), dtype=np.float64)
