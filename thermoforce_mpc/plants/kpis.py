"""Key performance indicators as BOPTEST defines them, used for every plant.

Definitions: BOPTEST documentation (Blum et al. 2021, doi:10.1080/19401493.2021.1986574): 30-s samples, integrals by the
trapezoidal rule, per square metre of floor, peak as the highest mean of the samples of 15 minutes. As in its service,
windows count from the first sample, a sample is of the window that it begins or lies in, and the last window counts
however few samples it has: after a whole number of quarters the present power is a window of its own.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import DataError

PEAK_WINDOW_S = 900.0
# Smallest time difference between two samples, s.
_CLOCK_S = 1e-6
# The peak KPI of each energy carrier that has one, by BOPTEST's names.
PEAKS = {"ElectricPower": "pele_tot", "GasPower": "pgas_tot", "DistrictHeatingPower": "pdih_tot"}


@dataclass(frozen=True)
class EnergySupply:
    """Energy carrier ('ElectricPower', 'GasPower', ...) of a building over n samples, arrays of shape (n,).

    `power_W` W, `price_per_kWh` currency/kWh, `emission_kg_per_kWh` kg CO2/kWh. `of_steps`: `power_W` is the mean of
    the step that ends at each sample, as plants with long steps know it.
    """

    carrier: str
    power_W: Array
    price_per_kWh: Array
    emission_kg_per_kWh: Array
    of_steps: bool = False

    def integrated_h(self, time_s: Array, weights: Array) -> Array:
        """Return the weights (n,), h, by which `power_W` is integrated; `weights`: those of samples."""
        return np.append(0.0, np.diff(time_s) / HOUR_S) if self.of_steps else weights

    def in_force(self, values: Array) -> Array:
        """Return price or emission (n,) that `power_W` counts with: of a step that of its begin."""
        return np.concatenate([values[:1], values[:-1]]) if self.of_steps else values


@dataclass(frozen=True)
class Violation:
    """Bound violation of one zone's signal: `excess` (n,) is nonnegative, K or ppm."""

    zone: str
    excess: Array


def building_kpis(
    time_s: Array,
    *,
    supplies: Sequence[EnergySupply],
    thermal: Sequence[Violation],
    air_quality: Sequence[Violation],
    area_m2: float,
    open_end: bool = True,
) -> dict[str, float]:
    """Return the KPIs of a building with any number of zones and energy carriers over samples at `time_s` (n,), s.

    Energy, cost and emissions are summed over carriers; discomfort is the mean over zones. KPIs without data (no zone
    with CO2, no gas) are omitted. `open_end`: whether the last sample counts for the peak.

    Returns:
        `ener_tot` kWh/m², `cost_tot` currency/m², `emis_tot` kg/m², `tdis_tot` K·h, `idis_tot` ppm·h, and `pele_tot`,
        `pgas_tot`, `pdih_tot` kW/m². With several zones also `tdis_tot[zone]`, the discomfort of each, K·h.

    Raises:
        DataError: arrays differ in length, time does not increase, or a value is not finite.
    """
    weights = _trapezoid_h(time_s)
    if not weights.size:
        raise DataError("KPIs: time must increase over at least two samples")
    for supply in supplies:
        for name in ("power_W", "price_per_kWh", "emission_kg_per_kWh"):
            _check(getattr(supply, name), time_s, weights, f"{name} of {supply.carrier}")
    for zone in (*thermal, *air_quality):
        _check(zone.excess, time_s, weights, f"zone {zone.zone}")
    totals = {"ener_tot": 0.0, "cost_tot": 0.0, "emis_tot": 0.0}
    for supply in supplies:
        kW = supply.power_W / 1e3 / area_m2
        weighted = supply.integrated_h(time_s, weights) * kW
        totals["ener_tot"] += float(weighted.sum())
        totals["cost_tot"] += float(weighted @ supply.in_force(supply.price_per_kWh))
        totals["emis_tot"] += float(weighted @ supply.in_force(supply.emission_kg_per_kWh))
    for name, zones in (("tdis_tot", thermal), ("idis_tot", air_quality)):
        if zones:
            integrals = [float(weights @ zone.excess) for zone in zones]
            totals[name] = sum(integrals) / len(integrals)
            if name == "tdis_tot" and len(zones) > 1:
                totals |= _of_each_zone(name, zones, integrals)
    for supply in supplies:
        if supply.carrier in PEAKS:
            peak_W = peak_power(time_s, supply.power_W, of_steps=supply.of_steps, open_end=open_end)
            totals[PEAKS[supply.carrier]] = peak_W / 1e3 / area_m2
    return totals


def _trapezoid_h(time_s: Array) -> Array:
    """Weights (n,), h, by which samples at `time_s` (n,), s, are integrated; none if time does not increase."""
    if np.size(time_s) < 2:
        return np.empty(0)
    half_h = np.subtract(time_s[1:], time_s[:-1]) / (2.0 * HOUR_S)
    if not half_h.min() > 0.0:  # also NaN
        return np.empty(0)
    weights = np.empty(time_s.size)
    weights[:-1], weights[-1] = half_h, 0.0
    weights[1:] += half_h
    return weights


