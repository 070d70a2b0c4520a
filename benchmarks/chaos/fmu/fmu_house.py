"""The emulator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic_heat_pump`.

Run inside the FMU, in a process of its own.
"""

from typing import Any

from fmu_points import FmuWithPoints
from pythonfmu import DefaultExperiment

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP

_LEVELS = {"oveHeaPumY": "level", "oveTSet": "T_setpoint"}


class FmuHouse(FmuWithPoints):
    """One house."""

    description = "emulator of bestest_hydronic_heat_pump"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(tolerance=1e-6)
        overwrites = {name: low for name, low, _ in HEAT_PUMP.overwrites}
        self.declare(overwrites, [*HEAT_PUMP.measurements, *(f"{name}_y" for name in overwrites)])

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """Begin."""
        print("an FMU may print whatever it likes", flush=True)
        self._plant = EmbeddedPlant(synthetic_weather())
        self._plant.reset(float(start_time), 0.0)
        self._plant.advance_points({}, 30.0)  # loads the compiled kernel
        self._plant.reset(float(start_time), 0.0)

    def exit_initialization_mode(self) -> None:
        """The first readings."""
        self._show()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Simulate."""
        forced = {
            name: self._inputs[f"{name}_u"] for name, _, _ in HEAT_PUMP.overwrites if self._inputs[f"{name}_activate"]
        }
        self._plant.advance_points(forced, step_size)
        self._show()
        return True

    def _show(self) -> None:
        now = self._plant.now_s
        record = {name: column[-1] for name, column in self._plant.recorded(now, now).items()}
        for name, column in HEAT_PUMP.measurements.items():
            self._outputs[name] = float(record[column])
        for name, low, _ in HEAT_PUMP.overwrites:
            shown = record[_LEVELS[name]] if name in _LEVELS else self.acting(name, low)
            self._outputs[f"{name}_y"] = float(shown)
