"""A simulated house behind a `Connection`, with a clock of its own: waiting lets it live, a row a minute."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import yaml
from simple_house import SimpleHouse, outdoor_C, power_W, simple_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.data import DAY_S, HOUR_S

START = pd.Timestamp("2025-01-12", tz="UTC")
RULES = {
    "time": {"zone": "UTC"},
    "step": "1h",
    "outdoor": "out",
    "sun": "sun",
    "zones": {"zone": {"temperature": "T", "lower": "low", "upper": "high", "floor_area_m2": 100.0}},
    "actuators": {"actuator": {"level": "u"}},
    "machines": {"machine": {"power": "P", "price": 0.25}},
}


def mpc(**options) -> ThermoForceMPC:
    """A controller of that house, without gate, guard and watch."""
    off = {"enabled": False}
    base = {"step_s": 3600.0, "horizon_h": 12.0, "free_response": {"name": "persistence"}}
    base |= {"gate": off, "guard": off, "watch": off}
    return ThermoForceMPC(simple_model(), MPCConfig.model_validate(base | options))


def files_of_now(folder: Path) -> None:
    """The files of the connection `files` in `folder`, up to this hour, with `map.yaml` and `model`."""
    house = SimulatedBuilding()
    shift = pd.Timestamp.now("UTC").floor("1h") - START
    house.measurements().assign(time=lambda table: table["time"] + shift).to_csv(folder / "house.csv", index=False)
    house.forecast().shift(freq=shift).to_csv(folder / "tomorrow.csv")
    (folder / "map.yaml").write_text(yaml.safe_dump(RULES))
    simple_model().save(folder / "model")


class SimulatedBuilding:
    """`Connection` and `Clock`. `failing` is asked before every answer and raises what it likes."""

    def __init__(self, failing=lambda what, now: None) -> None:
        self.house, self.failing = SimpleHouse(), failing
        self.house.reset(0.0, 0.0)
        self.at, self.level, self.rows, self.written, self.closed = START, None, [], [], False
        self.at -= pd.Timedelta(days=3)
        self.house.now_s = (self.at - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds()
        self.wait_until(START)
        self.begun = len(self.rows)

    def now(self) -> pd.Timestamp:
        return self.at

    def wait_until(self, at: pd.Timestamp) -> None:
        while (left_s := (at - self.at).total_seconds()) > 1e-6:
            part_s = min(60.0, left_s)
            row = self._present()
            level = self.house.live(self.level, part_s)
            self.rows.append(row | {"u": level, "P": power_W(level), "low": 20.0, "high": 24.0})
            self.at += pd.Timedelta(seconds=part_s)

    def measurements(self) -> pd.DataFrame:
        self.failing("measurements", self.at)
        return pd.DataFrame([*self.rows[-4 * 1440 :], self._present()])

    def _present(self):
        return {"time": self.at, "T": self.house.T, "out": float(outdoor_C(self.house.now_s)), "sun": 0.0}

    def forecast(self) -> pd.DataFrame:
        self.failing("forecast", self.at)
        begin = self.at.floor("1h")
        b = self.house.forecast(DAY_S, HOUR_S)
        index = pd.date_range(begin, periods=b.n_steps + 1, freq="1h", name="time")
        return pd.DataFrame({"out": b.T_out_C, "sun": 0.0, "low": 20.0, "high": 24.0}, index=index)

    def write(self, levels, seconds) -> None:
        self.failing("write", self.at)
        self.written.append((self.at, dict(levels), seconds))
        (self.level,) = levels.values()

    def close(self) -> None:
        self.closed = True
