"""EnergyPlus simulation in this process, with callbacks before and after every step.

The engine keeps global state, so a process must never run two simulations at once. There is no snapshot: to branch,
simulate again from the start. The engine drops exceptions of callbacks, so they are stored, the simulation is stopped,
and they are raised afterwards.
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.zone import GAINS, HVAC, ZONE, ZoneSpec

# What a driver reads at the end of a step.
R = TypeVar("R")
R_contra = TypeVar("R_contra", contravariant=True)

# PI loop of a zone's own control: u per K, and reset time, s.
_U_PER_K, _RESET_S = 0.35, 5400.0
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
    """Reading at the end of a step: temperatures °C, global horizontal irradiance W/m², heat over the step W.

    `heat_W` is given only if the engine decides the heat, else NaN.
    """

    T_zone_C: float
    T_out_C: float
    solar_W_m2: float
    heat_W: float = float("nan")


@dataclass(frozen=True)
class Wiring(Generic[R]):
    """Sensors and actuators of a model.

    `sensors` and `means` map names to (variable, key), `actuators` names to (component, control, key); `read` converts
    the values of sensors and means to a reading; `suffix` is the model's file format. A sensor shows the value at the
    end of a zone time step. A mean is taken over the step: the engine divides a step with large changes into several
    system steps, and a sensor of the system shows the last of them.
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


ZONE_WIRING: Wiring[Reading] = Wiring(
    sensors={"T_zone": ("Zone Mean Air Temperature", ZONE)} | WEATHER_SENSORS,
    actuators={name: ("OtherEquipment", "Power Level", name) for name in (HVAC, GAINS)},
    read=lambda value: weather_reading(value, value["T_zone"]),
)


@dataclass(frozen=True)
class Job:
    """Simulation job from midnight of `first_day`.

    `setpoint_C` and `gains` (fraction of the zone's internal gains) have shape (n_steps,), one value per recorded step.
    Runs that must be equal up to an intervention need the same length: the engine's results differ by microkelvins
    between run periods with different last days.
    """

    spec: ZoneSpec
    first_day: int
    setpoint_C: Array
    gains: Array

    @property
    def n_steps(self) -> int:
        """Number of steps recorded."""
        return int(self.setpoint_C.size)


class PiPolicy:
    """PI loop that tracks the set-points of a job, signed for heating or cooling.

    The integral is clamped while u is at a limit (conditional integration, anti-windup).
    """

    def __init__(self, job: Job) -> None:
        self._job, self._sign = job, 1.0 if job.spec.mode == "heating" else -1.0
        self._integral = 0.0

    def __call__(self, step: int, T_zone_C: float) -> float:
        """Return u of this step."""
        job = self._job
        error = self._sign * (float(job.setpoint_C[max(step, 0)]) - T_zone_C)
        proposed = self._integral + error * _U_PER_K * job.spec.step_s / _RESET_S
        u = _U_PER_K * error + proposed
        if 0.0 <= u <= 1.0:
            self._integral = proposed
        elif u > 1.0:
            u, self._integral = 1.0, min(self._integral, proposed)
        else:
            u, self._integral = 0.0, max(self._integral, proposed)
        return u


