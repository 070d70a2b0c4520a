"""A watchdog outside the loop: a process of its own that gives a building back when no action came for a set time.

What holds a building is a deadline, which each action that was taken moves. It passes where the controller hangs, is
stopped or killed, or sets nothing any more; the watchdog then writes that everything is the building's own again, until
that was taken. It ends with the controller, or once that was done after it died; where another controller took over in
between (the lock of `sole_control` tells), it leaves the building to that one; and what a device holds that neither was
set nor was about to be, somebody set by hand.

It waits for months, so that it loads no connection: what gives back is a process too, for as long as that takes.
"""

from __future__ import annotations

import json
import logging
import math
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from pathlib import Path
from typing import Any, NamedTuple

from thermoforce_mpc.connections.sole import SetByAnother, Sets, last_to_set, sole_control
from thermoforce_mpc.errors import ConfigError

_LOG = logging.getLogger(__name__)
Ours = Mapping[str, Sequence[tuple[float, float | None]]]
"""Commands by name: values by which a device shows that it holds what was set, and how near; None: of a level."""
# How often the deadline is looked at, s, and how soon a building is asked again that does not take its levels back:
# twice as long after each attempt, so that a broker that is gone for good is asked every five minutes, for ever.
_LOOK_S, _AGAIN_S, _SELDOM_S = 0.5, 5.0, 300.0
# The longest attempt, s: a connection has its own limits, of some ten seconds each for what it reads and sets.
_ATTEMPT_S = 120.0
# How long the end of the process is waited for, s.
_END_S = 5.0
# Attempts that are remembered of each command, at a step of a minute those of half a day.
_MOST_OURS = 720
# What is run, and the word for the process that makes one attempt.
_MODULE, _GIVE_BACK = "thermoforce_mpc.connections.watchdog", "give-back"
# Kept, so that Python does not warn of processes that are meant to outlive this one.
_OUTLIVE_US: list[subprocess.Popen[str]] = []


class Watchdog:
    """The controller's side: starts the process, and tells it of each action. One that dies is started again."""

    def __init__(
        self,
        connection: str,
        options: Mapping[str, Any],
        sets: Sets,
        grace_s: float,
        log: Path | None,
        held: Mapping[str, float] | None = None,
    ) -> None:
        """`grace_s`: how long after the end of what was set the building is given back, s; `log`: file it writes to;
        `held`: what devices are put back to, where that is not what giving them back sets (`Connection.put_back`).
        """
        of = {"path": str(sets.resolve())} if isinstance(sets, Path) else {"text": sets}  # texts of several: a list
        self._told = {
            "connection": connection,
            "options": dict(options),
            "sets": of,
            "grace_s": grace_s,
            "controller": os.getpid(),
            "held": dict(held or {}),
        }
        self._log = log
        self._process: subprocess.Popen[str] | None = None
        self._start()

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process is not None
        return self._process.pid

    def about_to_set(self, names: Sequence[str], seconds: float, ours: Ours | None) -> None:
        """Something is about to be set: should it fail, or this process end in it, it may have been."""
        self._tell({"names": list(names), "attempt": float(seconds), "ours": ours or {}})

    def set(self, names: Sequence[str], seconds: float, ours: Ours | None = None) -> None:
        """Something was set, to hold for `seconds` s."""
        self._tell({"names": list(names), "seconds": float(seconds), "ours": ours or {}})

    def released(self) -> None:
        """The building has everything back."""
        self._tell({"names": [], "seconds": None})

    def close(self) -> None:
        """End the process; what is still set then is given back when its time is over."""
        process, self._process = self._process, None
        if process is None or process.stdin is None:
            return
        with suppress(OSError):
            process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            _OUTLIVE_US.append(process)

    def _start(self) -> None:
        with open(os.devnull if self._log is None else self._log, "a", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", _MODULE],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=log,
                text=True,
                start_new_session=True,  # Ctrl-C and a closed terminal are the controller's to answer
            )
        self._tell(self._told, again=False)

    def _tell(self, what: Mapping[str, Any], again: bool = True) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(what, default=str) + "\n")
            self._process.stdin.flush()
        except OSError:
            if not again:
                _LOG.warning("the watchdog cannot be started: what is set ends at its time, by the connection alone")
                return
            _LOG.warning("the watchdog ended, and is started again")
            self.close()
            self._start()
            self._tell(what, again=False)


