"""A BOPTEST service with test cases of several zones: documented names and limits, control as its sources describe it.

The rooms are simple (air, radiator, outdoor air through one conductance); what is under test is who turns what on.
"""

from __future__ import annotations

import bisect
import math

import numpy as np
from boptest_server import Service, rejected
from multizone_points import HOUSE_ROOMS, MULTIZONE, OFFICE_ZONES

DT_S = 60.0
_K = 273.15


class FakeTest:
    """One selected test: its building, what is overwritten, and the record."""

    def __init__(self, name: str) -> None:
        self.name, self.points = name, MULTIZONE[name]
        self.sent: list[dict[str, float]] = []
        self.initialize(0.0, 0.0)

    def initialize(self, start_s: float, warmup_s: float) -> dict[str, float]:
        self.building = BUILDINGS[self.name]()
        self._set: dict[str, float] = {}
        self.time_s = max(start_s - warmup_s, 0.0)
        self.times: list[float] = []
        self.rows: list[dict[str, float]] = []
        self._simulate(start_s - self.time_s)
        return self._now()

    def advance(self, inputs: dict[str, float], step_s: float) -> dict[str, float]:
        self.sent.append(inputs)
        self._set |= inputs
        self._simulate(step_s)
        return self._now()

    def recorded(self, names: list[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        i, j = bisect.bisect_left(self.times, start_s - 1e-6), bisect.bisect_right(self.times, final_s + 1e-6)
        return {name: [row[name] for row in self.rows[i:j]] for name in names} | {"time": self.times[i:j]}

    def _active(self, name: str) -> float | None:
        """Overwritten value of a point, None where native control decides."""
        return self._set[f"{name}_u"] if self._set.get(f"{name}_activate") else None

    def _simulate(self, duration_s: float) -> None:
        for _ in range(round(duration_s / DT_S)):
            self.time_s += DT_S
            self.times.append(self.time_s)
            self.rows.append(self.building.step(self.time_s, self._active))

    def _now(self) -> dict[str, float]:
        return {"time": self.time_s, **(self.rows[-1] if self.rows else {})}


class FakeService(Service):
    """Answers for tests of several zones; unlike a real one it refuses what that would clip or ignore."""

    def __init__(self) -> None:
        super().__init__(offers=tuple(MULTIZONE))
        self.started: list[FakeTest] = []

    def _new(self, name):
        self.started.append(FakeTest(name))
        return self.started[-1]

    def _name(self, testid, test, body):
        return {"name": test.name}

    def _inputs(self, testid, test, body):
        return _described(test.points.inputs)

    def _measurements(self, testid, test, body):
        return _described(test.points.measurements)

    def _forecast_points(self, testid, test, body):
        return _described(test.points.forecast)

    def _initialize(self, testid, test, body):
        return test.initialize(body["start_time"], body["warmup_period"])

    def _scenario(self, testid, test, body):
        if body.get("time_period"):
            raise rejected("Scenario parameter time_period: start days only")
        return body

    def _advance(self, testid, test, body):
        for name, value in body.items():
            point = test.points.inputs.get(name)
            if point is None:
                raise rejected(f"Unexpected input variable: {name}")
            if point.minimum is not None and not point.minimum <= value <= point.maximum:
                raise rejected(f"{name} = {value} would be clipped to {point.minimum} .. {point.maximum}")
        return test.advance(body, self.steps[testid])

    def _forecast(self, testid, test, body):
        unknown = set(body["point_names"]) - set(test.points.forecast)
        if unknown:
            raise rejected(f"Invalid forecast points: {unknown}")
        times = test.time_s + np.arange(0.0, body["horizon"] + 1.0, body["interval"])
        return {name: [boundary(name, t) for t in times] for name in body["point_names"]} | {"time": times.tolist()}

    def _results(self, testid, test, body):
        return test.recorded(body["point_names"], body["start_time"], body["final_time"])

    def _kpi(self, testid, test, body):
        return {"tdis_tot": 0.0, "cost_tot": 0.0, "ener_tot": 0.0}


def _described(points):
    return {
        p.name: {"Unit": p.unit, "Description": p.name, "Minimum": p.minimum, "Maximum": p.maximum}
        for p in points.values()
    }


def _hour(t: float) -> float:
    return t / 3600.0 % 24.0


def _outdoor(t: float) -> float:
    day = t / 86400.0
    return _K + 4.0 - 4.0 * math.cos(2 * math.pi * (day - 0.15)) + 2.0 * math.sin(1.7 * day)


def _sun(t: float) -> float:
    return 400.0 * max(math.sin(math.pi * (_hour(t) - 7.0) / 11.0), 0.0) if 7.0 < _hour(t) < 18.0 else 0.0


def _office_hours(t: float) -> bool:
    return 6.0 <= _hour(t) < 19.0


def boundary(name: str, t: float) -> float:
    """Forecast point at `t`: the house's band by room name in capitals, the office's by zone in small letters."""
    at_home = not 10.0 <= _hour(t) < 19.0
    if name.startswith(("LowerSetp", "UpperSetp")):
        if name[10].isupper():
            return (292.15 if at_home else 289.15) if name.startswith("Lower") else 305.15
        on = _office_hours(t)
        return (293.15 if on else 285.15) if name.startswith("Lower") else (297.15 if on else 303.15)
    known = {
        "TDryBul": _outdoor(t), "HGloHor": _sun(t), "PriceGasPower": 0.0911, "EmissionsGasPower": 0.18108,
        "PriceElectricPowerConstant": 0.094, "EmissionsElectricPower": 0.341,
    }  # fmt: skip
    return known.get(name, 1.0)


RADIATOR_W = dict(zip((*HOUSE_ROOMS, "Hal"), (1800.0, 1000.0, 900.0, 1100.0, 800.0, 300.0), strict=True))
DESIGN_M3S = dict(zip(OFFICE_ZONES, (4.4967, 0.9479, 0.9002, 0.9479, 0.7002), strict=True))
LEAST_M3S = dict(zip(OFFICE_ZONES, (0.7847, 0.1654, 0.1350, 0.1654, 0.1050), strict=True))


class House:
    """Boiler and pump follow the thermostat in the living room; valves their rooms; the hall is always open."""

    def __init__(self) -> None:
        self.T = dict.fromkeys(RADIATOR_W, 292.0)
        self.wall = dict.fromkeys(RADIATOR_W, 291.0)
        self.water = dict.fromkeys(RADIATOR_W, 292.0)
        self.on = False

    def step(self, t, active):
        home = not 10.0 <= _hour(t) < 19.0
        native = 292.15 if home else 289.15
        thermostat = active("oveTSetPumBoi") or native
        if self.T["Liv"] < thermostat - 0.25:
            self.on = True
        elif self.T["Liv"] > thermostat + 0.25:
            self.on = False
        pump = active("oveEmiPum")
        pump = (0.25 if self.on else 0.0) if pump is None else pump
        out = _outdoor(t)
        supply = active("oveTSetSup") or 293.0 + 1.3 * max(native - out, 0.0)
        row, heat_W = {}, 0.0
        hall = self.T["Hal"]
        for zone, nominal in RADIATOR_W.items():
            valve = active(f"conHea{zone}_oveActHea") if zone != "Hal" else 1.0
            valve = min(max(2.0 * (native - self.T[zone]), 0.0), 1.0) if valve is None else valve
            flows = min(valve / 0.2, 1.0) if pump > 0 else 0.0
            taken = flows * nominal / 10.0 * max(supply - self.water[zone], 0.0)
            given = nominal / 35.0 * (self.water[zone] - self.T[zone])
            self.water[zone] += DT_S * (taken - given) / (37.0 * nominal)
            UA, C = nominal / 40.0, 100.0 * nominal
            flux = given - UA * (self.T[zone] - out) - 5 * UA * (self.T[zone] - self.wall[zone])
            flux += 0.4 * nominal * _sun(t) / 400.0 * (zone in ("Liv", "Ro1", "Ro2")) - 8.0 * (self.T[zone] - hall)
            self.wall[zone] += DT_S * 5 * UA * (self.T[zone] - self.wall[zone]) / (60.0 * C)
            self.T[zone] += DT_S * flux / C
            heat_W += taken
            row[f"reaHea{zone}_y"] = given
            if zone != "Hal":
                row |= {f"conHea{zone}_reaTZon_y": self.T[zone], f"conHea{zone}_oveActHea_u": valve}
        return row | {
            "reaTHal_y": self.T["Hal"],
            "oveEmiPum_u": pump,
            "boi_reaGasBoi_y": heat_W / 0.9,
            "boi_reaPpum_y": 141.0 if pump > 0 else 4.0,
            "weatherStation_reaWeaTDryBul_y": out,
            "weatherStation_reaWeaHGloHor_y": _sun(t),
        }


class Office:
    """The fan runs in office hours with air at 12 °C; boxes have a least flow, reheat below and open above the band."""

    def __init__(self) -> None:
        self.T = dict.fromkeys(DESIGN_M3S, 293.5)
        self.wall = dict.fromkeys(DESIGN_M3S, 293.5)

    def step(self, t, active):
        on, out, row = _office_hours(t), _outdoor(t), {}
        total, reheat_W, cooled_W = 0.0, 0.0, 0.0
        for zone, design in DESIGN_M3S.items():
            heating = active(f"hvac_oveZonSup{zone}_TZonHeaSet") or (293.15 if on else 285.15)
            cooling = active(f"hvac_oveZonSup{zone}_TZonCooSet") or (297.15 if on else 303.15)
            T, least = self.T[zone], LEAST_M3S[zone]
            reheat = min(max(2.0 * (heating - T), 0.0), 1.0) if on else 0.0
            opened = min(max(2.0 * (T - cooling), 0.0), 1.0) if on else 0.0
            V = max(least + opened * (design - least), 0.3 * design if reheat > 0 else 0.0) if on else 0.0
            supply = 285.15 + 20.0 * reheat
            air_W = 1207.0 * V * (supply - T)
            UA, C = 250.0 * design, 1.5e6 * design
            flux = air_W - UA * (T - out) - 6 * UA * (T - self.wall[zone])
            flux += 4000.0 * design * on + (3000.0 * design * _sun(t) / 400.0 if zone != "Cor" else 0.0)
            self.wall[zone] += DT_S * 6 * UA * (T - self.wall[zone]) / (40.0 * C)
            self.T[zone] = T + DT_S * flux / C
            total, reheat_W = total + V, reheat_W + 1207.0 * V * 20.0 * reheat
            cooled_W += 1207.0 * V * max(0.7 * T + 0.3 * out - 285.15, 0.0)
            row |= {
                f"hvac_reaZon{zone}_TZon_y": self.T[zone],
                f"hvac_reaZon{zone}_TSup_y": supply,
                f"hvac_reaZon{zone}_V_flow_y": V,
            }
        return row | {
            "hvac_reaAhu_TSup_y": 285.15,
            "hvac_reaAhu_PFanSup_y": 9000.0 * (total / 5.6) ** 2,
            "heaPum_reaPHeaPum_y": reheat_W / 2.5,
            "chi_reaPChi_y": cooled_W / 3.0 if out > 286.15 else 0.0,
            **dict.fromkeys(
                ("heaPum_reaPPumDis_y", "chi_reaPPumDis_y", "hvac_reaAhu_PPumHea_y", "hvac_reaAhu_PPumCoo_y"), 0.0
            ),
            "weaSta_reaWeaTDryBul_y": out,
            "weaSta_reaWeaHGloHor_y": _sun(t),
        }


BUILDINGS = {"multizone_residential_hydronic": House, "multizone_office_simple_air": Office}
