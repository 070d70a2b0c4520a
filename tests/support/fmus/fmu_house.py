"""The emulator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic_heat_pump`.

Run inside the FMU, in a process of its own. The environment can make it fail, to see what its user is told.
"""

import os
import signal

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.emulator import MEASUREMENTS, OVERWRITES

_LEVELS = {"oveHeaPumY": "level", "oveTSet": "T_setpoint"}


class FmuHouse(Fmi2Slave):
    author = "tests"
    description = "emulator of bestest_hydronic_heat_pump"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self._plant = None
        self._inputs = {}
        self._outputs = {}
        for name, low, _ in OVERWRITES:
            self._inputs[f"{name}_u"], self._inputs[f"{name}_activate"] = low, False
            self._declare_input(Real, f"{name}_u", low)
            self._declare_input(Boolean, f"{name}_activate", False)
        for name in [*MEASUREMENTS, *(f"{name}_y" for name, _, _ in OVERWRITES)]:
            self._outputs[name] = 0.0
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, getter=lambda name=name: self._outputs[name]), nested=False
            )

    def _declare_input(self, kind, name, start):
        self.register_variable(
            kind(
                name,
                start=start,
                causality=Fmi2Causality.input,
                variability=Fmi2Variability.discrete,
                getter=lambda: self._inputs[name],
                setter=lambda value: self._inputs.__setitem__(name, value),
            ),
            nested=False,
        )

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
            acting = self._inputs[f"{name}_u"] if self._inputs[f"{name}_activate"] else low
            self._outputs[f"{name}_y"] = float(record[_LEVELS[name]]) if name in _LEVELS else float(acting)
