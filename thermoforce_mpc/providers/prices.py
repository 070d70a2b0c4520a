"""Day-ahead prices and tariffs per kWh: ENTSO-E, aWATTar, Tibber, Nord Pool, EnergyZero, Octopus."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import urlsplit
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.files import secret_from
from thermoforce_mpc.protocols import Answer
from thermoforce_mpc.providers.service import PRICE, Service, documented, parsed, stamped

_DAY = pd.Timedelta(days=1)
_PER_MWH = 1e-3
_MOST_PAGES = 20
_RESOLUTIONS = {"PT15M": 900.0, "PT30M": 1800.0, "PT60M": 3600.0, "PT1H": 3600.0}


class Entsoe(Service):
    """ENTSO-E Transparency Platform: day-ahead prices of a bidding zone; needs a token of yours"""

    attribution: ClassVar[str] = "Prices by ENTSO-E Transparency Platform"

    def __init__(
        self, area: str = "", token_file: Path | None = None, url: str = "https://web-api.tp.entsoe.eu"
    ) -> None:
        """Of a bidding zone.

        Args:
            area: its EIC code, as 10Y1001A1001A82H for Germany and Luxembourg.
            token_file: file of mode 600 with the security token; without it the environment variable ENTSOE_TOKEN.
            url: its address.
        """
        super().__init__(url)
        if not re.fullmatch(r"[0-9A-Z-]{16}", area):
            raise ConfigError(f"provider entsoe: area: {area!r}: expected an EIC code, as 10Y1001A1001A82H")
        self._area, self._token = area, secret_from(token_file, ("ENTSOE_TOKEN",), "provider entsoe: token_file")

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`."""
        begin = (now - _DAY).floor("1D")
        _, body, _ = self.get(
            "/api",
            {
                "securityToken": self._token, "documentType": "A44", "in_Domain": self._area, "out_Domain": self._area,
                "periodStart": f"{begin:%Y%m%d%H%M}", "periodEnd": f"{begin + 4 * _DAY:%Y%m%d%H%M}",
            },
        )  # fmt: skip
        return _table(self.url, entsoe_rows(body, self.url))


def entsoe_rows(body: bytes, where: str) -> list[tuple[pd.Timestamp, float, float]]:
    """Begin, length in s and price per kWh of each part of a Publication_MarketDocument.

    Of the curve A03 a position that is left out has the price of the one before (ENTSO-E, Introduction of different
    time series possibilities with IEC 62325-451, 2.3.3). Of several resolutions of one time the finest counts, and of
    several auctions the first. Raises `PlantError`.
    """
    if b"<!DOCTYPE" in body or b"<!ENTITY" in body:
        raise PlantError(f"{where}: declares entities, which prices have none of")
    try:
        root = ElementTree.fromstring(body)
    except ElementTree.ParseError as error:
        raise PlantError(f"{where}: no XML ({error})") from error
    if _name(root) != "Publication_MarketDocument":
        told = [node.text for node in root.iter() if _name(node) == "text"]
        raise PlantError(f"{where}: {'; '.join(filter(None, told)) or _name(root)}")
    found: dict[pd.Timestamp, tuple[float, int, float]] = {}
    for series in _all(root, "TimeSeries"):
        unit = _text(series, "price_Measure_Unit.name", "MWH")
        if unit.upper() != "MWH":
            raise PlantError(f"{where}: prices per {unit}, not per MWH")
        auction = int(_text(series, "classificationSequence_AttributeInstanceComponent.position", "1"))
        for period in _all(series, "Period"):
            resolution = _text(period, "resolution", "")
            if resolution not in _RESOLUTIONS:
                raise PlantError(f"{where}: resolution {resolution!r}")
            step_s = _RESOLUTIONS[resolution]
            begin, end = stamped([_text(period, "start", ""), _text(period, "end", "")], where)
            count = round((end - begin).total_seconds() / step_s)
            points = {
                int(_text(point, "position", "0")): float(_text(point, "price.amount", "nan"))
                for point in _all(period, "Point")
            }
            if not points or min(points) < 1 or max(points) > count or count > 4 * 24 * 31:
                raise PlantError(f"{where}: positions that do not fit the interval {begin} to {end}")
            price, last = float("nan"), count if _text(series, "curveType", "A03") == "A03" else max(points)
            for position in range(1, last + 1):
                price = points.get(position, price if last == count else float("nan"))
                at = begin + pd.Timedelta(seconds=(position - 1) * step_s)
                rank = (step_s, auction)
                if at not in found or rank < found[at][:2]:
                    found[at] = (*rank, price)
    if not found:
        raise PlantError(f"{where}: no prices")
    return [(at, step_s, price * _PER_MWH) for at, (step_s, _, price) in found.items()]


