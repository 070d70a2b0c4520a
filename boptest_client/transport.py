"""HTTP requests to the service: time limits, the JSON envelope, and patience with a service that is away."""

from __future__ import annotations

import functools
import logging
import math
import os
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar
from urllib.parse import urlsplit

import requests
import tenacity
from requests.adapters import HTTPAdapter

from boptest_client.errors import (
    BadAddress,
    ConnectError,
    ConnectionLost,
    InternalError,
    Moved,
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

_LOG = logging.getLogger(__name__)
_Result = TypeVar("_Result")

# A request that was refused (400) is repeated this many times: a proxy may have mangled it.
_REFUSALS = 2
# Failures after which a request that may be repeated is repeated.
_PASSING = (ConnectError, ConnectionLost, ServiceTimeout, InternalError, ProtocolError)


@dataclass(frozen=True)
class TransportConfig:
    """Time limits of requests. Long steps and warm-ups of a real test case take minutes.

    Attributes:
        connect_timeout_s: time limit for making a connection, s.
        read_timeout_s: time limit between two received bytes, s; `connect_timeout_s + read_timeout_s` also limits the
            whole request, since a peer that sends single bytes would never exceed the first limit.
        patience_s: how long requests of a run are repeated while the service is away or answers nonsense, s; before
            the test was initialised it is `connect_timeout_s`, since address or test case may be wrong.
        backoff_s: pause before the first repeat, s; it doubles with each.
        longest_pause_s: longest pause, s.
        sleep: waits for the given number of seconds.
    """

    connect_timeout_s: float = 5.0
    read_timeout_s: float = 300.0
    patience_s: float = 900.0
    backoff_s: float = 0.5
    longest_pause_s: float = 15.0
    sleep: Callable[[float], None] = field(default=time.sleep, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("connect_timeout_s", "read_timeout_s", "patience_s", "backoff_s", "longest_pause_s"):
            value = getattr(self, name)
            may_be_zero = name not in ("connect_timeout_s", "read_timeout_s")
            if not (math.isfinite(value) and (value > 0 or (value == 0 and may_be_zero))):
                raise ValueError(f"{name} is {value!r}, expected a positive number of seconds")


@dataclass(frozen=True)
class Answer:
    """Answer of the service: the payload (the whole JSON if there is no envelope) and the message."""

    payload: Any
    message: str


class Transport:
    """Sends requests and unpacks `{"status", "message", "payload"}`."""

    def __init__(self, url: str, config: TransportConfig, user_agent: str) -> None:
        if not _is_address(url):
            raise BadAddress(url, "not the address of a service; expected something like http://127.0.0.1:8000")
        self.url = url.rstrip("/")
        self.config = config
        self.in_a_run = False
        """Whether the test was initialised: requests are then repeated for `patience_s`."""
        self._session, self._adapter = requests.Session(), _CuttableAdapter()
        for scheme in ("http://", "https://"):
            self._session.mount(scheme, self._adapter)
        self._session.headers["User-Agent"] = user_agent
        if token := os.environ.get("BOPTEST_TOKEN", "").strip():
            self._session.auth = _Bearer(token)

    def patiently(
        self,
        request: Callable[[], _Result],
        *,
        passing: tuple[type[Exception], ...] = _PASSING,
        refusals: int = _REFUSALS,
        most_s: float = math.inf,
    ) -> _Result:
        """The result of `request`, repeated with growing pauses while it fails in a way that may pass.

        Args:
            passing: errors that may pass; a refused request is repeated `refusals` times.
            most_s: gives up after this time, s, if patience lasts longer.

        Raises:
            BoptestError: that of the last attempt.
        """
        c = self.config
        patience_s = min(c.patience_s if self.in_a_run else c.connect_timeout_s, most_s)

        def again(state: tenacity.RetryCallState) -> bool:
            error = state.outcome.exception() if state.outcome else None
            if isinstance(error, RequestRejected):
                return state.attempt_number <= refusals
            return isinstance(error, passing) and not isinstance(error, Moved)

        def over(state: tenacity.RetryCallState) -> bool:
            # The requested pauses count too: a clock of tests may make them shorter.
            return max(state.seconds_since_start or 0.0, state.idle_for) >= patience_s

        def log_retry(state: tenacity.RetryCallState) -> None:
            error = state.outcome.exception() if state.outcome else None
            _LOG.warning("%s (asking again in %.2g s)", error, state.upcoming_sleep)

        retrying = tenacity.Retrying(
            retry=again,
            stop=over,
            wait=tenacity.wait_exponential(multiplier=c.backoff_s, max=c.longest_pause_s),
            sleep=c.sleep,
            before_sleep=log_retry,
            reraise=True,
        )
        return retrying(request)

    def call(
        self, method: Method, path: str, body: dict[str, Any] | None = None, *, most_s: float = math.inf
    ) -> Answer:
        """Send one request, once, and return the answer; it is waited for `most_s` at most, s.

        Raises:
            BoptestError: see `boptest_client.errors`.
        """
        return self._once(method, path, f"{method} {self.url}/{path}", body, most_s)

    def close(self) -> None:
        """Close the connections."""
        self._session.close()

    def _once(self, method: Method, path: str, endpoint: str, body: dict[str, Any] | None, most_s: float) -> Answer:
        connect_s, read_s = min(self.config.connect_timeout_s, most_s), min(self.config.read_timeout_s, most_s)
        in_all_s = min(connect_s + read_s, most_s)
        late = ServiceTimeout(endpoint, f"no complete answer within {in_all_s:g} s")
        with self._adapter.cut_after(in_all_s, endpoint) as cut:
            try:
                response = self._session.request(
                    method,
                    f"{self.url}/{path}",
                    json=body,
                    timeout=(connect_s, read_s),
                    # Following a redirect would turn a POST into a GET.
                    allow_redirects=False,
                )
            except Exception as error:
                if cut.is_set():  # the libraries below raise various errors when their connection is closed
                    raise late from error
                if isinstance(error, requests.RequestException):
                    raise _failure(endpoint, error, connect_s, read_s) from error
                raise
        if cut.is_set():
            raise late
        if response.is_redirect:
            raise Moved(endpoint, f"the service has moved to {response.headers['Location']}; use that address")
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


def _is_address(url: str) -> bool:
    """Whether `url` is an http(s) address with a host and, if it names one, a port that can be."""
    try:
        parts = urlsplit(url)
        port = parts.port  # raises ValueError if it is none
        requests.Request("GET", url).prepare()
    except (ValueError, requests.RequestException):
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname) and port != 0


def _failure(endpoint: str, error: requests.RequestException, connect_s: float, read_s: float) -> TransportError:
    if isinstance(error, requests.ConnectTimeout):
        return ConnectError(endpoint, f"no connection within {connect_s:g} s")
    if isinstance(error, requests.Timeout):
        return ServiceTimeout(endpoint, f"no answer within {read_s:g} s")
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
    def cut_after(self, seconds: float, endpoint: str) -> Iterator[threading.Event]:
        """Close all connections after `seconds` unless the block has ended; the event is set if they were closed.

        After half of them it is said that `endpoint` has not answered.
        """
        cut = threading.Event()

        def act() -> None:
            cut.set()
            for open_socket in list(self._sockets):
                with suppress(OSError):
                    open_socket.shutdown(socket.SHUT_RDWR)

        def say() -> None:
            _LOG.warning("%s: no answer for %.3g s already; it is waited for %g s", endpoint, seconds / 2.0, seconds)

        timers = (threading.Timer(seconds / 2.0, say), threading.Timer(seconds, act))
        for timer in timers:
            timer.daemon = True
            timer.start()
        try:
            yield cut
        finally:
            for timer in timers:
                timer.cancel()


def _service_error(endpoint: str, status: int, message: str) -> ServiceError:
    if status == 404 or "invalid testid" in message.lower():
        return UnknownTest(endpoint, message, status)
    return (InternalError if status >= 500 or status == 429 else RequestRejected)(endpoint, message, status)


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
    cause: BaseException | None = error
    while cause is not None:
        # Compared by name, since urllib3 is not a direct dependency.
        if type(cause).__name__ in ("NewConnectionError", "NameResolutionError", "ConnectTimeoutError"):
            return True
        reason = getattr(cause, "reason", None)
        cause = reason if isinstance(reason, BaseException) else cause.__context__
    return False


def _root(error: BaseException) -> BaseException:
    """The innermost error of a chain of network errors."""
    while error.__context__ is not None:
        error = error.__context__
    return error
