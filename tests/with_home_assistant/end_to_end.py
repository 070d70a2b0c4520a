"""A house behind a real Home Assistant core, at speed: against the same without one between; core killed, sensor gone.

    python tests/with_home_assistant/end_to_end.py [--folder /tmp/ha] [--hours 48]

The house's clock jumps; the core's does not: what it stored when is put into the house's time.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUPPORT = ROOT / "tests" / "support"
sys.path[:0] = [str(ROOT), str(SUPPORT / "buildings"), str(SUPPORT / "services"), str(Path(__file__).parent)]

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402
import requests  # noqa: E402
from connected_home import (  # noqa: E402
    HOUR,
    SENSORS,
    START,
    TimedHome,
    at_hours,
    check_commands,
    controlled,
    in_process,
    rules_of,
    same_as,
)
from core import Core, running_core  # noqa: E402

from thermoforce_mpc.connections.registry import build_connection  # noqa: E402

COLUMNS = {
    "T": "sensor.room_temperature", "out": "input_number.outdoor", "P": "input_number.power", "u": "input_number.level",
    "set": "climate.hall.temperature",
}  # fmt: skip
HELPERS = {"out": "outdoor", "P": "power", "u": "level", "T": "room"}
# Between two rows of the house, s: longer than between two rows of the table, so that one shows what came of it.
ROW_S, EVERY_S = 0.06, 0.05


class CoreHome:
    """The house as sensors and a thermostat of the core, and the connection to it in the house's time."""

    def __init__(self, core: Core) -> None:
        self.core, self.home = core, TimedHome()
        os.environ["HOME_ASSISTANT_TOKEN"] = core.token
        hall = {"actuator": {"entity": "climate.hall", "release": 20.0}}
        # Half an hour of the core's time is more than it runs.
        self.connection = build_connection(
            "home-assistant", {"url": core.url, "actuators": hall, "days": 0.02, "every_s": EVERY_S}
        )
        self._read, self.connection.measurements = self.connection.measurements, self._measurements
        self._write, self.connection.write = self.connection.write, self._set
        self.connection.forecast = self.home.forecast
        self._before = pd.DataFrame(self.home.rows).set_index("time")[list(SENSORS)]
        self._pairs: list[tuple[float, pd.Timestamp]] = []
        self.events = lambda row: None
        self._publish({"time": START, **{name: self.home.rows[-1][name] for name in SENSORS}})
        self.home.on_row = self._row

    def _row(self, row) -> None:
        self.events(row)
        self._publish(row)

    def _publish(self, row) -> None:
        begun = time.time()
        self._pairs.append((begun, row["time"]))
        for name, helper in HELPERS.items():
            if name in row:
                try:
                    self.core.call("input_number.set_value", entity_id=f"input_number.{helper}", value=float(row[name]))
                except requests.RequestException:
                    return  # the core is away
        time.sleep(ROW_S)

    def _measurements(self) -> pd.DataFrame:
        self._publish({"time": self.home.at, "T": self.home.T, "out": self.home.rows[-1]["out"]})
        table = self._read()
        wall = np.asarray(table.index.as_unit("ns").asi8, dtype=np.float64) / 1e9
        sent, sim = np.array([w for w, _ in self._pairs]), pd.DatetimeIndex([t for _, t in self._pairs])
        # What the core held when the next row of the house came: a state is there some ms after it was sent, which at
        # this speed are minutes of the house (by interpolated stamps its hourly levels were wrong by up to 0.1, and
        # the plans others).
        last = np.searchsorted(wall, np.append(sent[1:], np.inf)) - 1
        table = table.iloc[last].set_axis(sim, axis=0)[wall[last] >= sent]
        present = table.iloc[-1].copy()
        present[COLUMNS["T"]] = self.home.T if np.isfinite(present[COLUMNS["T"]]) else np.nan
        now = pd.DataFrame([present.to_dict()], index=pd.DatetimeIndex([self.home.at]))
        whole = pd.concat([self._before.rename(columns=COLUMNS), table, now])
        whole = whole[~whole.index.duplicated(keep="last")].sort_index()
        # As the logger of a house: a row for each time that it was read.
        return whole.groupby(whole.index.floor("1min")).last().rename_axis("time").reset_index()

    def _set(self, levels, seconds) -> None:
        """What the thermostat holds afterwards is what the house follows."""
        try:
            self._write(levels, seconds)
        finally:
            try:
                held = float(self.core.state("climate.hall")["attributes"]["temperature"])
            except (requests.RequestException, KeyError, TypeError):
                held = None
            (wanted,) = levels.values()
            if held is not None:
                ends = self.home.at + pd.Timedelta(seconds=seconds)
                self.home.set_by(None if wanted is None else held, None if wanted is None else ends)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("/tmp/ha"))
    parser.add_argument("--hours", type=int, default=48)
    options = parser.parse_args()
    failed = 0
    usual, plain = in_process(options.hours)
    alone = TimedHome()
    alone.wait_until(START + options.hours * HOUR)
    with running_core(options.folder) as core:
        house = CoreHome(core)
        decisions = controlled(house.home, house.connection, rules_of(COLUMNS), options.hours)
        solved = sum(one.plan.status == "solved" for one in decisions)
        dearer, discomfort = same_as(house.home, usual)
        own = alone.scores()[0]
        print(
            f"{options.hours} h: cost {house.home.scores()[0]:.2f} behind the core, {usual.scores()[0]:.2f} without, "
            f"{own:.2f} by its own control; discomfort {discomfort:+.2f} K·h; {solved} of {len(decisions)} solved, "
            f"{sum(one.plan.status == 'solved' for one in plain)} without",
            flush=True,
        )
        check_commands(house.home)
        failed += not (abs(dearer) < 0.02 and abs(discomfort) < 0.2)
    with running_core(options.folder) as core:
        house = CoreHome(core)

        def there(on: bool) -> None:
            core.call(f"input_boolean.turn_{'on' if on else 'off'}", entity_id="input_boolean.there")

        house.events = at_hours(
            {
                4.2: lambda: core.stop(signal.SIGKILL),
                6.2: core.start,
                10.2: lambda: there(False),
                12.2: lambda: there(True),
            }
        )
        decisions = controlled(house.home, house.connection, rules_of(COLUMNS), 20)
        print("core killed for 2 h, sensor and thermostat gone for 2 h:", [one.plan.status.value for one in decisions])
        check_commands(house.home)
        failed += not all(one.plan.status == "solved" for one in decisions[-3:])
        failed += core.state("climate.hall")["attributes"]["temperature"] != 20.0
    print(f"{2 - bool(failed)} passed, {int(bool(failed))} failed")
    raise SystemExit(bool(failed))


if __name__ == "__main__":
    main()
