"""Two simple houses as the zones of one building, each with an actuator and a machine of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simple_house import SimpleHouse

from thermoforce_mpc.data import CONDITIONS, Measurement, Names, Record
from thermoforce_mpc.plants.checks import check_levels

TWO = Names(("bath", "hall"), ("radiator", "floor"), ("boiler", "heat pump"))


class TwoHouses:
    """Two simple houses as the zones of one building; the level of the second is not measured."""

    def __init__(self) -> None:
        self.houses = (SimpleHouse(), SimpleHouse(T_start_C=19.0))
        self.info = self.houses[0].info

    def _both(self, parts):
        def rows(name):
            return np.array([getattr(part, name)[0] for part in parts])

        u = rows("u") * np.array([1.0, np.nan])
        first = parts[0]
        return Measurement(
            first.time_s,
            rows("T_zone_C"),
            first.T_out_C,
            first.solar_W_m2,
            u,
            rows("power_W"),
            rows("heat_W"),
            names=TWO,
        )

    def reset(self, start_s, warmup_s, price="constant"):
        return self._both([house.reset(start_s, warmup_s, price) for house in self.houses])

    def advance(self, u, duration_s):
        levels = check_levels(u, duration_s, names=TWO).u
        return self._both([h.advance(level, duration_s) for h, level in zip(self.houses, levels, strict=True)])

    def forecast(self, horizon_s, interval_s):
        one = self.houses[0].forecast(horizon_s, interval_s)
        both = {
            name: np.repeat(getattr(one, name), 2, axis=0) for name in CONDITIONS if np.ndim(getattr(one, name)) == 2
        }
        both["upper_C"] = both["upper_C"] + np.array([[0.0], [1.0]])
        return replace(one, **both, names=TWO)

    def past(self, step_s):
        return Record.beginning(self._both([house._measure() for house in self.houses]))

    def kpis(self):
        each = [house.kpis() for house in self.houses]
        total = {name: sum(of[name] for of in each) for name in ("ener_tot", "cost_tot")}
        discomfort = {f"tdis_tot[{zone}]": of["tdis_tot"] for zone, of in zip(TWO.zones, each, strict=True)}
        return total | {"tdis_tot": sum(discomfort.values()) / 2} | discomfort

    def period(self, name):
        return self.houses[0].period(name)

    def close(self):
        pass
