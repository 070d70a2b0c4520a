"""Server of the application on a socket. Needs the extra `serve` (flask, waitress)."""

from __future__ import annotations

import copy
import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from waitress.adjustments import Adjustments  # type: ignore[import-untyped]
from waitress.server import TcpWSGIServer  # type: ignore[import-untyped]

from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.service.access import check_token, is_loopback

if TYPE_CHECKING:  # the page of a controller is served without a plant, in half of the memory
    from thermoforce_mpc.boundary.tariffs import Tariff
    from thermoforce_mpc.boundary.weather.year import Weather
    from thermoforce_mpc.plants.embedded.emulator import Emulator

_TESTCASE = "bestest_hydronic_heat_pump"
DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8000
_FREE_THREADS = 4
# Largest number of open connections. A client reuses one connection and reconnects when it was closed.
MOST_CONNECTIONS = 200
# Idle time after which a connection is closed, s.
_SILENT_S = 60
_MOST_HEADER = 65_536
_MOST_REPLY = 2**31


class Server(TcpWSGIServer):
    """Waitress server that closes the connection idle for longest when `MOST_CONNECTIONS` are open.

    Waitress itself accepts no more until some have been idle for minutes. A slow sender occupies no thread: a thread
    gets a request when it is complete.
    """

    def handle_accept(self) -> None:
        """Accept a connection; called by the server's loop."""
        channels = list(self.active_channels.values())
        silent = [channel for channel in channels if not channel.requests and not channel.will_close]
        if len(channels) >= MOST_CONNECTIONS and silent:
            # Closed by the loop, not here: the loop may be about to read from it.
            min(silent, key=lambda channel: channel.last_activity).will_close = True
        super().handle_accept()

    def close(self) -> None:
        """End `run`, also where a connection is open whose request is just being finished."""
        for channel in list(self.active_channels.values()):
            channel.will_close = True
        super().close()


def bound(host: str, port: int, other: str) -> socket.socket:
    """A socket that listens at an address; raises `PlantError`, which asks for what is `other`, where it cannot.

    Bound here, since waitress leaves its own socket open when binding fails.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        # Without the address that Python appends to the system's message.
        reason = os.strerror(error.errno) if error.errno and error.errno > 0 else str(error)
        raise PlantError(f"cannot listen on {host}:{port} ({reason}); choose {other}") from error


def run_to_its_end(server: Server, on_ready: Callable[[int], None]) -> None:
    """Serve until interrupted; `on_ready` is called with the port."""
    on_ready(effective_port(server))
    try:
        server.run()
    finally:
        server.close()


def serve_on(listening: socket.socket, app: Callable[..., Any], *, threads: int, most_bytes: int) -> Server:
    """Server of `app` on a bound socket, answering `threads` requests, of `most_bytes` each, at a time."""
    adjustments = Adjustments(
        threads=threads,
        max_request_body_size=most_bytes,
        max_request_header_size=_MOST_HEADER,
        # A reply that its client does not read waits in a file, not in a thread.
        outbuf_high_watermark=_MOST_REPLY,
        ident=None,
        channel_timeout=_SILENT_S,
        cleanup_interval=5,
        # Not reached: `Server` stays below it, except for connections that are being closed.
        connection_limit=2 * MOST_CONNECTIONS,
        # `select` fails where the process has more than 1024 files open.
        asyncore_use_poll=True,
    )
    kind = (listening.family, listening.type, listening.proto, listening.getsockname())
    return Server(app, _sock=listening, bind_socket=False, adj=adjustments, sockinfo=kind)


def build_server(
    weather: Weather,
    *,
    testcase: str = _TESTCASE,
    host: str = DEFAULT_HOST,
    port: int = DEFAULT_PORT,
    highly_dynamic: Tariff | None = None,
    token: str | None = None,
    names: Sequence[str] = (),
    **limits: Any,
) -> Server:
    """Bind the service to `host` and `port` (0: a free one); `run()` of the server serves until `close()`.

    `testcase`: an embedded one. `highly_dynamic`: tariff of that name, by default a synthetic one. `token`: see
    `check_token`. `names`: by which it may be asked, besides `host`, addresses and localhost. `limits`: fields of
    `ServiceLimits`; by default one address has half of the tests where other machines reach `host`.

    Raises:
        ConfigError: `port`, a limit or the token is out of range, or the token is missing.
        PlantError: the address cannot be bound.
    """
    from thermoforce_mpc.service.app import ServiceLimits, create_app
    from thermoforce_mpc.service.sessions import MOST_ASKING

    if not 0 <= port <= 65535:
        raise ConfigError(f"port {port}: expected 0 to 65535")
    for name, value in limits.items():
        if value is not None and not value > 0:
            raise ConfigError(f"{name} is {value}: expected a positive number")
    bounds = ServiceLimits(**limits)
    if bounds.tests_each is None and not is_loopback(host):
        bounds = replace(bounds, tests_each=(bounds.most_tests + 1) // 2)
    check_token(host, token)
    listening = bound(host, port, "another address or port")
    app = create_app(
        plants(weather, highly_dynamic, testcase), bounds, testcase=testcase, token=token, names=(host, *names)
    )
    # One thread per admitted request, plus free ones: long simulations do not block other requests.
    threads = bounds.most_tests * MOST_ASKING + _FREE_THREADS
    # Twice as long, so that what is moderately too long gets an answer in the service's own form.
    return serve_on(listening, app, threads=threads, most_bytes=2 * bounds.most_bytes)


def serve(
    weather: Weather,
    *,
    host: str = DEFAULT_HOST,
    port: int = DEFAULT_PORT,
    on_ready: Callable[[str], None] | None = None,
    **options: Any,
) -> None:
    """Serve until interrupted; `on_ready` is called with the base URL. Options and errors as for `build_server`."""
    server = build_server(weather, host=host, port=port, **options)
    logging.getLogger("waitress").setLevel(logging.WARNING)
    shown = f"[{host}]" if ":" in host else host
    run_to_its_end(server, lambda at: on_ready(f"http://{shown}:{at}") if on_ready else None)


def effective_port(server: Server) -> int:
    """The port a server listens on."""
    return int(server.effective_port)


def plants(weather: Weather, highly_dynamic: Tariff | None = None, testcase: str = _TESTCASE) -> Callable[[], Emulator]:
    """Builder of plants that share constant data, such as the irradiance on each surface."""
    from thermoforce_mpc.plants.registry import emulator_of
    from thermoforce_mpc.service.points import WEATHER_SIGNALS

    first = emulator_of(testcase, weather, highly_dynamic=highly_dynamic)
    # The first wet bulb temperature may compile psychrolib, which takes seconds: done here, not in a request.
    WEATHER_SIGNALS["TWetBul"].at(weather, np.zeros(1))

    def another() -> Emulator:
        # A reset gives the copy a state, a record and a clock of its own.
        plant = copy.copy(first)
        plant.reset(0.0, 0.0)
        return plant

    return another


@contextmanager
def serving(weather: Weather, **options: Any) -> Iterator[str]:
    """Address of a service on a free loopback port, in a thread until the block ends; options as of `build_server`."""
    with running(build_server(weather, port=0, **options)) as address:
        yield address


@contextmanager
def running(server: Any) -> Iterator[str]:
    """Address of a server on loopback, in a thread of this process until the block ends; then it is closed."""
    thread = threading.Thread(target=server.run, name="tf-mpc service", daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{effective_port(server)}"
    finally:
        server.close()
        thread.join(timeout=5)
