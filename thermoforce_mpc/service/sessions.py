"""Registry of running tests: start, look up, stop, and drop when idle.

One test of the service: an embedded plant with control step, scenario and overwritten inputs.

Every public method is one endpoint: it takes the values of the request and returns `Reply(message, payload)`, or raises
`Refusal`. Semantics follow the BOPTEST service.
"""

from __future__ import annotations

import math
import threading
import time
import uuid
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from thermoforce_mpc.boundary.forecast_error import MAX_HORIZON_H, ForecastError, Level
from thermoforce_mpc.data import HOUR_S, Array, Period
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import plain_number
from thermoforce_mpc.plants.embedded.emulator import LEAST_STEP_S, NEVER_GIVEN, Emulator
from thermoforce_mpc.plants.embedded.kernel import STEP_S
from thermoforce_mpc.plants.kpis import PEAKS
from thermoforce_mpc.service.access import Refusal
from thermoforce_mpc.service.points import served_points

# What stands for no value where one may be left out.
NOTHING = (None, "")
LEVELS: tuple[Level, ...] = ("low", "medium", "high")


def choice(body: Mapping[str, Any], key: str, choices: Sequence[str], nothing: Sequence[str | None] = NOTHING) -> Any:
    """One of `choices`, given in a request; None for what stands for `nothing`. Raises `Refusal`."""
    value = body.get(key)
    if value in nothing:
        return None
    if value not in choices:
        also = [name for name in nothing if name]
        raise Refusal(400, f"Invalid {key} {value!r}; expected one of {', '.join([*also, *choices])}.")
    return value


def seed(value: Any) -> int | None:
    """Seed of a request; None for null, '' and 0. As in BOPTEST, text is refused and whole floats are allowed."""
    if value in NOTHING:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or value < 0 or value != value // 1:
        raise Refusal(400, f"Invalid seed {value!r}: expected a nonnegative integer.")
    return int(value) or None


def forecast_error(temperature: Level | None, solar: Level | None, seed: int | None) -> ForecastError | None:
    """Forecast errors of a scenario, or None for a perfect forecast."""
    return ForecastError(temperature, solar, seed) if temperature or solar else None


__all__ = ["DEFAULT_STEP_S", "LEAST_STEP_S", "MOST_STEP_S", "MOST_VALUES", "Reply", "Session"]

DEFAULT_STEP_S = 3600.0
MOST_STEP_S = 364 * 86400.0
# Limits that bound memory: values per reply, samples per test.
MOST_VALUES = 5_000_000
_MOST_SAMPLES = 400 * 2880


class Reply(NamedTuple):
    """Message and payload of a reply."""

    message: str
    payload: Any


