"""EnergyPlus simulation in this process: a PI loop sets the heat source, and every data step is recorded.

The engine keeps global state, so a process must never run two simulations at once. There is no snapshot: to branch,
simulate again from the start. The engine drops exceptions of callbacks, so they are stored, the simulation is stopped,
and they are raised afterwards.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import weather_file
from thermoforce_mpc.plants.energyplus.zone import GAINS, HVAC, ZONE, ZoneSpec, zone_model

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

# Maps the step's number (−1 while the engine warms up) and the zone temperature before it, °C, to u in [0, 1].
Policy = Callable[[int, float], float]


@dataclass(frozen=True)
class PI:
    """Parameters of the PI loop on the set-point error, signed for heating or cooling.

    `proportional` is u per K, `integral_s` the reset time, s. The integral is clamped while u is at a limit
    (conditional integration, anti-windup).
    """

    proportional: float = 0.35
    integral_s: float = 5400.0


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
    pi: PI = PI()

    @property
    def n_steps(self) -> int:
        """Number of steps recorded."""
        return int(self.setpoint_C.size)


class PiPolicy:
    """`Policy` of the PI loop that tracks the set-points of a job."""

    def __init__(self, job: Job) -> None:
        self._job, self._sign = job, 1.0 if job.spec.mode == "heating" else -1.0
        self._integral = 0.0

    def __call__(self, step: int, T_zone_C: float) -> float:
        """Return u of this step."""
        job = self._job
        error = self._sign * (float(job.setpoint_C[max(step, 0)]) - T_zone_C)
        proposed = self._integral + error * job.pi.proportional * job.spec.step_s / job.pi.integral_s
        u = job.pi.proportional * error + proposed
        if 0.0 <= u <= 1.0:
            self._integral = proposed
        elif u > 1.0:
            u, self._integral = 1.0, min(self._integral, proposed)
        else:
            u, self._integral = 0.0, max(self._integral, proposed)
        return u


def simulate(job: Job) -> Record:
    """Run one job in this process.

    Returns:
        Record of `n_steps` steps from midnight of `first_day`, starting from the state after the engine's warm-up.
        `power_W` is NaN (there is no machine), `heat_W` the delivered heat, negative for cooling.

    Raises:
        PlantError: the engine refused the model or stopped early; includes the engine's messages.
    """
    if job.spec.engine_steps_per_hour % job.spec.steps_per_hour:
        raise PlantError(
            f"EnergyPlus: {job.spec.engine_steps_per_hour} engine steps an hour do not divide into "
            f"{job.spec.steps_per_hour} steps of the data"
        )
    if job.gains.shape != job.setpoint_C.shape or job.n_steps < 1:
        raise PlantError(
            f"EnergyPlus: set-points {job.setpoint_C.shape} and gains {job.gains.shape} differ or are empty"
        )
    per_day = round(DAY_S / job.spec.step_s)
    days = -(-job.n_steps // per_day)
    model = zone_model(job.spec, job.first_day, days)
    recorder = Recorder(job, PiPolicy(job))
    run_engine(json.dumps(model), weather_file(job.spec.weather), recorder, ZONE_WIRING)
    return recorder.history()


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


class Recorder:
    """`Driver` that acts before each step, reads after it, and stops when all steps are recorded."""

    def __init__(self, job: Job, policy: Policy) -> None:
        self._job, self._policy = job, policy
        self._sign = 1.0 if job.spec.mode == "heating" else -1.0
        self._before: Reading | None = None
        self._readings: list[Reading] = []
        self._u: list[float] = []
        self._acting = 0.0
        self._per_step = job.spec.engine_steps_per_hour // job.spec.steps_per_hour
        self._within, self._warming_up = 0, True

    @property
    def done(self) -> bool:
        """Whether every step was recorded."""
        return len(self._readings) == self._job.n_steps

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the heat of each actuated source over the next step, W."""
        step = -1 if warming_up else len(self._readings)
        if step >= self._job.n_steps:
            return {HVAC: 0.0, GAINS: 0.0}
        if warming_up != self._warming_up:
            self._within, self._warming_up = 0, warming_up
        if self._within == 0:
            last = self._readings[-1] if self._readings else self._before
            setpoint = float(self._job.setpoint_C[0])
            self._acting = self._policy(step, last.T_zone_C if last else setpoint)
        gains = float(self._job.gains[max(step, 0)])
        spec = self._job.spec
        return {HVAC: self._sign * self._acting * spec.capacity_W, GAINS: gains * spec.gains_W}

    def end(self, warming_up: bool, read: Callable[[], Reading]) -> bool:
        """Store the reading at the end of a data step; return True when the run may stop.

        That is one step after the last requested one, since readings in the step of a stop are 0.
        """
        self._within = (self._within + 1) % self._per_step
        if self._within:
            return self.done
        if warming_up:
            self._before = read()
        elif not self.done:
            self._readings.append(read())
            self._u.append(self._acting)
            return False
        return self.done

    def history(self) -> Record:
        """Return the record; raises `PlantError` if the engine ended before all steps were recorded."""
        if not self.done or self._before is None:
            raise PlantError(f"EnergyPlus recorded {len(self._readings)} of {self._job.n_steps} steps and then ended")
        readings = [self._before, *self._readings]
        u = np.array(self._u)
        spec = self._job.spec
        return Record(
            time_s=np.asarray(self._job.first_day * DAY_S + spec.step_s * np.arange(len(readings), dtype=np.float64)),
            T_zone_C=np.array([r.T_zone_C for r in readings]),
            T_out_C=np.array([r.T_out_C for r in readings]),
            solar_W_m2=np.array([r.solar_W_m2 for r in readings]),
            u=u,
            power_W=np.full(u.size, np.nan),
            heat_W=self._sign * u * spec.capacity_W,
        )


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
