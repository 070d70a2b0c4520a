"""Whole days of a record: their energy and their weather, also as the mass of a building remembers it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record, energy_kWh, steps_in
from thermoforce_mpc.data.series import interpolated, lagged
from thermoforce_mpc.errors import DataError

LEAST_MEASURED = 0.9
"""Least share of a day's steps with energy and outdoor temperature for it to count."""
# The same of the sun, where that is metered: a sensor may be silent at night.
_LEAST_SUN = 0.25
# Time constants of the weather's low passes, h; 0: the day's own mean.
LAGS_H: tuple[float, ...] = (0.0, 12.0, 24.0, 48.0)


@dataclass(frozen=True)
class Days:
    """Whole days of a record; `left_out` have gaps.

    `number` (n,): day since the record's time 0. `energy_kWh` (n,): of all machines, or the heat that was moved.
    `T_out_C`, `solar_W_m2` (lags, n): daily means of °C and W/m² through a low pass of each of `LAGS_H`. `T_zone_C` (Z,
    n): daily means, °C. `weekend` (n,): False throughout where the record has no date.
    """

    number: NDArray[np.int64]
    energy_kWh: Array
    T_out_C: Array
    solar_W_m2: Array
    T_zone_C: Array
    weekend: NDArray[np.bool_]
    left_out: int

    @property
    def n(self) -> int:
        """Number of days."""
        return int(self.number.size)


def days_of(record: Record, meter: str, name: str, past: Record | None = None) -> Days:
    """The whole days of `record`, midnight to midnight; the energy is that of `meter`, 'power_W' or 'heat_W'.

    `past`: what was recorded just before, from which the weather's low passes start. Raises `DataError`, with `name`,
    where the step does not divide a day or no whole day is there.
    """
    per_day = DAY_S / record.step_s
    if abs(per_day - round(per_day)) > 1e-6:
        raise DataError(f"{name}: a step of {record.step_s:g} s does not divide a day; resample the record")
    k = round(per_day)
    low_out, low_sun = _low_passes(record, past)
    first = int(np.ceil(record.time_s[0] / DAY_S - 1e-9))
    last = int(np.floor(record.time_s[-1] / DAY_S + 1e-9))
    offset = record.nearest(first * DAY_S)
    # Heat that is taken out of a zone is negative in a record: cold that was used is energy like heat.
    total = (record.power_W if meter == "power_W" else np.abs(record.heat_W)).sum(axis=0)
    total = np.where(np.isfinite(total), total, np.nan)
    measured = np.isfinite(total) & np.isfinite(record.T_out_C[:-1])
    sunny = np.isfinite(record.solar_W_m2[:-1])
    least_sun = _LEAST_SUN if sunny.any() else 0.0
    rows: list[tuple[int, float, Array, Array, Array]] = []
    left_out = 0
    for day in range(first, last):
        at = slice(offset + (day - first) * k, offset + (day - first + 1) * k)
        if measured[at].mean() < LEAST_MEASURED or sunny[at].mean() < least_sun:
            left_out += 1
            continue
        energy = energy_kWh(float(np.nanmean(total[at])), DAY_S)
        zone = np.array([np.nanmean(row[at]) if np.isfinite(row[at]).any() else np.nan for row in record.T_zone_C])
        rows.append((day, energy, low_out[:, at].mean(axis=1), low_sun[:, at].mean(axis=1), zone))
    if not rows:
        raise DataError(
            f"{name}: no whole day from midnight to midnight has energy, outdoor temperature and, where it is metered, "
            f"sun ({left_out} have gaps)"
        )
    number, energies, outs, suns, zones = zip(*rows, strict=True)
    weekend = np.zeros(len(rows), dtype=bool)
    if record.origin is not None:
        # At noon, since days begin an hour before or after midnight where the clock has moved since 1 January.
        weekend = np.array([(record.origin + pd.Timedelta(days=day, hours=12)).weekday() >= 5 for day in number])
    return Days(
        np.array(number), np.array(energies), np.array(outs).T, np.array(suns).T, np.array(zones).T, weekend, left_out
    )  # fmt: skip


def _low_passes(record: Record, past: Record | None) -> tuple[Array, Array]:
    """Outdoor temperature and irradiance through each low pass, (lags, n + 1)."""
    filtered = []
    for name in ("T_out_C", "solar_W_m2"):
        values = interpolated(getattr(record, name))
        before = np.empty(0)
        if past is not None and 0.0 <= record.time_s[0] - past.time_s[-1] <= DAY_S and past.step_s == record.step_s:
            before = interpolated(getattr(past, name))
        joined = np.concatenate([before, values])
        rows = []
        for lag in LAGS_H:
            if lag == 0.0:
                rows.append(values)
                continue
            pole = float(np.exp(-record.step_s / HOUR_S / lag))
            start = float(joined[: steps_in(DAY_S, record.step_s)].mean())
            rows.append(lagged(joined, pole, start)[1 + before.size :])
        filtered.append(np.array(rows))
    return filtered[0], filtered[1]
