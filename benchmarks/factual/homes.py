"""A measured building, or room, of the factual suite, and the parts of its record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.factual.protocol import Protocol
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.errors import DataError

# Longest gap that is interpolated, h. Beyond it the weather of the day before stands in, and nothing is scored there.
_SHORT_GAP_H = 3.0
# A meter's full level: this quantile of its positive readings, so that one odd reading does not set the scale.
_FULL_LEVEL_QUANTILE = 0.99


@dataclass(frozen=True)
class Home:
    """One room or home as measured.

    Attributes:
        name: for tables and file names.
        group: dataset.
        record: zone temperature and weather with gaps (NaN) where nothing was measured; levels are not used.
        meters: what acted, by name: nonnegative energy or power of each step (n,), in any unit, NaN gaps.
        sign: +1 if what is metered heats the zone, −1 if it cools it.
        source: SHA-256 of each file that was read, by name.
    """

    name: str
    group: str
    record: Record
    meters: Mapping[str, Array]
    sign: int = 1
    source: Mapping[str, str] = field(default_factory=dict)

    def between(self, first: Any = None, last: Any = None) -> Home:
        """The home from time stamp `first` until `last` (None: as recorded); all of it where its times have no date.

        Raises:
            DataError: nothing is left.
        """
        if (first is None and last is None) or self.record.origin is None:
            return self
        stamps, zone = self.record.stamps(), self.record.origin.tz
        if zone is not None:
            first, last = (t if t is None or t.tzinfo else t.tz_localize(zone) for t in (first, last))
        keep = np.ones(stamps.size, dtype=bool)
        if first is not None:
            keep &= np.asarray(stamps >= first)
        if last is not None:
            keep &= np.asarray(stamps <= last)
        inside = np.flatnonzero(keep)
        if inside.size < 2:
            raise DataError(f"{self.name}: its record ({stamps[0]} to {stamps[-1]}) has nothing in {first} to {last}")
        start, stop = int(inside[0]), int(inside[-1])
        meters = {name: values[start:stop] for name, values in self.meters.items()}
        return replace(self, record=self.record.slice(start, stop), meters=meters)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A home cut to the suite's window, gaps filled, levels normalised on the fit part.

    Attributes:
        home: as measured.
        record: without gaps shorter than three hours; `u` is that of the first meter.
        levels: level of each meter in [0, 1], (n,).
        truth_C: measured temperature (n + 1,), NaN where there was none.
        usable: steps (n,) with measured weather and meters.
        fit, validation, test: first and last boundary of each part.
        stride: steps between origins.
        notes: what was filled, in words.
    """

    home: Home
    record: Record
    levels: Mapping[str, Array]
    truth_C: Array
    usable: NDArray[np.bool_]
    fit: tuple[int, int]
    validation: tuple[int, int]
    test: tuple[int, int]
    stride: int
    notes: tuple[str, ...] = ()

    @property
    def steps_per_day(self) -> int:
        """Steps in a day."""
        return round(DAY_S / self.record.step_s)

    def steps(self, hours: float) -> int:
        """Steps in `hours`."""
        return round(hours * HOUR_S / self.record.step_s)

    def with_level(self, meter: str) -> Record:
        """The record with the levels of `meter`."""
        return replace(self.record, u=self.levels[meter][None])

    def budget(self, days: int) -> tuple[int, int]:
        """First and last boundary of the last `days` days of the fit part, all of it where it is shorter."""
        return max(self.fit[0], self.fit[1] - days * self.steps_per_day), self.fit[1]

    def origins(self, part: tuple[int, int], horizon: int) -> list[int]:
        """Boundaries from which forecasts of `horizon` steps start and end inside `part`, where they can be scored."""
        found = []
        for o in range(part[0], part[1] - horizon + 1, self.stride):
            ahead = slice(o, o + horizon)
            measured = np.isfinite(self.truth_C[o + 1 : o + horizon + 1]).mean()
            if np.isfinite(self.truth_C[o]) and measured > 0.9 and self.usable[ahead].all():
                found.append(o)
        return found


