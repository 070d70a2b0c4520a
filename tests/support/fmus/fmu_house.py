"""The emulator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic_heat_pump`.

Run inside the FMU, in a process of its own. The environment can make it fail, to see what its user is told.
"""

import os
import signal

from fmu_points import FmuWithPoints

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.emulator import MEASUREMENTS, OVERWRITES

_LEVELS = {"oveHeaPumY": "level", "oveTSet": "T_setpoint"}


class FmuHouse(FmuWithPoints):
    description = "emulator of bestest_hydronic_heat_pump"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self._plant = None
        overwrites = {name: low for name, low, _ in OVERWRITES}
        self.declare(overwrites, [*MEASUREMENTS, *(f"{name}_y" for name in overwrites)])

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        print("an FMU may print whatever it likes", flush=True)
        self._plant = EmbeddedPlant(synthetic_weather())
        self._plant.reset(float(start_time), 0.0)

    def exit_initialization_mode(self):
        self._show()

    def do_step(self, current_time, step_size):
        day = current_time / 86400.0
        if day >= float(os.environ.get("FMU_HOUSE_CRASHES_ON_DAY", "inf")):
            os.kill(os.getpid(), signal.SIGSEGV)
        if day >= float(os.environ.get("FMU_HOUSE_FAILS_ON_DAY", "inf")):
            return False
        forced = {name: self._inputs[f"{name}_u"] for name, _, _ in OVERWRITES if self._inputs[f"{name}_activate"]}
        self._plant.advance_points(forced, step_size)
        self._show()
        return True

    def _show(self):
        now = self._plant.now_s
        record = {name: column[-1] for name, column in self._plant.recorded(now, now).items()}
        for name, column in MEASUREMENTS.items():
            self._outputs[name] = float(record[column])
        for name, low, _ in OVERWRITES:
            shown = record[_LEVELS[name]] if name in _LEVELS else self.acting(name, low)
            self._outputs[f"{name}_y"] = float(shown)
