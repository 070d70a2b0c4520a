"""Days of levels to hold by hand, added to a record of operation one by one.

Levels change on the hour and only while people are awake; at night the building's own control acts. Of seeded draws the
most informative is taken (`design`), less what it costs in comfort; draws lean towards comfort as the design imagines
the zone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record
from thermoforce_mpc.identification.probing.design import expected_rise_K, information
from thermoforce_mpc.identification.probing.excitation import Excitation

# Holding times by hand, h, and draws that are compared a day.
HOLDS_H = (1, 2, 3, 4, 6)
_CANDIDATES = 24
# Price of discomfort when draws are compared, nats per K·h.
_DISCOMFORT = 0.02


@dataclass
class HandPlanner:
    """Adds days of levels, hour by hour, to a record of operation in hours as it may go on.

    Attributes:
        operation: the record.
        layout: what acts where.
        begin_s: when the first day begins, s.
        levels, awake, seed: as of `by_hand.probe_schedule`.
        usual, lower, upper: usual temperature and comfort band of each zone (Z,), °C.
        u: levels of the days so far (A, n), NaN where the building's own control acts.
    """

    operation: Record
    layout: Layout
    begin_s: float
    levels: tuple[float, ...]
    awake: tuple[int, int]
    usual: Array
    lower: Array
    upper: Array
    seed: int
    u: Array = field(init=False)

    def __post_init__(self) -> None:
        self.u = np.empty((len(self.layout.home), 0))

    @cached_property
    def holding(self) -> Array:
        """Mean level of operation (A,)."""
        return np.asarray(np.nanmean(self.operation.u, axis=1))

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
            draws = [self._draw(a, (self.seed, a, self.days, k)) for k in range(_CANDIDATES)]
            day[a] = max(draws, key=lambda draw, a=a: self._worth(a, draw))  # type: ignore[misc]
        self.u = np.concatenate([self.u, day], axis=1)

    def _worth(self, a: int, draw: Array) -> float:
        day = np.full((self.u.shape[0], 24), np.nan)
        day[a] = draw
        u = np.concatenate([self.u, day], axis=1)
        home = self.layout.home[a]
        nats = information(self._extended(u).part(home, [a]))
        return nats - _DISCOMFORT * float(self._outside_K(u)[home].sum())

    def _draw(self, a: int, seed: tuple[int, ...]) -> Array:
        """Levels of a day from the first hour, NaN at night; they lean towards comfort as the design imagines it."""
        excitation = Excitation(self.levels, HOLDS_H, np.random.default_rng(seed))
        awake = self._is_awake(24 * self.days + np.arange(24))
        levels = np.full(24, np.nan)
        sign, home = self.layout.signs[a], self.layout.home[a]
        unit = expected_rise_K(np.eye(1, 25)[0], HOUR_S)
        rise = float(self._rise_K(self.u)[home, -1]) * np.ones(25)
        centre = 0.5 * (self.lower[home] + self.upper[home])
        for t in range(24):
            if awake[t]:
                levels[t] = excitation.next(sign * (centre - self.usual[home] - rise[t]))
                rise[t + 1 :] += sign * (levels[t] - self.holding[a]) * unit[1 : 25 - t]
            else:
                excitation.left = 0
        return levels

    def _is_awake(self, hours: NDArray[np.intp]) -> NDArray[np.bool_]:
        of_day = ((self.begin_s + hours * HOUR_S) % DAY_S) / HOUR_S
        return np.asarray((of_day >= self.awake[0]) & (of_day < self.awake[1]))

    def _extended(self, u: Array) -> Record:
        r, n = self.operation, u.shape[1]
        if not n:
            return r
        levels = np.where(np.isfinite(u), u, self.holding[:, None])
        # The rest of the day before; a schedule of later days may as well begin on the next one.
        gap = round((self.begin_s - float(r.time_s[-1])) / HOUR_S) % 24
        levels = np.concatenate([np.repeat(self.holding[:, None], gap, axis=1), levels], axis=1)
        n += gap
        back = np.arange(n) % min(7 * 24, r.n_steps) - min(7 * 24, r.n_steps)
        unknown = np.full((len(r.names.machines), r.n_steps + n), np.nan)
        return Record(
            np.concatenate([r.time_s, r.time_s[-1] + np.arange(1, n + 1) * HOUR_S]),
            np.concatenate([r.T_zone_C, np.repeat(self.usual[:, None], n, axis=1)], axis=1),
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
        rise = np.zeros((len(self.usual), u.shape[1] + 1))
        for a, home in enumerate(self.layout.home):
            extra = np.where(np.isfinite(u[a]), u[a] - self.holding[a], 0.0)
            rise[home] += self.layout.signs[a] * expected_rise_K(extra, HOUR_S)
        return rise

    def _outside_K(self, u: Array) -> Array:
        """Expected distance outside the comfort band (Z, n + 1), K."""
        T = self.usual[:, None] + self._rise_K(u)
        return np.asarray(np.maximum(self.lower[:, None] - T, 0.0) + np.maximum(T - self.upper[:, None], 0.0))

    def discomfort_Kh(self) -> Array:
        """Expected discomfort of the schedule (Z,), K·h."""
        return np.asarray(self._outside_K(self.u)[:, 1:].sum(axis=1))

    def excursion_K(self) -> Array:
        """Expected largest distance from the usual temperature (Z,), K."""
        return np.asarray(np.abs(self._rise_K(self.u)).max(axis=1))
