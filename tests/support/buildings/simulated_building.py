"""A simulated house behind a `Connection`, with a clock of its own: waiting lets it live, a row a minute."""

from __future__ import annotations

import copy
import functools
from pathlib import Path

import pandas as pd
import simple_house
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
    for name, text in _tables_of(pd.Timestamp.now("UTC").floor("1h")).items():
        (folder / name).write_text(text)
    (folder / "map.yaml").write_text(yaml.safe_dump(RULES))
    simple_model().save(folder / "model")


@functools.cache
def _tables_of(hour: pd.Timestamp) -> dict[str, str]:
    house, shift = SimulatedBuilding(), hour - START
    measured = house.measurements().assign(time=lambda table: table["time"] + shift)
    return {"house.csv": measured.to_csv(index=False), "tomorrow.csv": house.forecast().shift(freq=shift).to_csv()}


def _present(house: SimpleHouse, at: pd.Timestamp) -> dict:
    return {"time": at, "T": house.T, "out": float(outdoor_C(house.now_s)), "sun": 0.0}


def _lived(house: SimpleHouse, at: pd.Timestamp, level: float | None, part_s: float) -> dict:
    row, level = _present(house, at), house.live(level, part_s)
    return row | {"u": level, "P": power_W(level), "low": 20.0, "high": 24.0}


@functools.cache
def _three_days(native_level) -> tuple[SimpleHouse, list[dict], pd.DataFrame]:
    """The house at `START` after three days under `native_level`, which stands in `simple_house`; its rows, a table."""
    house, at, rows = SimpleHouse(), START - pd.Timedelta(days=3), []
    house.reset(0.0, 0.0)
    house.now_s = (at - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds()
    while at < START:
        rows.append(_lived(house, at, None, 60.0))
        at += pd.Timedelta(seconds=60.0)
    return house, rows, pd.DataFrame(rows)


class SimulatedBuilding:
    """`Connection` and `Clock`. `failing` is asked before every answer and raises what it likes."""

    def __init__(self, failing=lambda what, now: None) -> None:
        house, rows, self._before = _three_days(simple_house.native_level)
        self.house, self.rows, self.failing = copy.copy(house), list(rows), failing
        self.at, self.level, self.begun, self.written, self.closed = START, None, len(rows), [], False

    def now(self) -> pd.Timestamp:
        return self.at

    def wait_until(self, at: pd.Timestamp) -> None:
        while (left_s := (at - self.at).total_seconds()) > 1e-6:
            part_s = min(60.0, left_s)
            self.rows.append(_lived(self.house, self.at, self.level, part_s))
            self.at += pd.Timedelta(seconds=part_s)

    def measurements(self) -> pd.DataFrame:
        self.failing("measurements", self.at)
        since = pd.DataFrame([*self.rows[self.begun :], _present(self.house, self.at)])
        return pd.concat([self._before, since], ignore_index=True).iloc[-4 * 1440 - 1 :].reset_index(drop=True)

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
