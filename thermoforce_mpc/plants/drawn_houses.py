"""What the drawn houses share, `random_houses` and `rooms`.

Constants of EN ISO 13790 and the solver of a step; their plants' two weeks, synthetic weather, known ahead, and samples
every 30 s.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np

from thermoforce_mpc.boundary.weather.solar import on_plane, sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import DAY_S, YEAR_S, Array, Block, Boundary, Period, PlantInfo
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.kpis import EnergySupply, Violation, building_kpis
from thermoforce_mpc.plants.shell import CLOCK_S, BranchingShell, check_start, day_period
from thermoforce_mpc.version import VERSION

# Step of the physics and of the samples, and of the grids of weather and schedules, s.
STEP_S, GRID_S = 30.0, 900.0

Mass = Literal["very light", "light", "medium", "heavy", "very heavy"]
# EN ISO 13790:2008, table 12: effective mass area, m² per m² of floor, and heat capacity, J/K per m² of floor.
MASSES: dict[Mass, tuple[float, float]] = {
    "very light": (2.5, 80e3),
    "light": (2.5, 110e3),
    "medium": (2.5, 165e3),
    "heavy": (3.0, 260e3),
    "very heavy": (3.5, 370e3),
}
HEIGHT_M = 2.5
# Design outdoor temperature at the unshifted climate, °C (EN 12831-1, Belgian annex: −7 to −9), and room, °C.
DESIGN_OUT_C, DESIGN_ROOM_C = -8.0, 20.0
# Output of floor heating up to which rooms have it, W/m² (EN 1264-2: 100 at a surface of 29 °C in a room of 20 °C).
FLOOR_LIMIT_W_M2 = 70.0
AIR_WH_M3_K = 0.34
WATER_J_KG_K = 4186.0
# Air and furniture, J/K per m² of floor (EN ISO 52016-1); surface to air and surface to structure, W/m²K, and room
# surface per floor area (EN ISO 13790).
AIR_J_M2_K = 10e3
SURFACE_AIR_W_M2_K, SURFACE_MASS_W_M2_K, SURFACE_PER_FLOOR = 3.45, 9.1, 4.5
# First centimetre of plaster or board, J/K per m² of surface.
SURFACE_J_M2_K = 10e3
# Operative temperature: share of the air (EN ISO 13790, C.12).
AIR_SHARE = 0.3
# Share of the air change that is driven by the wind, at the mean wind of the synthetic year, m/s.
_WIND_SHARE, _MEAN_WIND_M_S = 0.3, 3.9


def opaque_U_W_m2K(rng: np.random.Generator, age: float) -> float:
    """Draw the U-value of walls and roof at an age from 0, a passive house, to 1, not refurbished (TABULA)."""
    return float(0.15 * 8.0 ** (age * rng.uniform(0.85, 1.0)))


def glazing_of(age: float) -> tuple[float, float]:
    """Return U-value, W/m²K, and g-value of windows of an age: triple to double glazing (EN 673 and EN 410)."""
    return 0.8 + 2.0 * age, 0.5 + 0.25 * age


def air_changes_1_h(rng: np.random.Generator, age: float) -> float:
    """Draw the mean infiltration at an age, 1/h."""
    return float(rng.uniform(0.15, 0.35) + 0.45 * age * rng.uniform(0.5, 1.0))


def climate(rng: np.random.Generator) -> tuple[float, float]:
    """Draw how much warmer, K, and how much clearer a year is, see `synthetic_weather`."""
    return float(rng.uniform(-4.0, 4.0)), float(rng.uniform(-0.3, 0.8))


def ground_C(warmer_K: float) -> float:
    """Ground temperature below a slab, °C: the annual mean outdoor temperature (EN ISO 13370) of the shifted year."""
    return 10.3 + warmer_K


@njit(cache=True)
def solve(a: np.ndarray, b: np.ndarray) -> None:
    """Solve a x = b, a diagonally dominant (n, n), into `b`; skips zeros below the diagonal: few neighbours first."""
    n = b.size
    for k in range(n):
        for i in range(k + 1, n):
            ratio = a[i, k] / a[k, k]
            if ratio != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= ratio * a[k, j]
                b[i] -= ratio * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]


@njit(cache=True)
def read(grid: np.ndarray, time_s: float, w: np.ndarray) -> int:
    """Interpolate the first columns of a year's grid at `time_s` into `w` and return the row that holds then."""
    at = (time_s % ((grid.shape[0] - 1) * GRID_S)) / GRID_S
    row = int(at)
    share = at - row
    for j in range(w.size):
        w[j] = (1.0 - share) * grid[row, j] + share * grid[row + 1, j]
    return row


