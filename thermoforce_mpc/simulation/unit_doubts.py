"""Readings and prices of a loop that are probably in another unit than is expected."""

from __future__ import annotations

import logging
import math

from thermoforce_mpc.boundary.tariffs import price_doubt
from thermoforce_mpc.data import DAY_S, Boundary, Layout, Record

_LOG = logging.getLogger(__name__)


class UnitDoubts:
    """Looks at the begin of a loop and once a day; each doubt is said once, as a warning of the log too.

    Args:
        layout: what acts where.
        model: what the controller plans with, if anything.
        currency: of the prices; '' where that is not known.
    """

    def __init__(self, layout: Layout, model: object = None, currency: str = "") -> None:
        self._layout, self._model, self._currency = layout, model, currency
        self._said: set[str] = set()
        self._next_s = -math.inf

    def now(self, record: Record, boundary: Boundary | None = None) -> tuple[str, ...]:
        """What is new in doubt of `record`, at the begin as it was read, and of the prices of a forecast."""
        # Loaded only when a loop runs.
        from thermoforce_mpc.identification.checks.units import unit_remarks
        from thermoforce_mpc.model.thermal_model import ThermalModel

        now_s = float(record.time_s[-1])
        if now_s < self._next_s:
            return ()
        if self._next_s > -math.inf:
            record = record.last(round(DAY_S / record.step_s))
        model = self._model if isinstance(self._model, ThermalModel) else None
        doubts = {remark.where: remark.in_words() for remark in unit_remarks(record, self._layout, model)}
        self._next_s = now_s + DAY_S
        if boundary is not None:
            prices = (boundary.price_per_kWh, boundary.heating_price_per_kWh)
            doubts["price"] = next(filter(None, (price_doubt(price, self._currency) for price in prices)), "")
        new = {where: words for where, words in doubts.items() if words and where not in self._said}
        for words in new.values():
            _LOG.warning("%s", words)
        self._said |= set(new)
        return tuple(new.values())
