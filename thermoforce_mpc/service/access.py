"""Who may ask, and how often: names of the service, pages of a browser, a token, and a rate for each address."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from urllib.parse import urlsplit

from werkzeug.datastructures import Headers

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import is_loopback

LEAST_TOKEN = 16
# Addresses remembered; the one that asked longest ago is forgotten first.
_MOST_ADDRESSES = 10_000
_SCHEME = "bearer"
# What a browser says of a request by a page of the service, or by its user.
_HERE = ("same-origin", "none")


def check_token(host: str, token: str | None, variable: str = "BOPTEST_TOKEN") -> None:
    """Raise `ConfigError` where a service on `host` may not start with `token`: it is missing though other machines can
    reach `host`, is too short, or has characters that a header cannot carry. `variable`: of the environment, for it.
    """
    advice = f"set {variable} to the output of: python -c 'import secrets; print(secrets.token_urlsafe(32))'"
    if token is None:
        if not is_loopback(host):
            raise ConfigError(f"{host} can be reached from other machines, so the service needs a token: {advice}")
    elif len(token) < LEAST_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
        raise ConfigError(f"the token needs {LEAST_TOKEN} or more printable ASCII characters without spaces; {advice}")


class HostNames:
    """Names by which the service may be asked, and so which pages of a browser may ask: its own.

    An address may always be asked: only a name can be made to lead here by whom it belongs to (DNS rebinding).
    """

    def __init__(self, names: Iterable[str] = (), option: str = "") -> None:
        """`option`: by which others are given, '' where they cannot be."""
        self._names, self._option = {"localhost", *(name.lower() for name in names)}, option

    def check(self, headers: Headers) -> None:
        """Raise `Refusal` (403) for a host of another name, or for a request that a page of elsewhere makes."""
        asked = headers.get("Host", "")
        if asked and not self._own(asked):
            or_named = f", or start it with {self._option}" if self._option else ""
            raise Refusal(403, f"This service is not called {asked!r:.80}; ask by its address{or_named}.")
        check_page(headers, asked)

    def _own(self, asked: str) -> bool:
        try:
            name = (urlsplit(f"//{asked}").hostname or "").lower()
            return name in self._names or bool(ipaddress.ip_address(name))
        except ValueError:
            return False


def check_page(headers: Headers, *hosts: str) -> None:
    """Raise `Refusal` (403) for a request that a page of another site than `hosts` makes."""
    page = headers.get("Origin")
    # `same-site` is a page of another port. Not every request of a page states an Origin.
    elsewhere = page is not None and page.partition("://")[2] not in hosts
    if elsewhere or headers.get("Sec-Fetch-Site", "none") not in _HERE:
        raise Refusal(403, "A page of another site may not ask this service.")


def check_authorization(header: str | None, token: str) -> None:
    """Raise `Refusal` (401) unless `header` holds the token; takes as long for any wrong token of its length."""
    scheme, _, credentials = (header or "").partition(" ")
    # Compared in any case, so that the time taken does not depend on the scheme.
    same = hmac.compare_digest(credentials.strip().encode("utf-8", "replace"), token.encode("ascii"))
    if scheme.lower() != _SCHEME or not same:
        raise Refusal(401, "This service needs the header 'Authorization: Bearer TOKEN' with its token.")


def signed(token: str, until_s: int) -> str:
    """What a browser that gave the token shows of it until a time, s since 1970."""
    return f"{until_s}.{hmac.new(token.encode(), str(until_s).encode(), hashlib.sha256).hexdigest()}"


def is_signed(shown: str, token: str, now_s: float) -> bool:
    """Whether `shown` is of `signed`, with this token, and its time not over."""
    until, _, _ = shown.partition(".")
    if not (until.isascii() and until.isdigit() and len(until) < 16 and now_s < int(until)):
        return False
    return hmac.compare_digest(shown.encode("utf-8", "replace"), signed(token, int(until)).encode())


class Rate:
    """At most `per_second` requests a second from one address, after a burst of twice as many. Thread-safe."""

    def __init__(self, per_second: float) -> None:
        self._per_second, self._burst = per_second, 2.0 * per_second
        # Requests left and when that was counted, s, of each address.
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def admit(self, address: str) -> None:
        """Count a request; raises `Refusal` (429) if it comes too soon."""
        now_s = time.monotonic()
        with self._lock:
            left, counted_s = self._left.pop(address, (self._burst, now_s))
            left = min(self._burst, left + (now_s - counted_s) * self._per_second)
            self._left[address] = (max(left - 1.0, 0.0) if left >= 1.0 else left, now_s)
            if len(self._left) > _MOST_ADDRESSES:
                self._left.popitem(last=False)
        if left < 1.0:
            raise Refusal(429, f"More than {self._per_second:g} requests a second from {address}; ask again later.")


class Refusal(Exception):
    """Refused request: HTTP `status` and a message with the error and the allowed values."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status, self.message = status, message
