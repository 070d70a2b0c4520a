"""A service asked over HTTPS within bounds: time, size, no redirect, no proxy set outside; no secret in errors."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from email.utils import parsedate_to_datetime
from typing import Any, ClassVar
from urllib.parse import urlsplit

import pandas as pd
import requests

from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.files import is_loopback, no_secret_in
from thermoforce_mpc.version import VERSION

OUTDOOR, SUN, PRICE = "temperature_C", "solar_W_m2", "price_per_kWh"
"""Columns of what a provider answers."""
_OFFSET = re.compile(r"T\d\d:\d\d.*(Z|[+-]\d\d:?\d\d)$")
_TIMEOUT_S, _MOST_BYTES = 15.0, 20_000_000


@dataclass
class Service:
    """Base of the providers of this package: where they ask, and how."""

    attribution: ClassVar[str] = ""
    url: str

    def __post_init__(self) -> None:
        no_secret_in(self.url, "provider: url", "a token belongs in token_file")
        try:
            asked = urlsplit(self.url)
            scheme, host = asked.scheme, asked.hostname or ""
        except ValueError:  # brackets that do not close
            scheme, host = "", ""
        if not host or not (scheme == "https" or (scheme == "http" and is_loopback(host))):
            raise ConfigError(f"provider: url: {self.url!r}: expected https:// (http:// on this machine alone)")
        self.url = self.url.rstrip("/")

    def get(
        self,
        path: str,
        parameters: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        json: Any = None,
        accepted: tuple[int, ...] = (200,),
    ) -> tuple[int, bytes, Mapping[str, str]]:
        """Status, body and headers; raises `PlantError`, without parameters and headers, which may hold a secret."""
        where = self.url + path
        sent = {"User-Agent": f"thermoforce-mpc/{VERSION}", **(headers or {})}
        try:
            with requests.Session() as session:
                session.trust_env = False
                with session.request(
                    "GET" if json is None else "POST", where, params=parameters, headers=sent, json=json,
                    timeout=_TIMEOUT_S, stream=True, allow_redirects=False,
                ) as answer:  # fmt: skip
                    body = bytearray()
                    for chunk in answer.iter_content(65536):
                        body += chunk
                        if len(body) > _MOST_BYTES:
                            raise PlantError(f"{where}: more than {_MOST_BYTES} bytes")
                    status, told = answer.status_code, dict(answer.headers)
        except requests.RequestException as error:
            raise PlantError(f"{where}: cannot be reached ({type(error).__name__})") from None
        if status not in accepted:
            raise PlantError(f"{where}: status {status}")
        return status, bytes(body), {key.lower(): value for key, value in told.items()}


@contextmanager
def documented(where: str) -> Iterator[None]:
    """Say (`PlantError`) that an answer has not the documented layout where a key or value is missing in the block."""
    try:
        yield
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise PlantError(f"{where}: not the documented layout ({type(error).__name__}: {error})") from error


def parsed(body: bytes, where: str) -> Any:
    """JSON of an answer; raises `PlantError`."""
    try:
        return json.loads(body)
    except ValueError as error:
        raise PlantError(f"{where}: its answer is no JSON") from error


def expires(headers: Mapping[str, str]) -> datetime | None:
    """Time of the header Expires, None where there is none or it is no time."""
    try:
        return parsedate_to_datetime(headers["expires"])
    except (KeyError, ValueError, TypeError):
        return None


def stamped(times: list[Any], what: str) -> pd.DatetimeIndex:
    """Time stamps with an offset, as UTC; raises `PlantError` for one without: of which zone would it be?"""
    if not all(_OFFSET.search(str(time)) for time in times):
        raise PlantError(f"{what}: time stamps without an offset: of which zone are they?")
    try:
        return pd.DatetimeIndex(pd.to_datetime(times, utc=True, format="ISO8601"))
    except (ValueError, TypeError) as error:
        raise PlantError(f"{what}: a time stamp is none ({error})") from error
