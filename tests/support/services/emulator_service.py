"""The embedded plant's service on a free loopback port, for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from boptest_server import template
from waiting import LONG_S

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.service.server import serving


@contextmanager
def running_emulator_service(**options) -> Iterator[str]:
    """Base URL of a service that runs until the block ends."""
    template()  # compiles the plant now: later it would cost a client's patience
    before = set(threading.enumerate())
    with serving(synthetic_weather(), **options) as url:
        (thread,) = (one for one in set(threading.enumerate()) - before if one.name == "tf-mpc service")
        yield url
    thread.join(LONG_S)
    assert not thread.is_alive(), "the service did not end"