Facade = Literal["south", "west", "north", "east"]
FACADES: tuple[Facade, ...] = ("south", "west", "north", "east")
AZIMUTH_DEG: dict[Facade, float] = {"south": 180.0, "west": 270.0, "north": 0.0, "east": 90.0}
# Transmittance of diffuse relative to normal light, and ASHRAE's incidence factor, of double glazing.
_DIFFUSE_FACTOR, _ASHRAE_B = 0.87, 0.10


def year() -> Array:
    """Return the times of the grids of weather and schedules, s, shape (35041,)."""
    return np.arange(0.0, YEAR_S + GRID_S, GRID_S)


def on_facades(weather: Weather, time_s: Array, turn_deg: float = 0.0) -> Iterator[tuple[Array, Array]]:
    """Yield what passes a vertical pane over its g-value, and the irradiance on its facade, W/m² (n,), by `FACADES`."""
    from pvlib import iam  # not at the top: see `boundary.weather.solar`

    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    for azimuth_deg in AZIMUTH_DEG.values():
        light = on_plane(weather, sun, time_s, 90.0, (azimuth_deg + turn_deg) % 360.0)
        passing = light.beam * iam.ashrae(light.incidence_deg, b=_ASHRAE_B) + light.diffuse * _DIFFUSE_FACTOR
        yield passing, light.beam + light.diffuse


def air_change(weather: Weather, time_s: Array) -> Array:
    """Return the air change by infiltration relative to its mean, (n,)."""
    return np.asarray(1.0 - _WIND_SHARE + _WIND_SHARE * (weather.at("wind_m_s", time_s) / _MEAN_WIND_M_S))


WEEKS = ("cold_week", "sunny_week")
_WEEK_OF = {"peak_heat_day": "cold_week", "typical_heat_day": "sunny_week"}
NAMES = (*WEEKS, *_WEEK_OF)
# First days of the weeks a window is chosen from, and least heat load of the sunny week relative to the design load.
_COLD_DAYS, _SUNNY_DAYS, _LEAST_LOAD = range(17, 53), range(60, 111), 0.12


