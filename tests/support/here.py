"""An engine that computes in this process: for tests of what is computed, not of where."""

from __future__ import annotations

from collections import deque

from thermoforce_mpc.execution.execute import Begun, Ended, Event, answer_to


class Here:
    """One task after the other, each when it is waited for; pickled and answered as a worker does it."""

    width = 1

    def __init__(self) -> None:
        self._left: deque[tuple[str, bytes]] = deque()
        self._begun: tuple[str, bytes] | None = None

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None:
        self.cancel()

    @property
    def room(self) -> int:
        """How many more tasks to submit now."""
        return 1 - len(self._left) - (self._begun is not None)

    def submit(self, key: str, title: str, payload: bytes) -> None:
        """Keep a task until it is waited for."""
        self._left.append((key, payload))

    def wait(self) -> Event:
        """The next event."""
        if self._begun is None:
            self._begun = self._left.popleft()
            return Begun(self._begun[0])
        (key, payload), self._begun = self._begun, None
        return Ended(key, answer_to(payload, lambda share: None))

    def cancel(self) -> None:
        """Forget what is left."""
        self._left.clear()
        self._begun = None
