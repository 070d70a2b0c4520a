"""All free responses by name. A new one is one new file and one entry here."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.scenario.settings import suggestion

if TYPE_CHECKING:
    from thermoforce_mpc.model.free_response.rc import RcParameters


def _persistence() -> FreeResponse:
    from thermoforce_mpc.model.free_response.persistence import Persistence

    return Persistence()


def _seasonal_naive() -> FreeResponse:
    from thermoforce_mpc.model.free_response.seasonal_naive import SeasonalNaive

    return SeasonalNaive()


def _ar(lags: int = 26, ridge: float = 1e-2) -> FreeResponse:
    from thermoforce_mpc.model.free_response.autoregressive import Autoregressive

    return Autoregressive(lags, ridge)


def _arx(lags: int = 26, ridge: float = 1e-2) -> FreeResponse:
    from thermoforce_mpc.model.free_response.autoregressive import Autoregressive

    return Autoregressive(lags, ridge, weather=True)


def _ets() -> FreeResponse:
    from thermoforce_mpc.model.free_response.exponential_smoothing import ExponentialSmoothing

    return ExponentialSmoothing()


def _linear_weather() -> FreeResponse:
    from thermoforce_mpc.model.free_response.linear_weather import LinearWeather

    return LinearWeather()


def _residual(backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several") -> FreeResponse:
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
    from thermoforce_mpc.model.free_response.residual import ResidualFreeResponse

    return ResidualFreeResponse(ChronosFreeResponse(backbone, context_steps, resolutions))


def _selected(backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several") -> FreeResponse:
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
    from thermoforce_mpc.model.free_response.linear_weather import LinearWeather
    from thermoforce_mpc.model.free_response.persistence import Persistence
    from thermoforce_mpc.model.free_response.residual import ResidualFreeResponse
    from thermoforce_mpc.model.free_response.selected import SelectedFreeResponse

    chronos = ChronosFreeResponse(backbone, context_steps, resolutions)
    candidates: dict[str, FreeResponse] = {
        "persistence": Persistence(),
        "chronos": chronos,
        "linear_weather": LinearWeather(),
        "residual": ResidualFreeResponse(chronos),
    }
    return SelectedFreeResponse(candidates, first="chronos")


def _calibrated(
    method: str = "residual", backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several"
) -> FreeResponse:
    from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse

    if method not in _WITH_BACKBONE:
        raise ConfigError(
            f"free response 'calibrated': method '{method}' is not one of {', '.join(_WITH_BACKBONE)}"
            f"{suggestion(method, _WITH_BACKBONE)}"
        )
    return CalibratedFreeResponse(_WITH_BACKBONE[method](backbone, context_steps, resolutions))


def _chronos(backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several") -> FreeResponse:
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse

    return ChronosFreeResponse(backbone, context_steps, resolutions)


_WITH_BACKBONE: dict[str, Callable[[str, int, str], FreeResponse]] = {
    "selected": _selected,
    "residual": _residual,
    "chronos": _chronos,
}


def _rc(*, rc: RcParameters | None) -> FreeResponse:
    from thermoforce_mpc.model.free_response.rc import RcFreeResponse

    if rc is None:
        raise ConfigError("free response 'rc': the model has no linear free part (it was identified from pairs alone)")
    return RcFreeResponse(rc)


_BUILDERS: dict[str, Callable[..., FreeResponse]] = {
    "chronos": _chronos,
    "calibrated": _calibrated,
    "selected": _selected,
    "residual": _residual,
    "linear_weather": _linear_weather,
    "rc": _rc,
    "arx": _arx,
    "ar": _ar,
    "ets": _ets,
    "seasonal_naive": _seasonal_naive,
    "persistence": _persistence,
}


def build_free_response(name: str, *, rc: RcParameters | None = None, **options: Any) -> FreeResponse:
    """Build a free response by name; `rc` is the identified linear free part that 'rc' forecasts with.

    Raises:
        ConfigError: unknown name or option, or 'rc' without a linear free part.
        BackboneError: the forecaster's weights cannot be loaded.
    """
    check_free_response(name, options)
    if name == "rc":
        return _rc(rc=rc)
    return _BUILDERS[name](**options)


def check_free_response(name: str, options: dict[str, Any]) -> None:
    """Check a name and its options without loading anything; raises `ConfigError` naming what is allowed."""
    if name not in _BUILDERS:
        raise ConfigError(f"unknown free response '{name}'{suggestion(name, _BUILDERS)}; known: {', '.join(_BUILDERS)}")
    allowed = [key for key in inspect.signature(_BUILDERS[name]).parameters if key != "rc"]
    for key in options:
        if key not in allowed:
            raise ConfigError(
                f"free response '{name}': unknown option '{key}'{suggestion(key, allowed)}; "
                f"known: {', '.join(allowed) or 'none'}"
            )
