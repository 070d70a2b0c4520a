"""Trials of live control: torn tables, wrong clocks, a second controller, and what fails around a house that runs."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from controllers import MPCConfig, ThermoForceMPC
from thermoforce_mpc.errors import PlantError, ThermoForceError
from thermoforce_mpc.live import Decision, KeptState, LiveBuilding, control, real_run
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.parameters import linear_operator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.records.live_journal import LiveJournal

# A house of one room: share of its distance to the outdoor temperature kept in an hour, K per hour at full level, W.
_POLE, _GAIN_K, _POWER_W, _OUT_C = 0.99, 0.4, 4300.0, 3.0
_STEPS, _TROUBLED, _MINUTE_S, _HOUR_S = 10, (2, 7), 60.0, 3600.0
_MAP: dict[str, Any] = {
    "time": {"zone": "UTC"},
    "step": "1h",
    "outdoor": "out",
    "zones": {"zone": {"temperature": "T", "lower": "low", "upper": "high", "floor_area_m2": 100.0}},
    "actuators": {"actuator": {"level": "u"}},
    "machines": {"machine": {"power": "P", "price": 0.25}},
}
# What acts where the model does.
_PLANNED = ("solved", "bridged")
# Longest time without a word, s, less what a busy machine kept from the process.
MOST_SILENT_S = 10.0
# Longest time until a first controller has set its levels, and until a second one is refused, s.
_START_S, _REFUSED_S = 120.0, 40.0


class Silence:
    """The longest time without a word, s: by the clock, less the time in which threads were kept waiting for a core."""

    def __init__(self) -> None:
        self.longest_s, self._last = 0.0, self._now()

    def word(self) -> None:
        """Something is said."""
        now = self._now()
        clock_s, waited_s, computed_s = (after - before for after, before in zip(now, self._last, strict=True))
        self.longest_s, self._last = max(self.longest_s, min(clock_s, max(clock_s - waited_s, computed_s))), now

    @staticmethod
    def _now() -> tuple[float, float, float]:
        waited_ns = 0
        for task in os.listdir("/proc/self/task"):  # a service has two hundred threads: a path each would cost 20 ms
            with suppress(OSError), open(f"/proc/self/task/{task}/schedstat") as told:  # one may have ended meanwhile
                waited_ns += int(told.read().split()[1])
        return time.perf_counter(), waited_ns / 1e9, time.process_time()


def one_room_model() -> ThermalModel:
    """The exact model of the house."""
    power = PowerModel(MachineLoad((0.0, 0.0, _POWER_W, 0.0), (-20.0, 30.0), lowest_level=1.0))
    operator = linear_operator(np.array([_POLE]), np.array([_GAIN_K]), step_s=_HOUR_S)
    return ThermalModel.single(operator, power)


class _House:
    """The house as a connection and a clock of its own, with a table of readings that somebody else writes.

    `spoils(table, text)`: writes `text` of the table to the file `table`, or what is to be read in its place.
    `clock`: how far its stamps are ahead at an hour of the run, s.
    """

    def __init__(
        self, folder: Path, spoils: Callable[[Path, str], None] | None, clock_s: Callable[[float], float]
    ) -> None:
        self._table, self._spoils, self._clock_s = folder / "house.csv", spoils, clock_s
        self._at = self._begin = pd.Timestamp("2025-01-12", tz="UTC")
        self._at -= pd.Timedelta(days=2)
        self._T_C, self._rows = 21.0, list[dict[str, Any]]()
        self._level: float | None = 0.5
        self.written: list[float | None] = []
        self.wait_until(self._begin)

    @property
    def hour(self) -> float:
        """Hours of the run."""
        return float((self._at - self._begin) / pd.Timedelta("1h"))

    def now(self) -> pd.Timestamp:
        """See `Clock.now`."""
        return self._at

    def wait_until(self, at: pd.Timestamp) -> None:
        """See `Clock.wait_until`: the house lives, a row a minute."""
        while (left_s := (at - self._at).total_seconds()) > 1e-6:
            part_s = min(_MINUTE_S, left_s)
            hours, u = part_s / _HOUR_S, 0.5 if self._level is None else self._level
            stamp = self._at + pd.Timedelta(seconds=self._clock_s(self.hour))
            self._rows.append({"time": stamp, **self._bounds, "T": self._T_C, "u": u, "P": u * _POWER_W})
            self._T_C = _OUT_C + (self._T_C - _OUT_C) * _POLE**hours + _GAIN_K * hours * u
            self._at += pd.Timedelta(seconds=part_s)

    _bounds: Mapping[str, float] = {"out": _OUT_C, "low": 20.0, "high": 24.0}

    def measurements(self) -> str:
        """See `Connection.measurements`."""
        text = pd.DataFrame(self._rows).to_csv(index=False)
        if self._spoils is not None and _TROUBLED[0] <= self.hour < _TROUBLED[1]:
            self._spoils(self._table, text)
        else:
            self._table.write_text(text)
        return str(self._table)

    def forecast(self) -> pd.DataFrame:
        """See `Connection.forecast`."""
        index = pd.date_range(self._at.floor("1h"), periods=25, freq="1h", name="time")
        return pd.DataFrame(dict(self._bounds), index=index)

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`."""
        (self._level,) = levels.values()
        self.written.append(self._level)

    def close(self) -> None:
        """Nothing is open."""