class Awattar(Service):
    """aWATTar: day-ahead prices of Germany or Austria, without a key"""

    attribution: ClassVar[str] = "Prices by aWATTar (EPEX SPOT)"

    def __init__(self, url: str = "https://api.awattar.de") -> None:
        """Of a country.

        Args:
            url: https://api.awattar.de or https://api.awattar.at.
        """
        super().__init__(url)

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`."""
        begin = (now - _DAY).floor("1D")
        asked = {"start": _ms(begin), "end": _ms(begin + 4 * _DAY)}
        said = parsed(self.get("/v1/marketdata", asked)[1], self.url)
        with documented(self.url):
            rows = []
            for one in said["data"]:
                if one["unit"].lower() != "eur/mwh":
                    raise PlantError(f"{self.url}: prices in {one['unit']}, not in Eur/MWh")
                at = pd.Timestamp(one["start_timestamp"], unit="ms", tz="UTC")
                length_s = (one["end_timestamp"] - one["start_timestamp"]) / 1000.0
                rows.append((at, length_s, float(one["marketprice"]) * _PER_MWH))
        return _table(self.url, rows)


class Tibber(Service):
    """Tibber: what its customers pay, taxes included; needs a token of yours"""

    attribution: ClassVar[str] = "Prices by Tibber"

    def __init__(self, token_file: Path | None = None, home: int = 0, url: str = "https://api.tibber.com") -> None:
        """Of a home.

        Args:
            token_file: file of mode 600 with the token; without it the environment variable TIBBER_TOKEN.
            home: which of the account's homes, from 0.
            url: its address.
        """
        super().__init__(url)
        self._home, self._token = home, secret_from(token_file, ("TIBBER_TOKEN",), "provider tibber: token_file")

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`."""
        prices = "today{total startsAt} tomorrow{total startsAt}"
        query = f"{{viewer{{homes{{currentSubscription{{priceInfo(resolution:QUARTER_HOURLY){{{prices}}}}}}}}}}}"
        body = self.get("/v1-beta/gql", headers={"Authorization": f"Bearer {self._token}"}, json={"query": query})[1]
        said = parsed(body, self.url)
        if said.get("errors"):
            raise PlantError(f"{self.url}: {said['errors'][0].get('message', 'an error')}")
        with documented(self.url):
            homes = said["data"]["viewer"]["homes"]
            if self._home >= len(homes) or homes[self._home]["currentSubscription"] is None:
                raise PlantError(f"{self.url}: the account has no home {self._home} with a subscription")
            info = homes[self._home]["currentSubscription"]["priceInfo"]
            rows = [*info["today"], *info["tomorrow"]]
            at = stamped([row["startsAt"] for row in rows], self.url)
            values = [float("nan") if row["total"] is None else float(row["total"]) for row in rows]
        return _table(self.url, list(zip(at, _lengths_s(at), values, strict=True)))


class NordPool(Service):
    """Nord Pool: day-ahead prices of a delivery area, for private use under its terms"""

    attribution: ClassVar[str] = "Prices by Nord Pool"

    def __init__(
        self, area: str = "", currency: str = "EUR", url: str = "https://dataportal-api.nordpoolgroup.com"
    ) -> None:
        """Of a delivery area.

        Args:
            area: as SE3, NO1, DK1, FI or EE.
            currency: as EUR, SEK, NOK or DKK.
            url: its address.
        """
        super().__init__(url)
        if not area.isalnum():
            raise ConfigError(f"provider nord-pool: area: {area!r}: expected one such as SE3")
        self._area, self._currency = area, currency

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`; its days are those of Central European time."""
        today = now.tz_convert("Europe/Brussels")
        rows: list[tuple[pd.Timestamp, float, float]] = []
        for day in (today - _DAY, today, today + _DAY):
            asked = {"date": f"{day:%Y-%m-%d}", "market": "DayAhead", "deliveryArea": self._area,
                     "currency": self._currency}  # fmt: skip
            status, body, _ = self.get("/api/DayAheadPrices", asked, accepted=(200, 204))
            if status == 204:  # not yet known
                continue
            said = parsed(body, self.url)
            with documented(self.url):
                if said["currency"] != self._currency:
                    raise PlantError(f"{self.url}: prices in {said['currency']}, not in {self._currency}")
                for one in said["multiAreaEntries"]:
                    begin, end = stamped([one["deliveryStart"], one["deliveryEnd"]], self.url)
                    price = float(one["entryPerArea"][self._area]) * _PER_MWH
                    rows.append((begin, (end - begin).total_seconds(), price))
        return _table(self.url, rows)


