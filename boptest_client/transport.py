"""HTTP requests to the service: time limits, unpacking of the JSON envelope, and retries of repeatable requests."""

from __future__ import annotations

import functools
import math
import os
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import urlsplit

import requests
from requests.adapters import HTTPAdapter

from boptest_client.errors import (
    BadAddress,
    ConnectError,
    ConnectionLost,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    TransportError,
    UnknownTest,
)

Method = Literal["GET", "PUT", "POST"]
# A year of fifty points every half minute, unpacked, has 1 GB; no request of ours asks for a tenth of it.
_MOST_BYTES = 200_000_000


@dataclass(frozen=True)
class TransportConfig:
    """Time limits and retries of requests. Long steps and warm-ups of a real test case take minutes.

    Attributes:
        connect_timeout_s: time limit for making a connection, s.
        read_timeout_s: time limit between two received bytes, s; `connect_timeout_s + read_timeout_s` also limits the
            whole request, since a peer that sends single bytes would never exceed the first limit.
        retries: repeats of a failed request.
        backoff_s: pause before the first repeat, s; it doubles with each.
    """

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
    """Answer of the service: the payload (the whole JSON if there is no envelope) and the message."""

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
        self._session, self._adapter = requests.Session(), _CuttableAdapter()
        for scheme in ("http://", "https://"):
            self._session.mount(scheme, self._adapter)
        self._session.headers["User-Agent"] = user_agent
        if token := os.environ.get("BOPTEST_TOKEN", "").strip():
            self._session.auth = _Bearer(token)

    def call(self, method: Method, path: str, body: dict[str, Any] | None = None, *, repeatable: bool) -> Answer:
        """Send one request and return the answer.

        A failed connection attempt is repeated with growing pauses, since nothing was sent. A connection that broke
        later is repeated only if `repeatable`. A timed-out request is not repeated, since the service may still work
        on it. Until the first answer there are no retries after `connect_timeout_s`, since the address may be wrong.

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
        in_all_s = c.connect_timeout_s + c.read_timeout_s
        late = ServiceTimeout(endpoint, f"no complete answer within {in_all_s:g} s")
        with self._adapter.cut_after(in_all_s) as cut:
            try:
                response = self._session.request(
                    method,
                    f"{self.url}/{path}",
                    json=body,
                    timeout=(c.connect_timeout_s, c.read_timeout_s),
                    # Following a redirect would turn a POST into a GET.
                    allow_redirects=False,
                )
            except Exception as error:
                if cut.is_set():  # the libraries below raise various errors when their connection is closed
                    raise late from error
                if isinstance(error, requests.RequestException):
                    raise self._failure(endpoint, error) from error
                raise
        if cut.is_set():
            raise late
        self._reached = True
        if response.is_redirect:
            raise ProtocolError(endpoint, f"the service has moved to {response.headers['Location']}; use that address")
        try:
            content = response.json()
        except (ValueError, RecursionError):
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

    def _failure(self, endpoint: str, error: requests.RequestException) -> TransportError:
        if isinstance(error, requests.ConnectTimeout):
            return ConnectError(endpoint, f"no connection within {self.config.connect_timeout_s:g} s")
        if isinstance(error, requests.Timeout):
            return ServiceTimeout(endpoint, f"no answer within {self.config.read_timeout_s:g} s")
        root = _root(error)
        if _never_connected(error):
            return ConnectError(endpoint, f"cannot be reached ({root}); is the service running there?")
        return ConnectionLost(endpoint, f"the connection broke ({root})")


class _Bearer(requests.auth.AuthBase):
    """Sends a token with every request, whatever a `.netrc` file says about the host."""

    def __init__(self, token: str) -> None:
        self._header = f"Bearer {token}"

    def __call__(self, request: requests.PreparedRequest) -> requests.PreparedRequest:
        request.headers["Authorization"] = self._header
        return request


class _CuttableAdapter(HTTPAdapter):
    """HTTP adapter that can close its open sockets after a total time; socket timeouts only limit single reads."""

    def __init__(self) -> None:
        self._sockets: weakref.WeakSet[socket.socket] = weakref.WeakSet()
        super().__init__()

    def build_response(self, req: requests.PreparedRequest, resp: Any) -> requests.Response:
        """The answer, which raises `ProtocolError` when it is read beyond `_MOST_BYTES`."""
        stream = resp.stream

        def bounded(*args: Any, **kwargs: Any) -> Iterator[bytes]:
            size = 0
            for piece in stream(*args, **kwargs):
                size += len(piece)
                if size > _MOST_BYTES:
                    resp.close()
                    raise ProtocolError(f"{req.method} {req.url}", f"the answer is longer than {_MOST_BYTES:,} bytes")
                yield piece

        resp.stream = bounded
        return super().build_response(req, resp)

    def get_connection_with_tls_context(self, *args: Any, **kwargs: Any) -> Any:
        pool: Any = super().get_connection_with_tls_context(*args, **kwargs)
        if "ConnectionCls" not in vars(pool):
            pool.ConnectionCls = functools.partial(self._connection, pool.ConnectionCls)
        return pool

    def _connection(self, make: Callable[..., Any], **settings: Any) -> Any:
        connection = make(**settings)
        connect = connection.connect

        def connect_and_remember() -> None:
            connect()
            self._sockets.add(connection.sock)

        connection.connect = connect_and_remember
        return connection

    @contextmanager
    def cut_after(self, seconds: float) -> Iterator[threading.Event]:
        """Close all connections after `seconds` unless the block has ended; the event is set if they were closed."""
        cut = threading.Event()

        def act() -> None:
            cut.set()
            for open_socket in list(self._sockets):
                with suppress(OSError):
                    open_socket.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(seconds, act)
        timer.daemon = True
        timer.start()
        try:
            yield cut
        finally:
            timer.cancel()


def _service_error(endpoint: str, status: int, message: str) -> ServiceError:
    if status == 404 or "invalid testid" in message.lower():
        return UnknownTest(endpoint, message, status)
    return RequestRejected(endpoint, message, status) if status < 500 else InternalError(endpoint, message, status)


def _reason(content: Any, text: str) -> str:
    """Error text of an answer: `message` and last line of the payload, list of `errors`, or first 300 characters."""
    if isinstance(content, dict):
        if content.get("message"):
            detail = content.get("payload")
            last_line = detail.strip().splitlines()[-1] if isinstance(detail, str) and detail.strip() else ""
            return f"{content['message']}" + (f" ({last_line})" if last_line else "")
        if isinstance(content.get("errors"), list):
            return "; ".join(str(e.get("msg", e)) if isinstance(e, dict) else str(e) for e in content["errors"])
    return " ".join(text.split())[:300] or "no message"


def _never_connected(error: BaseException) -> bool:
    """Whether the request failed before a connection was made (name not found, refused, no route)."""
    seen: BaseException | None = error
    while seen is not None:
        # Compared by name, since urllib3 is not a direct dependency.
        if type(seen).__name__ in ("NewConnectionError", "NameResolutionError", "ConnectTimeoutError"):
            return True
        reason = getattr(seen, "reason", None)
        seen = reason if isinstance(reason, BaseException) else seen.__context__
    return False


def _root(error: BaseException) -> BaseException:
    """The innermost error of a chain of network errors."""
    while error.__context__ is not None:
        error = error.__context__
    return error
