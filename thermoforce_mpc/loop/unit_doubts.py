"""Readings and prices of a loop that are probably in another unit than is expected."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from thermoforce_mpc.boundary.tariffs import price_doubt
from thermoforce_mpc.data import DAY_S, HOUR_S, Boundary, Layout, Record

if TYPE_CHECKING:  # loaded only when a loop runs
    from thermoforce_mpc.model.thermal_model import ThermalModel

_LOG = logging.getLogger(__name__)
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
        from thermoforce_mpc.measurements.checks.units import unit_remarks
        from thermoforce_mpc.model.thermal_model import ThermalModel

        now_s = float(record.time_s[-1])
        if now_s < self._next_s:
            return ()
        if self._next_s > -math.inf:
            record = record.last(round(DAY_S / record.step_s))
        doubts = {remark.where: remark.in_words() for remark in unit_remarks(record, self._layout)}
        if isinstance(self._model, ThermalModel) and "T_out_C" not in doubts:
            said = " ".join(doubts)
            doubts |= {
                where: words for where, words in _beside_model(record, self._layout, self._model) if where not in said
            }
        self._next_s = now_s + DAY_S
        if boundary is not None:
            prices = (boundary.price_per_kWh, boundary.heating_price_per_kWh)
            fuel = not np.array_equal(*prices, equal_nan=True)
            found = [price_doubt(prices[0], self._currency), price_doubt(prices[1], self._currency, fuel=fuel)]
            doubts["price"] = next(filter(None, found), "")
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
