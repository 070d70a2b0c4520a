"""HTTP requests to the service: time limits, the JSON envelope, and patience with a service that is away.

requests and tenacity are loaded with the first service: 11 MB of a process that asks none.
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeVar
from urllib.parse import urlsplit

from boptest_client.answers import safe_text
from boptest_client.errors import (
    BadAddress,
    BoptestError,
    ConnectError,
    ConnectionLost,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceTimeout,
    TlsError,
    TransportError,
    UnknownTest,
)

if TYPE_CHECKING:
    import requests
    import tenacity

Method = Literal["GET", "PUT", "POST"]

_LOG = logging.getLogger(__name__)
_Result = TypeVar("_Result")

# A request that was refused (400) is repeated this many times: a proxy may have mangled it.
_REFUSALS = 2
# Failures after which a request is repeated: the service is away, or something else answers in its place.
_PASSING = (ConnectError, ConnectionLost, ServiceTimeout, InternalError, ProtocolError)
# Requests that may simulate days.
_WARM_UPS = ("initialize", "scenario")
# Silence is said after this time, s, and again whenever it has doubled; later where a request usually takes longer.
SAID_AFTER_S = 5.0


@dataclass(frozen=True)
class TransportConfig:
    """Time limits of requests. Long steps and warm-ups of a real test case take minutes.

    Attributes:
        connect_timeout_s: time limit for making a connection, s.
        read_timeout_s: time limit between two received bytes, s; the sum of both also limits the whole request, since a
            peer that sends single bytes would never exceed the first limit.
        patience_s: how long a request of a run is repeated while the service is away, silent or not itself, s, and
            waited for, but while it initialises; 0: sent once. Before the test was initialised it is
            `connect_timeout_s`, since address or test case may be wrong.
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
class ServiceAnswer:
    """Answer of the service: the payload (the whole JSON if there is no envelope) and the message."""

    payload: Any
    message: str


@dataclass
class _Wait:
    """Patience of one request, s, and how much of its time went to others within it, s."""

    patience_s: float
    repeats: int = 0
    apart_s: float = 0.0
    began_s: float = field(default_factory=time.monotonic)

    @property
    def used_s(self) -> float:
        return time.monotonic() - self.began_s - self.apart_s