class Session:
    """A running test; `period` returns the scored window of a name. Not thread-safe: the caller holds the lock."""

    def __init__(self, plant: Emulator, period: Callable[[str], Period]) -> None:
        self._plant = plant
        self._points = served_points(plant.case.name)
        self._period = period
        self._step_s = DEFAULT_STEP_S
        self._start_s, self._end_s = plant.now_s, math.inf
        self._scenario: dict[str, Any] = {
            "electricity_price": "constant",
            "time_period": None,
            "temperature_uncertainty": None,
            "solar_uncertainty": None,
            "seed": None,
        }
        self._overwrites: dict[str, float] = {}
        self._active: dict[str, bool] = {}
        # Activated overwrites and the time since when, s: one entry per change.
        self._switched_s: list[float] = []
        self._switches: list[Mapping[str, bool]] = []
        self._n_steps = 0
        self._waited, self._n_waits = 0.0, 0
        self._answered_s: float | None = None

    def step(self) -> Reply:
        """Control step, s."""
        return Reply("The control step.", self._step_s)

    def set_step(self, body: Mapping[str, Any]) -> Reply:
        """Set the control step, s: from 1 ms to 364 days."""
        self._step_s = _number(body, "step", low=LEAST_STEP_S, high=MOST_STEP_S)
        return Reply("The control step was set.", {"step": self._step_s})

    def initialize(self, body: Mapping[str, Any]) -> Reply:
        """Start at `start_time`, s, after `warmup_period`, s, of native control; `final_time`, s, ends the test."""
        start_s = _number(body, "start_time", low=0.0)
        warmup_s = _number(body, "warmup_period", low=0.0)
        final_s = math.inf if body.get("final_time") in (*NOTHING, 0) else _number(body, "final_time")
        return self._start(start_s, warmup_s, final_s)

    def scenario(self) -> Reply:
        """The scenario in force."""
        return Reply("The current scenario.", dict(self._scenario))

    def set_scenario(self, body: Mapping[str, Any]) -> Reply:
        """Change the scenario; a `time_period` initialises the test.

        Price and time period are kept when not given; uncertainties and seed are reset. Other keys are ignored.
        """
        price = choice(body, "electricity_price", self._plant.tariff_names)
        period = choice(body, "time_period", self._plant.case.periods)
        changed: dict[str, Any] = {
            name: choice(body, name, LEVELS, (*NOTHING, "none"))
            for name in ("temperature_uncertainty", "solar_uncertainty")
        }
        changed["seed"] = seed(body.get("seed"))
        if price:
            changed["electricity_price"] = price
        if period:
            changed["time_period"] = period
        self._scenario |= changed
        s = self._scenario
        error = forecast_error(s["temperature_uncertainty"], s["solar_uncertainty"], s["seed"])
        with _refusing():
            self._plant.use(s["electricity_price"], error)
        payload = {name: changed.get(name) for name in self._scenario} | {"time_period": None}
        if period:
            window = self._period(period)
            end_s = window.start_s + window.scored_s
            payload["time_period"] = self._start(window.start_s, window.warmup_s, end_s).payload
        return Reply("The scenario was set.", payload)

    def advance(self, body: Mapping[str, Any]) -> Reply:
        """Simulate one step with the given inputs; others keep their values since the initialisation."""
        if self._answered_s is not None:  # the client's time between two steps over a step's length, for `time_rat`
            self._waited += (time.monotonic() - self._answered_s) / self._step_s
            self._n_waits += 1
        overwrites, active, notes = self._read_inputs(body)
        now_s = self._plant.now_s
        if self._end_s - now_s < LEAST_STEP_S:
            return Reply("End of test case scenario time period reached.", {})
        step_s = min(self._step_s, self._end_s - now_s)
        # A step of less than 30 s also adds a sample.
        if (now_s + step_s - self._plant.begin_s) / STEP_S + self._n_steps > _MOST_SAMPLES:
            raise Refusal(
                400,
                "The record of this test has reached its largest length; initialize the test again, or select another.",
            )
        forced = {name: overwrites.get(name, NEVER_GIVEN) for name, on in active.items() if on}
        with _refusing():
            self._plant.advance_points(forced, step_s)
        self._overwrites, self._active = overwrites, active
        self._n_steps += 1
        if not self._switches or self._switches[-1] != active:
            self._switched_s.append(now_s)
            self._switches.append(active)
        self._answered_s = time.monotonic()
        message = f"Advanced simulation successfully from {now_s}s to {self._plant.now_s}s."
        return Reply("".join(f"{note};" for note in reversed(notes)) or message, self._state())

    def forecast(self, body: Mapping[str, Any]) -> Reply:
        """Forecast of `point_names` from now to `horizon`, s, every `interval`, s."""
        names = _names(body, self._points.forecasts, "forecast points")
        horizon_s = _number(body, "horizon", low=0.0)
        interval_s = _number(body, "interval", low=1.0)
        of_point = {"TDryBul": "temperature_uncertainty", "HGloHor": "solar_uncertainty"}
        erring = {name: key for name, key in of_point.items() if self._scenario[key]}
        for name, key in erring.items():
            if name in names and horizon_s > MAX_HORIZON_H * HOUR_S:
                raise Refusal(
                    400, f"Invalid horizon {horizon_s:g} s: at most {MAX_HORIZON_H} hours in a {key} scenario."
                )
        _check_size(len(names), horizon_s / interval_s)
        with _refusing():
            series = self._points.forecast(self._plant, names, horizon_s, interval_s, erring)
        return Reply("The forecast.", _lists(series))

    def results(self, body: Mapping[str, Any]) -> Reply:
        """Recorded values of `point_names` between `start_time` and `final_time`, s, warm-up included."""
        names = _names(body, {**self._points.measurements, **self._points.inputs}, "inputs and measurements")
        start_s = _end(body, "start_time")
        final_s = _end(body, "final_time")
        if start_s > self._plant.now_s or final_s < self._plant.begin_s:
            raise Refusal(
                400,
                f"Nothing is recorded between {start_s:g} s and {final_s:g} s: "
                f"the record of this test goes from {self._plant.begin_s:g} s to {self._plant.now_s:g} s.",
            )
        return Reply("The results.", _lists(self._recorded(names, start_s, final_s)) if names else {})

    def kpi(self) -> Reply:
        """Key performance indicators since the end of the warm-up."""
        if self._plant.now_s > self._start_s:
            kpis: dict[str, float | None] = dict(self._plant.kpis())
        else:
            peaks = [PEAKS[name] for name in self._plant.case.carriers]
            kpis = dict.fromkeys(("cost_tot", "emis_tot", "ener_tot", "idis_tot", "tdis_tot", *peaks), 0.0)
        wait = self._waited / self._n_waits if self._n_waits else None
        # Of carriers that the test case has not.
        absent: dict[str, float | None] = dict.fromkeys(("pele_tot", "pgas_tot", "pdih_tot"))
        return Reply("The key performance indicators.", dict(sorted((absent | kpis | {"time_rat": wait}).items())))

    def _start(self, start_s: float, warmup_s: float, end_s: float) -> Reply:
        with _refusing():
            self._plant.reset(start_s, warmup_s, self._scenario["electricity_price"])
        self._start_s, self._end_s = start_s, end_s
        self._overwrites, self._active, self._switched_s, self._switches = {}, {}, [], []
        self._n_steps, self._waited, self._n_waits, self._answered_s = 0, 0.0, 0, None
        return Reply(f"The test was initialized to {start_s:g} s.", self._state())

    def _state(self) -> dict[str, float | None]:
        now_s = self._plant.now_s
        series = self._recorded([*self._points.measurements, *self._points.inputs], now_s, now_s)
        return {name: _plain(values[-1]) for name, values in series.items()}

    def _recorded(self, names: list[str], start_s: float, final_s: float) -> dict[str, Array]:
        switches = [name for name in names if name.endswith("_activate")]
        record = self._plant.recorded(start_s, final_s)
        _check_size(len(names), record["time"].size)
        series = self._points.recorded(self._plant, [name for name in names if name not in switches], record)
        # A sample belongs to the step that ends there or later; nothing was overwritten before the first step. Only the
        # switches in force within the requested time are searched.
        first, last = bisect_left(self._switched_s, start_s), bisect_left(self._switched_s, final_s)
        in_force = [{} if first == 0 else self._switches[first - 1], *self._switches[first:last]]
        step = np.searchsorted(self._switched_s[first:last], series["time"])
        for key in switches:
            name = key.removesuffix("_activate")
            series[key] = np.array([float(active.get(name, False)) for active in in_force])[step]
        return {name: series[name] for name in [*names, "time"]}

    def _read_inputs(self, body: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, bool], list[str]]:
        overwrites, active, notes = dict(self._overwrites), dict(self._active), []
        for key, value in body.items():
            if key not in self._points.inputs:
                raise Refusal(400, f"Unexpected input {key!r}; known: {', '.join(self._points.inputs)}.")
            if value is None:
                continue
            name, _, ending = key.rpartition("_")
            if ending == "activate":
                active[name] = _switch(key, value)
                continue
            number = _number(body, key)
            info = self._points.inputs[key]
            overwrites[name] = min(max(number, info.minimum or 0.0), info.maximum or 0.0)
            if overwrites[name] != number:
                # Wording of the BOPTEST service, which clients search for.
                side = "above maximum" if number > overwrites[name] else "below minimum"
                notes.append(
                    f"WARNING: value of {number} for {key} is {side} of {overwrites[name]}.  Using {overwrites[name]}. "
                )
        return overwrites, active, notes


