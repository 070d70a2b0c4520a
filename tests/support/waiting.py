"""Waiting for what another process or thread does: for the condition itself, as long as a slow machine may take."""

from __future__ import annotations

import time
from collections.abc import Callable

# A test that waits this long has failed: no machine is so slow, or so busy.
LONG_S = 120.0


def wait_for(what: str, condition: Callable[[], object], every_s: float = 0.02) -> None:
    """Return as soon as `condition()` holds."""
    until = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < until, f"not within {LONG_S:.0f} s: {what}"
        time.sleep(every_s)
