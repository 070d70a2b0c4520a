"""Two rooms behind one heat pump on a heating curve: what is set is the curve's offset, which both rooms answer to,
or one of the other commands of such a pump.

Valves have a P band of their own set-points; heat goes by the open valve and what the water is above the room, and
power is that heat over a COP that falls with the water's temperature.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from home_by_setpoint import START, price
from simple_house import outdoor_C

from thermoforce_mpc.data import HOUR_S
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel

ROOMS = ("living", "bedroom")
SETPOINT_C = {"living": 21.5, "bedroom": 19.0}
CAPACITY_WH_K = {"living": 4500.0, "bedroom": 3000.0}
LOSS_W_K = {"living": 70.0, "bedroom": 45.0}
EMITTER_W_K = {"living": 130.0, "bedroom": 70.0}
RULES = {
    "time": {"zone": "UTC"},
    "step": "1h",
    "outdoor": "out",
    "sun": "sun",
    "zones": {
        name: {
            "temperature": f"T_{name}",
            "lower": SETPOINT_C[name] - 1.0,
            "upper": SETPOINT_C[name] + 1.0,
            "floor_area_m2": 30.0,
        }
        for name in ROOMS
    },
    "actuators": {
        name: {"zone": name, "machine": "heat_pump", "level": f"valve_{name}", "flow": "flow", "share": share}
        for name, share in (("living", 0.62), ("bedroom", 0.38))
    },
    "machines": {
        "heat_pump": {
            "power": "P",
            "price": "price",
            "command": {"kind": "curve_offset", "column": "offset", "usual": 0},
        }
    },
}


def cop(T_flow_C: float, T_out_C: float) -> float:
    """Half of Carnot."""
    return 0.5 * (T_flow_C + 273.15) / max(T_flow_C - T_out_C, 10.0)


def curve_C(out_C: float) -> float:
    """What the heating curve asks for."""
    return 27.0 + 0.6 * (20.0 - out_C)


def rules_by(kind: str, column: str, **keys) -> dict:
    """The map where a command of another kind is set."""
    command = {"kind": kind, "column": column, **keys}
    return RULES | {"machines": {"heat_pump": RULES["machines"]["heat_pump"] | {"command": command}}}


SG_RULES = rules_by("sg_ready", "contact", usual=2)
ENABLE_RULES = rules_by("enable", "enabled", usual=1)
# The thermostat of the house is in the living room; other rooms have open valves.
HOUSE_RULES = rules_by("setpoint", "set", reference="living")
# Left alone it is what the curve asks for: the record tells.
FLOW_RULES = rules_by("flow_temperature", "flow_set")
# What SG-Ready does to the curve, K; blocked, or not enabled, the pump stands.
SG_OFFSET_K = {1: 0.0, 2: 0.0, 3: 3.0, 4: 3.0}
# What trials set: from, up to and without, and for so long, h; of a temperature beside what it usually is.
TRIALS = {"curve_offset": (-3, 4, 4), "sg_ready": (1, 4, 2), "enable": (0, 4, 2), "flow_temperature": (-3, 4, 4)}
TRIALS |= {"setpoint": (-1, 2, 4)}
_DEAD_BAND_K = 0.2


class HomeByCurve:
    """`Connection` and `Clock`; five minutes a row. In the last `trials` days the command is another one by hours.

    `set_by`: the kind of what is set. `swing_K`: by how much days are warmer or colder, in turns of six.
    """

    def __init__(self, days: int = 21, trials: int = 5, set_by: str = "curve_offset", swing_K: float = 0.0) -> None:
        self._set_by, self._swing_K = set_by, swing_K
        self.at, self.rows, self.told, self.written = START - pd.Timedelta(days=days), [], None, []
        self.T, self._is_on = {"living": 21.5, "bedroom": 19.0}, True
        self._trials, self._rng = START - pd.Timedelta(days=trials), np.random.default_rng(3)
        self.wait_until(START)

    def now(self) -> pd.Timestamp:
        return self.at

    def out_C(self, at: pd.DatetimeIndex | pd.Timestamp):
        """Outdoor temperature, °C."""
        time_s = (at - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds()
        return outdoor_C(time_s) + self._swing_K * np.sin(2.0 * np.pi * np.asarray(time_s) / 518400.0)

    def usual(self, out_C: float) -> float:
        """What is set when it is left alone."""
        own = {"curve_offset": 0.0, "sg_ready": 2.0, "enable": 1.0, "flow_temperature": round(curve_C(out_C))}
        return (own | {"setpoint": 21.5 if 6 <= self.at.hour < 22 else 20.5})[self._set_by]

    def wait_until(self, at: pd.Timestamp) -> None:
        low, high, hold_h = TRIALS[self._set_by]
        while (left_s := (at - self.at).total_seconds()) > 1e-6:
            part_s = min(300.0, left_s)
            out = float(self.out_C(self.at))
            if self._trials <= self.at < START and self.at.hour % hold_h == 0 and self.at.minute == 0:
                self._trial = float(self._rng.integers(low, high))
                self._trial = min(self._trial, 1.0) if self._set_by == "enable" else self._trial
            told = self.usual(out)
            if self._trials <= self.at < START and hasattr(self, "_trial"):
                told = self._trial + (told if self._set_by in ("flow_temperature", "setpoint") else 0.0)
            told = told if self.told is None else self.told
            set_by = {"curve_offset": 0.0, "sg_ready": 2.0, "enable": 1.0} | {self._set_by: told}
            offset = set_by["curve_offset"] + SG_OFFSET_K[round(set_by["sg_ready"])]
            asked = set_by.get("flow_temperature", curve_C(out) + offset)
            runs = set_by["sg_ready"] != 1.0 and set_by["enable"] == 1.0
            flow = float(np.clip(asked, 20.0, 55.0)) if runs else 15.0
            row = {"time": self.at, "out": out, "sun": 0.0, "flow": flow, "price": price(self.at)}
            row |= {"offset": offset, "contact": set_by["sg_ready"], "enabled": set_by["enable"], "flow_set": asked}
            row["set"] = set_by.get("setpoint", np.nan)
            if abs(row["set"] - self.T["living"]) > _DEAD_BAND_K:
                self._is_on = row["set"] > self.T["living"]
            heat_W = {}
            for name in ROOMS:
                valve = float(np.clip((SETPOINT_C[name] + 0.5 - self.T[name]) / 2.0 + 0.5, 0.0, 1.0))
                valve = float(self._is_on) if self._set_by == "setpoint" else valve
                heat_W[name] = valve * EMITTER_W_K[name] * max(flow - self.T[name], 0.0) * 0.8
                row |= {f"T_{name}": self.T[name], f"valve_{name}": valve}
            row["P"] = sum(heat_W.values()) / cop(flow, out)
            self.rows.append(row)
            for name in ROOMS:
                gain_W = heat_W[name] - LOSS_W_K[name] * (self.T[name] - out)
                self.T[name] += part_s / HOUR_S * gain_W / CAPACITY_WH_K[name]
            self.at += pd.Timedelta(seconds=part_s)

    def measurements(self) -> pd.DataFrame:
        last = {"time": self.at, "out": self.rows[-1]["out"], "sun": 0.0}
        return pd.DataFrame([*self.rows, last | {f"T_{name}": self.T[name] for name in ROOMS}])

    def forecast(self) -> pd.DataFrame:
        index = pd.date_range(self.at.floor("1h"), periods=49, freq="1h", name="time")
        return pd.DataFrame({"out": self.out_C(index), "sun": 0.0, "price": [price(at) for at in index]}, index=index)

    def write(self, levels, seconds) -> None:
        assert set(levels) == {"heat_pump"}
        self.told = levels["heat_pump"]
        self.written.append((self.at, self.told))

    def close(self) -> None:
        """Nothing is open."""


def curve_model(home: HomeByCurve) -> ThermalModel:
    """The rooms' exact effects at hourly steps, for levels as the map makes them; power at the usual flow."""
    table = home.measurements().set_index("time").resample("1h").mean()
    pairs, full_W = [], []
    for name in ROOMS:
        over_K = float(np.nanpercentile(np.maximum(table["flow"] - table[f"T_{name}"], 0.0), 99.0))
        full_W.append(0.8 * EMITTER_W_K[name] * over_K)
        pole = float(np.exp(-LOSS_W_K[name] / CAPACITY_WH_K[name]))
        gain = (1.0 - pole) * full_W[-1] / LOSS_W_K[name]
        pairs.append(linear_operator(np.array([pole]), np.array([gain]), step_s=HOUR_S))
    operator = BuildingOperator(ROOMS, ROOMS, ((pairs[0], None), (None, pairs[1])), (0, 1))
    per_u_W = sum(full_W) / cop(float(table["flow"].mean()), float(table["out"].mean()))
    power = PowerModel(MachineLoad((0.0, 0.0, per_u_W, 0.0), (-20.0, 30.0), lowest_level=1.0))
    shares = tuple(one / sum(full_W) for one in full_W)
    return ThermalModel(operator, (power,), (None,) * 2, (ModelCard(),) * 2, ("heat_pump",), (0, 0), shares)