def prepared(home: Home, protocol: Protocol) -> Prepared:
    """Cut `home` into fit, validation and test part by `protocol`, and fill what it says.

    Raises:
        DataError: the record is too short for the longest horizon in each part, or has nothing to score.
    """
    record = home.record
    horizon = round(max(protocol.horizons_h) * HOUR_S / record.step_s)
    per_day = DAY_S / record.step_s
    n = record.n_steps
    lengths = [
        min(round(share * n), round(days * per_day))
        for share, days in zip(protocol.shares, protocol.most_days, strict=True)
    ]
    if min(lengths) <= horizon:
        raise DataError(
            f"{home.name}: {n / per_day:.1f} days are too short for forecasts of {max(protocol.horizons_h):g} h in "
            f"a fit, a validation and a test part (shares {protocol.shares}); give a longer record"
        )
    ends = np.minimum(np.cumsum([0, *lengths]), n)
    fit, validation, test = ((int(a), int(b)) for a, b in pairwise(ends))
    record = record.slice(0, int(ends[-1]))
    gap = round(_SHORT_GAP_H * HOUR_S / record.step_s)
    notes: list[str] = []
    T_out, known_out = _weather(record.T_out_C, gap, round(per_day))
    solar, known_sun = _weather(record.solar_W_m2, gap, round(per_day))
    usable = known_out & known_sun
    for name, known in (("outdoor temperature", known_out), ("irradiance", known_sun)):
        if not known.all():
            notes.append(f"{name}: {100 * (1 - known.mean()):.1f} % taken from the day before, not scored")
    levels = {}
    measured_steps = usable[:-1] & usable[1:]
    for name, values in home.meters.items():
        energy = values[: record.n_steps]
        measured_steps &= np.isfinite(energy)
        reference = energy[fit[0] : fit[1]]
        positive = reference[np.isfinite(reference) & (reference > 0)]
        full = float(np.quantile(positive, _FULL_LEVEL_QUANTILE)) if positive.size else 1.0
        levels[name] = np.clip(np.nan_to_num(energy) / full, 0.0, 1.0)
        if not np.isfinite(energy).all():
            notes.append(f"{name}: {100 * (1 - np.isfinite(energy).mean()):.1f} % not metered, not scored")
    truth = record.T_zone_C[0]
    first = next(iter(levels.values()), np.zeros(record.n_steps))
    filled = replace(
        record, T_zone_C=_interpolated(truth, gap)[None], T_out_C=T_out, solar_W_m2=solar, u=first[None]
    )  # fmt: skip
    stride = _stride(validation[1] - validation[0] - horizon, protocol.most_origins)
    out = Prepared(
        home, filled, levels, truth, measured_steps, fit, validation, test, stride, tuple(notes)
    )  # fmt: skip
    for part, name in ((validation, "validation"), (test, "test")):
        if len(out.origins(part, horizon)) < protocol.least_origins:
            raise DataError(
                f"{home.name}: the {name} part has {len(out.origins(part, horizon))} instants to forecast from (need "
                f"{protocol.least_origins}): too many gaps there; choose another stretch with --from and --until"
            )
    return out


def hashes(homes: Sequence[Home]) -> dict[str, str]:
    """SHA-256 of all files behind `homes`, by file name."""
    return {name: digest for home in homes for name, digest in home.source.items()}


def _stride(steps: int, most: int) -> int:
    """Steps between origins: an odd number, so that all hours of the day are among them."""
    stride = max(1, round(steps / most))
    return stride + 1 - stride % 2


def _interpolated(values: Array, most: int) -> Array:
    """`values` with gaps of at most `most` steps between measured ones interpolated."""
    known = np.flatnonzero(np.isfinite(values))
    out = values.copy()
    if known.size > 1:
        between = np.interp(np.arange(values.size), known, values[known], left=np.nan, right=np.nan)
        for a, b in pairwise(known):
            if 1 < b - a <= most + 1:
                out[a + 1 : b] = between[a + 1 : b]
    return out


def _weather(values: Array, most: int, day: int) -> tuple[Array, NDArray[np.bool_]]:
    """`values` without gaps, and where they were measured or interpolated."""
    out = _interpolated(values, most)
    known = np.isfinite(out)
    if not known.any():
        raise DataError("the weather was never measured: map an outdoor temperature, and 0 where there is no sun")
    for t in np.flatnonzero(~known):
        if t >= day and np.isfinite(out[t - day]):
            out[t] = out[t - day]
    left = np.flatnonzero(~np.isfinite(out))
    out[left] = np.interp(left, np.flatnonzero(known), values[known] if known.all() else out[known])
    return out, known
