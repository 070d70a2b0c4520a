"""Registry of free responses by name. A new method needs one file and one entry here."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.scenario.settings import suggestion

if TYPE_CHECKING:
    from thermoforce_mpc.model.free_response.rc import RcParameters


def _residual(
    backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several", calibrate: bool = True
) -> FreeResponse:
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
    from thermoforce_mpc.model.free_response.residual import ResidualFreeResponse

    return _calibrated(ResidualFreeResponse(ChronosFreeResponse(backbone, context_steps, resolutions)), calibrate)


def _chronos(
    backbone: str = "shipped", context_steps: int = 512, resolutions: str = "several", calibrate: bool = False
) -> FreeResponse:
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse

    return _calibrated(ChronosFreeResponse(backbone, context_steps, resolutions), calibrate)


def _calibrated(method: FreeResponse, calibrate: bool) -> FreeResponse:
    from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse

    return CalibratedFreeResponse(method) if calibrate else method


def _linear_weather() -> FreeResponse:
    from thermoforce_mpc.model.free_response.linear_weather import LinearWeather

    return LinearWeather()


def _rc(*, rc: RcParameters | None) -> FreeResponse:
    from thermoforce_mpc.model.free_response.rc import RcFreeResponse

    if rc is None:
        raise ConfigError("free response 'rc': the model has no linear free part (it was identified from pairs alone)")
    return RcFreeResponse(rc)


def _persistence() -> FreeResponse:
    from thermoforce_mpc.model.free_response.persistence import Persistence

    return Persistence()


_BUILDERS: dict[str, Callable[..., FreeResponse]] = {
    "residual": _residual,
    "chronos": _chronos,
    "linear_weather": _linear_weather,
    "rc": _rc,
    "persistence": _persistence,
}


def free_response_options() -> dict[str, dict[str, Any]]:
    """Return all free responses by name, each with its options and their defaults."""
    return {
        name: {key: p.default for key, p in inspect.signature(builder).parameters.items() if key != "rc"}
        for name, builder in _BUILDERS.items()
    }


def build_free_response(name: str, *, rc: RcParameters | None = None, **options: Any) -> FreeResponse:
    """Build a free response by name; `rc` is the identified linear free part, needed by 'rc'.

    Raises:
        ConfigError: unknown name or option, or 'rc' without a linear free part.
        BackboneError: the forecaster's weights cannot be loaded.
    """
    check_free_response(name, options)
    if name == "rc":
        return _rc(rc=rc)
    return _BUILDERS[name](**options)


def check_free_response(name: str, options: dict[str, Any]) -> None:
    """Check a name and its options without loading weights; raises `ConfigError` naming what is allowed."""
    known = free_response_options()
    if name not in known:
        raise ConfigError(f"unknown free response '{name}'{suggestion(name, known)}; known: {', '.join(known)}")
    allowed = known[name]
    for key, value in options.items():
        if key not in allowed:
            raise ConfigError(
                f"free response '{name}': unknown option '{key}'{suggestion(key, allowed)}; "
                f"known: {', '.join(allowed) or 'none'}"
            )
        # A quoted string such as "off" would be truthy.
        if key == "calibrate" and not isinstance(value, bool):
            raise ConfigError(f"free response '{name}': calibrate is {value!r}, write true or false")
