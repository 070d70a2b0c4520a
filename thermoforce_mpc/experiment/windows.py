"""Windows of a plant, and prices over them: what cannot be right is refused before anything is run."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from thermoforce_mpc.data import DAY_S, Period
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import DoubtfulInput, plain_number
from thermoforce_mpc.plants.registry import tariff_of, windows_of
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.scenario import PlantSpec
from thermoforce_mpc.scenario.settings import suggestion
from thermoforce_mpc.scenario.testcase import TestCase

# BOPTEST's names and those of plants of our own; the plant knows which of them it has.
_NAMED_PERIODS = (
    "peak_heat_day", "typical_heat_day", "peak_cool_day", "typical_cool_day", "mix_day", "cold_day", "cold_week",
    "sunny_week",
)  # fmt: skip
# Distance of the instants at which prices must be known, s.
_PRICE_STEP_S = 900.0


def scored_period(plant: Plant, name: str, days: float) -> Period:
    """The window called `name` on this plant, `days` long; raises `ConfigError` for a name that is not one."""
    check_window(name)
    return replace(plant.period(name), scored_s=days * DAY_S)


def check_prices(spec: PlantSpec, price: str, period: Period, ahead_s: float = 0.0) -> None:
    """Refuse (`ConfigError`) a file of prices that ends before the window does, or forecasts `ahead_s` beyond it do."""
    if spec.prices_file is None or price != "highly_dynamic":
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtfulInput)  # said when the plant was built
        tariff = tariff_of(Path(spec.prices_file))
    until_s = period.start_s + period.scored_s + ahead_s
    tariff(np.append(np.arange(period.start_s, until_s, _PRICE_STEP_S), until_s))


def check_window(name: str, key: str = "period") -> None:
    """Refuse a `name` that no plant can know as a window; raises `ConfigError` naming `key` and those there are."""
    try:
        if not 0.0 <= plain_number(name) < 365.0:
            raise ConfigError(f"{key}: '{name}': a start day lies between 0 and 365")
    except ValueError:
        if name not in _NAMED_PERIODS:
            raise ConfigError(
                f"{key}: '{name}' is not a window{suggestion(name, _NAMED_PERIODS)}; "
                f"use {', '.join(_NAMED_PERIODS)}, or the day of the year it starts, such as 44"
            ) from None


def check_windows(names: Iterable[str], spec: PlantSpec, testcase: TestCase) -> None:
    """Refuse windows that the plant does not have, as far as that is known without it; raises `ConfigError`."""
    windows_of_plant = cache(partial(windows_of, spec, testcase))  # may open an FMU
    days: dict[float, str] = {}
    for name in names:
        check_window(name, "windows")
        if name not in _NAMED_PERIODS:  # a start day, which all have
            if (earlier := days.setdefault(float(name), name)) != name:
                raise ConfigError(f"windows: '{earlier}' and '{name}' are the same start day; leave one out")
            continue
        windows = windows_of_plant()
        if windows is not None and name not in windows:
            raise ConfigError(
                f"windows: {testcase.name} has no '{name}'; use {''.join(f'{window}, ' for window in windows)}or the "
                "day of the year it starts, such as 44"
            )
