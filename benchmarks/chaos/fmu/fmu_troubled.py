"""A small house as an FMU for PythonFMU that fails on purpose, with the names of `bestest_hydronic_heat_pump`.

Made up: one node in a day's sine outdoors. It imports no more than it needs, since each restart begins a new process.
The environment makes it fail, to see what its user is told: `FMU_HOUSE_<CRASHES|FAILS|SLEEPS|CREEPS>_ON_DAY`, at the
tolerances in `FMU_HOUSE_TROUBLED_AT` (default: all), or once, if the file `FMU_HOUSE_UNLESS` is not there;
`FMU_HOUSE_FAILS_SWITCHED_AT_S`: where its inputs change at that second. Every step takes `FMU_HOUSE_LAGS_S`. Another
tolerance than 1e-6 shifts the zone temperature by 1 mK a decade.
"""

import math
import os
import pathlib
import signal
import time
from typing import Any

from fmu_points import FmuWithPoints
from pythonfmu import DefaultExperiment

_OVERWRITES = {"oveHeaPumY": 0.0, "oveTSet": 294.15, "ovePum": 0.0, "oveFan": 0.0}
_OUTPUTS = (
    "reaTZon_y", "reaPHeaPum_y", "reaPFan_y", "reaPPumEmi_y", "reaQHeaPumCon_y", "reaTRet_y", "reaCO2RooAir_y",
    "weaSta_reaWeaTDryBul_y", "weaSta_reaWeaHGloHor_y",
)  # fmt: skip
_CAPACITY_J_K, _LOSS_W_K, _MOST_W, _COP = 2.0e7, 200.0, 9000.0, 3.0


class FmuTroubled(FmuWithPoints):
    """One house; what fails when is in the environment."""

    description = "a small house that fails on purpose"

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(tolerance=1e-6)
        self.declare(_OVERWRITES, [*_OUTPUTS, *(f"{name}_y" for name in _OVERWRITES)])

    def setup_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        """Begin; another tolerance shifts the zone temperature."""
        print("an FMU may print whatever it likes", flush=True)
        decade = math.log10(tolerance or 1e-6)
        self._T_zone_K, self._shift_K, self._now_s = 294.15, 1e-3 * (decade + 6.0), float(start_time)
        self._steps_in_trouble, self._inputs_before = 0, dict(self._inputs)
        at = os.environ.get("FMU_HOUSE_TROUBLED_AT")
        self._troubled = at is None or any(abs(decade - math.log10(float(t))) < 0.1 for t in at.split())

    def exit_initialization_mode(self) -> None:
        """The first readings."""
        self._simulate(0.0)

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
        self._simulate(step_size)
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

    def _simulate(self, dt_s: float) -> None:
        self._now_s += dt_s
        T_set_K = self.acting("oveTSet", _OVERWRITES["oveTSet"])
        level = self.acting("oveHeaPumY", min(max(T_set_K - self._T_zone_K, 0.0), 1.0))
        heat_W = _MOST_W * level
        T_out_K = 275.15 - 4.0 * math.cos(2.0 * math.pi * self._now_s / 86400.0)
        self._T_zone_K += dt_s / _CAPACITY_J_K * (heat_W - _LOSS_W_K * (self._T_zone_K - T_out_K))
        running = float(level > 0.0)
        self._outputs.update(
            reaTZon_y=self._T_zone_K + self._shift_K,
            reaPHeaPum_y=heat_W / _COP,
            reaPFan_y=20.0 * running,
            reaPPumEmi_y=10.0 * running,
            reaQHeaPumCon_y=heat_W,
            reaTRet_y=self._T_zone_K + 5.0 * level,
            reaCO2RooAir_y=600.0,
            weaSta_reaWeaTDryBul_y=T_out_K,
            weaSta_reaWeaHGloHor_y=0.0,
            oveHeaPumY_y=level,
            oveTSet_y=T_set_K,
            ovePum_y=self.acting("ovePum", running),
            oveFan_y=self.acting("oveFan", running),
        )
