"""What prices of energy are of, and whether they may be of a kWh: a wrong unit makes heat free, or unaffordable."""

from __future__ import annotations

import re
from typing import Literal

import numpy as np

from thermoforce_mpc.data.clock import Array

PriceUnit = Literal["per kWh", "per MWh", "cent per kWh", "cent per MWh"]
"""What a price is of: hundredths of its currency are cents."""
# Means of energy that is sold in EUR or USD: gas in the cheapest years, and electricity in the dearest.
_USUAL_PRICES, _USUAL_IN = (0.01, 2.0), ("EUR", "USD")
# Hundredths of a currency, in the name of a column of its prices.
_CENTS = re.compile(r"(?i)(?<![^\W\d_])(?:ct|(?:euro?[ -]?)?cents?|öre|øre|pence|[cp](?= ?/ ?[km]wh))(?![^\W\d_])|¢")
# A code of three capitals before the unit, as "JPY/kWh" or "SEK per MWh".
_CURRENCY = re.compile(r"(?<![A-Z])([A-Z]{3})(?: ?/ ?|[ _]per[ _]|_)[kM]Wh")


def currency_of(name: str) -> str:
    """The currency that the name of a column of prices tells, as JPY of 'price JPY/kWh'; '' where it tells none."""
    told = _CURRENCY.search(name)
    return told[1] if told else ""


def price_unit_of(name: str) -> PriceUnit | None:
    """The unit that the name of a column of prices tells, as 'cent per kWh' of 'Preis ct/kWh'; None: it tells none."""
    energy = re.search(r"(?i)([km])wh", name)
    cents = _CENTS.search(name) is not None
    if energy is None:
        return "cent per kWh" if cents else None
    if energy[1].lower() == "m":
        return "cent per MWh" if cents else "per MWh"
    return "cent per kWh" if cents else "per kWh"


def price_doubt(price: Array, currency: str = "", *, fuel: bool = False) -> str:
    """What is doubtful about the size of prices per kWh in EUR or USD; '' where nothing is.

    `fuel`: of another carrier than electricity, which may be a tenth as dear: gas of `bestest_air` costs 0.0029 USD.
    """
    if currency and currency not in _USUAL_IN:
        return ""
    known = np.abs(price[np.isfinite(price)])
    mean, (low, high) = (float(known.mean()) if known.size else 0.0), _USUAL_PRICES
    low = low / 10.0 if fuel else low
    # Of prices of an exchange a night may cost next to nothing: the dearest hour says more.
    if mean == 0.0 or (mean <= high and known.max() >= low):
        return ""
    unit = "per MWh, or in cents" if mean > high else "too low by a factor of 10, 100 or 1000"
    other = "" if currency else ", or in another currency"
    return (
        f"prices of {mean:.3g} per kWh on average, where {low:g} to {high:g} {currency or ' or '.join(_USUAL_IN)} are "
        f"usual: are they {unit}{other}?"
    )
