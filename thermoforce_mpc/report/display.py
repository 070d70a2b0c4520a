"""What a run shows: a live line on a terminal, elsewhere a line now and then; and a line of what each phase found."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from boptest_client import safe_text
from thermoforce_mpc.data import DAY_S, Period, PlanStatus
from thermoforce_mpc.execution.progress import duration
from thermoforce_mpc.loop.closed_loop import Sample, StepRecord
from thermoforce_mpc.loop.probing import ProbingProgress
from thermoforce_mpc.plants.kpis import zone_kpis
from thermoforce_mpc.records.run_folder import own_of
from thermoforce_mpc.report.findings import best_values
from thermoforce_mpc.report.whole_tables import figure, plain_table, print_whole

Kpis = Callable[[], Mapping[str, float]]
# Loops that end sooner say nothing of it.
_SHORT_S = 5.0
# Where nothing can be overwritten, the first line of progress comes after this time, s, the next after twice that, …,
# but none later than so long after the one before: who looks at a log has to see that it goes on (by judgement).
SAID_AFTER_S = 5.0
MOST_APART_S = 60.0
# Shortest wait before it is said that nothing has come yet, s.
_LEAST_WAIT_S = 0.1
# Steps that are counted, in the order in which they are said.
_ODD = ("bridged", "gate", "watch", "fallbacks")
# Characters of a message: it may list many things, and quote what comes from elsewhere.
_MOST_SHOWN = 20_000

KPI_COLUMNS = {
    "cost_tot": "cost\n{currency}/m²",
    "tdis_tot": "discomf.\nK·h",
    "ener_tot": "energy\nkWh/m²",
    "emis_tot": "CO2\nkg/m²",
    "pele_tot": "el. peak\nkW/m²",
}


class _Line:
    """A line that is written over, on a terminal that is not quiet; elsewhere lines at growing distances in time.

    `before`: what goes on until the first progress, or until `then`. A plant that warms up, a slow step of an FMU and a
    look at what probing knows tell nothing while they go on: how long they do is said in the meantime.
    """

    def __init__(self, console: Console, quiet: bool, begins: str = "", before: str = "") -> None:
        self._console, self._quiet, self._begins, self._before = console, quiet, begins, before
        self._live: Live | None = None
        self._lock, self._over = threading.RLock(), threading.Event()
        self._began, self._next_said_s = time.monotonic(), SAID_AFTER_S
        self._goes_on("{}: {} so far", before)

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._quiet:
            self._live = Live(Text(self._begins), console=self._console, refresh_per_second=8, transient=True)
            self._live.__enter__()
        self.then(self._before)
        if self._before and not self._quiet:
            threading.Thread(target=self._say_until_over, name="progress", daemon=True).start()
        return self

    def then(self, text: str) -> None:
        """What goes on from here, which tells nothing itself."""
        with self._lock:
            self._began, self._next_said_s = time.monotonic(), SAID_AFTER_S
            self._goes_on("{}: {} so far", text)

    def _goes_on(self, form: str, text: str) -> None:
        """What to say where nothing comes for a while: `text` and for how long, in the `form` of both."""
        self._form, self._text, self._since = form, text, time.monotonic()

    def __exit__(self, *exception: object) -> None:
        with self._lock:
            self._over.set()
        if self._live:
            self._live.__exit__(None, None, None)

    def _say_until_over(self) -> None:
        """Where nothing came for a while: what goes on, and since when."""
        while not self._over.wait(self._silent_s()):
            with self._lock:
                if not self._over.is_set() and self._silent_s() <= _LEAST_WAIT_S:
                    self._show(self._form.format(self._text, duration(time.monotonic() - self._since)))

    def _silent_s(self) -> float:
        """How long to wait until something is to be said of what goes on."""
        due_s = max(self._began + self._next_said_s, self._since + SAID_AFTER_S)
        return max(due_s - time.monotonic(), _LEAST_WAIT_S)

    def _progress(self, line: str, also: bool = True) -> None:
        """Show a line of progress; where it cannot be overwritten, only when one is due, and where `also`."""
        with self._lock:
            self._goes_on("{}, {} ago", line)
            if also or self._live:
                self._show(line)

    def _show(self, line: str) -> None:
        gone_s = time.monotonic() - self._began
        if self._live:
            self._live.update(Text(line))
            self._next_said_s = gone_s + SAID_AFTER_S
        elif not self._quiet and gone_s >= self._next_said_s:
            self._next_said_s = gone_s + min(max(gone_s, SAID_AFTER_S), MOST_APART_S)
            self._print(line)

    def _print(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)


class LoopDisplay(_Line):
    """Progress of one closed loop: state at each step, the plant's KPIs at the end of each day and of the loop."""

    def __init__(
        self, console: Console, controller: str, period: Period, kpis: Kpis, currency: str, quiet: bool
    ) -> None:
        super().__init__(console, quiet, before=f"{controller}: the plant warms up under its own control")
        self._controller, self._period, self._kpis, self._currency = controller, period, kpis, currency
        self._so_far = ""
        self._days_done = 0
        self._odd: Counter[str] = Counter()

    def __exit__(self, *exception: object) -> None:
        super().__exit__(*exception)
        if exception[0] is None and not self._quiet:
            days = f"{self._days:g} day{'' if self._days == 1 else 's'}"
            took = duration(time.monotonic() - self._began)
            self._print(f"{self._controller}: {days} in {took}{self._so_far}{self._odd_steps()}")

    def step(self, record: StepRecord) -> None:
        """Update the display with one control step."""
        status = record.plan.status
        self._odd.update([status.value] * (status in (PlanStatus.BRIDGED, PlanStatus.GATE, PlanStatus.WATCH)))
        self._odd.update(["fallbacks"] * (status.fallen_back or bool(record.refused)))
        if self._quiet:
            return
        if record.plan.news:
            news = f"{self._controller}: day {record.time_s / DAY_S:.2f}: {record.plan.news}"
            self._console.print(safe_text(news, _MOST_SHOWN), highlight=False, markup=False, soft_wrap=True)
        last = record.samples[-1]
        day = (last.start_s + last.duration_s - self._period.start_s) / DAY_S
        days_done = int(day + 1e-9)
        day_is_over = days_done > self._days_done or day >= self._days - 1e-9
        if day_is_over:
            self._days_done = days_done
            self._so_far = _so_far(self._kpis(), self._currency)
        self._progress(self._line(record, day), also=day < self._days)

    @property
    def _days(self) -> float:
        return self._period.scored_s / DAY_S

    def _line(self, record: StepRecord, day: float) -> str:
        last = record.samples[-1]
        weights = [sample.duration_s for sample in record.samples]
        mean_u = np.average([sample.u_measured for sample in record.samples], weights=weights, axis=0)
        line = f"{self._controller}: day {day:5.2f}/{self._days:g}  T {_temperatures(last)}"
        line += f"  u {' '.join(f'{u:4.2f}' for u in mean_u)}{self._so_far}"
        if (solve_s := record.plan.seconds.get("solve")) is not None:
            line += f"  solve {1e3 * solve_s:.0f} ms"
        return line + self._left(day) + self._odd_steps()

    def _odd_steps(self) -> str:
        """How many steps were not as planned, by what held them."""
        return "".join(f"  {name} {self._odd[name]}" for name in _ODD if self._odd[name])

    def _left(self, day: float) -> str:
        """How long the rest of the loop takes if it goes on as until now; nothing where that is seconds."""
        seconds = (time.monotonic() - self._began) * (self._days / day - 1.0)
        return "" if seconds < _SHORT_S else f"  {duration(seconds)} left"


