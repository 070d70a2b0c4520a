"""One room with a fan coil unit as an FMU for PythonFMU, with the names of the test case `bestest_air`.

Made up: one node, a day's sine outdoors. Enough to see whether a point map heats, cools, holds and lets go.
"""

import math

from fmu_points import FmuRoom

OVERWRITES = {"fcu_oveTSup": 293.15, "fcu_oveFan": 0.0, "con_oveTSetHea": 288.15, "con_oveTSetCoo": 303.15}
OUTPUTS = ("zon_reaTRooAir_y", "zon_reaCO2RooAir_y", "zon_weaSta_reaWeaTDryBul_y", "zon_weaSta_reaWeaHGloHor_y",
           "fcu_reaPHea_y", "fcu_reaPCoo_y", "fcu_reaPFan_y", *(f"{name}_y" for name in OVERWRITES))  # fmt: skip
_CAPACITY_J_K, _LOSS_W_K, _FLOW_W_K = 3.0e6, 60.0, 0.55 * 1006.0


class FmuOffice(FmuRoom):
    description = "a room with a fan coil unit"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.declare(OVERWRITES, OUTPUTS)
        self._T, self._time_s = 302.15, 0.0  # warm enough that a lower set-point has something to do

    def setup_experiment(self, start_time, stop_time=None, tolerance=None):
        self._time_s = float(start_time)

    def simulate(self, dt_s):
        self._time_s += dt_s
        heating = self.acting("con_oveTSetHea", OVERWRITES["con_oveTSetHea"])
        cooling = self.acting("con_oveTSetCoo", OVERWRITES["con_oveTSetCoo"])
        cold, warm = heating - self._T, self._T - cooling
        fan = self.acting("fcu_oveFan", min(max(cold, warm, 0.0), 1.0))
        T_supply = self.acting("fcu_oveTSup", 313.15 if cold > warm else 285.15)
        heat_W = fan * _FLOW_W_K * (T_supply - self._T)
        T_out = 288.15 - 8.0 * math.cos(2 * math.pi * self._time_s / 86400.0)
        self._T += dt_s / _CAPACITY_J_K * (heat_W + _LOSS_W_K * (T_out - self._T))
        self._outputs.update(
            zon_reaTRooAir_y=self._T,
            zon_reaCO2RooAir_y=500.0,
            zon_weaSta_reaWeaTDryBul_y=T_out,
            zon_weaSta_reaWeaHGloHor_y=0.0,
            fcu_reaPHea_y=max(heat_W, 0.0) / 0.9,
            fcu_reaPCoo_y=max(-heat_W, 0.0) / 3.0,
            fcu_reaPFan_y=130.0 * fan,
            fcu_oveTSup_y=T_supply,
            fcu_oveFan_y=fan,
            con_oveTSetHea_y=heating,
            con_oveTSetCoo_y=cooling,
        )
