"""Answers of the service as typed values, in the units of the protocol (K, W, s)."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
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
class Scenario:
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

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Scenario:
        """Read the payload of GET scenario; keys unknown to this client are ignored."""
        return cls(**{name: data.get(name) for name in cls.__dataclass_fields__})

    def as_json(self) -> dict[str, Any]:
        """All five keys, as the service expects them."""
        return asdict(self)


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
        if not isinstance(answer, bool):
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


def scenario(at: str, answer: Any) -> Scenario:
    """A scenario, null where a part is not set."""
    values = mapping(at, answer)
    for name in Scenario.__dataclass_fields__:
        kind = int if name == "seed" else str
        if not (values.get(name) is None or (isinstance(values[name], kind) and values[name] is not True)):
            raise ProtocolError(at, f"{name} is {values[name]!r:.120}, expected {kind.__name__} or null")
    return Scenario.from_json(values)


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