class Driver(Protocol[R_contra]):
    """Callbacks of `run_engine`."""

    @property
    def done(self) -> bool:
        """Whether all requested steps were simulated."""
        ...

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the value of each actuator over the next zone time step, NaN to leave it to the model's own control.

        An actuator that is left out keeps its value.
        """
        ...

    def end(self, warming_up: bool, read: Callable[[], R_contra]) -> bool:
        """Process the end of a zone time step, reading it if needed; return True when the run may stop."""
        ...


def run_engine(model: str, weather: Path, recorder: Driver[R], wiring: Wiring[R]) -> None:
    """Run the model text `model` with a weather file in this process, with the callbacks of `recorder`.

    Raises:
        PlantError: the engine failed; includes the errors of its error file.
        Exception: an exception of a callback.
    """
    from pyenergyplus.api import EnergyPlusAPI

    api = EnergyPlusAPI()
    state = api.state_manager.new_state()
    failure: list[BaseException] = []
    handles: dict[str, int] = {}
    variables = {**wiring.sensors, **wiring.means}
    system_steps: list[tuple[float, dict[str, float]]] = []

    def guarded(action: Callable[[Any], None]) -> Callable[[Any], None]:
        def callback(state: Any) -> None:
            if failure or not api.exchange.api_data_fully_ready(state):
                return
            if api.exchange.kind_of_sim(state) != _RUN_PERIOD:  # sizing comes first
                return
            try:
                action(state)
            except BaseException as error:
                failure.append(error)
                api.runtime.stop_simulation(state)

        return callback

    def dropped(unraisable: Any) -> None:
        """Keep what a signal raises at the edge of a callback, where ctypes would drop it."""
        if isinstance(unraisable.exc_value, Exception):
            sys.__unraisablehook__(unraisable)
            return
        failure.append(unraisable.exc_value)
        api.runtime.stop_simulation(state)

    def find(state: Any) -> None:
        for name, (variable, key) in variables.items():
            handles[name] = api.exchange.get_variable_handle(state, variable, key)
        for name, (component, control, key) in wiring.actuators.items():
            handles[name] = api.exchange.get_actuator_handle(state, component, control, key)
        missing = [name for name, handle in handles.items() if handle < 0]  # 0 is a valid handle
        if missing:
            raise PlantError(f"EnergyPlus has no sensor or actuator for {', '.join(missing)} in this model")

    def begin(state: Any) -> None:
        if not handles:
            find(state)
        for name, value in recorder.begin(bool(api.exchange.warmup_flag(state))).items():
            if math.isnan(value):
                api.exchange.reset_actuator(state, handles[name])
            else:
                api.exchange.set_actuator_value(state, handles[name], value)

    def values(state: Any, names: Iterable[str]) -> dict[str, float]:
        return {name: api.exchange.get_variable_value(state, handles[name]) for name in names}

    def end_system_step(state: Any) -> None:
        if handles:
            system_steps.append((api.exchange.system_time_step(state), values(state, wiring.means)))

    def end(state: Any) -> None:
        if not handles:
            return

        parts = list(system_steps)
        system_steps.clear()

        def read() -> R:
            whole = sum(length for length, _ in parts)
            means = {name: sum(length * part[name] for length, part in parts) / whole for name in wiring.means}
            return wiring.read(values(state, wiring.sensors) | means)

        if recorder.end(bool(api.exchange.warmup_flag(state)), read):
            api.runtime.stop_simulation(state)

    hook_before, sys.unraisablehook = sys.unraisablehook, dropped
    try:
        api.runtime.set_console_output_status(state, False)
        for variable, key in variables.values():
            api.exchange.request_variable(state, variable, key)
        api.runtime.callback_begin_zone_timestep_before_set_current_weather(state, guarded(begin))
        if wiring.means:
            api.runtime.callback_end_system_timestep_after_hvac_reporting(state, guarded(end_system_step))
        api.runtime.callback_end_zone_timestep_after_zone_reporting(state, guarded(end))
        with tempfile.TemporaryDirectory(prefix="energyplus-") as folder:
            path = Path(folder) / f"in.{wiring.suffix}"
            path.write_text(model)
            status = api.runtime.run_energyplus(state, ["-w", str(weather), "-d", folder, str(path)])
            if failure:
                raise failure[0]
            if status != 0 and not recorder.done:
                said = Path(folder) / "eplusout.err"
                text = said.read_text(errors="replace") if said.is_file() else "no error file"
                raise PlantError(f"EnergyPlus ended with status {status}: {_complaints(text)}")
    finally:
        sys.unraisablehook = hook_before
        api.state_manager.delete_state(state)


def _complaints(text: str) -> str:
    """Return the first severe and continuation lines of an error file (6 at most), or its last 500 characters."""
    lines = [line.strip() for line in text.splitlines()]
    marks = ("** Severe", "**  Fatal", "**   ~~~   **")
    said = [line for line in lines if line.startswith(marks)]
    return " | ".join(said[:6]) or text[-500:]