def _temperatures(sample: Sample) -> str:
    """Zone temperatures as text: with their bounds for one zone, else by name, with '!' outside the bounds."""
    bounds = list(zip(sample.T_zone_C, sample.lower_C, sample.upper_C, strict=True))
    if len(bounds) == 1:
        ((T, lower, upper),) = bounds
        return f"{T:5.2f} °C in [{lower:g}, {upper:g}]"
    by_zone = zip(sample.names.zones, bounds, strict=True)
    return ", ".join(f"{name} {T:.2f}{'' if low <= T <= high else '!'}" for name, (T, low, high) in by_zone) + " °C"


def _so_far(kpis: Mapping[str, float], currency: str) -> str:
    """Cost and discomfort so far as text, where the plant reports them."""
    formats = (("cost_tot", ".4f", f" {currency}/m²"), ("tdis_tot", ".2f", " K·h"))
    return "".join(f"  {kpis[key]:{digits}}{unit}" for key, digits, unit in formats if key in kpis)


class ProbingDisplay(_Line):
    """Progress of a probing: a callback."""

    def __init__(self, console: Console, quiet: bool, begins: str) -> None:
        super().__init__(console, quiet, begins, before="the plant warms up under its own control before the probing")

    def __enter__(self) -> Self:
        if not (self._console.is_terminal or self._quiet):
            self._console.print(self._begins, soft_wrap=True, markup=False)
        return super().__enter__()

    def __call__(self, progress: ProbingProgress) -> None:
        """Show `progress`, every hour."""
        self._progress(f"probing: day {progress.days:5.2f}/{progress.planned_days:g}")


