"""One room with a boiler and a radiator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic`.

Made up: one node in constant cold. Enough to see whether a point map heats, holds the pump and lets go.
"""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

OVERWRITES = {"oveTSetHea": 294.25, "oveTSetCoo": 297.15, "oveTSetSup": 293.15, "ovePum": 0.0}
OUTPUTS = ("reaTRoo_y", "reaCO2RooAir_y", "weaSta_reaWeaTDryBul_y", "weaSta_reaWeaHGloHor_y", "reaQHea_y", "reaPPum_y",
           *(f"{name}_y" for name in OVERWRITES))  # fmt: skip
_CAPACITY_J_K, _LOSS_W_K, _RADIATOR_W_K, _MOST_W, _STEP_S = 3.0e6, 80.0, 100.0, 5000.0, 30.0


class FmuRadiator(Fmi2Slave):
    author = "tests"
    description = "a room with a radiator"

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
        self._T = 293.15

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
        cold = self._acting("oveTSetHea", OVERWRITES["oveTSetHea"]) - self._T
        T_supply = self._acting("oveTSetSup", min(max(293.15 + 10.0 * cold, 293.15), 353.15))
        pump = self._acting("ovePum", float(cold > 0.0))
        heat_W = pump * min(max(_RADIATOR_W_K * (T_supply - self._T), 0.0), _MOST_W)
        T_out = 278.15
        self._T += dt_s / _CAPACITY_J_K * (heat_W + _LOSS_W_K * (T_out - self._T))
        self._outputs.update(
            reaTRoo_y=self._T,
            reaCO2RooAir_y=500.0,
            weaSta_reaWeaTDryBul_y=T_out,
            weaSta_reaWeaHGloHor_y=0.0,
            reaQHea_y=heat_W / 0.9,
            reaPPum_y=20.0 * pump,
            oveTSetHea_y=self._acting("oveTSetHea", OVERWRITES["oveTSetHea"]),
            oveTSetCoo_y=self._acting("oveTSetCoo", OVERWRITES["oveTSetCoo"]),
            oveTSetSup_y=T_supply,
            ovePum_y=pump,
        )