class EnergyZero(Service):
    """EnergyZero: day-ahead prices of the Netherlands, without a key"""

    attribution: ClassVar[str] = "Prices by EnergyZero"

    def __init__(self, with_tax: bool = True, url: str = "https://api.energyzero.nl") -> None:
        """Of the Netherlands.

        Args:
            with_tax: whether with value added tax.
            url: its address.
        """
        super().__init__(url)
        self._with_tax = with_tax

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`."""
        begin = (now.tz_convert("Europe/Amsterdam") - _DAY).floor("1D").tz_convert("UTC")
        asked = {"fromDate": _iso_ms(begin), "tillDate": _iso_ms(begin + 4 * _DAY), "interval": 4, "usageType": 1,
                 "inclBtw": str(self._with_tax).lower()}  # fmt: skip
        said = parsed(self.get("/v1/energyprices", asked)[1], self.url)
        with documented(self.url):
            at = stamped([one["readingDate"] for one in said["Prices"]], self.url)
            values = [float(one["price"]) for one in said["Prices"]]
        return _table(self.url, list(zip(at, _lengths_s(at), values, strict=True)))


class Octopus(Service):
    """Octopus Energy: half-hourly unit rates of a British tariff, without a key"""

    attribution: ClassVar[str] = "Prices by Octopus Energy"

    def __init__(
        self, product: str = "", tariff: str = "", with_tax: bool = True, url: str = "https://api.octopus.energy"
    ) -> None:
        """Of a tariff.

        Args:
            product: as AGILE-24-10-01.
            tariff: as E-1R-AGILE-24-10-01-C, whose last letter is the region.
            with_tax: whether with value added tax.
            url: its address.
        """
        super().__init__(url)
        if not (re.fullmatch(r"[\w-]+", product) and re.fullmatch(r"[\w-]+", tariff)):
            raise ConfigError("provider octopus: give product and tariff, as AGILE-24-10-01 and E-1R-AGILE-24-10-01-C")
        self._path = f"/v1/products/{product}/electricity-tariffs/{tariff}/standard-unit-rates/"
        self._column = "value_inc_vat" if with_tax else "value_exc_vat"

    def answer(self, now: pd.Timestamp, state: dict[str, str]) -> Answer:
        """See `Provider`; rates are in pence."""
        begin = (now - _DAY).floor("1D")
        end = begin + 4 * _DAY
        asked: dict[str, Any] | None = {"period_from": _minute(begin), "period_to": _minute(end), "page_size": 1000}
        path, rows = self._path, list[tuple[pd.Timestamp, float, float]]()
        for _ in range(_MOST_PAGES):
            said = parsed(self.get(path, asked)[1], self.url)
            with documented(self.url):
                for one in said["results"]:
                    ends = one["valid_to"] or end.isoformat()  # a rate without an end holds on
                    start, until = stamped([one["valid_from"], ends], self.url)
                    start = max(start, begin)
                    while start < min(until, end):
                        rows.append((start, 1800.0, float(one[self._column]) / 100.0))
                        start += pd.Timedelta(seconds=1800)
                following = said["next"]
            if not following:
                return _table(self.url, rows)
            there = urlsplit(following)
            path, asked = f"{there.path}?{there.query}", None  # of the same host, whatever it says
        raise PlantError(f"{self.url}: more than {_MOST_PAGES} pages")


def _table(where: str, rows: list[tuple[pd.Timestamp, float, float]]) -> Answer:
    """Prices at the finest length there is, a longer one where no finer one stands; a hole stays one."""
    if not rows:
        raise PlantError(f"{where}: no prices")
    shortest = min(length_s for _, length_s, _ in rows)
    if not 60.0 <= shortest <= 86400.0:
        raise PlantError(f"{where}: prices for {shortest:g} s at a time")
    values: dict[pd.Timestamp, float] = {}
    for at, length_s, price in sorted(rows, key=lambda row: -row[1]):
        for k in range(max(1, round(length_s / shortest))):
            values[at + pd.Timedelta(seconds=k * shortest)] = price
    index = pd.DatetimeIndex(sorted(values))
    return Answer(pd.DataFrame({PRICE: [values[at] for at in index]}, index=index), holds_s=shortest)


def _lengths_s(at: pd.DatetimeIndex) -> list[float]:
    """How long each price holds, s: until the next, at most as long as is usual."""
    between = np.diff(np.sort(at.as_unit("s").asi8))
    usual = float(np.median(between)) if between.size else 3600.0
    return [usual] * len(at)


def _ms(at: pd.Timestamp) -> int:
    return int(at.timestamp() * 1000)


def _minute(at: pd.Timestamp) -> str:
    return f"{at:%Y-%m-%dT%H:%MZ}"


def _iso_ms(at: pd.Timestamp) -> str:
    return f"{at:%Y-%m-%dT%H:%M:%S}.000Z"


def _name(node: ElementTree.Element) -> str:
    return node.tag.rpartition("}")[2]


def _all(node: ElementTree.Element, name: str) -> Iterable[ElementTree.Element]:
    return [child for child in node.iter() if _name(child) == name]


def _text(node: ElementTree.Element, name: str, default: str) -> str:
    return next((child.text or "" for child in node.iter() if _name(child) == name), default).strip()
