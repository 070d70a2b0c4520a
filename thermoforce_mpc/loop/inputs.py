"""What a loop is given: forecasts, an empty one in their place for a while, and what is odd of units and rooms."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from thermoforce_mpc.data import CONDITIONS, DAY_S, HOUR_S, Array, Boundary, Layout, Record
from thermoforce_mpc.data.notes import Note
from thermoforce_mpc.data.prices import price_doubt
from thermoforce_mpc.errors import NoForecast
from thermoforce_mpc.model.forecast_gaps import completed, lengthened

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel


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

    Where it gives none, the step has an empty one (NaN) but for what is `known` all the same, which controllers fill as
    they fill holes. That is said once in the log, and in the notes of every step. After `outage_h` hours without one,
    `NoForecast` ends the run.
    """

    def __init__(self, plant: Forecaster, horizon_s: float, step_s: float, outage_h: float) -> None:
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
            if isinstance(error.known, Boundary):
                forecast = lengthened(error.known, self._n_steps, self._step_s)
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
        what = "the plant gives no forecast, the last one is"
        return Note(f"{what} {age_h:.3g} h old", what, age_h)


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
    notes = list[str]()
    for name in _NEEDED:
        if np.isfinite(getattr(boundary, name)).all():
            continue
        for row, values in enumerate(np.atleast_2d(getattr(boundary, name))):
            missing = np.flatnonzero(~np.isfinite(values))
            if missing.size:
                label = name if np.ndim(getattr(boundary, name)) == 1 else boundary.names.label(name, row)
                ahead_h = (boundary.time_s[missing[0]] - boundary.time_s[0]) / HOUR_S
                what = f"the forecast of {label} has no value at"
                text = f"{what} {missing.size} of {values.size} instants, first {ahead_h:g} h ahead"
                notes.append(Note(text, what, missing.size))
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


# Level above which a machine counts as on, and steps so that a comparison with a model needs; what differs by less than
# the factor is for the watch.
_ON, _LEAST_STEPS, _FAR = 0.1, 8, 30.0
# A ratio so near to the length of a step, h, is that of Wh per step; closer ones may be those of a machine.
_NEAR, _LONGEST_H = 1.2, 0.5


class UnitDoubts:
    """Looks at the begin of a loop and once a day; each doubt is said once, as a warning of the log too.

    `model`: what the controller plans with, if anything; `currency`: of the prices, '' where that is not known.
    """

    def __init__(self, layout: Layout, model: object = None, currency: str = "") -> None:
        self._layout, self._model, self._currency = layout, model, currency
        self._said: set[str] = set()
        self._next_s = -math.inf

    def now(self, record: Record, boundary: Boundary | None = None) -> tuple[str, ...]:
        """What is new in doubt of `record`, at the begin as it was read, and of the prices of a forecast."""
        # Loaded only when a loop runs.
        from thermoforce_mpc.measurements.checks.rooms import room_remarks
        from thermoforce_mpc.measurements.checks.units import unit_remarks
        from thermoforce_mpc.model.thermal_model import ThermalModel

        now_s = float(record.time_s[-1])
        if now_s < self._next_s:
            return ()
        if self._next_s > -math.inf:
            record = record.last(round(DAY_S / record.step_s))
        found = (*unit_remarks(record, self._layout), *room_remarks(record, self._layout))
        doubts = {remark.where: remark.in_words() for remark in found}
        if isinstance(self._model, ThermalModel) and "T_out_C" not in doubts:
            said = " ".join(doubts)
            doubts |= {
                where: words for where, words in _beside_model(record, self._layout, self._model) if where not in said
            }
        self._next_s = now_s + DAY_S
        if boundary is not None:
            prices = (boundary.price_per_kWh, boundary.heating_price_per_kWh)
            fuel = not np.array_equal(*prices, equal_nan=True)
            of_prices = [price_doubt(prices[0], self._currency), price_doubt(prices[1], self._currency, fuel=fuel)]
            doubts["price"] = next(filter(None, of_prices), "")
        new = {where: words for where, words in doubts.items() if words and where not in self._said}
        for words in new.values():
            _LOG.warning("%s", words)
        self._said |= set(new)
        return tuple(new.values())


def _beside_model(record: Record, layout: Layout, model: ThermalModel) -> Iterator[tuple[str, str]]:
    """Meters of machines with one actuator, and of heat, far from what a model says of the known levels, in words."""
    T_out, names = record.T_out_C[:-1], record.names
    for a, m in enumerate(layout.machine_of):
        u = np.clip(record.u[a], layout.u_min[a], 1.0)
        power, law = model.power[m], model.operator.of_actuator(a).heat_input.law
        meters = []
        if power is not None and len(layout.fed_by(m)) == 1:
            power = power.seen(record.u[[a]], record.time_s[:-1], T_out, record.power_W[m])
            expected_W = power.metered(u, record.time_s[:-1], T_out, record.T_return_C[m])
            meters.append((names.label("power_W", m), record.power_W[m], expected_W))
        if law is not None:
            meters.append((names.label("heat_W", a), np.abs(record.heat_W[a]), law(np.maximum(u, 0.0), T_out)))
        for where, load_W, expected_W in meters:
            rows = (np.abs(u) > _ON) & np.isfinite(load_W) & (expected_W > 0.0)
            if rows.sum() >= _LEAST_STEPS:
                ratio = float(np.median(load_W[rows] / expected_W[rows]))
                if unit := _unit_by(ratio, record.step_s / HOUR_S):
                    words = f"{ratio:.3g} of what the model expects at these levels; {unit}: convert it at the meter"
                    yield where, f"unit of power: {where}: {words}"


def _unit_by(ratio: float, step_h: float) -> str:
    """The unit that a meter probably has, by what it shows over the W expected; '' where W is."""
    if ratio > _FAR:
        return "mW, or W taken for kW, is likelier than W"
    if step_h <= _LONGEST_H and 1.0 / _NEAR < ratio / step_h < _NEAR:
        return "Wh per step is likelier than W, or the machine gives much less than it did"
    if not 0.0 < ratio < 1.0 / _FAR:
        return ""
    factors = {"kW": 1e-3, "kWh per step": 1e-3 * step_h}
    unit, factor = min(factors.items(), key=lambda one: abs(math.log(ratio / one[1])))
    return f"{unit} is likelier than W" if factor / _FAR < ratio < factor * _FAR else ""
