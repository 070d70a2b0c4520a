"""Values of a BOPTEST scenario; its forecast uncertainty has separate levels for temperature and irradiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from thermoforce_mpc.boundary.forecast_error import ForecastError, Level
from thermoforce_mpc.data import Array
from thermoforce_mpc.service.access import Refusal

# What stands for no value where one may be left out.
NOTHING = (None, "")
LEVELS: tuple[Level, ...] = ("low", "medium", "high")


class SeparateErrors(ForecastError):
    """Forecast errors with one level for the temperature and one for the irradiance; None: no error."""

    def __init__(self, temperature: Level | None, solar: Level | None, seed: int) -> None:
        super().__init__(temperature or solar or "low", seed)
        self._temperature = ForecastError(temperature, seed) if temperature else None
        self._solar = ForecastError(solar, seed) if solar else None

    def apply(self, time_s: Array, T_out_C: Array, hourly_solar_W_m2: Array, solar_W_m2: Array) -> tuple[Array, Array]:
        """See `ForecastError.apply`."""
        T_seen, solar_seen = T_out_C, solar_W_m2
        if self._temperature:
            T_seen, _ = self._temperature.apply(time_s, T_out_C, hourly_solar_W_m2, solar_W_m2)
        if self._solar:
            _, solar_seen = self._solar.apply(time_s, T_out_C, hourly_solar_W_m2, solar_W_m2)
        return T_seen, solar_seen


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
    """Forecast errors of a scenario, or None for a perfect forecast; without a seed, seed 0 is used."""
    if temperature is None and solar is None:
        return None
    return SeparateErrors(temperature, solar, seed or 0)
