"""Steps of a run in which the gate held or the watch had handed control back, in words for console and report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

from thermoforce_mpc.data import DAY_S, HOUR_S, PlanStatus
from thermoforce_mpc.simulation.closed_loop import RunResult


@dataclass(frozen=True)
class GateHeld:
    """Steps of a run in which the competence gate held: `steps` of `total`, and why, of the first."""

    steps: int
    total: int
    why: str

    def in_words(self) -> str:
        """One sentence for people."""
        return f"the gate held in {self.steps} of {self.total} steps: {self.why.removeprefix('gate: ')}"


def gates_held(result: RunResult, others: Mapping[str, RunResult]) -> dict[str, GateHeld]:
    """Return the runs in which the gate held, by controller."""
    gates = {}
    for name, run in {result.controller: result, **others}.items():
        why = [step.plan.why for step in run.steps if step.plan.status is PlanStatus.GATE]
        if why:
            gates[name] = GateHeld(len(why), len(run.steps), why[0])
    return gates


@dataclass(frozen=True)
class Spell:
    """Consecutive steps with the status `watch`: from `start_s` to `end_s`, s, and the reasons of beginning and end.

    `why_back` is empty where the run ended first.
    """

    start_s: float
    end_s: float
    why: str
    why_back: str

    def in_words(self) -> str:
        """One sentence for people."""
        back = f"; {self.why_back}" if self.why_back else "; until the end of the run"
        return f"day {self.start_s / DAY_S:.2f}, {(self.end_s - self.start_s) / HOUR_S:.1f} h: {self.why}{back}"


def watch_spells(result: RunResult) -> tuple[Spell, ...]:
    """Return the spells of `result` in which the watch had handed control back."""
    spells, first = [], 0
    for watched, steps in groupby(result.steps, key=lambda step: step.plan.status is PlanStatus.WATCH):
        last = first + sum(1 for _ in steps)
        if watched:
            end = result.steps[last - 1].samples[-1]
            news = result.steps[last].plan.news if last < len(result.steps) else ""
            back = next((note.removeprefix("watch: ") for note in news.split("; ") if note.startswith("watch: ")), "")
            why = result.steps[first].plan.why.removeprefix("watch: ")
            spells.append(Spell(result.steps[first].time_s, end.start_s + end.duration_s, why, back))
        first = last
    return tuple(spells)
