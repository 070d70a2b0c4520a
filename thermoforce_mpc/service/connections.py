"""The sockets of the service: whoever has something to ask gets in, however many connections say nothing."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

from waitress.adjustments import Adjustments  # type: ignore[import-untyped]
from waitress.server import TcpWSGIServer  # type: ignore[import-untyped]

# As many connections are kept. A client keeps one for all it asks, and makes another when that was closed.
MOST_CONNECTIONS = 200
# After how long without a word a connection is closed, s.
_SILENT_S = 60


class Server(TcpWSGIServer):
    """Where all connections are taken, the one that was silent longest makes room for the next.

    Waitress by itself takes no more until some have been silent for minutes. Whoever sends a request slowly takes no
    thread meanwhile: a request is given to one when it is complete.
    """

    def handle_accept(self) -> None:
        """Take a connection; called by the server's loop."""
        channels = list(self.active_channels.values())
        silent = [channel for channel in channels if not channel.requests and not channel.will_close]
        if len(channels) >= MOST_CONNECTIONS and silent:
            # Closed by the loop, not here: it may just be about to read from it.
            min(silent, key=lambda channel: channel.last_activity).will_close = True
        super().handle_accept()


def serve_on(listening: socket.socket, app: Callable[..., Any], *, threads: int, most_bytes: int) -> Server:
    """A server of `app` on a socket that is bound, answering up to `threads` requests at a time.

    Args:
        most_bytes: longest request body.
    """
    adjustments = Adjustments(
        threads=threads,
        max_request_body_size=most_bytes,
        ident=None,
        channel_timeout=_SILENT_S,
        cleanup_interval=5,
        # Never reached: `Server` keeps below it, but for those that are still being closed.
        connection_limit=2 * MOST_CONNECTIONS,
        # `select` fails where the process has more than 1024 files open.
        asyncore_use_poll=True,
    )
    kind = (listening.family, listening.type, listening.proto, listening.getsockname())
    return Server(app, _sock=listening, bind_socket=False, adj=adjustments, sockinfo=kind)