class _Killed(BaseException):
    """Nothing after it runs, as after SIGKILL."""


class _TroubledHouse(_House):
    """The house with faults around it, each from an hour of the run to another; see `live_faults`.

    What it was told ends with its time, as with a gateway that looks after it: then its own control acts.
    """

    def __init__(self, folder: Path, faults: Mapping[str, tuple[float, float]]) -> None:
        self._faults, self._ends, self.is_dead = dict(faults), math.inf, False
        super().__init__(folder, self._tear, lambda hour: 0.0)

    def _is(self, fault: str) -> bool:
        begin, end = self._faults.get(fault, (math.inf, math.inf))
        return begin <= self.hour < end

    def _tear(self, table: Path, text: str) -> None:
        table.write_text(text[: -len(text) // 3] if self._is("torn") else text)

    def now(self) -> pd.Timestamp:
        """See `Clock.now`: a clock that is stepped is so from then on."""
        step_s = self._faults.get("clock stepped back", (math.inf, 0.0))
        return self._at - pd.Timedelta("1min") if self.hour >= step_s[0] else self._at

    def wait_until(self, at: pd.Timestamp) -> None:
        """See `Clock.wait_until`."""
        if self.is_dead:
            raise _Killed
        while self._at < at:
            if self.hour >= self._ends:
                self._level, self._ends = None, math.inf
            super().wait_until(min(at, self._at + pd.Timedelta("1min")))
            if self._is("killed"):
                begin, _ = self._faults["killed"]
                self.is_dead = True
                raise _Killed(begin)

    @property
    def is_reached(self) -> bool:
        """Whether anything comes from the house now."""
        return not (self._is("network cut") or self._is("broker restarted"))

    def starts_again(self) -> None:
        """Somebody starts the process again."""
        self.is_dead = False
        self._faults.pop("killed")

    def measurements(self) -> str:
        """See `Connection.measurements`."""
        if not self.is_reached:
            raise ConnectionError("no route to the house")
        if self._is("unavailable"):
            table = pd.DataFrame(self._rows)
            since = self._begin + pd.Timedelta(hours=self._faults["unavailable"][0])
            table.loc[table["time"] >= since, ["T", "u"]] = np.nan
            self._table.write_text(table.to_csv(index=False))
            return str(self._table)
        return super().measurements()

    def write(self, levels: Mapping[str, float | None], seconds: float) -> None:
        """See `Connection.write`."""
        if self.is_dead:
            raise _Killed
        if not self.is_reached:
            raise ConnectionError("no route to the house")
        super().write(levels, seconds)
        self._ends = math.inf if self._level is None else self.hour + seconds / _HOUR_S


def live_faults(rng: np.random.Generator, folder: Path) -> list[str]:
    """Two or three of: an hour without network or readings, a broker away for minutes, a torn table, a clock that is
    stepped by a minute, a killed process that is started again.

    The house's own control acts meanwhile, and plans do again within an hour after.
    """
    run = folder / f"faults{rng.integers(10**9)}"
    run.mkdir()
    kinds = ["network cut", "unavailable", "broker restarted", "torn", "clock stepped back", "killed"]
    chosen = rng.choice(kinds, int(rng.integers(2, 4)), replace=False).tolist()
    begins = np.sort(rng.uniform(*_TROUBLED, len(chosen)))
    faults = {
        str(kind): (float(at), float(at) + (0.1 if kind == "broker restarted" else 1.0))
        for kind, at in zip(chosen, begins, strict=True)
    }
    house, said = _TroubledHouse(run, faults), ", ".join(chosen)
    with suppress(_Killed, PlantError):  # of a killed one no word comes
        found = _controlled(house, run)
        if not house.is_dead:
            return [f"{said}: {fault}" for fault in found]
    # The house goes on by itself until somebody starts it again.
    house.starts_again()
    house.wait_until(house.now() + pd.Timedelta(minutes=float(rng.uniform(5.0, 60.0))))
    while not house.is_reached:  # one that cannot begin ends, and is started again
        house.wait_until(house.now() + pd.Timedelta("5min"))
    return [f"{said}: {fault}" for fault in _controlled(house, run, _STEPS - math.floor(house.hour))]


def _controlled(house: _House, folder: Path | None = None, steps: int = _STEPS) -> list[str]:
    """What must not be of a live run: a wrong level, a step without a decision, silence, an error without a name.

    `folder`: where the controller's state and a journal are kept; then the last steps must be planned again.
    """
    silence, told = Silence(), list[Decision]()

    def hear(decision: Decision) -> None:
        silence.word()
        told.append(decision)

    off = {"enabled": False}
    config = MPCConfig.model_validate(
        {"step_s": _HOUR_S, "horizon_h": 12.0, "free_response": {"name": "persistence"}, "gate": off}
    )
    building = LiveBuilding(house, MeasurementMap.model_validate(_MAP), _HOUR_S)
    faults = []
    controller = ThermoForceMPC(one_room_model(), config)
    kept, journal = None, None
    if folder is not None:
        kept, of = KeptState(folder / "state.npz", "chaos"), MeasurementMap.model_validate(_MAP)
        journal = LiveJournal(folder, real_run(folder, None, Path("map.yaml"), of, config, "chaos"))
    try:
        control(building, controller, clock=house, steps=steps, told=hear, kept=kept, journal=journal)
    except ThermoForceError as error:
        faults.append(f"ended with {type(error).__name__}: {error}")
    wrong = [u for u in house.written if u is not None and not (math.isfinite(u) and 0.0 <= u <= 1.0)]
    faults += [f"a level of {wrong[0]!r} was sent"] if wrong else []
    faults += [] if len(told) == steps else [f"{len(told)} of {steps} decisions were made: a step is lost"]
    if folder is not None and any(decision.plan.status not in _PLANNED for decision in told[-2:]):
        faults.append(f"ended with {told[-1].plan.status}: {told[-1].plan.why}")
    faults += [] if house.written and house.written[-1] is None else ["the building was not given back"]
    return faults + ([f"silent for {silence.longest_s:.0f} s"] if silence.longest_s > MOST_SILENT_S else [])


def torn_table(rng: np.random.Generator, folder: Path) -> list[str]:
    """For hours the table is cut in a line, empty, gone, has NUL bytes, words, a second header or old rows again."""
    run = folder / f"torn{rng.integers(10**9)}"
    run.mkdir()

    def spoil(table: Path, text: str) -> None:
        kind = str(rng.choice(["cut", "empty", "gone", "nul", "words", "header", "again", "comma", "bytes"]))
        at, lines = int(rng.integers(1, len(text))), text.splitlines(keepends=True)
        line = int(rng.integers(1, len(lines)))
        table.write_bytes(
            {
                "cut": text[:at],
                "empty": "",
                "gone": "",
                "nul": text[:-2] + "\0" * 40,
                "words": "".join([*lines[:line], lines[line].replace("21", "twenty"), *lines[line + 1 :]]),
                "header": "".join([*lines, *lines]),
                "again": "".join([*lines, *lines[-line:]]),
                "comma": text.replace(".", ",", at % 40),
                "bytes": text[:at] + "\ufffd" + text[at:],
            }[kind].encode()
            + (b"\xff\xfe" if kind == "bytes" else b"")
        )
        if kind == "gone":
            table.unlink()

    return _controlled(_House(run, spoil, lambda hour: 0.0))


def wrong_wall_clock(rng: np.random.Generator, folder: Path) -> list[str]:
    """For hours the stamps of the readings are ahead, behind, of another zone, jump back, or stand."""
    run, ahead_s = folder / f"clock{rng.integers(10**9)}", float(rng.choice([-7200, -3600, -90, 20, 90, 1800, 3600]))
    run.mkdir()
    stands = rng.random() < 0.2

    def clock_s(hour: float) -> float:
        if not _TROUBLED[0] <= hour < _TROUBLED[1]:
            return 0.0
        return -_HOUR_S * (hour - _TROUBLED[0]) if stands else ahead_s

    return _controlled(_House(run, None, clock_s))


def two_controllers(rng: np.random.Generator, folder: Path) -> list[str]:
    """A second `tf-mpc control` of the same house is refused with a word, and leaves it to the first."""
    run = folder / f"two{rng.integers(10**9)}"
    run.mkdir()
    one_room_model().save(run / "model")
    now = pd.Timestamp.now(tz="UTC").floor("1min")
    past = pd.date_range(now - pd.Timedelta(days=2), now, freq="1min", name="time")
    ahead = pd.date_range(now.floor("1h"), periods=40, freq="1h", name="time")

    def table(index: pd.DatetimeIndex, **more: float) -> pd.DataFrame:
        outdoor_C = _OUT_C + np.sin(index.hour.to_numpy())  # what never changes is taken as stuck
        return pd.DataFrame({"out": outdoor_C, "low": 20.0, "high": 24.0, **more}, index=index)

    table(past, T=21.0, u=0.5, P=0.5 * _POWER_W).to_csv(run / "house.csv")
    table(ahead).to_csv(run / "tomorrow.csv")
    (run / "map.yaml").write_text(yaml.safe_dump(_MAP))
    words = ["control", "--model", "model", "--map", "map.yaml", "--set", "controller.gate.enabled=false"]
    words += ["--set", "controller.free_response.name=persistence", "--set", "controller.horizon_h=12"]
    begin = [sys.executable, "-m", "thermoforce_mpc", *words]
    levels, faults = run / "levels.json", list[str]()
    with (run / "first.txt").open("w") as said:
        first = subprocess.Popen([*begin, "--out", "first"], cwd=run, stdout=said, stderr=said)
        try:
            until = time.monotonic() + _START_S
            while not levels.exists() and first.poll() is None and time.monotonic() < until:
                time.sleep(0.1)
            if not levels.exists():
                return [f"ended with {(run / 'first.txt').read_text()[-500:]}"]
            before = levels.read_bytes()
            try:
                second = subprocess.run(
                    [*begin, "--out", "second", "--steps", "1"],
                    cwd=run, capture_output=True, text=True, timeout=_REFUSED_S, check=False,
                )  # fmt: skip
                refused, said_of = second.returncode != 0, second.stderr
            except subprocess.TimeoutExpired:
                refused, said_of = False, ""
            if not refused or levels.read_bytes() != before:
                faults.append("two controllers set one house: what a second one decided was sent")
            elif "Traceback" in said_of:
                faults.append(f"ended with {said_of[-500:]}")
        finally:
            first.terminate()
            first.wait(_START_S)
    return faults
