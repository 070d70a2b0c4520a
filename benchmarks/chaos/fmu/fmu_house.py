"""The emulator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic_heat_pump`.

Run inside the FMU, in a process of its own. The environment can make it fail, to see what its user is told:
`FMU_HOUSE_<CRASHES|FAILS|SLEEPS|CREEPS>_ON_DAY`, at the tolerances in `FMU_HOUSE_TROUBLED_AT` (default: all), or once,
if the file `FMU_HOUSE_UNLESS` is not there; `FMU_HOUSE_FAILS_SWITCHED_AT_S`: where its inputs change at that second.
Every step takes `FMU_HOUSE_LAGS_S`. Another tolerance than 1e-6 shifts the zone temperature by 1 mK a decade.
"""

import math
import os
import pathlib
import signal
import time
from typing import Any

from fmu_points import FmuWithPoints
from pythonfmu import DefaultExperiment

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP

_LEVELS = {"oveHeaPumY": "level", "oveTSet": "T_setpoint"}


class FmuHouse(FmuWithPoints):
    """One house; what fails when is in the environment."""

    description = "emulator of bestest_hydronic_heat_pump"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(tolerance=1e-6)
        overwrites = {name: low for name, low, _ in HEAT_PUMP.overwrites}
        self.declare(overwrites, [*HEAT_PUMP.measurements, *(f"{name}_y" for name in overwrites)])

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """Begin; another tolerance shifts the zone temperature."""
        print("an FMU may print whatever it likes", flush=True)
        self._plant = EmbeddedPlant(synthetic_weather())
        self._plant.reset(float(start_time), 0.0)
        self._plant.advance_points({}, 30.0)  # loads the compiled kernel
        self._plant.reset(float(start_time), 0.0)
        self._shift_K = 1e-3 * (math.log10(tolerance or 1e-6) + 6.0)
        self._steps_in_trouble, self._inputs_before = 0, dict(self._inputs)
        at = os.environ.get("FMU_HOUSE_TROUBLED_AT")
        decade = math.log10(tolerance or 1e-6)
        self._troubled = at is None or any(abs(decade - math.log10(float(t))) < 0.1 for t in at.split())

    def exit_initialization_mode(self) -> None:
        """The first readings."""
        self._show()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Simulate, or fail."""
        time.sleep(float(os.environ.get("FMU_HOUSE_LAGS_S", "0")))
        if self._in_trouble("CRASHES", current_time):
            os.kill(os.getpid(), signal.SIGSEGV)
        if self._in_trouble("FAILS", current_time):
            return False
        switched, self._inputs_before = self._inputs != self._inputs_before, dict(self._inputs)
        if switched and abs(current_time - float(os.environ.get("FMU_HOUSE_FAILS_SWITCHED_AT_S", "inf"))) < 1.0:
            return False
        if self._in_trouble("SLEEPS", current_time):
            time.sleep(3600.0)
        if self._in_trouble("CREEPS", current_time):
            self._steps_in_trouble += 1
            time.sleep(0.05 * 2**self._steps_in_trouble)
        forced = {
            name: self._inputs[f"{name}_u"] for name, _, _ in HEAT_PUMP.overwrites if self._inputs[f"{name}_activate"]
        }
        self._plant.advance_points(forced, step_size)
        self._show()
        return True

    def _in_trouble(self, how: str, time_s: float) -> bool:
        if not (self._troubled and time_s / 86400.0 >= float(os.environ.get(f"FMU_HOUSE_{how}_ON_DAY", "inf"))):
            return False
        once = os.environ.get("FMU_HOUSE_UNLESS")
        if once is None:
            return True
        happened = pathlib.Path(once).exists()
        pathlib.Path(once).touch()
        return not happened

    def _show(self) -> None:
        now = self._plant.now_s
        record = {name: column[-1] for name, column in self._plant.recorded(now, now).items()}
        for name, column in HEAT_PUMP.measurements.items():
            self._outputs[name] = float(record[column])
        self._outputs["reaTZon_y"] += self._shift_K
        for name, low, _ in HEAT_PUMP.overwrites:
            shown = record[_LEVELS[name]] if name in _LEVELS else self.acting(name, low)
            self._outputs[f"{name}_y"] = float(shown)
