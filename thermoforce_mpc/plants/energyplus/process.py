"""A building on the engine: its run in a process of its own, told step by step what to do, and what plants share."""

from __future__ import annotations

import tempfile
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.forecast_error import ForecastError, forecast_weather
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.data import DAY_S, Array, Block, Boundary, Period, PlantInfo
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.energyplus.engine import (
    R,
    Wiring,
    engine_folder,
    engine_version,
    file_hash,
    run_engine,
    weather_file,
)
from thermoforce_mpc.plants.kpis import PEAKS, EnergySupply, Violation, building_kpis
from thermoforce_mpc.plants.shell import PlantShell, Samples, WithProcess, day_period
from thermoforce_mpc.plants.worker_process import PATIENCE_S, PIECE_S, START_S, Failed, WorkerProcess, channel
from thermoforce_mpc.scenario.testcase import TestCase

# Length of the engine's run period, days: a year plus warm-up and forecast.
RUN_DAYS = 400
# What a building is told for a step, such as a level; None leaves it to its own control.
U = TypeVar("U")


@dataclass(frozen=True)
class SimulatedBuilding(Generic[U, R]):
    """Building that a worker process simulates; picklable. Its run begins at midnight of `first_day`, from 0.

    `model`: the engine's input of `n_steps` steps or more, each a zone time step of `step_s`. `acting` is called with
    the step (−1 while the engine warms up), what the building is told and the reading before the step, None before the
    first; it returns the actuator values of the step, as `Driver.begin` does, and what acts.
    """

    first_day: int
    step_s: float
    n_steps: int
    model: str
    weather: Path
    wiring: Wiring[R]
    acting: Callable[[int, U | None, R | None], tuple[dict[str, float], U]]


class ZoneStretch(NamedTuple, Generic[U, R]):
    """The reading at the end of each step, and what acted in each step."""

    readings: tuple[R, ...]
    acted: tuple[U, ...]


class _Live(Generic[U, R]):
    """`Driver` that answers requests: do what is demanded (None: the building's own control) for so many steps.

    The first answer is the state after the engine's warm-up.
    """

    def __init__(
        self, building: SimulatedBuilding[U, R], receive: Callable[[], Any], send: Callable[[Any], None]
    ) -> None:
        self._n_steps, self._act = building.n_steps, building.acting
        self._received, self._sent = receive, send
        self._last: R | None = None
        self._demand: U | None = None
        self._steps = 0
        self._answer: list[tuple[R, U]] = []
        self._now: U | None = None
        self._step = 0

    @property
    def done(self) -> bool:
        return self._step >= self._n_steps

    def begin(self, warming_up: bool) -> dict[str, float]:
        """The actuator values of the next step; waits for a request if the last is done."""
        if not self.done and not warming_up and len(self._answer) >= self._steps:
            if self._last is None:
                raise RuntimeError("the engine asked for an action before its warm-up")
            if self._answer:
                self._send()
            else:
                self._sent(ZoneStretch((self._last,), ()))
            (self._demand, self._steps), self._answer = self._received(), []
        if self.done:
            return {}
        demand = None if warming_up else self._demand
        values, self._now = self._act(-1 if warming_up else self._step, demand, self._last)
        return values

    def end(self, warming_up: bool, read: Callable[[], R]) -> bool:
        self._last = reading = read()
        if not warming_up and self._now is not None:
            self._step += 1
            self._answer.append((reading, self._now))
            if self.done:
                self._send()
        return self.done

    def _send(self) -> None:
        self._sent(ZoneStretch(tuple(r for r, _ in self._answer), tuple(u for _, u in self._answer)))


def main() -> None:
    """Run the `SimulatedBuilding` of the first request in this process, and answer what it is told."""
    receive, send = channel()
    building = receive()
    try:
        run_engine(building.model, building.weather, _Live(building, receive, send), building.wiring)
    except Exception as error:  # any error is reported by the client
        send(Failed(error))


def whole_steps(what: str, duration_s: float, step_s: float) -> int:
    """Return a duration in steps of the engine; raises `InputError`, naming `what`, if it is no whole number."""
    n = round(duration_s / step_s)
    if abs(n * step_s - duration_s) > 1e-6 or bool(n) != bool(duration_s):
        raise InputError(f"{what} of {duration_s:g} s: expected a multiple of EnergyPlus' step of {step_s:g} s")
    return n


class EngineProcess(WorkerProcess, Generic[U, R]):
    """See `WorkerProcess`. `first`: reading after the engine's warm-up, at midnight of the building's first day."""

    def __init__(self, building: SimulatedBuilding[U, R], patience_s: float = PATIENCE_S) -> None:
        """Start the process and wait for the end of the engine's warm-up; raises `PlantError`."""
        self._folder = tempfile.TemporaryDirectory(prefix="energyplus-", ignore_cleanup_errors=True)
        super().__init__(__name__, "EnergyPlus", Path(self._folder.name), patience_s)
        self.step_s, self.now_s = building.step_s, building.first_day * DAY_S
        self._left = building.n_steps
        self.first: R = self.ask("warm-up before", building, limit_s=max(patience_s, START_S)).readings[0]

    def advance(self, demand: U | None, duration_s: float) -> ZoneStretch[U, R]:
        """Do what is `demand` (None: the building's own control) for `duration_s`.

        Raises `InputError` where that is no multiple of the engine's step, `PlantError` where the engine failed or took
        too long, or its run period is over.
        """
        n = whole_steps("step", duration_s, self.step_s)
        if n > self._left:
            raise PlantError(f"EnergyPlus has {self._left} of {n} steps left: its run period is over; reset the plant")
        most = max(int(PIECE_S / self.step_s), 1)
        readings: list[R] = []
        acted: list[U] = []
        for steps in (min(most, n - i) for i in range(0, n, most)):
            piece: ZoneStretch[U, R] = self.ask("step from", (demand, steps))
            self._left -= steps
            self.now_s += steps * self.step_s
            readings += piece.readings
            acted += piece.acted
        return ZoneStretch(tuple(readings), tuple(acted))

    def close(self) -> None:
        """See `WorkerProcess.close`; the engine's files go too."""
        super().close()
        self._folder.cleanup()


