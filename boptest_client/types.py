"""Frozen data types of the client, in the units of the protocol (K, W, s)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from boptest_client.texts import safe_text


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
