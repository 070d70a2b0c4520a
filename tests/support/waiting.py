"""Waiting for what another process or thread does: for the condition itself, as long as a slow machine may take."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

# A test that waits this long has failed: no machine is so slow, or so busy.
LONG_S = 120.0


def wait_for(what: str, condition: Callable[[], object], every_s: float = 0.02) -> None:
    """Return as soon as `condition()` holds."""
    until = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < until, f"not within {LONG_S:.0f} s: {what}"
        time.sleep(every_s)


def children() -> set[int]:
    """Numbers of the processes that this one has started and that have not ended."""
    lists = Path("/proc/self/task").glob("*/children")
    started = {int(pid) for of in lists for pid in of.read_text().split()}
    return {pid for pid in started if "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()}
