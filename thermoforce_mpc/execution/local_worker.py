"""What a process of this machine does with tasks."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection

from thermoforce_mpc.execution.engine import Answer, answer_to

_TERMINATED = 143

_channel: Connection | None = None


def begin(channel: Connection) -> None:
    """Prepare the process: interrupts are for the parent, which ends this process by SIGTERM; so does its own end."""
    global _channel
    _channel = channel
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _terminate)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _terminate(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not cut the release short
    sys.exit(_TERMINATED)


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def work(key: str, payload: bytes) -> Answer:
    """Make the call of `payload`, which is the task of `key`."""
    try:
        return answer_to(payload, lambda share: _tell(key, share))
    except SystemExit:  # what the task held is released; the pool would go on
        for child in multiprocessing.active_children():
            child.terminate()
        os._exit(_TERMINATED)


def _tell(key: str, share: float) -> None:
    if _channel is not None:
        with suppress(OSError):  # the parent has ended
            _channel.send((key, share))
