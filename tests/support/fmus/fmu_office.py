"""One room with a fan coil unit as an FMU for PythonFMU, with the names of the test case `bestest_air`.

Made up: one node, a day's sine outdoors. Enough to see whether a point map heats, cools, holds and lets go.
"""

import math

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

OVERWRITES = {"fcu_oveTSup": 293.15, "fcu_oveFan": 0.0, "con_oveTSetHea": 288.15, "con_oveTSetCoo": 303.15}
OUTPUTS = ("zon_reaTRooAir_y", "zon_reaCO2RooAir_y", "zon_weaSta_reaWeaTDryBul_y", "zon_weaSta_reaWeaHGloHor_y",
           "fcu_reaPHea_y", "fcu_reaPCoo_y", "fcu_reaPFan_y", *(f"{name}_y" for name in OVERWRITES))  # fmt: skip
_CAPACITY_J_K, _LOSS_W_K, _FLOW_W_K, _STEP_S = 3.0e6, 60.0, 0.55 * 1006.0, 30.0


class FmuOffice(Fmi2Slave):
    author = "tests"
    description = "a room with a fan coil unit"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self._inputs = {}
        self._outputs = dict.fromkeys(OUTPUTS, 0.0)
        for name, value in OVERWRITES.items():
            for kind, end, start in ((Real, "u", value), (Boolean, "activate", False)):
                self._declare_input(kind, f"{name}_{end}", start)
        for name in OUTPUTS:
            self.register_variable(
                Real(name, causality=Fmi2Causality.output, getter=lambda name=name: self._outputs[name]), nested=False
            )
        self._T, self._time_s = 302.15, 0.0  # warm enough that a lower set-point has something to do

    def _declare_input(self, kind, name, start):
        self._inputs[name] = start
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
        self._time_s = float(start_time)

    def exit_initialization_mode(self):
        self._simulate(0.0)

    def do_step(self, current_time, step_size):
        n = max(round(step_size / _STEP_S), 1)
        for _ in range(n):
            self._simulate(step_size / n)
        return True

    def _acting(self, name, native):
        return self._inputs[f"{name}_u"] if self._inputs[f"{name}_activate"] else native

    def _simulate(self, dt_s):
        self._time_s += dt_s
        heating = self._acting("con_oveTSetHea", OVERWRITES["con_oveTSetHea"])
        cooling = self._acting("con_oveTSetCoo", OVERWRITES["con_oveTSetCoo"])
        cold, warm = heating - self._T, self._T - cooling
        fan = self._acting("fcu_oveFan", min(max(cold, warm, 0.0), 1.0))
        T_supply = self._acting("fcu_oveTSup", 313.15 if cold > warm else 285.15)
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
