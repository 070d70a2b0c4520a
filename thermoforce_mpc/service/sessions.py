"""Registry of running tests: start, look up, stop, and drop when idle."""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from thermoforce_mpc.service.access import Refusal
from thermoforce_mpc.service.session import Session

# Largest number of requests of one test admitted at a time; they are answered one after another.
MOST_ASKING = 2
_LONE = "the one test of clients that know no test ids"


class UnknownTestid(Exception):
    """Unknown test id: stopped, dropped when idle, or never started."""


@dataclass
class _Entry:
    session: Session
    client: str
    born_s: float
    used_s: float
    asking: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


class Sessions:
    """At most `most` tests at a time, `each` of them (None: all) by one client. Thread-safe.

    One without requests for `idle_s`, s, is dropped, and any that is `lifetime_s`, s, old.
    """

    def __init__(
        self,
        make: Callable[[], Session],
        *,
        most: int,
        idle_s: float,
        lifetime_s: float = math.inf,
        each: int | None = None,
    ) -> None:
        self._make, self._most, self._each = make, most, each or most
        self._idle_s, self._lifetime_s = idle_s, lifetime_s
        self._entries: dict[str, _Entry] = {}
        # Stopped tests that are still simulating, which cannot be interrupted.
        self._ending: list[_Entry] = []
        self._lock = threading.Lock()

    def select(self, client: str = "") -> str:
        """Start a test for the address `client`; returns its id. Raises `Refusal` (429) where there is none left."""
        return self._id_of(str(uuid.uuid4()), client)

    def lone(self, client: str = "") -> str:
        """Id of the test of clients without test ids: started on the first request, never dropped.

        Such a client could not detect that its test was replaced. Raises `Refusal` (429) as `select`.
        """
        return self._id_of(_LONE, client)

    def _id_of(self, testid: str, client: str) -> str:
        with self._lock:
            self._drop_idle()
            if testid not in self._entries:
                self._entries[testid] = self._new_entry(client)
            return testid

    def stop(self, testid: str) -> None:
        """End a test. Raises `UnknownTestid`."""
        with self._lock:
            entry = self._entry(testid)
            del self._entries[testid]
            if entry.asking:
                self._ending.append(entry)

    def check(self, testid: str) -> None:
        """Check that the test exists, without waiting for it. Raises `UnknownTestid`."""
        with self._lock:
            self._entry(testid).used_s = time.monotonic()

    @contextmanager
    def using(self, testid: str) -> Iterator[Session]:
        """The test, locked for one request. Raises `UnknownTestid`, or `Refusal` (429) when too many requests wait."""
        with self._lock:
            entry = self._entry(testid)
            if entry.asking >= MOST_ASKING:
                raise Refusal(429, "This test is busy: an earlier request is still being answered; ask again later.")
            # Not idle from here on, though the request may still wait for another one.
            entry.asking += 1
        try:
            with entry.lock:
                yield entry.session
        finally:
            with self._lock:
                entry.asking -= 1
                entry.used_s = time.monotonic()
                self._ending = [ending for ending in self._ending if ending.asking]

    def _entry(self, testid: str) -> _Entry:
        self._drop_idle()
        if testid not in self._entries:
            raise UnknownTestid(testid)
        return self._entries[testid]

    def _new_entry(self, client: str) -> _Entry:
        running = [*self._entries.values(), *self._ending]
        if len(running) >= self._most:
            raise Refusal(429, f"All {self._most} tests of this service are in use; stop one, or try again later.")
        if sum(entry.client == client for entry in running) >= self._each:
            raise Refusal(429, f"{client} runs {self._each} tests of this service, its share; stop one.")
        now_s = time.monotonic()
        return _Entry(self._make(), client, now_s, now_s)

    def _drop_idle(self) -> None:
        now_s = time.monotonic()
        for testid, entry in list(self._entries.items()):
            over = entry.used_s < now_s - self._idle_s or entry.born_s < now_s - self._lifetime_s
            if testid != _LONE and over and not entry.asking:
                del self._entries[testid]
