"""Connections that limit the whole time of a request and the length of its answer."""

from __future__ import annotations

import functools
import logging
import socket
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import requests
from requests.adapters import HTTPAdapter

from boptest_client.errors import ProtocolError

_LOG = logging.getLogger(__name__)
# A year of fifty points every half minute, unpacked, has 1 GB; no request of ours asks for a tenth of it.
_MOST_BYTES = 200_000_000


class Bearer(requests.auth.AuthBase):
    """Sends a token with every request, whatever a `.netrc` file says about the host."""

    def __init__(self, token: str) -> None:
        self._header = f"Bearer {token}"

    def __call__(self, request: requests.PreparedRequest) -> requests.PreparedRequest:
        """The request with the token."""
        request.headers["Authorization"] = self._header
        return request


class CuttableAdapter(HTTPAdapter):
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
        """The pool, whose connections remember their sockets."""
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
    def cut_after(self, seconds: float, endpoint: str, say_s: float) -> Iterator[threading.Event]:
        """Close all connections after `seconds` unless the block has ended; the event is set if they were closed.

        After `say_s`, and whenever that has doubled, it is said that `endpoint` has not answered.
        """
        cut, ended, began_s = threading.Event(), threading.Event(), time.monotonic()

        def watch() -> None:
            said_s = say_s
            while not ended.wait(began_s + min(said_s, seconds) - time.monotonic()):
                if time.monotonic() - began_s >= seconds:
                    cut.set()
                    for open_socket in list(self._sockets):
                        with suppress(OSError):
                            open_socket.shutdown(socket.SHUT_RDWR)
                    return
                _LOG.warning("%s: no answer for %.3g s already; it is waited for %.3g s", endpoint, said_s, seconds)
                said_s *= 2.0

        threading.Thread(target=watch, daemon=True).start()
        try:
            yield cut
        finally:
            ended.set()
