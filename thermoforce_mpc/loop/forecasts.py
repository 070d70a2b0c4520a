"""The forecasts of a run: what the plant gives, and an empty one in its place where it gives none for a while."""

from __future__ import annotations

import logging
from typing import Any, Protocol

import numpy as np

from thermoforce_mpc.data import CONDITIONS, HOUR_S, Array, Boundary, Layout, Record
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.model.forecast_gaps import completed, lengthened

_LOG = logging.getLogger(__name__)

OUTAGE_H = 48.0
"""Time without a forecast after which a run ends, h."""


class Forecaster(Protocol):
    """What gives forecasts: a plant, or a building."""

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`."""
        ...


class Forecasts:
    """Gets the forecast of each step from the plant.

    Where it gives none, the step has an empty one (NaN), which controllers fill as they fill holes. That is said once
    in the log, and in the notes of every step. After `outage_h` hours without one, `NoForecast` ends the run.
    """

    def __init__(self, plant: Forecaster, horizon_s: float, step_s: float, outage_h: float = OUTAGE_H) -> None:
        self._plant, self._step_s, self._outage_h = plant, step_s, outage_h
        self._horizon_s, self._n_steps = horizon_s, round(horizon_s / step_s)
        self._last: Boundary | None = None
        self._missing_since_s: float | None = None

    def now(self, history: Record) -> tuple[Boundary, Boundary, tuple[str, ...]]:
        """The forecast from the end of `history` on, as given (NaN where nothing is known) and completed, and notes.

        Raises:
            NoForecast: the plant gives none, and never gave one in this run or none for `outage_h`.
        """
        now_s = float(history.time_s[-1])
        notes: tuple[str, ...]
        try:
            forecast = self._plant.forecast(self._horizon_s, self._step_s)
        except NoForecast as error:
            forecast, notes = empty_forecast(history, self._n_steps, self._step_s), (self._without(error, now_s),)
        else:
            forecast = lengthened(forecast, self._n_steps, self._step_s)
            notes = holes(forecast)
            if self._missing_since_s is not None:
                hours = (now_s - self._missing_since_s) / HOUR_S
                _LOG.warning("there is a forecast again, after %.3g h without", hours)
                notes = (f"there is a forecast again, after {hours:.3g} h without", *notes)
            self._missing_since_s = None
        filled, _ = completed(forecast, history, self._last) if notes else (forecast, "")
        if self._missing_since_s is None:
            self._last = filled
        return forecast, filled, notes

    def _without(self, error: NoForecast, now_s: float) -> str:
        """What is said of a step without a forecast; raises `error` where that is too much."""
        if self._last is None:
            raise error
        age_h = (now_s - float(self._last.time_s[0])) / HOUR_S
        if age_h > self._outage_h:
            raise NoForecast(
                f"{error}\nThere was no forecast for {age_h:.3g} h, longer than plant.forecast_outage_h allows "
                f"({self._outage_h:g} h)"
            ) from error
        if self._missing_since_s is None:
            self._missing_since_s = now_s
            if not error.past:
                _LOG.warning("%s: the last forecast stands in, for up to %g h", error, self._outage_h)
        return f"the plant gives no forecast, the last one is {age_h:.3g} h old"


def empty_forecast(history: Record, n_steps: int, step_s: float) -> Boundary:
    """A forecast from the end of `history` on that knows nothing (NaN)."""
    values: dict[str, Any] = {"time_s": history.time_s[-1:]}
    for name in CONDITIONS[1:]:
        rows = () if name in ("T_out_C", "solar_W_m2") else (history.names.rows(name),)
        values[name] = np.full((*rows, 1), np.nan)
    return lengthened(Boundary(**values, names=history.names), n_steps, step_s)


# Signals of a forecast that a plan needs.
_NEEDED = tuple(name for name in CONDITIONS if name not in ("occupancy", "emission_kg_per_kWh"))


def holes(boundary: Boundary) -> tuple[str, ...]:
    """One note per signal of a forecast that has no value at some instants."""
    notes = []
    for name in _NEEDED:
        for row, values in enumerate(np.atleast_2d(getattr(boundary, name))):
            missing = np.flatnonzero(~np.isfinite(values))
            if missing.size:
                label = name if np.ndim(getattr(boundary, name)) == 1 else boundary.names.label(name, row)
                ahead_h = (boundary.time_s[missing[0]] - boundary.time_s[0]) / HOUR_S
                notes.append(
                    f"the forecast of {label} has no value at {missing.size} of {values.size} instants, first "
                    f"{ahead_h:g} h ahead"
                )
    return tuple(notes)


def price_paid(u: Array, price: Array, heating_price: Array, layout: Layout) -> Array:
    """Price of each machine's energy (M, n): that of heating unless an actuator of it cools at levels `u` (A, n)."""
    paid = price.copy()
    for m in range(price.shape[0]):
        fed = [a for a in layout.fed_by(m) if layout.signs[a] > 0]
        if fed:
            heats = (np.nan_to_num(u[fed]) >= 0).all(axis=0)
            paid[m] = np.where(heats, heating_price[m], price[m])
    return paid
