"""What people ask of a running controller: other bounds for a while, away, warmer now; and what they set by hand.

One small file holds it, so that a command, a message and a restart see the same.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout

from thermoforce_mpc.connections.discovery import MODES
from thermoforce_mpc.data import Boundary
from thermoforce_mpc.data.dataframes import stamps
from thermoforce_mpc.errors import ConfigError, StorageError
from thermoforce_mpc.files import read_json, write_json

_LOG = logging.getLogger(__name__)
# How long bounds that somebody asks for hold, as a thermostat's until its next change; and what was set by hand, h.
COMFORT_H, BY_HAND_H = 12.0, 4.0
# Bounds while nobody is there, and how much warmer a boost is, °C and K.
AWAY_C, _BOOST_K = (16.0, 28.0), 2.0
_RANGE_C = (5.0, 35.0)
# Between the bounds at least, K: as in a schedule's, they are in order.
_BAND_K = 0.5
# A file of wishes is a few hundred bytes.
_MOST_BYTES = 100_000
# It is written in some ms; who waits for so long, s, waits for one that stands.
_ALONE_S = 3.0
_LONGEST_BOOST_MIN, _LONGEST_AWAY = 480.0, pd.Timedelta("365D")
_DATE = re.compile(r"\d{4}-\d\d-\d\d")
KEYS = ("lower", "upper", "away", "boost", "comfort", "mode")
"""What may be asked: `lower`, `upper` in °C, `away` until a time, `boost` in min; each, and `comfort`, also `off`;
`mode`: one of `MODES`."""

SHOWN = "now.json"
"""Beside the file of wishes: what was decided last, in which mode, and what may be asked."""


@dataclass(frozen=True)
class Wishes:
    """What holds until when, ISO 8601 in UTC; None: nothing is asked. `by_hand`: value and end by actuator; `mode`:
    until another one is asked."""

    lower_C: float | None = None
    upper_C: float | None = None
    comfort_until: str | None = None
    away_until: str | None = None
    boost_until: str | None = None
    by_hand: dict[str, tuple[float, str]] | None = None
    mode: str | None = None


class People:
    """The wishes in the file at `path`.

    One that cannot be read may hold that nothing is to be set: until `mode` is asked anew nothing is, and it is said.
    """

    def __init__(self, path: Path, zone: str | None = None) -> None:
        """`zone`: of times that people write without an offset."""
        self._path, self._zone = path, zone or "UTC"
        self._failed = ""

    def wishes(self) -> Wishes:
        """What is asked, as the file says now; of one that cannot be read, that nothing is set."""
        return self._as_said()[0]

    def _as_said(self) -> tuple[Wishes, str]:
        """What is asked, and why the file cannot be read, '' where it can."""
        try:
            if not self._path.exists():
                return Wishes(), ""
            wishes = Wishes(**read_json(self._path, _MOST_BYTES, ConfigError))
            for one in (wishes.comfort_until, wishes.away_until, wishes.boost_until):
                _passed(one, pd.Timestamp(0, tz="UTC"))
            for bound in (wishes.lower_C, wishes.upper_C):
                _checked(bound)
            if wishes.mode not in (None, *MODES):
                raise ConfigError(f"mode: {wishes.mode!r} is none of {', '.join(MODES)}")
            for name, (value, until) in (wishes.by_hand or {}).items():
                if not math.isfinite(value):
                    raise ConfigError(f"by_hand: {name}: {value} is no value")
                _passed(until, pd.Timestamp(0, tz="UTC"))
            return wishes, ""
        except (OSError, ValueError, TypeError, AttributeError, ConfigError) as error:
            why = f"{self._path} cannot be used ({error}): nothing is set until mode control or advise is asked"
            if why != self._failed:
                self._failed = why
                _LOG.warning("%s", why)
            return Wishes(mode="advise"), why

    def ask(self, key: str, text: str, now: pd.Timestamp) -> Wishes:
        """Ask for one of `KEYS`; raises `ConfigError` for what is none, and `StorageError`."""
        with self._alone():
            return self._asked(key, text, now)

    def _asked(self, key: str, text: str, now: pd.Timestamp) -> Wishes:
        (wishes, wrong), word = self._as_said(), text.strip()
        if wrong and key != "mode":  # it would be written over, and with it what else was asked
            raise ConfigError(wrong)
        off = word.lower() in ("off", "none", "0", "")
        comfort = now + pd.Timedelta(hours=COMFORT_H)
        if key in ("lower", "upper", "comfort"):
            if key == "comfort" and not off:
                raise ConfigError(f"comfort {word!r}: only off, which ends what was asked")
            if off:
                wishes = replace(wishes, lower_C=None, upper_C=None, comfort_until=None)
            else:
                bound = _number(key, word)
                _checked(bound)
                fresh = _passed(wishes.comfort_until, now)
                low, high = (None, None) if fresh else (wishes.lower_C, wishes.upper_C)
                if key == "lower":  # the other one makes way
                    low, high = bound, None if high is None else max(high, bound + _BAND_K)
                else:
                    low, high = None if low is None else min(low, bound - _BAND_K), bound
                wishes = replace(wishes, lower_C=low, upper_C=high, comfort_until=comfort.isoformat())
        elif key == "away":
            until = None if off or word.lower() == "false" else self._time(word, now)
            wishes = replace(wishes, away_until=until)
        elif key == "boost":
            minutes = 0.0 if off else _number(key, word)
            if not 0.0 <= minutes <= _LONGEST_BOOST_MIN:
                raise ConfigError(f"boost {word!r}: minutes, at most {_LONGEST_BOOST_MIN:g}")
            until = (now + pd.Timedelta(minutes=minutes)).isoformat() if minutes else None
            wishes = replace(wishes, boost_until=until)
        elif key == "mode":
            if word not in MODES:
                raise ConfigError(f"mode {word!r}: one of {', '.join(MODES)}; others are options of `tf-mpc control`")
            wishes = replace(wishes, mode=word)
        else:
            raise ConfigError(f"{key!r} cannot be asked; there are {', '.join(KEYS)}")
        self._keep(wishes)
        return wishes

    def set_by_hand(self, name: str, value: float, now: pd.Timestamp) -> pd.Timestamp:
        """Note that the command of an actuator was set by hand; until when that is respected."""
        until = now + pd.Timedelta(hours=BY_HAND_H)
        with self._alone():
            wishes, wrong = self._as_said()
            if wrong:  # nothing is set, so that nobody is overruled
                return until
            try:
                self._keep(replace(wishes, by_hand={**(wishes.by_hand or {}), name: (value, until.isoformat())}))
            except StorageError as error:
                _LOG.warning("%s", error)
        return until

    @property
    def paused(self) -> str:
        """Why a controller that may act is not to, '' where it is."""
        wishes, wrong = self._as_said()
        return wrong or ("mode advise was asked: nothing is set" if wishes.mode == "advise" else "")

    def by_hand(self, now: pd.Timestamp) -> dict[str, tuple[float, pd.Timestamp]]:
        """What was set by hand and is respected yet: value and end by actuator."""
        found = (self.wishes().by_hand or {}).items()
        return {name: (value, pd.Timestamp(until)) for name, (value, until) in found if not _passed(until, now)}

    def applied(self, ahead: Boundary, origin: pd.Timestamp, now: pd.Timestamp) -> tuple[Boundary, tuple[str, ...]]:
        """Bounds with what is asked, and what that is in words.

        Away widens them, a boost raises the lower one, bounds that are asked take their place; in this order.
        """
        wishes, notes = self.wishes(), list[str]()
        at = stamps(ahead.time_s, origin)
        lower, upper = np.array(ahead.lower_C), np.array(ahead.upper_C)

        def until(end: str | None, what: str) -> np.ndarray[Any, Any] | None:
            if end is None or _passed(end, now):
                return None
            local = pd.Timestamp(end).tz_convert(self._zone)
            # Away by a switch is for a year: of the same day of another one.
            year = "" if local.year == now.tz_convert(self._zone).year else " %Y"
            notes.append(f"{what} until {local:%a %d %b{year} %H:%M} was asked")
            return np.asarray(at < pd.Timestamp(end))

        asked = {"lower": wishes.lower_C, "upper": wishes.upper_C}
        words = " and ".join(f"{key} bound {value:g} °C" for key, value in asked.items() if value is not None)
        if words and (held := until(wishes.comfort_until, words)) is not None:
            if wishes.lower_C is not None:
                lower[:, held] = wishes.lower_C
                upper[:, held] = np.maximum(upper[:, held], wishes.lower_C + _BAND_K)
            if wishes.upper_C is not None:
                upper[:, held] = wishes.upper_C
                lower[:, held] = np.minimum(lower[:, held], wishes.upper_C - _BAND_K)
        if (held := until(wishes.away_until, "away")) is not None:
            lower[:, held] = np.minimum(lower[:, held], AWAY_C[0])
            upper[:, held] = np.maximum(upper[:, held], AWAY_C[1])
        if (held := until(wishes.boost_until, f"{_BOOST_K:g} K warmer")) is not None:
            lower[:, held] = np.minimum(lower[:, held] + _BOOST_K, _RANGE_C[1] - _BAND_K)
            upper[:, held] = np.maximum(upper[:, held], lower[:, held] + _BAND_K)
        return replace(ahead, lower_C=lower, upper_C=upper), tuple(notes)

    def shown(self, now: pd.Timestamp) -> dict[str, Any]:
        """What is asked, for displays: bounds, whether away, minutes of boost left, mode."""
        wishes = self.wishes()
        comfort = not _passed(wishes.comfort_until, now)
        boost = now if wishes.boost_until is None else pd.Timestamp(wishes.boost_until)
        left_min = max((boost - now).total_seconds() / 60.0, 0.0)
        return {
            "lower_C": wishes.lower_C if comfort else None,
            "upper_C": wishes.upper_C if comfort else None,
            "away": not _passed(wishes.away_until, now),
            "boost_min": math.ceil(left_min),
            "mode": wishes.mode or MODES[0],
        }

    def _time(self, word: str, now: pd.Timestamp) -> str:
        if word.lower() in ("on", "true", "1"):  # a switch: until it is switched off
            return (now + _LONGEST_AWAY).isoformat()
        try:
            at = pd.Timestamp(word if _DATE.match(word) else "")  # 01.03.2027 is March here, and January there
            if at.tzinfo is None:  # of an hour that the clock has twice the first, of one that it skips its end
                at = at.tz_localize(self._zone, ambiguous=True, nonexistent="shift_forward")
        except (ValueError, TypeError) as error:
            raise ConfigError(f"away {word!r}: no time, as 2026-12-27T18:00") from error
        if not now < at <= now + _LONGEST_AWAY:
            raise ConfigError(f"away {word!r}: a time in the next year, as 2026-12-27T18:00")
        return at.tz_convert("UTC").isoformat()

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep others (the page, a command, the controller) from writing between our reading and writing.

        One that stands meanwhile holds up nobody for long.
        """
        lock = FileLock(self._path.with_suffix(".lock"), timeout=_ALONE_S)
        try:
            lock.acquire()
        except (Timeout, OSError) as error:
            _LOG.warning("%s: not locked (%s)", self._path, error)
        try:
            yield
        finally:
            lock.release()

    def _keep(self, wishes: Wishes) -> None:
        write_json(self._path, asdict(wishes), follow=True)


def _number(key: str, word: str) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise ConfigError(f"{key} {word!r}: no number") from error


def _checked(bound: float | None) -> None:
    if bound is not None and not _RANGE_C[0] <= bound <= _RANGE_C[1]:
        raise ConfigError(f"{bound:g}: bounds are °C, from {_RANGE_C[0]:g} to {_RANGE_C[1]:g}")


def _passed(until: str | None, now: pd.Timestamp) -> bool:
    at = None if until is None else pd.Timestamp(until)
    if at is pd.NaT:
        raise ConfigError(f"{until!r} is no time")
    return at is None or at <= now