class Transport:
    """Sends requests and unpacks `{"status", "message", "payload"}`."""

    def __init__(self, url: str, config: TransportConfig, user_agent: str) -> None:
        import requests

        from boptest_client.connections import Bearer, CuttableAdapter

        if "@" in url:  # requests would take what is before it for a user and a password
            raise BadAddress(
                f"…@{url.rpartition('@')[2]}",
                "what is before @ would stand in logs; expected something like http://127.0.0.1:8000, a token in "
                "BOPTEST_TOKEN",
            )
        if not _is_address(url):
            raise BadAddress(url, "not the address of a service; expected something like http://127.0.0.1:8000")
        self.url = url.rstrip("/")
        self.config = config
        self.in_a_run = False
        """Whether the test was initialised: requests are then repeated for `patience_s`."""
        self._wait: _Wait | None = None
        self._given_up: BaseException | None = None
        self._longest_s: dict[str, float] = {}
        self._session, self._adapter = requests.Session(), CuttableAdapter()
        for scheme in ("http://", "https://"):
            self._session.mount(scheme, self._adapter)
        self._session.headers["User-Agent"] = user_agent
        if token := os.environ.get("BOPTEST_TOKEN", "").strip():
            self._session.auth = Bearer(token)

    @property
    def patience_s(self) -> float:
        """How long a request is repeated now, s."""
        return self.config.patience_s if self.in_a_run else self.config.connect_timeout_s

    def patiently(
        self,
        request: Callable[[], _Result],
        *,
        passing: tuple[type[Exception], ...] = _PASSING,
        refusals: int = _REFUSALS,
        most_s: float = math.inf,
    ) -> _Result:
        """The result of `request`, repeated with growing pauses while it fails in a way that may pass.

        Patience is that of each request: where `request` sends others patiently, their time does not count, and where
        one of them is given up so is `request`. Raises the `BoptestError` of the last attempt.

        Args:
            passing: errors that may pass; a refused request is repeated `refusals` times.
            most_s: gives up after this time, s, if patience lasts longer.
        """
        import tenacity

        c, around, refused = self.config, self._wait, 0
        wait = self._wait = _Wait(min(self.patience_s, most_s))

        def again(error: BaseException) -> bool:
            nonlocal refused
            if error is self._given_up:
                return False
            if isinstance(error, RequestRejected):
                refused += 1
                return refused <= refusals
            refused = 0
            return isinstance(error, passing) and (self.in_a_run or not isinstance(error, TlsError))

        def over(state: tenacity.RetryCallState) -> bool:
            # The requested pauses count too: a clock of tests may make them shorter.
            return max(wait.used_s, state.idle_for) >= wait.patience_s

        def before_sleep(state: tenacity.RetryCallState) -> None:
            error = state.outcome.exception() if state.outcome else None
            _LOG.warning("%s (asking again in %.2g s)", error, state.upcoming_sleep)
            wait.repeats += 1

        retrying = tenacity.Retrying(
            retry=tenacity.retry_if_exception(again),
            stop=over,
            wait=tenacity.wait_exponential(multiplier=c.backoff_s, max=c.longest_pause_s),
            sleep=c.sleep,
            before_sleep=before_sleep,
            reraise=True,
        )
        try:
            return retrying(request)
        except BoptestError as error:
            if wait.repeats and error is not self._given_up and isinstance(error, passing):
                error.add(f", and no better answer within {wait.patience_s:g} s")
            self._given_up = error
            raise
        finally:
            self._wait = around
            if around is not None:
                around.apart_s += time.monotonic() - wait.began_s

    def close(self) -> None:
        """Close the connections."""
        self._session.close()

    def call(
        self, method: Method, path: str, body: dict[str, Any] | None = None, *, most_s: float = math.inf
    ) -> ServiceAnswer:
        """Send one request, once; the answer is waited for `most_s` at most, s; raises `BoptestError`s."""
        import requests

        endpoint = f"{method} {self.url}/{path}"
        verb, began_s = path.partition("/")[0], time.monotonic()
        # No request of a run takes longer than its patience, and no repeat than what is left of that; a first one may
        # simulate a warm-up, or is of a run whose patience is none.
        wait = self._wait
        limited = wait and (wait.repeats or (self.in_a_run and wait.patience_s > 0.0 and verb not in _WARM_UPS))
        left_s = max(wait.patience_s - wait.used_s if wait and limited else math.inf, self.config.connect_timeout_s)
        connect_s, read_s = (
            min(s, most_s, left_s) for s in (self.config.connect_timeout_s, self.config.read_timeout_s)
        )
        in_all_s = min(connect_s + read_s, most_s, left_s)
        say_s = min(max(SAID_AFTER_S, 2.0 * self._longest_s.get(verb, 0.0)), in_all_s / 2.0)
        late = ServiceTimeout(endpoint, f"no complete answer within {in_all_s:.3g} s")
        with self._adapter.cut_after(in_all_s, endpoint, say_s) as cut:
            try:
                response = self._session.request(
                    method,
                    f"{self.url}/{path}",
                    json=body,
                    timeout=(connect_s, read_s),
                    # Following a redirect would turn a POST into a GET, and tell another host the token.
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
        self._longest_s[verb] = max(self._longest_s.get(verb, 0.0), time.monotonic() - began_s)
        return _unpacked(endpoint, response)


def _unpacked(endpoint: str, response: requests.Response) -> ServiceAnswer:
    """What the service answers; raises `ServiceError` for an error of its own, `ProtocolError` where it is not its."""
    try:
        content = response.json()
    except (ValueError, RecursionError):
        content = None
    status, own = response.status_code, isinstance(content, dict) and ("message" in content or "errors" in content)
    if status >= 500 or status == 429:
        raise InternalError(endpoint, _reason(content, response.text), status)
    if status == 404 and endpoint.endswith("/select"):
        raise UnknownTest(endpoint, _reason(content, response.text), status)
    if status >= 400 and own:
        reason = _reason(content, response.text)
        # A 404 that names no test is of something in between, such as a gateway that has lost its route for a while.
        gone = "invalid testid" in reason.lower() or (status == 404 and endpoint.rpartition("/")[2] in reason)
        if gone or status != 404:
            raise (UnknownTest if gone else RequestRejected)(endpoint, reason, status)
    if status == 200 and response.text.strip() == "OK":  # the bare word answers `stop`
        return ServiceAnswer(None, "OK")
    if status >= 300 or content is None:
        raise ProtocolError(endpoint, f"not an answer of the service: {_came(response)}")
    if isinstance(content, dict) and "payload" in content:
        return ServiceAnswer(content["payload"], safe_text(content.get("message") or ""))
    return ServiceAnswer(content, "")


def _came(response: requests.Response) -> str:
    kind = response.headers.get("Content-Type") or "no content type"
    if "Location" in response.headers:
        kind = f"a redirect to {response.headers['Location']}, which is not followed; {kind}"
    return safe_text(f"HTTP {response.status_code}, {kind}: {' '.join(response.text.split()) or 'empty'}")


def _is_address(url: str) -> bool:
    """Whether `url` is an http(s) address with a host and, if it names one, a port that can be."""
    import requests

    try:
        parts = urlsplit(url)
        port = parts.port  # raises ValueError if it is none
        requests.Request("GET", url).prepare()
    except (ValueError, requests.RequestException):
        return False
    return parts.scheme in ("http", "https") and bool(parts.hostname) and port != 0


def _failure(endpoint: str, error: requests.RequestException, connect_s: float, read_s: float) -> TransportError:
    import requests

    if isinstance(error, requests.exceptions.SSLError) or "handshake" in str(_root(error)):
        return TlsError(endpoint, f"no TLS ({_root(error)}); if it speaks plain http, write http:// in its address")
    if isinstance(error, requests.ConnectTimeout):
        return ConnectError(endpoint, f"no connection within {connect_s:g} s")
    if isinstance(error, requests.Timeout):
        return ServiceTimeout(endpoint, f"no answer within {read_s:g} s")
    root = _root(error)
    if _never_connected(error):
        return ConnectError(endpoint, f"cannot be reached ({root}); is the service running there?")
    return ConnectionLost(endpoint, f"the connection broke ({root})")


def _reason(content: Any, text: str) -> str:
    """Error text of an answer: `message` and last line of the payload, list of `errors`, or its first characters."""
    if isinstance(content, dict):
        if content.get("message"):
            detail = content.get("payload")
            last_line = detail.strip().splitlines()[-1] if isinstance(detail, str) and detail.strip() else ""
            return safe_text(content["message"]) + (f" ({safe_text(last_line)})" if last_line else "")
        if isinstance(content.get("errors"), list):
            errors = content["errors"]
            return safe_text("; ".join(str(e.get("msg", e)) if isinstance(e, dict) else str(e) for e in errors))
    return safe_text(" ".join(text.split())) or "no message"


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
    while error.__context__ is not None:
        error = error.__context__
    return error