class DrawnHousePlant(BranchingShell):
    """A drawn house. Deterministic: same house and inputs, same bytes. Comfort is judged by true temperatures.

    Attributes:
        house: what was drawn.
        weather: its synthetic year.
        zones: names of its rooms.
    """

    house: Any
    weather: Weather
    zones: tuple[str, ...] = ("1",)
    _kind: str
    _carrier = "ElectricPower"

    @property
    def info(self) -> PlantInfo:
        """Plant, weather and version."""
        return PlantInfo(self._kind, self.house.name, self.house.words, self.weather.name, VERSION)

    def period(self, name: str) -> Period:
        """Return the week 'cold_week' or 'sunny_week', or two weeks from a start day.

        cold_week: lowest mean outdoor temperature of the weeks that start on day 17 to 52. sunny_week: most global
        radiation of those that start on day 60 to 110 and whose heat load at 20 °C is 12 % of the design load or more;
        without such a week the one with the highest heat load.

        BOPTEST's names stand for them: 'peak_heat_day' for the cold week, 'typical_heat_day' for the sunny one.

        Raises:
            InputError: `name` is neither of these nor a day of the year.
        """
        name = _WEEK_OF.get(name, name)
        if name not in WEEKS:
            return day_period(name, WEEKS)
        T_out_C, global_W_m2, load_W = self._heat_year()
        week = round(7 * DAY_S / GRID_S)

        def means(values: Array, days: range) -> Array:
            firsts = [round(day * DAY_S / GRID_S) for day in days]
            return np.array([values[first : first + week].mean() for first in firsts])

        if name == "cold_week":
            day = _COLD_DAYS[int(np.argmin(means(T_out_C, _COLD_DAYS)))]
        else:
            load, sun = means(load_W, _SUNNY_DAYS), means(global_W_m2, _SUNNY_DAYS)
            needed = load >= _LEAST_LOAD * self.house.design_load_W
            day = _SUNNY_DAYS[int(np.argmax(np.where(needed, sun, -np.inf) if needed.any() else load))]
        return Period(name, day * DAY_S, scored_s=7 * DAY_S)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up; discomfort is the mean over rooms."""
        if self._now_s - self._start_s < CLOCK_S:
            of_zones = [f"tdis_tot[{name}]" for name in self.zones] if len(self.zones) > 1 else []
            return dict.fromkeys(("ener_tot", "cost_tot", "emis_tot", "tdis_tot", *of_zones), 0.0)
        return self._scored()

    def _scored(self) -> dict[str, float]:
        return self._kpis_so_far(self._kpis_between)

    def _kpis_between(self, start_s: float, final_s: float, open_end: bool) -> dict[str, float]:
        time_s, rows = self._samples.between(start_s, final_s)
        power_W, T_C = self._power_and_rooms(rows)
        outside = map(excess, T_C, *map(np.atleast_2d, self._bounds_C(time_s)))
        return building_kpis(
            time_s,
            supplies=[EnergySupply(self._carrier, power_W, *self._bought(time_s))],
            thermal=list(map(Violation, self.zones, outside)),
            air_quality=[],
            area_m2=self.house.floor_area_m2,
            open_end=open_end,
        )

    def _boundary(self, time_s: Array) -> Boundary:
        lower, upper = self._bounds_C(time_s)
        price, emission = self._bought(time_s)
        return Boundary(
            time_s=time_s,
            T_out_C=self.weather.at("T_dry_C", time_s),
            solar_W_m2=self.weather.at("global_W_m2", time_s),
            occupancy=self._people(time_s),
            lower_C=lower,
            upper_C=upper,
            price_per_kWh=price,
            emission_kg_per_kWh=emission,
            names=self._names,
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

    def _weather_now(self) -> tuple[float, float]:
        """Outdoor temperature, °C, and irradiance, W/m²."""
        now = np.array([self._now_s])
        return float(self.weather.at("T_dry_C", now)[0]), float(self.weather.at("global_W_m2", now)[0])

    @abstractmethod
    def _heat_year(self) -> tuple[Array, Array, Array]:
        """Outdoor temperature, °C, irradiance, W/m², and heat losses at 20 °C less gains and sun, W, every `GRID_S`."""

    @abstractmethod
    def _bounds_C(self, time_s: Array) -> tuple[Array, Array]:
        """Comfort bounds at `time_s` (n,), °C, (n,) or (Z, n)."""

    @abstractmethod
    def _people(self, time_s: Array) -> Array:
        """Expected number of people at `time_s` (n,), (n,) or (Z, n)."""

    @abstractmethod
    def _power_and_rooms(self, rows: Array) -> tuple[Array, Array]:
        """Billed power, W (n,), and true temperatures, °C (Z, n), of samples (n, k)."""

    @abstractmethod
    def _simulate(self, forced: Array, before_s: float, dt_s: float, rows: Array) -> None:
        """Fill `rows` (n, k) with samples every `dt_s` from `before_s` on, under levels `forced` (A,), NaN: native."""
