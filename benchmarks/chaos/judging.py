"""What must hold of an episode, from what the proxy saw and what the journal says."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

from benchmarks.chaos.troubles import TWICE, UNITS, Trouble
from thermoforce_mpc.records.journal import JournalEntry

_CLOCK_TOLERANCE_S = 1e-3


def wrong_inputs(inputs: Sequence[dict[str, Any]]) -> list[str]:
    """Actions that were sent and are not finite or out of range."""
    wrong = [
        f"{name} = {value!r} was sent"
        for sent in inputs
        for name, value in sent.items()
        if not (isinstance(value, int | float) and math.isfinite(value) and 0.0 <= value <= 1.0)
    ]
    return wrong[:1]


def unsaid_units(entries: Sequence[JournalEntry], made: Collection[str]) -> list[str]:
    """Wrong units that no note of a step tells."""
    notes = [note for entry in entries if entry.kind == "done" for note in entry.content["notes"]]
    return [f"{kind}: not said" for kind in made if kind in UNITS and not any(UNITS[kind][2] in note for note in notes)]


def _advances(entries: Sequence[JournalEntry]) -> list[tuple[float, float]]:
    """Begin and end of what the journal has as one advance, s, without the asked duration."""
    found, before = [], math.nan
    for entry in entries:
        if entry.kind == "reset":
            before = float(entry.content["answer"]["time_s"])
        for one in [entry.content] if entry.kind == "advance" else entry.content.get("advances", ()):
            end = float(one["answer"]["time_s"])
            found.append((before + float(one["asked"]["duration_s"]), end))
            before = end
    return found


def jumps(entries: Sequence[JournalEntry]) -> list[tuple[float, float]]:
    """Advances after which the clock stood elsewhere than asked for."""
    return [(due, end) for due, end in _advances(entries) if abs(end - due) > _CLOCK_TOLERANCE_S]


def wrong_steps(
    entries: Sequence[JournalEntry], simulated_s: Sequence[float], troubles: Sequence[Trouble], done: bool
) -> list[str]:
    """Steps that the journal lacks, has twice, or that ran ahead without a word."""
    wrong = []
    indices = [entry.content["index"] for entry in entries if entry.kind == "done"]
    if indices != list(range(len(indices))):
        wrong.append(f"the journal's steps are not one after the other: {indices}")
    advances, ahead = _advances(entries), jumps(entries)
    if any(end < due - _CLOCK_TOLERANCE_S for due, end in advances):
        wrong.append("the clock of the journal falls behind")
    if ahead and not any(trouble.kind in TWICE for trouble in troubles):
        wrong.append(f"{len(ahead)} steps ran ahead, and nothing was doubled")
    noted = sum(any("ran ahead" in note for note in e.content["notes"]) for e in entries if e.kind == "done")
    if done and ahead and not noted:
        wrong.append("a step ran ahead and no note says so")
    known = {round(end) for _, end in advances} | {round(due) for due, _ in ahead}
    unknown = {round(end) for end in simulated_s} - known
    lacking = [time_s for time_s in unknown if not any(due < time_s <= end + 1 for due, end in ahead)]
    if done and lacking:
        wrong.append(f"steps that were simulated and are not in the journal: until {sorted(lacking)[:3]} s")
    never = {round(end) for _, end in advances} - {round(end) for end in simulated_s}
    if never:
        wrong.append(f"steps in the journal that were never simulated: until {sorted(never)[:3]} s")
    return wrong
