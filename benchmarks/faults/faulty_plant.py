"""The embedded plant with one fault between two instants, for `tf-mpc bench faults`, `bench fallback` and tests."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from thermoforce_mpc.data import (
    HOUR_S,
    ZERO_C_K,
    Array,
    Boundary,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
    steps_in,
)
from thermoforce_mpc.plants.embedded import EmbeddedPlant, kernel
from thermoforce_mpc.plants.shell import check_levels

Fault = Literal[
    "none", "weak", "window", "sensor", "stuck", "overridden", "frozen", "reads", "offset", "no weather", "no prices",
    "short forecast",
]  # fmt: skip

# Air of the house that an open window replaces, per hour (some 350 W/K), and the sub-step of that exchange, s.
_AIR_CHANGES_PER_H, _EXCHANGE_S = 2.0, 60.0
# Sub-step of a weak machine under native control, s.
_NATIVE_S = 300.0
_SENSOR_OFFSET_K, _SENSOR_LAG_S = 2.0, 1.5 * HOUR_S
# Length of a short forecast, s.
_SHORT_S = 3 * HOUR_S


class FaultyPlant:
    """Wrapper of an embedded plant with `fault` from `from_s` to `to_s`.

    weak: half the compressor speed at every level, while the asked level is reported. window: the air of the house is
    exchanged with outdoor air. sensor: the zone sensor reads 2 K more, with a lag of 1.5 h. stuck: the level stays at
    `level`. overridden: native control, whatever is asked for. frozen: the zone sensor repeats its last reading. reads:
    it reads `reading_C`. offset: it reads `offset_K` more, at once. no weather, no prices, short forecast: the forecast
    has no weather, no prices, or ends after 3 h. The plant's own control has a sensor of its own.
    """

    def __init__(
        self,
        plant: EmbeddedPlant,
        fault: Fault,
        from_s: float,
        to_s: float = math.inf,
        *,
        level: float = 0.0,
        reading_C: float = 0.0,
        offset_K: float = _SENSOR_OFFSET_K,
        reports_u: bool = True,
        meters: bool = True,
    ) -> None:
        """Wrap `plant`.

        Args:
            reports_u: whether the true level is reported; otherwise none is, and the loop takes the level asked for.
            meters: whether heat and power are reported.
        """
        self.plant, self.fault, self.from_s, self.to_s, self.level = plant, fault, from_s, to_s, level
        self.reading_C, self.offset_K = reading_C, offset_K
        self.reports_u, self.meters = reports_u, meters
        self._last_C: Array | None = None
        self._shown_C: Array | None = None

    @property
    def info(self) -> PlantInfo:
        """That of the plant."""
        return self.plant.info

    def period(self, name: str) -> Period:
        """See `EmbeddedPlant.period`."""
        return self.plant.period(name)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `EmbeddedPlant.reset`; the fault must begin later."""
        self._last_C = self._shown_C = None
        return self._reported(self.plant.reset(start_s, warmup_s, price))

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `EmbeddedPlant.forecast`."""
        boundary, fault = self.plant.forecast(horizon_s, interval_s), self._fault_now()
        nothing = np.full_like(boundary.T_out_C, math.nan)
        if fault == "no weather":
            return replace(boundary, T_out_C=nothing, solar_W_m2=nothing)
        if fault == "no prices":
            return replace(boundary, price_per_kWh=nothing[None], heating_price_per_kWh=nothing[None])
        if fault == "short forecast":
            return boundary.head(min(boundary.n_steps, round(_SHORT_S / interval_s)))
        return boundary

    def past(self, step_s: float) -> Record:
        """See `EmbeddedPlant.past`; before the fault, so only the meters are left out."""
        record = self.plant.past(step_s)
        nothing = {name: np.full_like(getattr(record, name), math.nan) for name in ("heat_W", "power_W")}
        return record if self.meters else replace(record, **nothing)

    def kpis(self) -> dict[str, float]:
        """Those of the plant: its true temperature counts, not the sensor's."""
        return self.plant.kpis()

    def close(self) -> None:
        """Close the plant."""
        self.plant.close()

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """See `EmbeddedPlant.advance`."""
        level = check_levels(u, duration_s).u[0]
        fault = self._fault_now()
        if fault == "weak":
            return self._reported(self._weak(level, duration_s))
        if fault == "window":
            return self._reported(self._aired(level, duration_s))
        applied = {"stuck": self.level, "overridden": None}.get(fault, level)
        measurement = self.plant.advance(applied, duration_s)
        if fault == "sensor":
            self._shown_C = measurement.T_zone_C if self._shown_C is None else self._shown_C
            share = 1.0 - math.exp(-duration_s / _SENSOR_LAG_S)
            self._shown_C = self._shown_C + share * (measurement.T_zone_C + _SENSOR_OFFSET_K - self._shown_C)
            measurement = replace(measurement, T_zone_C=self._shown_C)
        elif fault == "frozen" and self._last_C is not None:
            measurement = replace(measurement, T_zone_C=self._last_C)
        elif fault == "reads":
            measurement = replace(measurement, T_zone_C=np.full(1, self.reading_C))
        elif fault == "offset":
            measurement = replace(measurement, T_zone_C=measurement.T_zone_C + self.offset_K)
        self._last_C = measurement.T_zone_C
        return self._reported(measurement)

    def _fault_now(self) -> Fault:
        return self.fault if self.from_s - 1e-6 <= self.plant.now_s < self.to_s - 1e-6 else "none"

    def _weak(self, u: float | None, duration_s: float) -> Measurement:
        """Advance at half the level; under native control that of its PI law, in short sub-steps."""
        n = 1 if u is not None else steps_in(duration_s, _NATIVE_S)
        parts, wanted = [], []
        for _ in range(n):
            s = self.plant.snapshot().values["_scalars"]
            error = s[kernel.SETPOINT] - s[kernel.T_OPERATIVE] + s[kernel.INTEGRAL]
            wanted.append(u if u is not None else min(max(kernel.NATIVE_GAIN * error, 0.0), 1.0))
            parts.append((duration_s / n, self.plant.advance(0.5 * wanted[-1], duration_s / n)))
        return replace(parts[-1][1].averaged_with(parts), u=np.array([np.mean(wanted)]))

    def _aired(self, u: float | None, duration_s: float) -> Measurement:
        """Advance in short sub-steps, each of which replaces a share of the air by outdoor air."""
        n = steps_in(duration_s, _EXCHANGE_S)
        share = 1.0 - math.exp(-_AIR_CHANGES_PER_H * duration_s / n / HOUR_S)
        parts = []
        for _ in range(n):
            measurement = self.plant.advance(u, duration_s / n)
            parts.append((duration_s / n, measurement))
            here = self.plant.snapshot()
            scalars = here.values["_scalars"]
            scalars[kernel.T_AIR] += share * (measurement.T_out_C + ZERO_C_K - scalars[kernel.T_AIR])
            self.plant.restore(here)
        return parts[-1][1].averaged_with(parts)

    def _reported(self, measurement: Measurement) -> Measurement:
        if not self.reports_u:
            measurement = replace(measurement, u=np.full(1, math.nan))
        if self.meters:
            return measurement
        return replace(measurement, heat_W=np.full(1, math.nan), power_W=np.full(1, math.nan))
