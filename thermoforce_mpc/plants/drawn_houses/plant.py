"""What the plants of drawn houses share: synthetic weather, known ahead, and samples every 30 s."""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import Array, Block, Period, PlantInfo
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.checks import check_start
from thermoforce_mpc.plants.drawn_houses.envelope import GRID_S, STEP_S
from thermoforce_mpc.plants.drawn_houses.weeks import week_or_day
from thermoforce_mpc.plants.shell import BranchingShell
from thermoforce_mpc.version import VERSION

# The baseline thermostats' set-points above the lower bounds in use, K, as in the shipped test case (21.3 for 21 °C).
THERMOSTAT_ABOVE_K = 0.3


class _House(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def words(self) -> str: ...

    @property
    def design_load_W(self) -> float: ...


class DrawnHousePlant(BranchingShell):
    """A drawn house. Deterministic: same house and inputs, same bytes.

    Attributes:
        house: what was drawn.
        weather: its synthetic year.
    """

    house: _House
    weather: Weather
    _kind: str
    _tariffs: dict[str, tariffs.Tariff]

    @property
    def info(self) -> PlantInfo:
        """Plant, weather and version."""
        return PlantInfo(
            kind=self._kind,
            testcase=self.house.name,
            description=self.house.words,
            weather=self.weather.name,
            version=VERSION,
        )

    def period(self, name: str) -> Period:
        """Return the week 'cold_week' or 'sunny_week', or two weeks from a start day, see `week_or_day`.

        Raises:
            InputError: `name` is neither of these nor a day of the year.
        """
        T_out_C, global_W_m2, load_W = self._heat_year()
        return week_or_day(
            name,
            T_out_C=T_out_C,
            global_W_m2=global_W_m2,
            load_W=load_W,
            design_load_W=self.house.design_load_W,
            grid_s=GRID_S,
        )

    def _check_reset(self, start_s: float, warmup_s: float, price: str) -> None:
        check_start(start_s, warmup_s)
        if price not in self._tariffs:
            raise InputError(f"tariff '{price}': expected one of {', '.join(self._tariffs)}")

    def _run(self, block: Block) -> None:
        before_s = self._now_s
        time_s = self._spaced(block.duration_s, STEP_S)
        rows = np.empty((time_s.size, self._samples.rows.shape[1]))
        self._simulate(block.as_array(), before_s, block.duration_s / time_s.size, rows)
        self._samples.append(time_s, rows)

    @abstractmethod
    def _heat_year(self) -> tuple[Array, Array, Array]:
        """Outdoor temperature, °C, irradiance, W/m², and heat losses at 20 °C less gains and sun, W, every `GRID_S`."""

    @abstractmethod
    def _simulate(self, forced: Array, before_s: float, dt_s: float, rows: Array) -> None:
        """Fill `rows` (n, k) with samples every `dt_s` from `before_s` on, under levels `forced` (A,), NaN: native."""
