"""The EnergyPlus engine: its files, and a simulation in this process with callbacks before and after every step.

The wheel `pyenergyplus-lbnl` (extra `[energyplus]`) contains the shared library, the Python API, TMY3 weather files and
DOE reference buildings. The engine keeps global state, so a process must never run two simulations at once. There is no
snapshot: to branch, simulate again from the start. The engine drops exceptions of callbacks, so they are stored, the
simulation is stopped, and they are raised afterwards.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from thermoforce_mpc.errors import PlantError, WeatherError
from thermoforce_mpc.files import file_sha256

PACKAGE = "pyenergyplus-lbnl"


def is_available() -> bool:
    """Return whether the engine's package is installed."""
    return importlib.util.find_spec("pyenergyplus") is not None


def engine_folder() -> Path:
    """Return the folder of the engine's Python API; raises `PlantError` if it is not installed."""
    spec = importlib.util.find_spec("pyenergyplus")
    if spec is None or spec.origin is None:
        raise PlantError(f"EnergyPlus is not installed: pip install 'thermoforce-mpc[energyplus]' (package {PACKAGE})")
    return Path(spec.origin).parent


def engine_version() -> str:
    """Return the version of the engine's wheel, which is that of the engine."""
    engine_folder()
    return importlib.metadata.version(PACKAGE)


def weather_file(name: str) -> Path:
    """Return the TMY3 file whose name contains `name`; raises `WeatherError`, listing the files, if not exactly one."""
    folder = engine_folder() / "data" / "weather"
    paths = sorted(folder.glob(f"*{name}*.epw"))
    if len(paths) != 1:
        there = ", ".join(sorted(path.stem for path in folder.glob("*.epw")))
        raise WeatherError(
            f"EnergyPlus weather '{name}': {len(paths)} files of that name in {folder}; there are {there}"
        )
    return paths[0]


def reference_building(name: str) -> Path:
    """Return the IDF of a DOE reference building, as 'RefBldgSmallOfficeNew2004_Chicago'; raises `PlantError`."""
    path = engine_folder() / "data" / "model" / f"{name}.idf"
    if not path.is_file():
        raise PlantError(f"EnergyPlus: no reference building '{name}' in {path.parent}")
    return path


file_hash = cache(file_sha256)


# What a driver reads at the end of a step.
R = TypeVar("R")
R_contra = TypeVar("R_contra", contravariant=True)

# The engine's number for a run under a weather file.
_RUN_PERIOD = 3
WEATHER_SENSORS = {
    "T_out": ("Site Outdoor Air Drybulb Temperature", "Environment"),
    "direct": ("Site Direct Solar Radiation Rate per Area", "Environment"),
    "diffuse": ("Site Diffuse Solar Radiation Rate per Area", "Environment"),
    "altitude": ("Site Solar Altitude Angle", "Environment"),
}


@dataclass(frozen=True)
class Reading:
    """At the end of a step: temperatures °C, irradiance W/m², heat over it W, NaN unless the engine decides that."""

    T_zone_C: float
    T_out_C: float
    solar_W_m2: float
    heat_W: float = float("nan")


@dataclass(frozen=True)
class Wiring(Generic[R]):
    """Sensors and actuators of a model.

    `sensors` and `means` map names to (variable, key), `actuators` names to (component, control, key); `read` converts
    the values of sensors and means to a reading; `suffix` is the model's file format. A sensor shows the value at the
    end of a zone time step, a mean is taken over it: the engine divides a step with large changes into several system
    steps, and a sensor of the system shows the last of them.
    """

    sensors: Mapping[str, tuple[str, str]]
    actuators: Mapping[str, tuple[str, str, str]]
    read: Callable[[Mapping[str, float]], R]
    suffix: str = "epJSON"
    means: Mapping[str, tuple[str, str]] = field(default_factory=dict)


def weather_reading(value: Mapping[str, float], T_zone_C: float, heat_W: float = float("nan")) -> Reading:
    """Return a reading with the weather of `WEATHER_SENSORS`."""
    up = max(float(np.sin(np.radians(value["altitude"]))), 0.0)
    return Reading(T_zone_C, value["T_out"], value["diffuse"] + up * value["direct"], heat_W)