def _now_s() -> float:
    """A clock that nobody sets, and that goes on while the machine sleeps, s."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class _Attempt(NamedTuple):
    """Whether there is nothing more to be done, and what came of it in words."""

    is_done: bool
    said: str


def watch(told: int) -> None:
    """Read from the descriptor `told` what is watched, and then what is set, a line of JSON each, until it ends."""
    head: dict[str, Any] = {}
    names: list[str] = []
    ours: dict[str, list[tuple[float, float | None]]] = {}
    deadline_s: float | None = None
    alive, rest, failed = True, b"", 0
    with selectors.DefaultSelector() as waiting:
        waiting.register(told, selectors.EVENT_READ)
        while alive or deadline_s is not None:
            if not alive:
                time.sleep(_LOOK_S)
                if not _is_ours(head):
                    return
            elif waiting.select(_LOOK_S):
                part = os.read(told, 65536)  # not by lines: what a buffer holds back is not seen by `select`
                alive = bool(part)
                *lines, rest = (rest + part).split(b"\n")
                for line in lines:
                    beat = json.loads(line)
                    if not head:
                        head = beat
                        continue
                    names, failed = beat["names"] or names, 0
                    for name, some in beat.get("ours", {}).items():  # what failed may have been set: any of these
                        before = ours.get(name, []) if "attempt" in beat else []
                        ours[name] = [*before, *map(tuple, some)][-_MOST_OURS:]
                    if "attempt" in beat:
                        deadline_s = deadline_s or _now_s() + beat["attempt"] + head["grace_s"]
                    else:
                        deadline_s = None if beat["seconds"] is None else _now_s() + beat["seconds"] + head["grace_s"]
            if deadline_s is not None and _now_s() >= deadline_s:
                attempt = _tried({"head": head, "names": names, "ours": ours, "alive": alive})
                deadline_s, failed = _after(attempt, failed)


def _after(attempt: _Attempt, failed: int) -> tuple[float | None, int]:
    """When the next attempt is made, None: never, and how many failed on end; says of those the first one alone."""
    if attempt.is_done:
        _say(attempt.said + (f", at attempt {failed + 1}" if failed else ""))
        return None, 0
    if failed == 0:
        _say(f"{attempt.said}: tried again until it is taken, every {_SELDOM_S / 60.0:g} min at last")
    return _now_s() + min(_AGAIN_S * 2.0 ** min(failed, 30), _SELDOM_S), failed + 1


def _tried(what: Mapping[str, Any]) -> _Attempt:
    """Give everything back in a process of its own, which ends with the attempt."""
    words = [sys.executable, "-P", "-m", _MODULE, _GIVE_BACK]
    try:
        done = subprocess.run(
            words, input=json.dumps(what), stdout=subprocess.PIPE, text=True, timeout=_ATTEMPT_S, check=True
        )
        is_done, said = json.loads(done.stdout.splitlines()[-1])  # a connection may print, too
        return _Attempt(bool(is_done), str(said))
    except (OSError, ValueError, IndexError, subprocess.SubprocessError) as error:
        why = f"no answer in {_ATTEMPT_S:g} s" if isinstance(error, subprocess.TimeoutExpired) else error
        return _Attempt(False, f"{', '.join(what['names'])} could not be given back ({why})")


def _what(head: Mapping[str, Any]) -> Sets:
    if "path" in head["sets"]:
        return Path(head["sets"]["path"])
    text = head["sets"]["text"]
    return tuple(text) if isinstance(text, list) else str(text)


def _is_ours(head: Mapping[str, Any]) -> bool:
    """Whether nobody set the building after our controller, which has died or failed."""
    with suppress(ConfigError, OSError):
        what = _what(head)
        each = what if isinstance(what, tuple) else (what,)
        return all(last_to_set(one).startswith(f"process {head['controller']} ") for one in each)
    return True


def _given_back(
    head: Mapping[str, Any], names: Sequence[str], ours: Mapping[str, Sequence[tuple[float, float | None]]], alive: bool
) -> _Attempt:
    """Give everything back: done where it was taken, or is another controller's; `alive`: ours has the lock."""
    try:
        # While the building cannot be reached it stays our controller's, and is asked again.
        with nullcontext() if alive else sole_control(_what(head), head["controller"]):
            left = _give_back(head, names, ours)
    except SetByAnother as error:
        return _Attempt(True, f"not given back: {error}")
    except Exception as error:  # somebody's connection may raise anything
        return _Attempt(False, f"{', '.join(names)} could not be given back ({type(error).__name__}: {error})")
    back = ", ".join(name for name in names if name not in left) or "nothing"
    kept = f"; set by hand and left alone: {', '.join(left)}" if left else ""
    died = "" if alive else ", and the controller has died"
    return _Attempt(True, f"no action came in time{died}: gave back {back}{kept}")


def _give_back(
    head: Mapping[str, Any], names: Sequence[str], ours: Mapping[str, Sequence[tuple[float, float | None]]]
) -> list[str]:
    """Give back `names` but for those whose device says that somebody set it by hand, which are returned."""
    from thermoforce_mpc.connections.registry import build_connection  # loads pandas and pydantic

    with closing(build_connection(head["connection"], head["options"])) as connection:
        held: Mapping[str, float] = {}
        if (says := getattr(connection, "present", None)) is not None:
            with suppress(Exception):  # one that does not say it is given back
                held = says(names)
        left = [name for name in names if name in held and _by_hand(float(held[name]), ours.get(name, ()))]
        if left and (leave := getattr(connection, "leave", None)) is not None and len(left) == len(names):
            leave()
        elif back := [name for name in names if name not in left]:
            put_back, told = getattr(connection, "put_back", None), head.get("held", {})
            before = {name: float(told[name]) for name in back if name in told and put_back is not None}
            if put_back is not None and before:
                put_back(before)
            if rest := [name for name in back if name not in before]:
                connection.write(dict.fromkeys(rest), 0.0)
        return left


def _by_hand(value: float, ours: Sequence[tuple[float, float | None]]) -> bool:
    near = [(one, within) for one, within in ours if within is not None]
    return math.isfinite(value) and bool(near) and all(abs(value - one) > within for one, within in near)


def _say(text: str) -> None:
    at = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    print(json.dumps({"at": at, "level": "warning", "from": _MODULE, "message": text}), file=sys.stderr, flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        if sys.argv[1:] == [_GIVE_BACK]:
            print(json.dumps(_given_back(**json.loads(sys.stdin.read()))))
        else:
            watch(sys.stdin.fileno())