class EnginePlant(WithProcess[EngineProcess[U, R]], PlantShell, Generic[U, R]):
    """A building run through the engine's runtime API, in its own process.

    Durations are multiples of the 5-min step. There is no snapshot; every reset starts a new process. Samples begin
    with the temperatures of the zones, that outdoors, °C, and the irradiance, W/m².
    """

    _periods: Mapping[str, int]  # first day of the named windows, from 0
    _zones: Sequence[str] = ("1",)
    _carriers: tuple[str, ...] = ("ElectricPower",)

    def __init__(
        self,
        testcase: TestCase,
        weather: str,
        *,
        highly_dynamic: tariffs.Tariff | None = None,
        forecast_error: ForecastError | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Read the weather; the engine starts at `reset`; raises `ConfigError` where it is not installed.

        Args:
            weather: part of the name of the TMY3 file.
            highly_dynamic: highly dynamic tariff of electricity; default: a synthetic one, see `boundary.tariffs`.
            forecast_error: weather forecast errors; default: a perfect forecast.
            patience_s: longest time for a quarter of an hour of the building's time, and for the engine's warm-up, s.
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
        """Return the named window of two weeks, or that of a start day; raises `InputError` for another name."""
        if name in self._periods:
            return Period(name, self._periods[name] * DAY_S)
        return day_period(name, self._periods)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs of the building since the end of the warm-up, from the 5-min record.

        Energy is that of heating, cooling and fans, not of lights and plugs; discomfort is the mean over zones.
        """
        self._check_started()
        time_s, rows = self._samples.between(self._start_s, self._now_s)
        if len(rows) < 2:
            of_zones = [f"tdis_tot[{name}]" for name in self._zones] if len(self._zones) > 1 else []
            peaks = [PEAKS[carrier] for carrier in self._carriers]
            return dict.fromkeys(("ener_tot", "cost_tot", "emis_tot", "tdis_tot", *peaks, *of_zones), 0.0)
        bounds = self._bounds(time_s)
        return building_kpis(
            time_s,
            supplies=self._supplies(time_s, rows),
            thermal=[Violation(name, excess(rows[:, z], *bounds)) for z, name in enumerate(self._zones)],
            air_quality=[],
            area_m2=self.testcase.area_m2,
        )

    def _info(self, testcase: str, description: str, **details: str) -> PlantInfo:
        details = {"weather_sha256": file_hash(self._file)} | details
        return PlantInfo("energyplus", testcase, description, self._file.stem, engine_version(), details)

    def _begin(self) -> None:
        self.close()
        begin_s, building = self._begin_s, self._building(int(self._begin_s // DAY_S))
        self._process = EngineProcess(building, self._patience_s)
        self._now_s = building.first_day * DAY_S
        # The engine repeats its first day to warm up, so the weather of this reading is that of the next midnight.
        midnight = np.array([self._now_s])
        row, zones = np.array(self._row(self._process.first, None)), len(self._zones)
        row[zones : zones + 2] = [self.weather.at(name, midnight)[0] for name in ("T_dry_C", "global_W_m2")]
        self._samples = Samples(self._now_s, row)
        if begin_s > self._now_s:
            self._run(Block.native(len(self._names.actuators), begin_s - self._now_s))
            # The engine starts at midnight; the time up to the warm-up is not recorded.
            self._samples = Samples(self._now_s, self._samples.rows[-1])

    def _run(self, block: Block) -> None:
        stretch = self._running.advance(self._demand(block), block.duration_s)
        rows = np.array(list(map(self._row, stretch.readings, stretch.acted)))
        self._samples.append(self._now_s + self._running.step_s * np.arange(1.0, len(rows) + 1), rows)
        self._now_s = self._running.now_s

    def _boundary(self, time_s: Array) -> Boundary:
        self._check_started()
        T_out, solar = forecast_weather(self.weather, self._forecast_error, time_s)
        each = (len(self._zones), 1)
        lower, upper = self._bounds(time_s)
        price, emission = self._bought(time_s)
        return Boundary(
            time_s=time_s,
            T_out_C=T_out,
            solar_W_m2=solar,
            occupancy=self._people(time_s),
            lower_C=np.tile(lower, each),
            upper_C=np.tile(upper, each),
            price_per_kWh=np.tile(price, each),
            emission_kg_per_kWh=np.tile(emission, each),
            heating_price_per_kWh=np.tile(self._heating_price(time_s), each),
            names=self._names,
        )

    def _heating_price(self, time_s: Array) -> Array:
        """Price of the energy that heats, per kWh, (n,)."""
        return self._bought(time_s)[0]

    @abstractmethod
    def _building(self, first_day: int) -> SimulatedBuilding[U, R]:
        """What the engine simulates from midnight of a day on."""

    @abstractmethod
    def _demand(self, block: Block) -> U | None:
        """What the building is told in a block."""

    @abstractmethod
    def _row(self, reading: R, acted: U | None) -> Sequence[float]:
        """The sample of a step, after which what acted is known."""

    @abstractmethod
    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """Comfort bounds of every zone, °C, (n,) each."""

    @abstractmethod
    def _people(self, time_s: Array) -> Array:
        """People in the zones, (Z, n)."""

    @abstractmethod
    def _supplies(self, time_s: Array, rows: Array) -> list[EnergySupply]:
        """What the building was billed for at samples (n, k)."""
