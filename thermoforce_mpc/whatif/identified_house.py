"""A building as its model has it, lived through a record again: a plant whose own control does what it did then.

What the weather, sun and people did to the rooms is in the record once the forced part is taken off; other levels put
another forced part in its place. Power is what was measured, and what the law of power says that the other levels
change, and other commands beside them. Left alone, the house is the record. Where water carries the heat, a level gives
less to a room that is warmer than it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.commands.loop import LearnedCommand, behind_levels
from thermoforce_mpc.commands.meter import CourseState, MeterEffect, off_commands, share_on
from thermoforce_mpc.data import (
    HOUR_S,
    Array,
    Boundary,
    Commands,
    CommandValue,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
)
from thermoforce_mpc.data.series import bridged, interpolated
from thermoforce_mpc.errors import DataError, InputError, NoForecast
from thermoforce_mpc.model.forced_state import followed
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.shell import Releasing, check_levels, day_period, forecast_times
from thermoforce_mpc.version import VERSION
from thermoforce_mpc.whatif.on_meter import CommandOnMeter

# Times that are nearer than this are one, s.
_CLOCK_S = 1e-6
# Least and most heat of a level, over what it gives in a room that is as warm as it was.
_HEAT_RANGE = (0.0, 2.0)


@dataclass(frozen=True, eq=False)
class HouseState:
    """Where a house stands: its `record` until then, and by how much its forced states are more than they were then,
    `more_K` (Z, A, r), K. `behind` (A,): x of the last step of loops that answer commands, see `LoopMap`. `on_meters`:
    of each machine's command, see `CommandOnMeter.at`.
    """

    record: Record
    more_K: Array
    behind: Array
    on_meters: tuple[CourseState, ...]


class IdentifiedHouse(Releasing):
    """A plant of a model and a record (`Plant`), between the ends of the record.

    Attributes:
        steps: number of the record's steps.
        u, power_W: levels (A, n) and power (M, n) of each step lived through so far, else as they were.
        beside_W: of it what commands do on meters beside levels, more than as they were (M, n).
        forced_K: forced states now (Z, A, r), K.
    """

    def __init__(
        self,
        model: ThermalModel,
        record: Record,
        conditions: Boundary,
        *,
        effects: Array | None = None,
        less_per_K: Array | None = None,
        commands: Mapping[str, LearnedCommand] | None = None,
        meters: Mapping[str, MeterEffect] | None = None,
        error: ForecastError | None = None,
        forecasts: Mapping[float, Boundary] | None = None,
        before: HouseState | None = None,
    ) -> None:
        """`conditions`: bounds and prices at the record's boundaries.

        `effects` (Z, A): what actuators do to zones in this house, as a multiple of what the model says. `less_per_K`
        (A,): share by which the heat of a level falls per K that its zone is warmer than it was, 1/K. `commands`: loops
        that answer commands, by actuator; `meters`: what they do on meters beside levels, by machine. `error`: of its
        weather forecasts; None: what was measured later. `forecasts`: those that were given then, by their begin in
        whole s, in the place of both. `before`: where the house stands when it is reset to the end of that record,
        instead of as it was.

        Raises `DataError` where a zone or the weather was never measured, or `conditions` are of other times.
        """
        if conditions.time_s.shape != record.time_s.shape or not np.allclose(conditions.time_s, record.time_s):
            raise DataError("the bounds and prices are not those of the record's times")
        self.model, self._conditions, self._error = model, conditions, error
        self._forecasts, self._before = forecasts, before
        self._loops = {record.names.actuators.index(name): one for name, one in (commands or {}).items()}
        zones, home = model.names.zones, list(model.operator.home)
        self._rooms = [self._loops[a].room_of(zones, z) if a in self._loops else z for a, z in enumerate(home)]
        whole, _ = bridged(model.in_rooms(record))
        begins_s, T_out_C = record.time_s[:-1], 0.5 * (whole.T_out_C[:-1] + whole.T_out_C[1:])
        self._usual = {
            a: one.usual_at(one.from_origin_s(begins_s, record.origin), T_out_C) for a, one in self._loops.items()
        }
        self._was = whole
        operator = model.operator
        if effects is not None:
            operator = operator.map_pairs(lambda z, a, pair: replace(pair, gains=pair.gains * float(effects[z, a])))
        self._resampled = lru_cache(maxsize=32)(operator.resampled)
        forced_K = followed(operator, None, whole).forced_K
        free_C = whole.T_zone_C - forced_K.sum(axis=(1, 3))
        for zone, row in zip(whole.names.zones, free_C, strict=True):
            if not np.isfinite(row).any():
                raise DataError(f"the temperature of zone '{zone}' was never measured: nothing to live through")
        self._less_per_K = np.zeros(len(operator.actuators)) if less_per_K is None else less_per_K
        self._free_C, self._forced_was = np.array([interpolated(row) for row in free_C]), forced_K
        self.steps = whole.n_steps
        machines = range(len(whole.names.machines))
        self._law_was = np.array([model.power_by_law(m, whole.u, whole.T_out_C[:-1]) for m in machines])
        self._on_meters = self._commands_on_meters(meters or {})
        self._power_was = self._known_power(whole)
        self.reset(float(whole.time_s[0]), 0.0)

    @property
    def info(self) -> PlantInfo:
        """See `Plant.info`."""
        stamps = self._was.stamps()
        words = f"as identified, from {stamps[0]} to {stamps[-1]}"
        return PlantInfo("identified house", "own building", words, "as recorded", VERSION)

    def period(self, name: str) -> Period:
        """A start day of the record's year."""
        return day_period(name, ())

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """See `Plant.reset`; until `start_s` all is as it was, or `before`. Raises `InputError` outside the record."""
        at = (start_s - self._was.time_s[0]) / self._was.step_s
        if abs(at - round(at)) > _CLOCK_S or not 0 <= round(at) <= self.steps:
            raise InputError(f"start of {start_s:g} s: no boundary of the record")
        self._k = round(at)
        self._now_s = float(self._was.time_s[self._k])
        self.forced_K = self._forced_was[:, :, self._k].copy()
        self.u, self.power_W, self.beside_W = self._was.u.copy(), self._power_was.copy(), 0.0 * self._power_was
        self._meter_states = [one.at(self._k) for one in self._on_meters]
        self._T_C = self._free_C + self._forced_was.sum(axis=(1, 3))
        self._part_s, self._owed_J = 0.0, np.zeros(len(self.power_W))
        last = max(self._k - 1, 0)
        self._behind, self._behind_part = self._behind_levels(self.u[:, last], self._loops, last), np.zeros(len(self.u))
        if self._before is not None and abs(self._now_s - float(self._before.record.time_s[-1])) < _CLOCK_S:
            self._go_on_from(self._before)
        return self._measured(np.full(len(self.u), np.nan), np.full(len(self.power_W), np.nan))

    def _go_on_from(self, before: HouseState) -> None:
        """Take over what was lived through before; what its record does not hold stays as it was."""
        n = min(self._k, before.record.n_steps)
        self.forced_K, self._behind = self.forced_K + before.more_K, before.behind.copy()
        if [one.lagged.shape for one in before.on_meters] == [one.lagged.shape for one in self._meter_states]:
            self._meter_states = list(before.on_meters)  # not of commands that were learned anew since
        self._T_C[:, self._k - n : self._k + 1] = before.record.T_zone_C[:, before.record.n_steps - n :]
        for row, values in ((self.u, before.record.u), (self.power_W, before.record.power_W)):
            row[:, self._k - n : self._k] = values[:, before.record.n_steps - n :]

    @property
    def state(self) -> HouseState:
        """Where the house stands now."""
        more_K = self.forced_K - self._forced_was[:, :, self._k]
        return HouseState(self._lived(0, self._k), more_K, self._behind, tuple(self._meter_states))

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """See `RoomSetpointPlant.advance`: with a command the loop that was learned answers.

        Raises `InputError` for what is no level or command, and beyond the end of the record.
        """
        layout = self.model.layout
        block = check_levels(u, duration_s, command, names=layout.names, u_min=layout.u_min)
        if self._now_s + duration_s > self._was.time_s[-1] + _CLOCK_S:
            raise InputError(f"{duration_s:g} s from {self._now_s:g} s on: the record ends at {self._was.time_s[-1]:g}")
        left_s, u_sum, power_sum = float(duration_s), np.zeros(len(self.u)), np.zeros(len(self.power_W))
        while left_s > _CLOCK_S:
            seconds = min(left_s, self._was.step_s - self._part_s)
            level, behind = self._levels(block.u, block.command)
            power_W, beside_W = self._power(level, block.command, seconds)
            self._go_on(level, behind, power_W, beside_W, seconds)
            u_sum, power_sum, left_s = u_sum + level * seconds, power_sum + power_W * seconds, left_s - seconds
        return self._measured(u_sum / duration_s, power_sum / duration_s)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """See `Plant.forecast`; what lies beyond the record is left out, but of forecasts that were given then."""
        if self._forecasts is not None:
            if (told := self._forecasts.get(float(round(self._now_s)))) is None:
                raise NoForecast("none was given then")
            return told.head(round(horizon_s / interval_s))
        time_s = forecast_times(self._now_s, horizon_s, interval_s)
        time_s = time_s[time_s <= self._was.time_s[-1] + _CLOCK_S]
        T_out_C, solar_W_m2 = self._weather("T_out_C", time_s), self._weather("solar_W_m2", time_s)
        if self._error is not None and time_s.size > 1:
            T_out_C, solar_W_m2 = self._error.apply(
                time_s, lambda at: self._weather("T_out_C", at), lambda at: self._weather("solar_W_m2", at)
            )
        at = np.clip(np.floor((time_s - self._was.time_s[0]) / self._was.step_s + 1e-6), 0, self.steps).astype(np.intp)
        c = self._conditions
        return Boundary(
            time_s, T_out_C, solar_W_m2, c.occupancy[:, at], c.lower_C[:, at], c.upper_C[:, at],
            c.price_per_kWh[:, at], c.emission_kg_per_kWh[:, at], names=c.names,
        )  # fmt: skip

    def past(self, step_s: float) -> Record:
        """See `Plant.past`: what was, and what was lived through."""
        every = max(1, round(step_s / self._was.step_s))
        first = self._k % every
        return self._lived(first, self._k).resample(every)

    def lived(self, start_s: float) -> Record:
        """The record of this house from `start_s` until now."""
        return self._lived(self._was.nearest(start_s), self._k)

    @property
    def warmth_Kh(self) -> Array:
        """By how much each zone (Z,) will be warmer than it was, by what acted until now alone, K·h."""
        operator = self._resampled(self._was.step_s)
        poles = np.clip(operator.poles, 1e-9, 1.0 - 1e-9)
        hours = -self._was.step_s / HOUR_S / np.log(poles)
        more_K = self.forced_K - self._forced_was[:, :, self._k]
        return np.asarray((more_K * hours).sum(axis=(1, 2)))

    @property
    def later_kWh(self) -> Array:
        """What commands until now leave to come on the meter of each machine, more than as they were, kWh (M,)."""
        out = np.zeros(len(self.power_W))
        for one, state in zip(self._on_meters, self._meter_states, strict=True):
            out[one.m] = one.later_kWh(state)
        return out

    def kpis(self) -> dict[str, float]:
        """None: what was lived through is in `lived`."""
        return {}

    def _lived(self, first: int, last: int) -> Record:
        part = self._was.slice(first, last)
        return replace(
            part,
            T_zone_C=self._T_C[:, first : last + 1],
            u=self.u[:, first:last],
            power_W=self.power_W[:, first:last],
            heat_W=np.full_like(part.heat_W, np.nan),
        )

    def _levels(self, u: tuple[float | None, ...], command: tuple[CommandValue | None, ...]) -> tuple[Array, Array]:
        """Levels (A,) now, as set, as loops answer, or as they were, and x (A,) of their loops."""
        was, T_out_C = self._was.u[:, self._k], float(self._was.T_out_C[self._k])
        level = np.array([was[a] if one is None else one for a, one in enumerate(u)], dtype=np.float64)
        untold = {a: one for a, one in self._loops.items() if command[a] is None}
        behind = self._behind_levels(level, untold, self._k)
        for a, told in enumerate(command):
            if told is None:
                continue
            if a not in self._loops or isinstance(told, tuple):
                raise InputError(f"command of '{self._was.names.actuators[a]}': it has none")
            loop, T_C = self._loops[a].loop, self._rooms_C(self._k)[a]
            behind[a] = loop.behind(told, T_C, T_out_C, self._behind[a])
            level[a] = loop.opened(T_C) * behind[a] * float(share_on(np.full((1, 1), told), self._off.get(a, ()))[0])
        return np.clip(level, np.array(self.model.layout.u_min), 1.0), behind

    def _behind_levels(self, u: Array, loops: Mapping[int, LearnedCommand], k: int) -> Array:
        """x (A,) of levels `u` (A,) that no command set, in step `k` of the record."""
        usual = {a: float(self._usual[a][k]) for a in loops}
        return behind_levels(u, loops, usual, self._rooms_C(k), float(self._was.T_out_C[k]))

    def _rooms_C(self, k: int) -> Array:
        """The room that each actuator's loop works against (A,), with the forced states of now over the free part of
        step `k`, °C."""
        return np.asarray((self._free_C[:, k] + self.forced_K.sum(axis=(1, 2)))[self._rooms])

    def _commands_on_meters(self, meters: Mapping[str, MeterEffect]) -> list[CommandOnMeter]:
        """What commands of machines do on `meters`; each is told by the first of its actuators that has it."""
        machines, out = self._was.names.machines, dict[str, CommandOnMeter]()
        self._off = {a: off_commands(one, meters.get(one.machine)) for a, one in self._loops.items()}
        for a, one in self._loops.items():
            if one.machine in meters and one.machine not in out:
                m = machines.index(one.machine)
                out[one.machine] = CommandOnMeter(a, m, one, meters[one.machine], self._was, self._law_was[m])
        return list(out.values())

    def _power(self, level: Array, command: tuple[CommandValue | None, ...], seconds: float) -> tuple[Array, Array]:
        """Power of each machine (M,) at levels (A,) under commands (A,): as it was, and what other levels change by the
        law, and other commands beside them, which is given for itself too (M,).

        What lies below 0, since the law said more of what was than the meter, is taken off later: where only that were
        cut off, all that the meter said beyond the law would be paid twice.
        """
        T_out_C = self._was.T_out_C[self._k : self._k + 1]
        law = np.array([self.model.power_by_law(m, level[:, None], T_out_C)[0] for m in range(len(self.power_W))])
        law_was, beside_W = self._law_was[:, self._k], np.zeros(len(law))
        for i, one in enumerate(self._on_meters):
            told = command[one.first]
            value = None if isinstance(told, tuple) else told
            both = float(law_was[one.m]), float(law[one.m])
            (was_W, now_W), self._meter_states[i] = one.lived(self._k, value, both, seconds, self._meter_states[i])
            beside_W[one.m] = now_W - was_W
        power_W = self._power_was[:, self._k] + (law - law_was) + beside_W - self._owed_J / seconds
        self._owed_J = np.maximum(-power_W, 0.0) * seconds
        return np.maximum(power_W, 0.0), beside_W

    def _known_power(self, whole: Record) -> Array:
        """Power as it was (M, n), by the law where it was not measured; raises `DataError` where a machine has none."""
        for name, law in zip(whole.names.machines, self.model.power, strict=True):
            if law is None:
                raise DataError(f"the power of '{name}' was not measured: what other levels cost cannot be said")
        by_law = self._law_was.copy()
        for one in self._on_meters:
            by_law[one.m] += one.was_W
        return np.where(np.isfinite(whole.power_W), whole.power_W, by_law)

    def _go_on(self, level: Array, behind: Array, power_W: Array, beside_W: Array, seconds: float) -> None:
        operator, k, step_s = self._resampled(seconds), self._k, self._was.step_s
        share = self._part_s / step_s
        free_now = (1.0 - share) * self._free_C[:, k] + share * self._free_C[:, k + 1]
        x = feature_matrix(
            free_now[:, None],
            self._was.T_out_C[k : k + 1],
            self._was.solar_W_m2[k : k + 1],
            self._was.time_s[k : k + 1],
        )[:, 0]
        T_out_C = np.asarray(self._was.T_out_C[k])
        heat = np.array(
            [float(operator.of_actuator(a).heat_input(np.asarray(one), T_out_C)) for a, one in enumerate(level)]
        )
        was_K = (1.0 - share) * self._forced_was[:, :, k] + share * self._forced_was[:, :, k + 1]
        warmer_K = (self.forced_K - was_K).sum(axis=(1, 2))[list(operator.home)]
        heat *= np.clip(1.0 - self._less_per_K * warmer_K, *_HEAT_RANGE)
        self.forced_K = operator.advance(self.forced_K, operator.modulated(heat, x, self.forced_K))
        weight = seconds / step_s
        for row, values in ((self.u, level), (self.power_W, power_W), (self.beside_W, beside_W)):
            row[:, k] = values * weight if self._part_s == 0.0 else row[:, k] + values * weight
        self._behind_part = self._behind_part + behind * weight
        self._part_s += seconds
        self._now_s += seconds
        if self._part_s > step_s - _CLOCK_S:
            self._k, self._part_s = k + 1, 0.0
            self._behind, self._behind_part = self._behind_part, np.zeros(len(behind))
            self._now_s = float(self._was.time_s[self._k])
            self._T_C[:, self._k] = self._free_C[:, self._k] + self.forced_K.sum(axis=(1, 2))

    def _measured(self, u: Array, power_W: Array) -> Measurement:
        now = np.array([self._now_s])
        free_C = np.array([np.interp(self._now_s, self._was.time_s, row) for row in self._free_C])
        return Measurement(
            names=self._was.names,
            time_s=self._now_s,
            T_zone_C=free_C + self.forced_K.sum(axis=(1, 2)),
            T_out_C=float(self._weather("T_out_C", now)[0]),
            solar_W_m2=float(self._weather("solar_W_m2", now)[0]),
            u=u,
            power_W=power_W,
        )

    def _weather(self, name: str, at_s: Array) -> Array:
        return np.asarray(np.interp(at_s, self._was.time_s, getattr(self._was, name)))
