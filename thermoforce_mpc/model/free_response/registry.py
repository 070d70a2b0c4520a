"""Registry of free responses by name. A new method needs one file and one entry here.

Each name, or a `file.py:name` of the user's, stands for a function or class whose parameters are the method's options,
all with defaults, and that returns a `FreeResponse`. A keyword `rc` gets the identified linear free part, None where
there is none. Other distributions announce theirs in the group `thermoforce_mpc.free_responses`, see
docs/how-to/plugins.md.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from thermoforce_mpc.errors import ConfigError, suggestion
from thermoforce_mpc.protocols import FreeResponse
from thermoforce_mpc.registry import Registry
from thermoforce_mpc.scenario.own_code import is_own_code, own_code, unfit

if TYPE_CHECKING:
    from thermoforce_mpc.model.free_response.rc import RcParameters


def _residual(
    backbone: str = "shipped_weather", calibrate: bool = True, *, rc: RcParameters | None = None
) -> FreeResponse:
    """Linear weather models plus a frozen forecaster on what they leave over, and the model's own linear free part,
    by how both have erred: the default, for every building.
    """
    from thermoforce_mpc.model.free_response.calibrated import CalibratedFreeResponse
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse
    from thermoforce_mpc.model.free_response.following import MeanFreeResponse
    from thermoforce_mpc.model.free_response.rc import RcFreeResponse

    method: FreeResponse = ChronosFreeResponse(backbone, after_linear_weather=True)
    if rc is not None:
        method = MeanFreeResponse(method, RcFreeResponse(rc))
    return CalibratedFreeResponse(method) if calibrate else method


def _chronos(backbone: str = "shipped", resolutions: str = "several") -> FreeResponse:
    """Frozen forecaster alone: the paper's way, and the way to judge one that reads the weather itself."""
    from thermoforce_mpc.model.free_response.chronos import ChronosFreeResponse

    return ChronosFreeResponse(backbone, resolutions=resolutions)


def _linear_weather() -> FreeResponse:
    """Linear model of weather and daily course: fast and without torch, where people disturb little."""
    from thermoforce_mpc.model.free_response.linear_weather import LinearWeather

    return LinearWeather()


def _rc(*, rc: RcParameters | None) -> FreeResponse:
    """RC model identified with the operator, filtered: the usual grey box, to compare with."""
    from thermoforce_mpc.model.free_response.rc import RcFreeResponse

    if rc is None:
        raise ConfigError("free response 'rc': the model has no linear free part (it was identified from pairs alone)")
    return RcFreeResponse(rc)


def _persistence() -> FreeResponse:
    """The last value holds: the least to beat; it stands in with less than a day of history."""
    from thermoforce_mpc.model.free_response.linear_weather import Persistence

    return Persistence()


_OWN: dict[str, Callable[..., FreeResponse]] = {
    "residual": _residual,
    "chronos": _chronos,
    "linear_weather": _linear_weather,
    "rc": _rc,
    "persistence": _persistence,
}

REGISTRY: Registry[Callable[..., FreeResponse]] = Registry(
    "free response", "free_responses", _OWN, ConfigError, lambda entry: unfit(entry, ("rc",))
)


def own_options() -> dict[str, dict[str, Any]]:
    """Return the free responses of this package by name, each with its options and their defaults."""
    return {name: options_of(build) for name, build in REGISTRY.own.items()}


def options_of(build: Callable[..., FreeResponse]) -> dict[str, Any]:
    """Return the options of a free response with their defaults."""
    return {key: parameter.default for key, parameter in inspect.signature(build).parameters.items() if key != "rc"}


def find_free_response(name: str) -> Callable[..., FreeResponse]:
    """What makes a free response: by name, or the class or function `file.py:name` of the user's.

    Raises `ConfigError` where there is none, or its parameters cannot be options.
    """
    if not is_own_code(name):
        return REGISTRY.find(name)
    found: Callable[..., FreeResponse] = own_code(name, "free_response.name", ConfigError)
    if wrong := unfit(found, ("rc",)):
        raise ConfigError(f"free_response.name: {name}: {wrong}")
    return found


def build_free_response(name: str, *, rc: RcParameters | None = None, **options: Any) -> FreeResponse:
    """Build a free response by name; `rc` is the identified linear free part, needed by 'rc' and used by 'residual'.

    Raises `ConfigError` for an unknown name or option, or no linear free part, and `BackboneError` by the weights.
    """
    build = check_free_response(name, options)
    return build(rc=rc, **options) if "rc" in inspect.signature(build).parameters else build(**options)


def needs_identified(name: str) -> bool:
    """Whether a free response cannot be built without the identified linear free part."""
    rc = inspect.signature(find_free_response(name)).parameters.get("rc")
    return rc is not None and rc.default is inspect.Parameter.empty


def may_be_file(name: str, key: str, value: object) -> bool:
    """Whether the option `key` of a free response may name a file or folder by `value`; raises `ConfigError`.

    Of ours a backbone that has no registered name, of a plugin's or a file's every text but the default.
    """
    from thermoforce_mpc.model.free_response.backbones.loading import REGISTRY as BACKBONES

    if not isinstance(value, str) or value in BACKBONES:
        return False
    return key == "backbone" if name in REGISTRY.own else value != options_of(find_free_response(name)).get(key)


def check_free_response(name: str, options: dict[str, Any]) -> Callable[..., FreeResponse]:
    """What makes a free response of these options, loading no weights; raises `ConfigError` naming what is allowed."""
    build = find_free_response(name)
    allowed = options_of(build)
    for key, value in options.items():
        if key not in allowed:
            raise ConfigError(
                f"free response '{name}': unknown option '{key}'{suggestion(key, allowed)}; "
                f"known: {', '.join(allowed) or 'none'}"
            )
        # A quoted string such as "off" would be truthy.
        if key == "calibrate" and not isinstance(value, bool):
            raise ConfigError(f"free response '{name}': calibrate is {value!r}, write true or false")
    return build
