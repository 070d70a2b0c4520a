"""Foundation models by name: what each is, under which licence, and what it needs. `tf-mpc free-responses` lists them.

Parameters and licences are of the weights, as the packages and model cards stated them in November 2026.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from platform import python_version

from packaging.specifiers import SpecifierSet

from thermoforce_mpc.errors import BackboneError

WEATHER, SERIES = "past and future", "none"


@dataclass(frozen=True)
class Known:
    """A model that is chosen by name.

    `checkpoint`: name on the hub, `owner/model` with `@revision` where the main branch is another model; '' where the
    weights, which `parameters` and `licence` are of, are in an installed package. `covariates`: whether it reads the
    weather. `module`: what its package is imported as, '' for ours. `python`, `torch`: versions it works with.
    """

    name: str
    checkpoint: str
    parameters: str
    licence: str
    covariates: str = SERIES
    extra: str = ""
    module: str = ""
    python: str = ""
    torch: str = ""

    @property
    def weights(self) -> str:
        """Where the weights come from."""
        return f"hub: {self.checkpoint}" if self.checkpoint else "shipped"

    def missing(self) -> str:
        """Why it cannot be used here, with what to do; '' where its package is installed."""
        if self.python and python_version() not in SpecifierSet(self.python):
            own = f"with a newer one, pip install 'thermoforce-mpc[{self.extra}]'"
            return f"it needs Python {self.python}, this is {python_version()}: {own}"
        if self.torch and (here := _torch_version()) not in SpecifierSet(self.torch):
            own = f"pip install 'torch{self.torch}' 'thermoforce-mpc[{self.extra}]'"
            return f"it needs torch {self.torch}, this is {here}: install both in an environment of their own: {own}"
        if self.module and importlib.util.find_spec(self.module) is None:
            return f"it is not installed: pip install 'thermoforce-mpc[{self.extra}]'"
        return ""

    def check(self) -> None:
        """Raise `BackboneError` where `missing` says why."""
        if why := self.missing():
            raise BackboneError(f"backbone '{self.name}': {why}")


def _torch_version() -> str:
    try:
        return version("torch").partition("+")[0]
    except PackageNotFoundError:
        return "not installed"


_APACHE, _NOT_SOLD = "Apache-2.0", "non-commercial"
_GRANITE = {"extra": "granite", "module": "tsfm_public", "torch": ">=2.10,<2.12"}

SHIPPED = Known("shipped", "", "0.49 M", "MIT")
SHIPPED_WEATHER = Known("shipped_weather", "", "0.76 M", "MIT", WEATHER)
FRACAST = Known("fracast", "", "0.09 M", _APACHE, extra="fracast", module="fracast")
KNOWN = (
    SHIPPED,
    SHIPPED_WEATHER,
    FRACAST,
    Known("chronos-bolt-tiny", "amazon/chronos-bolt-tiny", "9 M", _APACHE),
    Known("chronos-bolt-mini", "amazon/chronos-bolt-mini", "21 M", _APACHE),
    Known("chronos-bolt-small", "amazon/chronos-bolt-small", "48 M", _APACHE),
    Known("chronos-bolt-base", "amazon/chronos-bolt-base", "205 M", _APACHE),
    Known("chronos-2-small", "autogluon/chronos-2-small", "28 M", _APACHE, WEATHER),
    Known("chronos-2", "amazon/chronos-2", "120 M", _APACHE, WEATHER),
    Known("tirex-2", "NX-AI/TiRex-2", "83 M", _APACHE, WEATHER, extra="tirex-2", module="tirex2"),
    Known("timesfm", "google/timesfm-2.5-200m-pytorch", "230 M", _APACHE, extra="timesfm", module="timesfm"),
    Known("timesfm-3", "google/timesfm-3.0-pytorch", "330 M", _NOT_SOLD, WEATHER, extra="timesfm", module="timesfm3"),
    Known("toto-2", "Datadog/Toto-2.0-22m", "22 M", _APACHE, extra="toto-2", module="toto2", python=">=3.12"),
    Known("ttm", "ibm-granite/granite-timeseries-ttm-r3@512-30-dec-90-r3", "from 1 M", _APACHE, **_GRANITE),
    Known("flowstate", "ibm-granite/granite-timeseries-flowstate-r1@r1.1", "18 M", _APACHE, **_GRANITE),
)
