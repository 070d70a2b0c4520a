"""What plants of the EnergyPlus engine share: weather, tariffs, windows, and their course from midnight on."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Generic

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.forecast_error import ForecastError, forecast_weather
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.data import DAY_S, Array, Block, Period
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.plants.checks import day_period
from thermoforce_mpc.plants.energyplus.engine import engine_folder, weather_file
from thermoforce_mpc.plants.energyplus.live import Building, Stretch, U
from thermoforce_mpc.plants.energyplus.process import EngineProcess
from thermoforce_mpc.plants.energyplus.simulate import R
from thermoforce_mpc.plants.shell import PlantShell, Samples, WithProcess
from thermoforce_mpc.plants.waiting import PATIENCE_S
from thermoforce_mpc.scenario.testcase import TestCase


class EnginePlant(WithProcess[EngineProcess[U, R]], PlantShell, Generic[U, R]):
    """A building run through the engine's runtime API, in its own process.

    Durations are multiples of the 5-min step. There is no snapshot; every reset starts a new process.
    """

    _periods: Mapping[str, int]  # first day of the named windows, from 0

    def __init__(
        self,
        testcase: TestCase,
        weather: str,
        *,
        highly_dynamic: tariffs.Tariff | None = None,
        forecast_error: ForecastError | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Read the weather; the engine starts at `reset`.

        Args:
            weather: part of the name of the TMY3 file.
            highly_dynamic: highly dynamic tariff of electricity; default: a synthetic one, see `boundary.tariffs`.
            forecast_error: weather forecast errors; default: a perfect forecast.
            patience_s: longest time for a quarter of an hour of the building's time, and for the engine's warm-up, s.

        Raises:
            ConfigError: the engine is not installed.
        """
        try:
            engine_folder()
        except PlantError as error:
            raise ConfigError(f"test case '{testcase.name}': {error}") from error
        self.testcase, self._file = testcase, weather_file(weather)
        self.weather = load_weather(self._file)
        self._forecast_error, self._patience_s = forecast_error, patience_s
        self._tariffs = tariffs.by_name(highly_dynamic)

    def period(self, name: str) -> Period:
        """Return the named window of two weeks, or that of a start day.

        Raises:
            InputError: `name` is neither a window of the building nor a day of the year.
        """
        if name in self._periods:
            return Period(name, self._periods[name] * DAY_S)
        return day_period(name, self._periods)

    def _begin(self) -> None:
        self.close()
        begin_s, building = self._begin_s, self._building(int(self._begin_s // DAY_S))
        self._process = EngineProcess(building, self._patience_s)
        self._now_s = building.first_day * DAY_S
        # The engine repeats its first day to warm up, so the weather of this reading is that of the next midnight.
        midnight = np.array([self._now_s])
        T_out, solar = (float(self.weather.at(name, midnight)[0]) for name in ("T_dry_C", "global_W_m2"))
        self._samples = Samples(self._now_s, self._first_row(self._process.first, T_out, solar))
        if begin_s > self._now_s:
            self._run(Block.native(len(self._names.actuators), begin_s - self._now_s))
            # The engine starts at midnight; the time up to the warm-up is not recorded.
            self._samples = Samples(self._now_s, self._samples.rows[-1])

    def _run(self, block: Block) -> None:
        rows = self._rows(self._running.advance(self._demand(block), block.duration_s))
        self._samples.append(self._now_s + self._running.step_s * np.arange(1.0, len(rows) + 1), rows)
        self._now_s = self._running.now_s

    def _weather_ahead(self, time_s: Array) -> tuple[Array, Array]:
        """Forecast of outdoor temperature, °C, and irradiance, W/m²."""
        return forecast_weather(self.weather, self._forecast_error, time_s)

    @abstractmethod
    def _building(self, first_day: int) -> Building[U, R]:
        """What the engine simulates from midnight of a day on."""

    @abstractmethod
    def _demand(self, block: Block) -> U | None:
        """What the building is told in a block."""

    @abstractmethod
    def _first_row(self, reading: R, T_out_C: float, solar_W_m2: float) -> Array:
        """The sample of the first midnight (k,), in this weather."""

    @abstractmethod
    def _rows(self, stretch: Stretch[U, R]) -> Array:
        """The samples of a stretch (n, k)."""