class Driver(Protocol[R_contra]):
    """Callbacks of `run_engine`."""

    @property
    def done(self) -> bool:
        """Whether all requested steps were simulated."""

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the actuators' values over the next zone time step, NaN: the model's own control; others stay."""

    def end(self, warming_up: bool, read: Callable[[], R_contra]) -> bool:
        """Process the end of a zone time step, reading it if needed; return True when the run may stop."""


def run_engine(model: str, weather: Path, recorder: Driver[R], wiring: Wiring[R]) -> None:
    """Run the model text `model` with a weather file in this process, with the callbacks of `recorder`.

    Raises `PlantError` with the errors of the engine's error file where it failed, and what a callback raises.
    """
    from pyenergyplus.api import EnergyPlusAPI

    api = EnergyPlusAPI()
    state = api.state_manager.new_state()
    callbacks = _Callbacks(api, state, recorder, wiring)
    hook_before, sys.unraisablehook = sys.unraisablehook, callbacks.dropped
    try:
        api.runtime.set_console_output_status(state, False)
        callbacks.register()
        with tempfile.TemporaryDirectory(prefix="energyplus-") as folder:
            path = Path(folder) / f"in.{wiring.suffix}"
            path.write_text(model)
            status = api.runtime.run_energyplus(state, ["-w", str(weather), "-d", folder, str(path)])
            if callbacks.failure is not None:
                raise callbacks.failure
            if status != 0 and not recorder.done:
                said = Path(folder) / "eplusout.err"
                text = said.read_text(errors="replace") if said.is_file() else "no error file"
                raise PlantError(f"EnergyPlus ended with status {status}: {_complaints(text)}")
    finally:
        sys.unraisablehook = hook_before
        api.state_manager.delete_state(state)


class _Callbacks(Generic[R]):
    """What one run of the engine calls: between its steps and a recorder, by the names of a wiring.

    `failure`: what the first callback that failed raised; the engine is stopped then, since it would drop it.
    """

    def __init__(self, api: Any, state: Any, recorder: Driver[R], wiring: Wiring[R]) -> None:
        self.failure: BaseException | None = None
        self._api, self._state, self._recorder, self._wiring = api, state, recorder, wiring
        self._variables = {**wiring.sensors, **wiring.means}
        self._handles: dict[str, int] = {}
        self._system_steps: list[tuple[float, dict[str, float]]] = []

    def register(self) -> None:
        """Ask the engine for the variables, and to be called at its steps."""
        for variable, key in self._variables.values():
            self._api.exchange.request_variable(self._state, variable, key)
        runtime = self._api.runtime
        runtime.callback_begin_zone_timestep_before_set_current_weather(self._state, self._guarded(self._begin))
        if self._wiring.means:
            runtime.callback_end_system_timestep_after_hvac_reporting(self._state, self._guarded(self._end_system_step))
        runtime.callback_end_zone_timestep_after_zone_reporting(self._state, self._guarded(self._end))

    def dropped(self, unraisable: Any) -> None:
        """Keep what a signal raises at the edge of a callback, where ctypes would drop it."""
        if isinstance(unraisable.exc_value, Exception):
            sys.__unraisablehook__(unraisable)
            return
        self._fail(unraisable.exc_value)

    def _fail(self, error: BaseException) -> None:
        self.failure = self.failure or error
        self._stop()

    def _stop(self) -> None:
        self._api.runtime.stop_simulation(self._state)

    def _guarded(self, action: Callable[[], None]) -> Callable[[Any], None]:
        exchange = self._api.exchange

        def callback(state: Any) -> None:
            if self.failure is not None or not exchange.api_data_fully_ready(state):
                return
            if exchange.kind_of_sim(state) != _RUN_PERIOD:  # sizing comes first
                return
            try:
                action()
            except BaseException as error:
                self._fail(error)

        return callback

    def _find(self) -> None:
        exchange = self._api.exchange
        for name, (variable, key) in self._variables.items():
            self._handles[name] = exchange.get_variable_handle(self._state, variable, key)
        for name, (component, control, key) in self._wiring.actuators.items():
            self._handles[name] = exchange.get_actuator_handle(self._state, component, control, key)
        missing = [name for name, handle in self._handles.items() if handle < 0]  # 0 is a valid handle
        if missing:
            raise PlantError(f"EnergyPlus has no sensor or actuator for {', '.join(missing)} in this model")

    def _begin(self) -> None:
        if not self._handles:
            self._find()
        exchange = self._api.exchange
        for name, value in self._recorder.begin(self._warming_up).items():
            if math.isnan(value):
                exchange.reset_actuator(self._state, self._handles[name])
            else:
                exchange.set_actuator_value(self._state, self._handles[name], value)

    def _end_system_step(self) -> None:
        if self._handles:
            length_h = self._api.exchange.system_time_step(self._state)
            self._system_steps.append((length_h, self._values(self._wiring.means)))

    def _end(self) -> None:
        if not self._handles:
            return
        parts, self._system_steps = self._system_steps, []

        def read() -> R:
            whole = sum(length for length, _ in parts)
            means = {name: sum(length * part[name] for length, part in parts) / whole for name in self._wiring.means}
            return self._wiring.read(self._values(self._wiring.sensors) | means)

        if self._recorder.end(self._warming_up, read):
            self._stop()

    @property
    def _warming_up(self) -> bool:
        return bool(self._api.exchange.warmup_flag(self._state))

    def _values(self, names: Iterable[str]) -> dict[str, float]:
        value = self._api.exchange.get_variable_value
        return {name: value(self._state, self._handles[name]) for name in names}


def _complaints(text: str) -> str:
    """The first severe and continuation lines of an error file (6 at most), or its last 500 characters."""
    lines = [line.strip() for line in text.splitlines()]
    marks = ("** Severe", "**  Fatal", "**   ~~~   **")
    said = [line for line in lines if line.startswith(marks)]
    return " | ".join(said[:6]) or text[-500:]
