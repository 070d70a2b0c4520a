"""One room with a boiler and a radiator as an FMU for PythonFMU, with the names of the test case `bestest_hydronic`.

Made up: one node in constant cold. Enough to see whether a point map heats, holds the pump and lets go.
"""

from fmu_points import FmuRoom

OVERWRITES = {"oveTSetHea": 294.25, "oveTSetCoo": 297.15, "oveTSetSup": 293.15, "ovePum": 0.0}
OUTPUTS = ("reaTRoo_y", "reaCO2RooAir_y", "weaSta_reaWeaTDryBul_y", "weaSta_reaWeaHGloHor_y", "reaQHea_y", "reaPPum_y",
           *(f"{name}_y" for name in OVERWRITES))  # fmt: skip
_CAPACITY_J_K, _LOSS_W_K, _RADIATOR_W_K, _MOST_W = 3.0e6, 80.0, 100.0, 5000.0


class FmuRadiator(FmuRoom):
    description = "a room with a radiator"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.declare(OVERWRITES, OUTPUTS)
        self._T = 293.15

    def simulate(self, dt_s):
        cold = self.acting("oveTSetHea", OVERWRITES["oveTSetHea"]) - self._T
        T_supply = self.acting("oveTSetSup", min(max(293.15 + 10.0 * cold, 293.15), 353.15))
        pump = self.acting("ovePum", float(cold > 0.0))
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
            oveTSetHea_y=self.acting("oveTSetHea", OVERWRITES["oveTSetHea"]),
            oveTSetCoo_y=self.acting("oveTSetCoo", OVERWRITES["oveTSetCoo"]),
            oveTSetSup_y=T_supply,
            ovePum_y=pump,
        )