_FILE_WIDTH = 110


class RunDisplay:
    """Console output of a run: messages, progress of the loops, and the KPI table."""

    def __init__(self, quiet: bool = False) -> None:
        self.console = Console(highlight=False, markup=False)
        if not self.console.is_terminal:
            # Do not wrap tables in files.
            self.console.width = max(self.console.width, _FILE_WIDTH)
        self.quiet = quiet

    def say(self, text: str) -> None:
        """Print `text` unless quiet."""
        if not self.quiet:
            self.console.print(safe_text(text, _MOST_SHOWN), soft_wrap=True, markup=False)

    def working(self, text: str) -> AbstractContextManager[object]:
        """Status text shown while the context is open."""
        if self.quiet:
            return nullcontext()
        if not self.console.is_terminal:
            self.say(text)
            return nullcontext()
        return self.console.status(text)

    def phase(self, text: str) -> _Line:
        """A context: where it takes long, it is said now and then that `text` goes on."""
        return _Line(self.console, self.quiet, before=text)

    def probing(self, begins: str) -> ProbingDisplay:
        """Progress display of a probing, a context and the callback of `identify_on`; `begins` says what is done."""
        return ProbingDisplay(self.console, self.quiet, begins)

    def loop(self, controller: str, period: Period, kpis: Kpis, currency: str) -> LoopDisplay:
        """Progress display of one closed loop; `kpis` returns the plant's KPIs so far."""
        return LoopDisplay(self.console, controller, period, kpis, currency, self.quiet)

    def kpi_table(
        self,
        everyone: Mapping[str, Mapping[str, float]],
        title: str,
        currency: str,
        held: Mapping[str, str] | None = None,
    ) -> None:
        """Print one row of KPIs per controller; an asterisk marks the best of each column (`best_values`).

        `held` says by controller that the competence gate held, and why: such a row is marked `gate`.
        """
        best = best_values(everyone)
        own = list(dict.fromkeys(key for kpis in everyone.values() for key in own_of(kpis)))
        headings = [label.format(currency=currency) for label in KPI_COLUMNS.values()]
        table = plain_table(["controller", *headings, *(key.replace(", ", "\n") for key in own)], title)
        for name, kpis in everyone.items():
            values = {key: kpis.get(key) for key in (*KPI_COLUMNS, *own)}
            table.add_row(
                f"{name} (gate)" if held and name in held else name,
                *(
                    "–" if v is None else figure(key, v) + ("*" if key in KPI_COLUMNS and v == best.get(key) else " ")
                    for key, v in values.items()
                ),
            )
        print_whole(table, self.console)
        zones = {name: zone_kpis(kpis) for name, kpis in everyone.items()}
        if any(zones.values()):
            print_whole(zone_table(zones), self.console)
        for name, why in (held or {}).items():
            self.console.print(f"{name}: {why}", soft_wrap=True, markup=False)


def zone_table(zones: Mapping[str, Mapping[str, float]]) -> Table:
    """Discomfort of each zone, one row per controller."""
    names = list(dict.fromkeys(zone for of in zones.values() for zone in of))
    table = plain_table(["controller", *names], "Discomfort by zone, K·h")
    for controller, of in zones.items():
        table.add_row(controller, *(f"{of[zone]:.2f}" if zone in of else "–" for zone in names))
    return table
