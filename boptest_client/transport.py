"""One HTTP request to the service: timeouts, the envelope, and repeats of what is safe to repeat."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import urlsplit

import requests

from boptest_client.errors import (
    BadAddress,
    ConnectError,
    ConnectionLost,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    UnknownTest,
)

Method = Literal["GET", "PUT", "POST"]


@dataclass(frozen=True)
class TransportConfig:
    """How patient the client is. Times in s; long steps and long warm-ups of a real test case take minutes."""

    connect_timeout_s: float = 5.0
    read_timeout_s: float = 300.0
    retries: int = 3
    backoff_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("connect_timeout_s", "read_timeout_s", "backoff_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 or (value == 0 and name == "backoff_s"))):
                raise ValueError(f"{name} is {value!r}, expected a positive number of seconds")
        if self.retries < 0:
            raise ValueError(f"retries is {self.retries!r}, expected 0 or more")


@dataclass(frozen=True)
class Answer:
    """What the service answered: the payload (the whole JSON where there is no envelope) and its message."""

    payload: Any
    message: str


class Transport:
    """Sends requests and unpacks `{"status", "message", "payload"}`."""

    def __init__(self, url: str, config: TransportConfig, user_agent: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise BadAddress(url, "not the address of a service; expected something like http://127.0.0.1:8000")
        self.url = url.rstrip("/")
        self.config = config
        self._reached = False
        self._session = requests.Session()
        self._session.headers["User-Agent"] = user_agent

    def call(self, method: Method, path: str, body: dict[str, Any] | None = None, *, repeatable: bool) -> Answer:
        """Send one request and return the answer.

        A connection that could not be made is tried again, with growing pauses: nothing was sent. One that broke later
        is tried again only when `repeatable`. A time-out never is: the service may still be at work on the first.
        Until the service has answered once, nothing is tried again after `connect_timeout_s`: the address may be wrong.

        Raises:
            BoptestError: see `boptest_client.errors`.
        """
        endpoint = f"{method} {self.url}/{path}"
        patient_until = math.inf if self._reached else time.monotonic() + self.config.connect_timeout_s
        for attempt in range(self.config.retries):
            try:
                return self._once(method, path, endpoint, body)
            except ConnectError:
                if time.monotonic() >= patient_until:
                    raise
            except ConnectionLost:
                if not repeatable:
                    raise
            time.sleep(self.config.backoff_s * 2**attempt)
        return self._once(method, path, endpoint, body)

    def close(self) -> None:
        """Close the connections."""
        self._session.close()

    def _once(self, method: Method, path: str, endpoint: str, body: dict[str, Any] | None) -> Answer:
        c = self.config
        try:
            response = self._session.request(
                method,
                f"{self.url}/{path}",
                json=body,
                timeout=(c.connect_timeout_s, c.read_timeout_s),
                # Following a redirect would turn a POST into a GET.
                allow_redirects=False,
            )
        except requests.ConnectTimeout as error:
            raise ConnectError(endpoint, f"no connection within {c.connect_timeout_s:g} s") from error
        except requests.Timeout as error:
            raise ServiceTimeout(endpoint, f"no answer within {c.read_timeout_s:g} s") from error
        except requests.RequestException as error:
            root = _root(error)
            if _never_connected(error):
                raise ConnectError(endpoint, f"cannot be reached ({root}); is the service running there?") from error
            raise ConnectionLost(endpoint, f"the connection broke ({root})") from error
        self._reached = True
        if response.is_redirect:
            raise ProtocolError(endpoint, f"the service has moved to {response.headers['Location']}; use that address")
        try:
            content = response.json()
        except ValueError:
            content = None
        if response.status_code >= 400:
            raise _service_error(endpoint, response.status_code, _reason(content, response.text))
        if content is None:
            # `stop` answers with the bare word OK.
            if response.text.strip() == "OK":
                return Answer(None, "OK")
            raise ProtocolError(endpoint, f"the answer is not JSON: {response.text[:120]!r}")
        if isinstance(content, dict) and "payload" in content:
            return Answer(content["payload"], str(content.get("message") or ""))
        return Answer(content, "")


def _service_error(endpoint: str, status: int, message: str) -> ServiceError:
    if status == 404 or "invalid testid" in message.lower():
        return UnknownTest(endpoint, message, status)
    return RequestRejected(endpoint, message, status) if status < 500 else InternalError(endpoint, message, status)


def _reason(content: Any, text: str) -> str:
    """The service's own words: `message` (and a payload that explains it), a list of `errors`, or the bare text."""
    if isinstance(content, dict):
        if content.get("message"):
            detail = content.get("payload")
            last_line = detail.strip().splitlines()[-1] if isinstance(detail, str) and detail.strip() else ""
            return f"{content['message']}" + (f" ({last_line})" if last_line else "")
        if isinstance(content.get("errors"), list):
            return "; ".join(str(e.get("msg", e)) if isinstance(e, dict) else str(e) for e in content["errors"])
    return " ".join(text.split())[:300] or "no message"


def _never_connected(error: BaseException) -> bool:
    """Whether the request failed before a connection stood (name not found, refused, no route)."""
    seen: BaseException | None = error
    while seen is not None:
        # By name: urllib3 is a dependency of requests, not of ours.
        if type(seen).__name__ in ("NewConnectionError", "NameResolutionError", "ConnectTimeoutError"):
            return True
        reason = getattr(seen, "reason", None)
        seen = reason if isinstance(reason, BaseException) else seen.__context__
    return False


def _root(error: BaseException) -> BaseException:
    """The innermost reason of a chain of network errors."""
    while error.__context__ is not None:
        error = error.__context__
    return error
