"""Two simple houses as the zones of one building, each with an actuator and a machine of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from simple_house import SimpleHouse, simple_model

from thermoforce_mpc.data import ACTING, CONDITIONS, Measurement, Names, Observation, Record
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.shell import check_levels

TWO = Names(("bath", "hall"), ("radiator", "floor"), ("boiler", "heat pump"))
SHARED = Names(TWO.zones, TWO.actuators, ("boiler",))


class TwoHouses:
    """Two simple houses as the zones of one building; the level of the second is not measured.

    `lower_K`: added to the lower bound of the second, K. `shared`: one machine feeds both, and its power is measured.
    """

    def __init__(self, first=None, second=None, lower_K=0.0, shared=False) -> None:
        self.names = SHARED if shared else TWO
        self.houses = (first or SimpleHouse(), second or SimpleHouse(T_start_C=19.0))
        self.info, self.lower_K = self.houses[0].info, lower_K

    def _both(self, parts):
        def rows(name):
            return np.array([getattr(part, name)[0] for part in parts])

        u = rows("u") * np.array([1.0, np.nan])
        power_W = rows("power_W")
        if self.names is SHARED:
            power_W = power_W.sum(keepdims=True)
        first = parts[0]
        return Measurement(
            first.time_s,
            rows("T_zone_C"),
            first.T_out_C,
            first.solar_W_m2,
            u,
            power_W,
            rows("heat_W"),
            names=self.names,
        )

    def reset(self, start_s, warmup_s, price="constant"):
        return self._both([house.reset(start_s, warmup_s, price) for house in self.houses])

    def advance(self, u, duration_s):
        levels = check_levels(u, duration_s, names=self.names).u
        return self._both([h.advance(level, duration_s) for h, level in zip(self.houses, levels, strict=True)])

    def forecast(self, horizon_s, interval_s):
        one = self.houses[0].forecast(horizon_s, interval_s)
        both = {
            name: np.repeat(getattr(one, name), 2, axis=0) for name in CONDITIONS if np.ndim(getattr(one, name)) == 2
        }
        both["upper_C"] = both["upper_C"] + np.array([[0.0], [1.0]])
        both["lower_C"] = both["lower_C"] + np.array([[0.0], [self.lower_K]])
        if self.names is SHARED:
            both |= {name: both[name][:1] for name in both if name.startswith(("price", "emission", "heating"))}
        return replace(one, **both, names=self.names)

    def past(self, step_s):
        return Record.beginning(self._both([house.measure() for house in self.houses]))

    def kpis(self):
        each = [house.kpis() for house in self.houses]
        total = {name: sum(of[name] for of in each) for name in ("ener_tot", "cost_tot")}
        discomfort = {f"tdis_tot[{zone}]": of["tdis_tot"] for zone, of in zip(TWO.zones, each, strict=True)}
        return total | {"tdis_tot": sum(discomfort.values()) / 2} | discomfort

    def period(self, name):
        return self.houses[0].period(name)

    def close(self):
        pass


def two_model(competence=(None, None), shared=False) -> ThermalModel:
    """The exact model of two houses at hourly steps, with verdicts on them; `shared`: one machine feeds both."""
    zone = simple_model().only
    pair = zone.operator
    operator = BuildingOperator(TWO.zones, TWO.actuators, ((pair, None), (None, pair)), (0, 1))
    cards = tuple(replace(zone.card, competence=one) for one in competence)
    if shared:
        load = replace(zone.power.load, coefficients=tuple(2.0 * c for c in zone.power.load.coefficients))
        power = (replace(zone.power, load=load),)
        return ThermalModel(operator, power, (None,) * 2, cards, SHARED.machines, (0, 0), (0.5, 0.5))
    return ThermalModel(operator, (zone.power,) * 2, (None,) * 2, cards, TWO.machines, (0, 1), (0.0, 0.0))


def two_observation(hours=24, houses=None) -> Observation:
    """Two days of both houses under native control, and the forecast."""
    houses = houses or TwoHouses()
    houses.reset(10 * 86400.0, 2 * 86400.0)
    parts = [house.past(3600.0) for house in houses.houses]
    rows = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ("T_zone_C", *ACTING)}
    weather = {name: getattr(parts[0], name) for name in ("time_s", "T_out_C", "solar_W_m2")}
    return Observation(Record(**weather, **rows, names=TWO), houses.forecast(hours * 3600.0, 3600.0))


def reordered(observation: Observation, zones, actuators, machines) -> Observation:
    """The same building with its zones, actuators and machines in another order."""
    old = observation.names
    axes = {"zones": list(zones), "actuators": list(actuators), "machines": list(machines)}
    names = Names(*(tuple(getattr(old, kind)[i] for i in order) for kind, order in axes.items()))
    history, boundary = observation.history, observation.boundary
    of = {name: axes["zones"] for name in ("T_zone_C", "occupancy", "lower_C", "upper_C")}
    of |= dict.fromkeys(("u", "heat_W"), axes["actuators"])
    of |= {
        name: axes["machines"]
        for name in ("power_W", "T_return_C", "price_per_kWh", "emission_kg_per_kWh", "heating_price_per_kWh")
    }

    def part(data):
        return {name: getattr(data, name)[rows] for name, rows in of.items() if hasattr(data, name)}

    return Observation(replace(history, **part(history), names=names), replace(boundary, **part(boundary), names=names))
