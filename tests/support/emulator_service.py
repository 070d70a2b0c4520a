"""The embedded plant's service on a free loopback port, for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.service.server import build_server, effective_port


@contextmanager
def running_emulator_service(**options) -> Iterator[str]:
    """Base URL of a service that runs until the block ends."""
    server = build_server(synthetic_weather(), port=0, **options)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{effective_port(server)}"
    finally:
        server.close()
        thread.join(timeout=5)
        assert not thread.is_alive(), "the service did not end"
