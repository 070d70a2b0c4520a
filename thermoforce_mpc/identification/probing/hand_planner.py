"""Days of levels to hold by hand, added to a record of operation one by one.

Levels change on the hour and only while people are awake; at night the building's own control acts. Of seeded draws the
most informative is taken (`design`), less what it costs in comfort; draws lean towards comfort as the design imagines
the zone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.probing.design import Designer
from thermoforce_mpc.identification.probing.excitation import Excitation, Law

# Holding times by hand, h, and draws that are compared a day.
HOLDS_H = (1, 2, 3, 4, 6)
_CANDIDATES = 24
# As the automatic probing leans and turns back, see `ProbingConfig`.
_LEAN_PER_K, _TURN_K = 0.35, 1.5
# Price of discomfort when draws are compared, nats per K·h.
_DISCOMFORT = 0.02


class HandPlanner:
    """Adds days of levels, hour by hour, to the record of operation as it may go on."""

    def __init__(
        self,
        record: Record,
        layout: Layout,
        designer: Designer,
        begin_s: float,
        levels: Sequence[float],
        awake: tuple[int, int],
        usual: Array,
        lower: Array,
        upper: Array,
        seed: int,
    ) -> None:
        # In hours: the design looks at hourly rows anyway, and people act on the hour.
        every = max(1, round(HOUR_S / record.step_s))
        self._record = record.resample(every) if abs(every * record.step_s - HOUR_S) < 1.0 else record
        if abs(self._record.step_s - HOUR_S) > 1.0:
            raise DataError(
                f"the record has steps of {record.step_s:g} s: a schedule needs a step that divides an hour, such as "
                "step: 15min"
            )
        self._layout, self._designer, self._begin_s = layout, designer, begin_s
        self._levels, self._awake, self._seed = tuple(levels), awake, seed
        self._usual, self._lower, self._upper = usual, lower, upper
        self._holding = np.nanmean(self._record.u, axis=1)
        self.u = np.empty((len(layout.home), 0))

    @property
    def days(self) -> int:
        """Days so far."""
        return self.u.shape[1] // 24

    def record(self) -> Record:
        """The record of operation with the schedule after it, the weather of its last days repeated."""
        return self._extended(self.u)

    def add_day(self, probed: Sequence[int]) -> None:
        """Append 24 h: for each of `probed` the best draw, one after the other."""
        day = np.full((self.u.shape[0], 24), np.nan)
        for a in probed:
            draws = [self._draw(a, (self._seed, a, self.days, k)) for k in range(_CANDIDATES)]
            day[a] = max(draws, key=lambda draw, a=a: self._worth(a, draw))  # type: ignore[misc]
        self.u = np.concatenate([self.u, day], axis=1)

    def _worth(self, a: int, draw: Array) -> float:
        day = np.full((self.u.shape[0], 24), np.nan)
        day[a] = draw
        u = np.concatenate([self.u, day], axis=1)
        home = self._layout.home[a]
        nats = self._designer.information(self._extended(u).part(home, [a]))
        return nats - _DISCOMFORT * float(self._outside_K(u)[home].sum())

    def _draw(self, a: int, seed: tuple[int, ...]) -> Array:
        """Levels of a day from the first hour, NaN at night; they lean towards comfort as the design imagines it."""
        law = Law(self._levels, HOLDS_H, _LEAN_PER_K, _TURN_K, _TURN_K)
        excitation = Excitation(law, np.random.default_rng(seed))
        awake = self._is_awake(24 * self.days + np.arange(24))
        levels = np.full(24, np.nan)
        sign, home = self._layout.signs[a], self._layout.home[a]
        unit = self._designer.expected_rise_K(np.eye(1, 25)[0], HOUR_S)
        rise = float(self._rise_K(self.u)[home, -1]) * np.ones(25)
        centre = 0.5 * (self._lower[home] + self._upper[home])
        for t in range(24):
            if awake[t]:
                levels[t] = excitation.next(sign * (centre - self._usual[home] - rise[t]))
                rise[t + 1 :] += sign * (levels[t] - self._holding[a]) * unit[1 : 25 - t]
            else:
                excitation.left = 0
        return levels

    def _is_awake(self, hours: NDArray[np.intp]) -> NDArray[np.bool_]:
        of_day = ((self._begin_s + hours * HOUR_S) % DAY_S) / HOUR_S
        return np.asarray((of_day >= self._awake[0]) & (of_day < self._awake[1]))

    def _extended(self, u: Array) -> Record:
        r, n = self._record, u.shape[1]
        if not n:
            return r
        levels = np.where(np.isfinite(u), u, self._holding[:, None])
        # The rest of the day before; a schedule of later days may as well begin on the next one.
        gap = round((self._begin_s - float(r.time_s[-1])) / HOUR_S) % 24
        levels = np.concatenate([np.repeat(self._holding[:, None], gap, axis=1), levels], axis=1)
        n += gap
        back = np.arange(n) % min(7 * 24, r.n_steps) - min(7 * 24, r.n_steps)
        unknown = np.full((len(r.names.machines), r.n_steps + n), np.nan)
        return Record(
            np.concatenate([r.time_s, r.time_s[-1] + np.arange(1, n + 1) * HOUR_S]),
            np.concatenate([r.T_zone_C, np.repeat(self._usual[:, None], n, axis=1)], axis=1),
            np.concatenate([r.T_out_C, r.T_out_C[back]]),
            np.concatenate([r.solar_W_m2, r.solar_W_m2[back]]),
            np.concatenate([r.u, levels], axis=1),
            unknown,
            np.full((len(r.names.actuators), r.n_steps + n), np.nan),
            origin=r.origin,
            names=r.names,
        )

    def _rise_K(self, u: Array) -> Array:
        """Expected change of the zones against usual operation, (Z, n + 1), K."""
        rise = np.zeros((len(self._usual), u.shape[1] + 1))
        for a, home in enumerate(self._layout.home):
            extra = np.where(np.isfinite(u[a]), u[a] - self._holding[a], 0.0)
            rise[home] += self._layout.signs[a] * self._designer.expected_rise_K(extra, HOUR_S)
        return rise

    def _outside_K(self, u: Array) -> Array:
        """Expected distance outside the comfort band (Z, n + 1), K."""
        T = self._usual[:, None] + self._rise_K(u)
        return np.asarray(np.maximum(self._lower[:, None] - T, 0.0) + np.maximum(T - self._upper[:, None], 0.0))

    def discomfort_Kh(self) -> Array:
        """Expected discomfort of the schedule (Z,), K·h."""
        return np.asarray(self._outside_K(self.u)[:, 1:].sum(axis=1))

    def excursion_K(self) -> Array:
        """Expected largest distance from the usual temperature (Z,), K."""
        return np.asarray(np.abs(self._rise_K(self.u)).max(axis=1))
