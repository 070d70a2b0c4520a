"""What a running controller does now, read from its journal as it grows: for `tf-mpc watch`."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from boptest_client import safe_text
from thermoforce_mpc.commands.tank import tank_in_words
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Measurement, Record, energy_kWh
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.clock import words_of
from thermoforce_mpc.data.superposition import compose
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.files import check_plain, plain_json
from thermoforce_mpc.loop.closed_loop import in_force, with_level
from thermoforce_mpc.loop.inputs import holes, price_paid
from thermoforce_mpc.model.forecast_gaps import completed
from thermoforce_mpc.records.journal import (
    FORMAT,
    NAME,
    JournalEntry,
    JournalError,
    JournalTail,
    making_sense,
    planned_of,
    tank_of,
)
from thermoforce_mpc.records.run_folder import LOCK, in_use, is_complete
from thermoforce_mpc.records.told_steps import StepReader, ToldBuilding, ToldStep, told_building

# Past shown, and steps of it at most.
_PAST_H, _MOST_POINTS = 24.0, 288
# Records read at once: a journal of a year is 150 MB, and several times that in memory.
_AT_ONCE = 500


@dataclass(frozen=True)
class ZoneNow:
    """A zone now: its temperature and comfort bounds, °C (NaN: not known)."""

    name: str
    T_C: float
    lower_C: float
    upper_C: float

    @property
    def outside_K(self) -> float:
        """Distance from the comfort bounds, K; 0 without a reading, NaN without bounds."""
        return 0.0 if np.isnan(self.T_C) else float(excess(self.T_C, self.lower_C, self.upper_C))


@dataclass(frozen=True)
class WatchPoint:
    """One step for the picture: its end, temperatures (Z,) and bounds there, °C, and mean levels in it (A,)."""

    time_s: float
    T_C: tuple[float, ...]
    lower_C: tuple[float, ...]
    upper_C: tuple[float, ...]
    u: tuple[float, ...]


@dataclass(frozen=True)
class TankPoint:
    """A tank of hot water at an instant: its temperature, °C, that it has on nine of ten days, and what is wanted."""

    time_s: float
    T_C: float
    low_C: float
    lower_C: float


@dataclass(frozen=True)
class TankNow:
    """A tank of hot water: its temperature now, °C, and what is set at it (NaN: not known, left to its device).

    `said`: what the plan makes of it; `past` and `plan` by step.
    """

    T_C: float
    told: float
    said: str
    past: tuple[TankPoint, ...]
    plan: tuple[TankPoint, ...]


@dataclass(frozen=True)
class RunView:
    """A run at an instant.

    `state`: running, finished, ended, or ended early, and `said` why; `at`: `time_s` for people; `origin`, `zone`: from
    when the seconds of a real building count, and on which clock, '' of a simulated one; `levels`: mean level
    of each actuator in the step under way, NaN under its own control; `cost` by metered power and prices in force
    (currency), `energy_kWh` and `discomfort_Kh` (mean over zones) since the begin of the loop, NaN where no power was
    metered yet, or prices or bounds are not known; `counts`: steps by status; `past` and `plan` by step, `until`: the
    ends of the steps of the plan for people; `hot_water`: the tank that is planned, None without one.
    """

    run: str
    testcase: str
    controller: str
    state: str
    said: str
    time_s: float
    at: str
    origin: str
    zone: str
    days: float
    days_in_all: float
    outdoor_C: float
    zones: tuple[ZoneNow, ...]
    actuators: tuple[str, ...]
    levels: tuple[float, ...]
    status: str
    acting: tuple[str, ...]
    why: str
    notes: tuple[str, ...]
    cost: float
    energy_kWh: float
    discomfort_Kh: float
    counts: Mapping[str, int]
    past: tuple[WatchPoint, ...]
    plan: tuple[WatchPoint, ...]
    until: tuple[str, ...]
    hot_water: TankNow | None = None

    def to_json(self) -> dict[str, Any]:
        """All of it in JSON types; null where a number is not known."""
        return dict(plain_json(asdict(self)))


class LiveRun:
    """Follows the journal of a run in its folder; it writes nothing there.

    `controller`: whose loop, by default the latest; of a run that has finished the first, the baselines come later.

    Raises:
        JournalError: there is no journal, it is damaged, or of another format.
        ConfigError: there is a link in the folder.
    """

    def __init__(self, folder: Path, controller: str | None = None) -> None:
        check_plain(folder)
        self._folder, self._wanted = folder, controller
        self._latest = not is_complete(folder)
        self._tail = JournalTail(folder / NAME)
        self._scenario: Mapping[str, Any] = {}
        self._loops: list[str] = []
        self._head: Mapping[str, Any] = {}
        self._building: ToldBuilding | None = None
        self._ended = ""
        self._begin("")

    def _begin(self, controller: str) -> None:
        self._controller, self._steps = controller, StepReader()
        self._last: ToldStep | None = None
        self._start_s = float("nan")
        self._cost, self._kWh, self._Kh = 0.0, 0.0, 0.0
        self._metered = False
        self._counts: Counter[str] = Counter()
        self._past: deque[WatchPoint] = deque(maxlen=_MOST_POINTS)
        self._tank: deque[TankPoint] = deque(maxlen=_MOST_POINTS)
        self._boundary: Boundary | None = None

    def now(self) -> RunView:
        """What is known now.

        Raises:
            JournalError, InputError: the journal is damaged, or has no step yet, or not of the controller asked for.
        """
        with making_sense(self._folder / NAME):
            while entries := self._tail.more(_AT_ONCE):
                for entry in entries:
                    self._take(entry)
            if step := self._steps.under_way or self._last:
                return self._view(step)
            if self._wanted and self._loops and self._wanted not in self._loops:
                raise InputError(f"--controller {self._wanted}: did not run yet; there are {', '.join(self._loops)}")
            raise JournalError(f"{self._folder / NAME}: no step was decided yet")

    def _take(self, entry: JournalEntry) -> None:
        if entry.kind == "run":
            if entry.content.get("format") != FORMAT:
                raise JournalError(f"{entry.path}: is not of format {FORMAT}, which this release reads")
            self._scenario, self._head = entry.content["scenario"], entry.content
        if entry.kind in ("begun", "ended"):
            self._ended = str(entry.content["why"]) if entry.kind == "ended" else ""
        if entry.kind == "loop":
            self._loops.append(safe_text(entry.content["controller"]))
            if self._wanted == self._loops[-1] or (self._wanted is None and (self._latest or len(self._loops) == 1)):
                self._begin(self._loops[-1])
        if not self._loops or self._loops[-1] != self._controller:
            return
        step = self._steps.read(entry)
        if entry.kind == "reset" and self._steps.before is not None:
            self._start_s = self._steps.before.time_s
        if step is not None:
            self._add(step)

    def _add(self, step: ToldStep) -> None:
        """Count a step that has ended."""
        self._last = step
        if (tank := tank_of(step.told)) is not None:
            self._tank.append(TankPoint(step.time_s, tank.T_now_C, np.nan, np.nan))
        self._counts[str(step.told["status"])] += 1
        self._boundary = self._forecast(step)
        start_s, levels = step.time_s, []
        for block, reported in zip(step.blocks, step.after, strict=True):
            reading = with_level(reported, block)
            seconds = reading.time_s - start_s
            hours = seconds / HOUR_S
            self._metered |= bool(np.isfinite(reading.power_W).any())
            kWh = energy_kWh(np.nan_to_num(reading.power_W), seconds)
            self._kWh += float(kWh.sum())
            if self._boundary is not None:
                paid = kWh * self._price(self._boundary, start_s, reading.u)
                self._cost += float(paid[kWh != 0.0].sum())
            zones = self._zones(reading)
            self._Kh += float(np.mean([zone.outside_K for zone in zones])) * hours
            levels.append((hours, reading.u))
            start_s = reading.time_s
        if step.after:
            u = np.average([u for _, u in levels], axis=0, weights=[h or 1e-9 for h, _ in levels])
            T_C, lower_C, upper_C = zip(*((zone.T_C, zone.lower_C, zone.upper_C) for zone in zones), strict=True)
            self._past.append(WatchPoint(start_s, T_C, lower_C, upper_C, tuple(u.tolist())))

    def _forecast(self, step: ToldStep) -> Boundary | None:
        """The forecast of a step; prices and bounds that it lacks are filled as in the run."""
        forecast = step.given
        if forecast is None or step.before is None or not holes(forecast):
            return forecast or self._boundary
        return completed(forecast, Record.beginning(step.before), self._boundary)[0]

    def _price(self, boundary: Boundary, time_s: float, u: Array) -> Array:
        """Price of each machine's energy (M,) at levels `u` (A,)."""
        i = in_force(boundary, time_s)
        price, heating = boundary.price_per_kWh[:, [i]], boundary.heating_price_per_kWh[:, [i]]
        if np.array_equal(price, heating):
            return price[:, 0]
        return price_paid(u[:, None], price, heating, self._told().layout)[:, 0]

    def _told(self) -> ToldBuilding:
        """The building, found out where it is asked for."""
        if self._building is None:
            self._building = told_building(self._head)
        return self._building

    def _zones(self, at: Measurement) -> tuple[ZoneNow, ...]:
        lower = upper = np.full(len(at.names.zones), np.nan)
        if (b := self._boundary) is not None:
            now = in_force(b, at.time_s)
            lower, upper = b.lower_C[:, now], b.upper_C[:, now]
        columns = (at.names.zones, at.T_zone_C.tolist(), lower.tolist(), upper.tolist())
        return tuple(ZoneNow(*row) for row in zip(*columns, strict=True))

    def _view(self, step: ToldStep) -> RunView:
        decision, names = step.told, step.names
        at = (step.after or (step.before,))[-1]
        self._boundary = self._forecast(step)
        state, explanation = self._state()
        blocks = decision["blocks"]
        u = [[np.nan if level is None else level for level in block["u"]] for block in blocks]
        levels = np.average(u, axis=0, weights=[block["duration_s"] for block in blocks])
        time_s = step.time_s if at is None else at.time_s
        real, plan = "building" in self._head, self._planned(decision)
        origin = self._told().origin if real else None
        in_words = self._told().in_words if real else words_of
        since_s = time_s - _PAST_H * HOUR_S
        return RunView(
            run=str(self._folder),
            testcase=self._told().name if real else str(self._scenario.get("testcase", "")),
            controller=self._controller,
            state=state,
            said=explanation,
            time_s=time_s,
            at=in_words(time_s),
            origin="" if origin is None else origin.isoformat(),
            zone="" if origin is None else str(origin.tz),
            days=(time_s - self._start_s) / DAY_S,
            days_in_all=np.nan if real else float(self._scenario.get("days") or np.nan),
            outdoor_C=float("nan") if at is None else at.T_out_C,
            zones=() if at is None else self._zones(at),
            actuators=names.actuators,
            levels=tuple(levels.tolist()),
            status=str(decision["status"]),
            acting=tuple(str(status) for status in decision["acting"]),
            why=str(decision["why"]),
            notes=step.notes,
            cost=self._cost if self._metered else float("nan"),
            energy_kWh=self._kWh if self._metered else float("nan"),
            discomfort_Kh=self._Kh,
            counts=dict(self._counts),
            past=tuple(point for point in self._past if point.time_s > since_s),
            plan=plan,
            until=tuple(in_words(point.time_s) for point in plan),
            hot_water=self._tank_now(decision, plan, since_s),
        )

    def _tank_now(self, decision: Mapping[str, Any], plan: Sequence[WatchPoint], since_s: float) -> TankNow | None:
        """The tank as a decision planned it; `plan`: of the rooms, whose steps are its steps."""
        if (tank := tank_of(decision)) is None:
            return None
        rows = zip((point.time_s for point in plan), tank.T_C, tank.low_C, tank.lower_C, strict=False)
        now = float(decision["time_s"])
        past = [point for point in self._tank if since_s < point.time_s < now]
        value = None if decision["refused"] else tank.command[0]
        return TankNow(
            T_C=tank.T_now_C,
            told=np.nan if value is None else value,
            said=tank_in_words(tank),
            past=(*past, TankPoint(now, tank.T_now_C, np.nan, np.nan)),
            plan=tuple(TankPoint(*map(float, row)) for row in rows),
        )

    def _planned(self, decision: Mapping[str, Any]) -> tuple[WatchPoint, ...]:
        """The plan of a step, one point at the end of each of its steps."""
        planned, b = planned_of(decision), self._boundary
        if not planned or b is None:
            return ()
        u, T = planned["u"], compose(planned["T_free_C"], planned["T_forced_K"])
        n = min(u.shape[1], b.n_steps)
        # A forecast that stands in for one that was not given began earlier.
        late_s = float(decision["time_s"]) - float(b.time_s[0])
        columns = (T[:, :n], b.lower_C[:, 1 : n + 1], b.upper_C[:, 1 : n + 1], u[:, :n])
        points = zip(*(map(tuple, rows.T.tolist()) for rows in columns), strict=True)
        ends_s = (b.time_s[1 : n + 1] + late_s).tolist()
        return tuple(WatchPoint(end_s, *of) for end_s, of in zip(ends_s, points, strict=True))

    def _state(self) -> tuple[str, str]:
        if is_complete(self._folder):
            others = [name for name in self._loops if name != self._controller]
            more = f"; --controller shows another that ran: {', '.join(others)}" if others else ""
            return "finished", f"results and report are in the folder{more}"
        if self._ended:
            return "ended", self._ended
        early = self._folder / "INCOMPLETE.txt"
        # One that is older than the journal is of a run that was resumed.
        if early.is_file() and early.stat().st_mtime >= self._tail.path.stat().st_mtime:
            return "ended early", early.read_text(encoding="utf-8", errors="replace")[:500].strip()
        if (self._folder / LOCK).exists() and not in_use(self._folder):
            resume = f"tf-mpc resume {quote(str(self._folder))}"
            again = "`tf-mpc control` with the same --out" if "building" in self._head else f"`{resume}`"
            return (
                "ended early",
                f"no process here has the folder: it was killed, or its machine stopped; {again} goes on",
            )
        return "running", ""
