"""What a run decided at an instant, and why: read from its journal."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from thermoforce_mpc.data import DAY_S, SINGLE, Array, Boundary, Measurement, Names
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.simulation.journal import NAME, Entry, JournalError, read_journal
from thermoforce_mpc.simulation.journal_values import boundary_of, measurement_of, names_of, unpack

# A planned temperature nearer to its bound than this is bound by it, K.
_BINDING_K = 0.05


@dataclass(frozen=True)
class Decision:
    """One step of a run: what was known, planned, decided and done.

    `told` is the step's record in the journal, `before` the readings it began with, `boundary` the forecast it was made
    on, `plan` the planned courses by name (rows as in `Plan`), `after` the readings at the end of each block; `notes`
    what was doubtful.
    """

    controller: str
    told: Mapping[str, Any]
    names: Names
    before: Measurement | None
    boundary: Boundary | None
    plan: Mapping[str, Array]
    after: tuple[Measurement, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def time_s(self) -> float:
        """Its begin, s since 1 January."""
        return float(self.told["time_s"])

    @property
    def T_zone_C(self) -> Array:
        """Planned zone temperatures (Z, N), °C."""
        return np.asarray(self.plan["T_free_C"] + self.plan["T_forced_K"])

    def bounds(self) -> list[str]:
        """What binds in the plan, zone by zone: the comfort bound it touches first, and what it violates."""
        if self.boundary is None or not self.plan:
            return []
        found = []
        n = self.T_zone_C.shape[-1]
        for z, zone in enumerate(self.names.zones):
            lower_C, upper_C = self.boundary.lower_C[z, 1 : n + 1], self.boundary.upper_C[z, 1 : n + 1]
            T, of = self.T_zone_C[z, : lower_C.size], "" if self.names.single else f"{zone}: "
            near = {"lower": T - lower_C, "upper": upper_C - T}
            touched = [
                (int(np.argmax(gap <= _BINDING_K)), side) for side, gap in near.items() if (gap <= _BINDING_K).any()
            ]
            if not touched:
                side, gap = min(near.items(), key=lambda item: float(np.nanmin(item[1])))
                nearest = f"the {side} one is nearest, {np.nanmin(gap):.2f} K away"
                found.append(f"{of}no comfort bound is touched (plans keep a margin); {nearest}")
                continue
            at, side = min(touched)
            when_h = (self.boundary.time_s[at + 1] - self.time_s) / 3600.0
            bound_C = float((lower_C if side == "lower" else upper_C)[at])
            found.append(f"{of}the {side} comfort bound, {bound_C:.1f} °C, binds first, in {when_h:g} h")
            outside = {side: float(-np.nanmin(gap)) for side, gap in near.items()}
            worst = max(outside, key=lambda name: outside[name])
            if outside[worst] > _BINDING_K:
                found.append(f"{of}the plan is up to {outside[worst]:.2f} K outside the {worst} bound")
        return found


def decision_at(folder: Path, at: str | None = None, controller: str | None = None) -> Decision:
    """The step of a run in force at an instant.

    Args:
        folder: run folder.
        at: see `seconds_of`; by default the last step.
        controller: whose, by default the first that was run (the scenario's own).

    Raises:
        JournalError: there is no journal, or it is damaged.
        InputError: `at` is no time or outside the run, or `controller` did not run.
    """
    entries = read_journal(folder / NAME).entries
    loops = _loops(entries)
    if not loops:
        raise JournalError(f"{folder / NAME}: no step was decided yet")
    name = controller or next(iter(loops))
    if name not in loops:
        raise InputError(f"--controller {name}: did not run; there are {', '.join(loops)}")
    decisions = list(_decisions(name, loops[name]))
    if not decisions:
        raise JournalError(f"{folder / NAME}: {name} has not decided anything yet")
    if at is None:
        return decisions[-1]
    seconds = seconds_of(at)
    first, last = decisions[0].time_s, decisions[-1].time_s
    step_s = decisions[1].time_s - first if len(decisions) > 1 else 3600.0
    if not first <= seconds < last + step_s:
        raise InputError(
            f"--at {at}: {name} ran from {words_of(first)} to {words_of(last + step_s)} ({first:.0f} to "
            f"{last + step_s:.0f} s)"
        )
    return [decision for decision in decisions if decision.time_s <= seconds][-1]


def seconds_of(at: str) -> float:
    """Seconds since 1 January of a time as people write it.

    '16 06:30' is half past six of day 16 (days from 0, as `--period`), '16.5' noon of it, '01-17 06:30' and
    '17 Jan 06:30' the calendar's, '1405800s' seconds. Raises `InputError` for anything else.
    """
    text = at.strip()
    if match := re.fullmatch(r"(\d+(?:\.\d+)?) ?s", text):
        return float(match[1])
    if match := re.fullmatch(r"(\d+(?:\.\d+)?)(?: ?d)?(?: +(\d{1,2}):(\d{2}))?", text):
        return float(match[1]) * DAY_S + 3600.0 * int(match[2] or 0) + 60.0 * int(match[3] or 0)
    for form in ("%m-%d %H:%M", "%m-%dT%H:%M", "%d %b %H:%M"):
        try:
            told = datetime.strptime(f"2021 {text}", f"%Y {form}")
        except ValueError:
            continue
        return (told - datetime(2021, 1, 1)).total_seconds()
    raise InputError(f"--at {at}: not a time; write '16 06:30' (day from 0, as --period), '01-17 06:30' or '1405800s'")


def words_of(time_s: float) -> str:
    """A time for people: day from 0 and clock."""
    minutes = round(time_s % DAY_S / 60.0)
    return f"day {int(time_s // DAY_S)} {minutes // 60:02d}:{minutes % 60:02d}"


def _loops(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """The records of each closed loop, by controller."""
    found: dict[str, list[Entry]] = {}
    for entry in entries:
        if entry.kind == "loop":
            found[str(entry.content["controller"])] = []
        elif found:
            next(reversed(found.values())).append(entry)
    return found


def _decisions(controller: str, entries: Sequence[Entry]) -> Iterator[Decision]:
    names, before, boundary = SINGLE, None, None
    for i, entry in enumerate(entries):
        if entry.kind == "reset":
            names = names_of(entry.content["answer"]["names"])
            before = measurement_of(entry.content["answer"], names)
        elif entry.kind == "advance":
            before = measurement_of(entry.content["answer"], names)
        elif entry.kind == "forecast":
            boundary = boundary_of(entry.content["answer"], names)
        elif entry.kind == "step":
            after: list[Measurement] = []
            notes: tuple[str, ...] = ()
            for later in entries[i + 1 :]:
                if later.kind == "advance":
                    after.append(measurement_of(later.content["answer"], names))
                if later.kind == "done":
                    notes = tuple(later.content["notes"])
                if later.kind in ("done", "step"):
                    break
            plan = {name: unpack(packed) for name, packed in entry.content.get("plan", {}).items()}
            yield Decision(controller, entry.content, names, before, boundary, plan, tuple(after), notes)
