"""The clock of a test: where it stands, and whether an answer is of the time that it should be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

from boptest_client.errors import ProtocolError

TOLERANCE_S = 1e-3
# Length of a scenario of a named period, s.
_SCENARIO_S = 14 * 86400.0
# BOPTEST's recording interval, s.
_SAMPLE_S = 30.0


class Clock:
    """Times of a test in s, NaN where unknown.

    Attributes:
        now_s: where the test stands: the time of the last answer.
        started_s: where it was begun or taken up.
        step_s: the step in force.
        scenario_ends: whether the test ends with a scenario of a named period.
    """

    def __init__(self) -> None:
        self.now_s = self.started_s = self.step_s = math.nan
        self.scenario_ends = False

    def begin(self, at: str, state: dict[str, float], at_s: float) -> dict[str, float]:
        """The `state` after an initialisation at endpoint `at`, which must be of `at_s` where that is known."""
        found_s = state.get("time", math.nan)
        if abs(found_s - at_s) > TOLERANCE_S:
            raise ProtocolError(at, f"its time is {found_s:.10g} s, expected is {at_s:.10g} s")
        self.started_s, self.step_s = found_s, math.nan  # it may reset the step
        return self.move(at, state)

    def step(self, at: str, state: dict[str, float], step_s: float) -> dict[str, float]:
        """The `state` after a step of `step_s`, NaN if unknown; the last one of a scenario ends on time."""
        found_s = state.get("time", math.nan)
        cut = self.scenario_ends and abs(found_s - self.started_s - _SCENARIO_S) <= TOLERANCE_S
        if not cut and (abs(found_s - self.now_s - step_s) > TOLERANCE_S or math.isnan(found_s)):
            expected = f"expected is that of a step of {step_s:g} s from {self.now_s:.10g} s"
            raise ProtocolError(at, f"its time is {found_s:.10g} s, {expected}")
        return self.move(at, state)

    def move(self, at: str, state: dict[str, float]) -> dict[str, float]:
        """The `state`, which must have a finite 'time': there the test stands now."""
        if not math.isfinite(state.get("time", math.nan)):
            raise ProtocolError(at, "the measurements have no time")
        self.now_s = state["time"]
        return state

    def moved(self, record: Mapping[str, Sequence[float]]) -> bool:
        """Whether a record goes on beyond where the test stood."""
        return record["time"][-1] > self.now_s + TOLERANCE_S

    def check_record(self, at: str, clock: Sequence[float], start_s: float, final_s: float) -> None:
        """Raise `ProtocolError` for a record of other times than asked for, or that lacks what was simulated."""
        first, last, now_s = clock[0], clock[-1], self.now_s
        whole = start_s - TOLERANCE_S <= first and last <= final_s + TOLERANCE_S
        since_s, until_s = max(start_s, self.started_s), min(final_s, now_s)  # some services record no warm-up
        if math.isfinite(now_s) and since_s <= until_s:
            whole &= first <= since_s + _SAMPLE_S and last >= until_s - _SAMPLE_S
        if last > now_s + TOLERANCE_S:  # steps that we do not know of; or the clock is wrong
            whole &= first <= start_s + TOLERANCE_S
        if not whole:
            asked = f"asked for {start_s:.10g} to {final_s:.10g} s while the test stands at {now_s:.10g} s"
            raise ProtocolError(at, f"its times are {first:.10g} to {last:.10g} s, {asked}")

    def check_forecast(self, at: str, clock: Sequence[float], horizon_s: float, interval_s: float) -> None:
        """Raise `ProtocolError` unless `clock` rises from now by `interval_s` to `horizon_s` or farther."""
        if clock and abs(clock[0] - self.now_s) > TOLERANCE_S:
            expected = f"expected is {self.now_s:.10g} s, where the test stands"
            raise ProtocolError(at, f"it begins at {clock[0]:.10g} s, {expected}")
        if not clock or any(a == b for a, b in pairwise(clock)):
            raise ProtocolError(at, f"its clock ('time') does not rise: {list(clock[:3])} …")
        n = math.floor(horizon_s / interval_s + 1e-9) + 1
        steps = [(i, time_s - clock[0]) for i, time_s in enumerate(clock[:n])]
        if len(clock) < n or any(abs(after_s - i * interval_s) > TOLERANCE_S for i, after_s in steps):
            got = f"got {len(clock)} from {clock[0]:g} s to {clock[-1]:g} s"
            raise ProtocolError(at, f"asked for {n} instants every {interval_s:g} s, {got}")