@contextmanager
def _refusing() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        raise Refusal(400, str(error)) from error


def _number(body: Mapping[str, Any], key: str, *, low: float = -math.inf, high: float = math.inf) -> float:
    if key not in body:
        raise Refusal(400, f"Missing parameter {key}.")
    given = body[key]
    try:
        if isinstance(given, bool):
            raise TypeError
        value = plain_number(given) if isinstance(given, str) else float(given)
    except OverflowError:
        raise Refusal(400, f"Invalid value of {key}: the integer is too large.") from None
    except (TypeError, ValueError):
        raise Refusal(400, f"Invalid value {given!r} of {key}: expected a number.") from None
    if not math.isfinite(value):
        raise Refusal(400, f"Invalid value {given!r} of {key}: expected a finite number.")
    if value < low or value > high:
        bound = f"at least {low:g}" if value < low else f"at most {high:g}"
        raise Refusal(400, f"Invalid value {value:g} of {key}: expected {bound}.")
    return value


def _end(body: Mapping[str, Any], key: str) -> float:
    """An end of a record, s; open where it is infinite, as BOPTEST's own example interface sends it."""
    given = body.get(key)
    return float(given) if given in ("inf", "-inf", math.inf, -math.inf) else _number(body, key)


def _switch(key: str, value: Any) -> bool:
    on = {"1": True, "1.0": True, "true": True, "0": False, "0.0": False, "false": False}.get(str(value).lower())
    if on is None:
        raise Refusal(400, f"Invalid value {value!r} of {key}: expected 0 or 1.")
    return on


def _names(body: Mapping[str, Any], points: Mapping[str, Any], what: str) -> list[str]:
    if "point_names" not in body:
        raise Refusal(400, "Missing parameter point_names.")
    names = body["point_names"]
    if isinstance(names, str):
        names = [names]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise Refusal(400, f"Invalid point_names {names!r}: expected a list of names of {what}.")
    # Every reply contains time.
    names = [name for name in names if name != "time"]
    wrong = [name for name in names if name not in points]
    if wrong:
        unknown = ", ".join(wrong[:5]) + (", ..." if len(wrong) > 5 else "")
        raise Refusal(400, f"Invalid point name(s) {unknown}: not among the {what} of this test case.")
    return list(dict.fromkeys(names))


def _check_size(n_names: int, n_samples: float) -> None:
    if (n_names + 1) * (n_samples + 1) > MOST_VALUES:
        raise Refusal(400, f"More than {MOST_VALUES} values in one request: give fewer points or a shorter time.")


def _lists(series: Mapping[str, Array]) -> dict[str, list[float | None]]:
    return {
        name: values.tolist() if np.isfinite(values).all() else [_plain(value) for value in values]
        for name, values in series.items()
    }


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


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