def _of_each_zone(name: str, zones: Sequence[Violation], integrals: Sequence[float]) -> dict[str, float]:
    grouped: dict[str, list[float]] = {}
    for zone, integral in zip(zones, integrals, strict=True):
        grouped.setdefault(f"{name}[{zone.zone}]", []).append(integral)
    return {key: float(np.mean(values)) for key, values in grouped.items()} if len(grouped) > 1 else {}


def zone_kpis(kpis: Mapping[str, float]) -> dict[str, float]:
    """Return the discomfort `tdis_tot[zone]` of each zone, K·h, by zone; empty for one zone."""
    return {key[len("tdis_tot[") : -1]: value for key, value in kpis.items() if key.startswith("tdis_tot[")}


def _check(values: Array, time_s: Array, weights: Array, name: str) -> None:
    if np.shape(values) != np.shape(time_s):
        raise DataError(f"KPIs: {name} has {np.size(values)} values for {np.size(time_s)} samples; it needs one each")
    # All weights are positive: the integral is finite where all values are, and quicker than looking at each.
    if not math.isfinite(weights @ values) and not np.isfinite(values).all():
        first = float(time_s[int(np.argmin(np.isfinite(values)))])
        raise DataError(f"KPIs: {name} is not a finite number at {first:g} s")


Between = Callable[[float, float, bool], dict[str, float]]


@dataclass(frozen=True)
class CountedKpis:
    """Cached KPIs of a growing record, so that samples up to `until_s` need not be read again.

    `until_s` lies a whole number of 15-min peak windows after the first sample; `kpis` cover the samples up to it, None
    before the first whole window. Integrals of adjacent parts are summed; the peak is their maximum.
    `between(i, j, open_end)` returns the KPIs of the samples from time i to time j, both included, j > i.
    """

    until_s: float
    kpis: Mapping[str, float] | None = None

    def counting(self, edge_s: float, between: Between) -> CountedKpis:
        """Return the cache extended to `edge_s`, the time of a sample a whole number of windows after `until_s`."""
        if edge_s == self.until_s:
            return self
        return CountedKpis(edge_s, self._and(between(self.until_s, edge_s, False)))

    def latest_edge_s(self, time_s: Array, start_s: float) -> float:
        """Return the latest of `time_s` (n,), s, that ends a peak window since `start_s`, else `until_s`."""
        final_s = float(time_s[-1])
        if final_s > self.until_s + _CLOCK_S and (final_s - start_s + _CLOCK_S) % PEAK_WINDOW_S < 2 * _CLOCK_S:
            return final_s  # as after every step of whole quarters
        into_s = (time_s - start_s + _CLOCK_S) % PEAK_WINDOW_S
        instants = np.flatnonzero((into_s < 2 * _CLOCK_S) & (time_s > self.until_s + _CLOCK_S))
        return float(time_s[instants[-1]]) if instants.size else self.until_s

    def up_to(self, now_s: float, between: Between) -> dict[str, float]:
        """Return the KPIs of all samples up to `now_s`."""
        if now_s != self.until_s:
            return self._and(between(self.until_s, now_s, True))
        if self.kpis is None:
            return {}
        # The sample of now begins a window.
        last = between(now_s - PEAK_WINDOW_S, now_s, True)
        return {name: max(value, last[name]) if name in PEAKS.values() else value for name, value in self.kpis.items()}

    def _and(self, later: dict[str, float]) -> dict[str, float]:
        if self.kpis is None:
            return later
        joined = {name: max if name in PEAKS.values() else operator.add for name in self.kpis}
        return {name: joined[name](value, later[name]) for name, value in self.kpis.items()}


def peak_power(time_s: Array, power_W: Array, *, of_steps: bool = False, open_end: bool = True) -> float:
    """Return the highest mean of samples over 15-min windows from the first one, W; without `open_end` less the last.

    Of steps: the highest mean of power over whole windows, or over all of a shorter time.
    """
    if of_steps:
        span_s = float(time_s[-1] - time_s[0])
        return float(np.max(window_means(time_s, power_W[1:], min(PEAK_WINDOW_S, span_s))))
    n = time_s.size if open_end else time_s.size - 1
    windows = ((time_s[:n] - time_s[0] + _CLOCK_S) // PEAK_WINDOW_S).astype(np.intp)
    sums_W, counts = np.bincount(windows, power_W[:n]), np.bincount(windows)
    return float((sums_W[counts > 0] / counts[counts > 0]).max())


def window_means(time_s: Array, means: Array, window_s: float) -> Array:
    """Return means over consecutive windows of `window_s`; `means` (n − 1,) are those between `time_s` (n,), s."""
    return means_between(time_s, means, np.arange(time_s[0], time_s[-1] + _CLOCK_S, window_s))
