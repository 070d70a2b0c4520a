"""Answers of the service as typed values, in the units of the protocol (K, W, s), and whether their time is right."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from boptest_client.errors import ProtocolError

# Controls, marks that turn the direction of writing, halves of characters, and separators of lines.
_UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")


def safe_text(text: object, most: int = 500) -> str:
    """`text` without control characters but line breaks and tabs, cut to `most` characters, for a terminal."""
    whole = str(text)
    kept = "".join(c for c in whole[:most] if c in "\n\t" or unicodedata.category(c) not in _UNSAFE)
    return kept if len(whole) <= most else f"{kept} … ({len(whole) - most:,} more characters left out)"


@dataclass(frozen=True)
class Point:
    """An input, measurement or forecast point; unit and limits are None if the service gives none."""

    name: str
    unit: str | None
    description: str
    minimum: float | None
    maximum: float | None

    @classmethod
    def from_json(cls, name: str, data: Mapping[str, Any]) -> Point:
        """Read one entry of `inputs`, `measurements` or `forecast_points`."""
        return cls(
            name=name,
            unit=None if data.get("Unit") is None else safe_text(data["Unit"]),
            description=safe_text(data.get("Description") or ""),
            minimum=_limit(data.get("Minimum")),
            maximum=_limit(data.get("Maximum")),
        )


@dataclass(frozen=True)
class ServiceScenario:
    """A test scenario.

    `electricity_price` is 'constant', 'dynamic' or 'highly_dynamic'; `time_period` is a scored window of the test
    case, such as 'peak_heat_day'; the uncertainties are 'low', 'medium' or 'high'. None keeps the present price and
    time period, but resets uncertainty and seed: the service drops those that a request does not name.
    """

    electricity_price: str | None = None
    time_period: str | None = None
    temperature_uncertainty: str | None = None
    solar_uncertainty: str | None = None
    seed: int | None = None


def _limit(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        return None


def mapping(at: str, answer: Any) -> Mapping[str, Any]:
    """Names and values."""
    if not isinstance(answer, Mapping):
        raise ProtocolError(at, f"expected names and values, got {answer!r:.120}")
    return answer


def text(at: str, answer: Any, what: str) -> str:
    """The text under `what` of an answer, not empty."""
    found = mapping(at, answer).get(what)
    if not isinstance(found, str) or not found:
        raise ProtocolError(at, f"no {what} in the answer ({found!r:.120})")
    return safe_text(found)


def number(at: str, answer: Any) -> float:
    """A number, which services also write as text; NaN for null, since JSON has no NaN."""
    if answer is None:
        return math.nan
    try:
        # To Python the text '1_0' is ten.
        if not isinstance(answer, bool) and not (isinstance(answer, str) and ("_" in answer or not answer.isascii())):
            return float(answer)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ProtocolError(at, f"a value is not a number ({answer!r:.120})")


def numbers(at: str, answer: Any) -> dict[str, float]:
    """Numbers by name."""
    return {key: number(at, value) for key, value in mapping(at, answer).items()}


def step(at: str, answer: Any) -> float:
    """The length of a step, s."""
    step_s = number(at, answer)
    if not (math.isfinite(step_s) and step_s > 0.0):
        raise ProtocolError(at, f"not a length of a step: {answer!r:.120}")
    return step_s


def kpis(at: str, answer: Any) -> dict[str, float | None]:
    """Indicators; one of them at least is a total, which JSON of another kind has not."""
    values = numbers(at, answer)
    if not any(name.endswith("_tot") for name in values):
        raise ProtocolError(at, f"the answer contains no indicator: {answer!r:.120}")
    return {key: None if math.isnan(value) else value for key, value in values.items()}


def testcases(at: str, answer: Any) -> tuple[str, ...]:
    """Names of test cases, sorted."""
    if not isinstance(answer, list):
        raise ProtocolError(at, f"not a list of test cases: {answer!r:.120}")
    return tuple(sorted(text(at, item, "testcaseid") for item in answer))


def scenario(at: str, answer: Any) -> ServiceScenario:
    """A scenario, null where a part is not set."""
    values = mapping(at, answer)
    for name in ServiceScenario.__dataclass_fields__:
        kind = int if name == "seed" else str
        if not (values.get(name) is None or (isinstance(values[name], kind) and values[name] is not True)):
            raise ProtocolError(at, f"{name} is {values[name]!r:.120}, expected {kind.__name__} or null")
    return ServiceScenario(**{name: values.get(name) for name in ServiceScenario.__dataclass_fields__})


def points(at: str, answer: Any) -> dict[str, Point]:
    """Points of a list; one of them at least must have a unit, which JSON of another kind does not."""
    entries = {
        safe_text(name): mapping(f"{at}: {safe_text(name)}", data)
        for name, data in mapping(at, answer).items()
        if name != "time"
    }
    if not any("Unit" in data for data in entries.values()):
        raise ProtocolError(at, f"not a list of points: {answer!r:.120}")
    return {name: Point.from_json(name, data) for name, data in entries.items()}


def series(at: str, answer: Any, names: Sequence[str]) -> dict[str, list[float]]:
    """Values of `names` and 'time', whose instants never fall; none where none are recorded."""
    at, names, found = f"PUT {at}", [*names, "time"], mapping(f"PUT {at}", answer)
    if missing := [name for name in names if name not in found]:
        raise ProtocolError(at, f"no values for {', '.join(missing)}")
    for name in names:
        if not isinstance(found[name], list):
            raise ProtocolError(at, f"{name} is not a list of numbers: {found[name]!r:.120}")
    values = {name: [number(at, value) for value in found[name]] for name in names}
    clock = values["time"]
    if any(len(one) != len(clock) for one in values.values()):
        raise ProtocolError(at, "series differ in length")
    if not (all(map(math.isfinite, clock)) and all(a <= b for a, b in pairwise(clock))):
        raise ProtocolError(at, "its clock ('time') has gaps or runs back")
    return values


TOLERANCE_S = 1e-3
# Length of a scenario of a named period, s.
_SCENARIO_S = 14 * 86400.0
# BOPTEST's recording interval, s.
_SAMPLE_S = 30.0


class ServiceClock:
    """Times of a test in s, NaN where unknown.

    Attributes:
        now_s: where the test stands: the time of the last answer.
        started_s: where it was begun or taken up.
        step_s: the step in force.
        scenario_ends: whether the test ends with a scenario of a named period.
    """

    def __init__(self) -> None:
        self.now_s = self.started_s = self.step_s = math.nan
        self.scenario_ends = False

    def begin(self, at: str, state: dict[str, float], at_s: float) -> dict[str, float]:
        """The `state` after an initialisation at endpoint `at`, which must be of `at_s` where that is known."""
        found_s = state.get("time", math.nan)
        if abs(found_s - at_s) > TOLERANCE_S:
            raise ProtocolError(at, f"its time is {found_s:.10g} s, expected is {at_s:.10g} s")
        self.started_s, self.step_s = found_s, math.nan  # it may reset the step
        return self.move(at, state)

    def step(self, at: str, state: dict[str, float], step_s: float) -> dict[str, float]:
        """The `state` after a step of `step_s`, NaN if unknown; the last one of a scenario ends on time."""
        found_s = state.get("time", math.nan)
        cut = self.scenario_ends and abs(found_s - self.started_s - _SCENARIO_S) <= TOLERANCE_S
        if not cut and (abs(found_s - self.now_s - step_s) > TOLERANCE_S or math.isnan(found_s)):
            expected = f"expected is that of a step of {step_s:g} s from {self.now_s:.10g} s"
            raise ProtocolError(at, f"its time is {found_s:.10g} s, {expected}")
        return self.move(at, state)

    def move(self, at: str, state: dict[str, float]) -> dict[str, float]:
        """The `state`, which must have a finite 'time': there the test stands now."""
        if not math.isfinite(state.get("time", math.nan)):
            raise ProtocolError(at, "the measurements have no time")
        self.now_s = state["time"]
        return state

    def moved(self, record: Mapping[str, Sequence[float]]) -> bool:
        """Whether a record goes on beyond where the test stood."""
        return record["time"][-1] > self.now_s + TOLERANCE_S

    def check_record(self, at: str, clock: Sequence[float], start_s: float, final_s: float) -> None:
        """Raise `ProtocolError` for a record of other times than asked for, or that lacks what was simulated."""
        first, last, now_s = clock[0], clock[-1], self.now_s
        whole = start_s - TOLERANCE_S <= first and last <= final_s + TOLERANCE_S
        since_s, until_s = max(start_s, self.started_s), min(final_s, now_s)  # some services record no warm-up
        if math.isfinite(now_s) and since_s <= until_s:
            whole &= first <= since_s + _SAMPLE_S and last >= until_s - _SAMPLE_S
        if last > now_s + TOLERANCE_S:  # steps that we do not know of; or the clock is wrong
            whole &= first <= start_s + TOLERANCE_S
        if not whole:
            asked = f"asked for {start_s:.10g} to {final_s:.10g} s while the test stands at {now_s:.10g} s"
            raise ProtocolError(at, f"its times are {first:.10g} to {last:.10g} s, {asked}")

    def check_forecast(self, at: str, clock: Sequence[float], horizon_s: float, interval_s: float) -> None:
        """Raise `ProtocolError` unless `clock` rises from now by `interval_s` to `horizon_s` or farther."""
        if clock and abs(clock[0] - self.now_s) > TOLERANCE_S:
            expected = f"expected is {self.now_s:.10g} s, where the test stands"
            raise ProtocolError(at, f"it begins at {clock[0]:.10g} s, {expected}")
        if not clock or any(a == b for a, b in pairwise(clock)):
            raise ProtocolError(at, f"its clock ('time') does not rise: {list(clock[:3])} …")
        n = math.floor(horizon_s / interval_s + 1e-9) + 1
        steps = [(i, time_s - clock[0]) for i, time_s in enumerate(clock[:n])]
        if len(clock) < n or any(abs(after_s - i * interval_s) > TOLERANCE_S for i, after_s in steps):
            got = f"got {len(clock)} from {clock[0]:g} s to {clock[-1]:g} s"
            raise ProtocolError(at, f"asked for {n} instants every {interval_s:g} s, {got}")
