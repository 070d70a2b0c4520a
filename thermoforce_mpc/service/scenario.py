"""Values of a BOPTEST scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.boundary.forecast_error import ForecastError, Level
from thermoforce_mpc.service.access import Refusal

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
