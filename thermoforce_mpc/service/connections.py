"""Socket server of the service: idle connections are closed to admit new ones."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from typing import Any

from waitress.adjustments import Adjustments  # type: ignore[import-untyped]
from waitress.server import TcpWSGIServer  # type: ignore[import-untyped]

from thermoforce_mpc.errors import PlantError

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
    on_ready(int(server.effective_port))
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
