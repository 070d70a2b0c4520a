"""What a machine's command does on its meter while a record is lived through again, beside what levels take.

It goes on from what was set before, as it was and as it is lived through, so that what had to wait comes later in both.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import CourseState, MeterCourse, MeterEffect
from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.dataframes import clock_s
from thermoforce_mpc.data.series import step_means


class CommandOnMeter:
    """The command of machine `m` over the n steps of a record.

    Attributes:
        first: the actuator that tells it.
        was: what was set (n,), the usual command where that is not known.
        was_W: what it did on the meter beside levels (n,), W.
    """

    def __init__(
        self, first: int, m: int, learned: LearnedCommand, meter: MeterEffect, record: Record, law_W: Array
    ) -> None:
        """`law_W` (n,): power of the machine by the levels of `record`, W."""
        begins_s = record.time_s[:-1]
        own_s = learned.from_origin_s(begins_s, record.origin)
        self.first, self.m, self.meter = first, m, meter
        T_out_C = step_means(record.T_out_C)
        self.was, self._usual = learned.set_at(own_s, T_out_C), learned.usual_at(own_s, T_out_C)
        self._law_W, self._step_s = law_W, record.step_s
        self._clock_s = clock_s(begins_s, record.origin)
        now = float(self.was[0]), float(self._usual[0])
        self._begin = meter.begin(*now, record.step_s, float(self._clock_s[0]))
        self.was_W = self._power_W(self._until(record.n_steps), law_W[None], self._clock_s)[0]

    def at(self, k: int) -> CourseState:
        """Where both courses, as it was and as it is lived through, stand at the begin of step `k`, as it was."""
        state = self._until(k).after if k else self._begin
        return CourseState(np.repeat(state.lagged, 2, axis=-1), np.repeat(state.waits_Wh, 2, axis=-1))

    def lived(
        self, k: int, value: float | None, law_W: tuple[float, float], seconds: float, before: CourseState
    ) -> tuple[Array, CourseState]:
        """Power beside levels in `seconds` of step `k`, as it was and as it is lived through (2,), W, and what follows.

        `value`: the command; None: as it was. `law_W`: by the levels of both.
        """
        was = self.was[k]
        values, law = np.array([[was], [was if value is None else value]]), np.array(law_W)[:, None]
        at_s = self._clock_s[k : k + 1]
        course = self.meter.course(values, self._usual[k : k + 1], seconds, 1, law, at_s, before)
        return self._power_W(course, law, at_s)[:, 0], course.after

    def later_kWh(self, state: CourseState) -> float:
        """What comes on the meter after both courses stand at `state`, more than as it was, kWh."""
        was, lived = self.meter.mean @ self.meter.after_h(state) / 1000.0
        return float(lived - was)

    def _until(self, k: int) -> MeterCourse:
        usual, law_W, at_s = self._usual[:k], self._law_W[None, :k], self._clock_s[:k]
        return self.meter.course(self.was[None, :k], usual, self._step_s, 1, law_W, at_s, self._begin)

    def _power_W(self, course: MeterCourse, law_W: Array, clock_s: Array) -> Array:
        return self.meter.power_W(course, self.meter.mean[None], law_W, clock_s)
