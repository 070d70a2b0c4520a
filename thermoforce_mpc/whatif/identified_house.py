"""A building as its model has it, lived through a record again: a plant whose own control does what it did then.

What the weather, sun and people did to the rooms is in the record once the forced part is taken off; other levels put
another forced part in its place. Power is what was measured, and what the law of power says that the other levels
change, and other commands beside them. Left alone, the house is the record. Where water carries the heat, a level gives
less to a room that is warmer than it was. While a machine charges its tank of hot water it gives the rooms nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.commands.loop import LearnedCommand, behind_levels
from thermoforce_mpc.commands.meter import CourseState, MeterEffect, off_commands, share_on
from thermoforce_mpc.commands.tank import CHARGED
from thermoforce_mpc.data import (
    HOUR_S,
    J_PER_KWH,
    Array,
    Block,
    Boundary,
    Commands,
    CommandValue,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
    steps_in,
)
from thermoforce_mpc.data.series import bridged, interpolated, step_means
from thermoforce_mpc.errors import DataError, InputError, NoForecast
from thermoforce_mpc.model.forced_state import followed
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.shell import Releasing, check_levels, day_period, forecast_times
from thermoforce_mpc.version import VERSION
from thermoforce_mpc.whatif.lived_tank import LivedTank, TankPart, TankState
from thermoforce_mpc.whatif.on_meter import CommandOnMeter

# Times that are nearer than this are one, s.
_CLOCK_S = 1e-6
# Least and most heat of a level, over what it gives in a room that is as warm as it was.
_HEAT_RANGE = (0.0, 2.0)
_NO_TANK = TankPart(0.0, 0.0, 0.0)
# Least share of a step without charging over which a level is taken to be that of this time.
_LEAST_LEFT = 0.05
# Own control is off or at full level beyond these: how far, nobody knows. Between them a room that is a kelvin warmer
# asks for less by one level (thermostatic valves, EN 215: 1 to 2 K from open to shut).
_OFF, _FULL, _P_BAND_K = 0.02, 0.98, 1.0


@dataclass(frozen=True, eq=False)
class HouseState:
    """Where a house stands: its `record` until then, and by how much its forced states are more than they were then,
    `more_K` (Z, A, r), K. `behind` (A,): x of the last step of loops that answer commands, see `LoopMap`. `on_meters`:
    of each machine's command, see `CommandOnMeter.at`. `tanks`: as it was set, and as it is lived through, () without;
    `owed_J`: what is taken off its power later.
    """

    record: Record
    more_K: Array
    behind: Array
    on_meters: tuple[CourseState, ...]
    tanks: tuple[TankState, ...] = ()
    owed_J: float = 0.0


class IdentifiedHouse(Releasing):
    """A plant of a model and a record (`Plant`), between the ends of the record.

    Attributes:
        steps: number of the record's steps.
        u, power_W: levels (A, n) and power (M, n) of each step lived through so far, else as they were.
        beside_W: of it what commands do on meters beside levels and a tank takes, more than as they were (M, n).
        forced_K: forced states now (Z, A, r), K.
        tank_C: temperature of the tank (2, n + 1), as it was set by its model, and as it is lived through, °C; NaN
            where it was not lived through.
        tank_below_Kh: K·h that it was below what is wanted, of both (2,).
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
        tank: LivedTank | None = None,
    ) -> None:
        """`conditions`: bounds and prices at the record's boundaries.

        `effects` (Z, A): what actuators do to zones in this house, as a multiple of what the model says. `less_per_K`
        (A,): share by which the heat of a level falls per K that its zone is warmer than it was, 1/K. `commands`: loops
        that answer commands, by actuator; `meters`: what they do on meters beside levels, by machine. `error`: of its
        weather forecasts; None: what was measured later. `forecasts`: those that were given then, by their begin in
        whole s, in the place of both. `before`: where the house stands when it is reset to the end of that record,
        instead of as it was. `tank`: of hot water; of the machine that heats it the record has the power of steps
        without charging.

        Raises `DataError` where a zone or the weather was never measured, or `conditions` are of other times.
        """
        if conditions.time_s.shape != record.time_s.shape or not np.allclose(conditions.time_s, record.time_s):
            raise DataError("the bounds and prices are not those of the record's times")
        self.model, self._conditions, self._error = model, conditions, error
        self._tank_told: float | None = None
        self._forecasts, self._before, self._tank = forecasts, before, tank
        self._loops = {record.names.actuators.index(name): one for name, one in (commands or {}).items()}
        zones, home = model.names.zones, list(model.operator.home)
        self._rooms = [self._loops[a].room_of(zones, z) if a in self._loops else z for a, z in enumerate(home)]
        whole, _ = bridged(model.in_rooms(record))
        begins_s, T_out_C = record.time_s[:-1], step_means(whole.T_out_C)
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
        self._free_was = whole.u if tank is None else _while_free(whole.u, tank.share, model.layout.fed_by(tank.m))
        share = np.zeros(whole.n_steps) if tank is None else tank.share
        self._law_was = np.array([self._by_law(m, self._free_was, whole.T_out_C[:-1], share) for m in machines])
        self._on_meters = self._commands_on_meters(meters or {})
        self._rooms_was, self._power_was = self._known_power(whole)
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
        self._rooms_W, self._share = self._rooms_was.copy(), np.zeros(self.steps)
        self.tank_C, self.tank_below_Kh = np.full((2, self.steps + 1), np.nan), np.zeros(2)
        self._tanks: tuple[TankState, ...] = ()
        self._tank_owed_J = 0.0
        if self._tank is not None:
            self._share = self._tank.share.copy()
            self._tanks = (self._tank.at(self._now_s),) * 2
        self._meter_states = [one.at(self._k) for one in self._on_meters]
        self._T_C = self._free_C + self._forced_was.sum(axis=(1, 3))
        self._part_s, self._owed_J = 0.0, np.zeros(len(self.power_W))
        last = max(self._k - 1, 0)
        self._behind, self._behind_part = self._behind_levels(self.u[:, last], self._loops, last), np.zeros(len(self.u))
        if self._before is not None and abs(self._now_s - float(self._before.record.time_s[-1])) < _CLOCK_S:
            self._go_on_from(self._before)
        self._note_tank()
        return self._measured(np.full(len(self.u), np.nan), np.full(len(self.power_W), np.nan))

    def _go_on_from(self, before: HouseState) -> None:
        """Take over what was lived through before; what its record does not hold stays as it was."""
        n = min(self._k, before.record.n_steps)
        self.forced_K, self._behind = self.forced_K + before.more_K, before.behind.copy()
        if [one.lagged.shape for one in before.on_meters] == [one.lagged.shape for one in self._meter_states]:
            self._meter_states = list(before.on_meters)  # not of commands that were learned anew since
        if len(before.tanks) == len(self._tanks):
            self._tanks, self._tank_owed_J = before.tanks, before.owed_J
        self._T_C[:, self._k - n : self._k + 1] = before.record.T_zone_C[:, before.record.n_steps - n :]
        for row, values in ((self.u, before.record.u), (self.power_W, before.record.power_W)):
            row[:, self._k - n : self._k] = values[:, before.record.n_steps - n :]
        if self._tank is not None:
            over = slice(self._k - n, self._k)
            self._rooms_W[:, over] = np.nan_to_num(self.power_W[:, over])
            self._share[over] = np.isnan(self.power_W[self._tank.m, over])

    @property
    def state(self) -> HouseState:
        """Where the house stands now."""
        more_K = self.forced_K - self._forced_was[:, :, self._k]
        return HouseState(
            self._seen(0), more_K, self._behind, tuple(self._meter_states), self._tanks, self._tank_owed_J
        )

    def tank_now(self) -> tuple[float, bool]:
        """See `TankPlant`; NaN without a tank."""
        return (self._tanks[1].T_C, self._tanks[1].is_charged) if self._tanks else (float("nan"), False)

    def set_tank(self, command: float | None) -> None:
        """See `TankPlant`: None is as it was set then."""
        self._tank_told = command

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
            tank = self._of_tank(seconds)
            free, behind = self._levels(block.u, block.command)
            free, level = self._beside_tank(free, block, tank)
            parts_W = self._power(free, block.command, seconds, tank)
            self._go_on(level, behind, parts_W, tank[1].share, seconds)
            rooms_W = self._of_rooms(parts_W[2], tank[1].share)
            u_sum, power_sum, left_s = u_sum + level * seconds, power_sum + rooms_W * seconds, left_s - seconds
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
        """See `Plant.past`: what was, and what was lived through; power is that of steps without charging."""
        every = steps_in(step_s, self._was.step_s)
        first = self._k % every
        return self._seen(first).resample(every)

    def _seen(self, first: int) -> Record:
        """What a controller may know from step `first` on."""
        part = self._lived(first, self._k)
        if self._tank is None:
            return part
        over = slice(first, self._k)
        return replace(part, power_W=self._of_rooms(self._rooms_W[:, over], self._share[over]))

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
        if self._tank is not None:
            was_kWh, now_kWh = map(self._tank.stored_kWh, self._tanks)
            out[self._tank.m] += was_kWh - now_kWh - self._tank_owed_J / J_PER_KWH
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
        """Levels (A,) now while a machine is free of its tank, as set, as loops answer, or as they were, and x (A,) of
        their loops.
        """
        was, T_out_C = self._free_was[:, self._k], float(self._was.T_out_C[self._k])
        level = np.array([was[a] if one is None else one for a, one in enumerate(u)], dtype=np.float64)
        untold = {a: one for a, one in self._loops.items() if command[a] is None}
        behind = self._behind_levels(level, untold, self._k)
        rooms_C, names = self._rooms_C(self._k), self._was.names.actuators
        opened = {names[a]: one.loop.opened(rooms_C[a]) for a, one in self._loops.items()}
        for a, told in enumerate(command):
            if told is None:
                continue
            if a not in self._loops or isinstance(told, tuple):
                raise InputError(f"command of '{self._was.names.actuators[a]}': it has none")
            loop, T_C = self._loops[a].loop, rooms_C[a]
            behind[a] = loop.behind(told, T_C, T_out_C, self._behind[a], taken=loop.taken(opened))
            level[a] = loop.opened(T_C) * behind[a] * float(share_on(np.full((1, 1), told), self._off.get(a, ()))[0])
        return np.clip(level, np.array(self.model.layout.u_min), 1.0), behind

    def _beside_tank(self, free: Array, block: Block, tank: tuple[TankPart, TankPart]) -> tuple[Array, Array]:
        """Levels (A,) while the machine is free of the tank, and over a step; `free`: the former, set or as they were.

        Levels that the building's own control gave are as they were, but for what the tank takes more or less of them,
        and for the room that is warmer or colder for it since.
        """
        if self._tank is None:
            return free, free
        free, level, layout = free.copy(), free.copy(), self.model.layout
        warmer_K = (self.forced_K - self._forced_was_now()).sum(axis=(1, 2))
        was, now = tank[0].share, tank[1].share
        for a in layout.fed_by(self._tank.m):
            if block.u[a] is not None or block.command[a] is not None:
                level[a] = free[a] * (1.0 - now)
                continue
            less = warmer_K[layout.home[a]] * layout.signs[a] / _P_BAND_K if _OFF < abs(free[a]) < _FULL else 0.0
            level[a] = self._was.u[a, self._k] + free[a] * (was - now) - less * (1.0 - now)
            free[a] -= less
        u_min = np.array(layout.u_min)
        return np.clip(free, u_min, 1.0), np.clip(level, u_min, 1.0)

    def _forced_was_now(self) -> Array:
        """Forced states as they were now, (Z, A, r), K."""
        share = self._part_s / self._was.step_s
        if share == 0.0:
            return self._forced_was[:, :, self._k]
        return np.asarray((1.0 - share) * self._forced_was[:, :, self._k] + share * self._forced_was[:, :, self._k + 1])

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

    def _of_tank(self, seconds: float) -> tuple[TankPart, TankPart]:
        """What the tank did in the next `seconds`, as it was set and as it is lived through."""
        if self._tank is None:
            return _NO_TANK, _NO_TANK
        (was, now), at_s = self._tanks, self._now_s
        was, of_was = self._tank.lived(was, at_s, seconds, None)
        now, of_now = self._tank.lived(now, at_s, seconds, self._tank_told)
        self._tanks = was, now
        self.tank_below_Kh = self.tank_below_Kh + np.array([of_was.below_Kh, of_now.below_Kh])
        return of_was, of_now

    def _note_tank(self) -> None:
        if self._tanks:
            self.tank_C[:, self._k] = [one.T_C for one in self._tanks]

    def _by_law(self, m: int, free: Array, T_out_C: Array, share: Array) -> Array:
        """Power of machine `m` for rooms (n,), W, with levels `free` (A, n) in what `share` (n,) of the tank leaves."""
        power_W = self.model.power_by_law(m, free, T_out_C)
        return np.asarray(power_W * (1.0 - share) if self._tank is not None and m == self._tank.m else power_W)

    def _of_rooms(self, power_W: Array, share: Array | float) -> Array:
        """Power (M, n) or (M,) as a record has it: NaN of the machine of the tank where that was charged."""
        if self._tank is None:
            return power_W
        out = power_W.copy()
        out[self._tank.m] = np.where(np.asarray(share) > CHARGED, np.nan, out[self._tank.m])
        return out

    def _power(
        self,
        free: Array,
        command: tuple[CommandValue | None, ...],
        seconds: float,
        tank: tuple[TankPart, TankPart],
    ) -> tuple[Array, Array, Array]:
        """Power of each machine (M,) at `free` levels (A,) under commands (A,): as it was, and what other levels change
        by the law, and other commands beside them and the tank, which is given for itself too (M,), as that of rooms.

        What lies below 0, since the law said more of what was than the meter, is taken off later: where only that were
        cut off, all that the meter said beyond the law would be paid twice.
        """
        T_out_C, machines = self._was.T_out_C[self._k : self._k + 1], range(len(self.power_W))
        was, now = (np.array([one.share]) for one in tank)
        law = np.array([self._by_law(m, free[:, None], T_out_C, now)[0] for m in machines])
        law_was, beside_W = self._law_was[:, self._k], np.zeros(len(law))
        if self._tank is not None:
            free_was, m = self._free_was[:, self._k : self._k + 1], self._tank.m
            law_was = law_was.copy()
            law_was[m] = self._by_law(m, free_was, T_out_C, was)[0]
        for i, one in enumerate(self._on_meters):
            told = command[one.first]
            value = None if isinstance(told, tuple) else told
            both = float(law_was[one.m]), float(law[one.m])
            (was_W, now_W), self._meter_states[i] = one.lived(self._k, value, both, seconds, self._meter_states[i])
            beside_W[one.m] = now_W - was_W
        rooms_W = self._rooms_was[:, self._k] + (law - law_was) + beside_W - self._owed_J / seconds
        self._owed_J = np.maximum(-rooms_W, 0.0) * seconds
        rooms_W = np.maximum(rooms_W, 0.0)
        power_W = rooms_W.copy()
        if self._tank is not None:
            more_W = tank[1].power_W - tank[0].power_W
            for_tank_W = (
                self._power_was[m, self._k] - self._rooms_was[m, self._k] + more_W - self._tank_owed_J / seconds
            )
            self._tank_owed_J = max(-for_tank_W, 0.0) * seconds
            power_W[m] += max(for_tank_W, 0.0)
            beside_W[m] += more_W
        return power_W, beside_W, rooms_W

    def _known_power(self, whole: Record) -> tuple[Array, Array]:
        """Power as it was (M, n), for the rooms and in all, by the law where it was not measured.

        Raises `DataError` where a machine has none.
        """
        for name, law in zip(whole.names.machines, self.model.power, strict=True):
            if law is None:
                raise DataError(f"the power of '{name}' was not measured: what other levels cost cannot be said")
        by_law = self._law_was.copy()
        for one in self._on_meters:
            by_law[one.m] += one.was_W
        rooms_W = np.where(np.isfinite(whole.power_W), whole.power_W, by_law)
        if self._tank is None:
            return rooms_W, rooms_W
        power_W, m, metered_W = rooms_W.copy(), self._tank.m, self._tank.power_W
        power_W[m] = np.where(np.isfinite(metered_W), metered_W, rooms_W[m] + self._tank.charge_W)
        return rooms_W, power_W

    def _go_on(
        self, level: Array, behind: Array, parts_W: tuple[Array, Array, Array], share: float, seconds: float
    ) -> None:
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
        each = zip(operator.of_actuators, level, strict=True)
        heat = np.array([float(own.heat_input(np.asarray(one), T_out_C)) for own, one in each])
        warmer_K = (self.forced_K - self._forced_was_now()).sum(axis=(1, 2))[list(operator.home)]
        heat *= np.clip(1.0 - self._less_per_K * warmer_K, *_HEAT_RANGE)
        self.forced_K = operator.advance(self.forced_K, operator.modulated(heat, x, self.forced_K))
        weight = seconds / step_s
        power_W, beside_W, rooms_W = parts_W
        rows = (
            (self.u, level),
            (self.power_W, power_W),
            (self.beside_W, beside_W),
            (self._rooms_W, rooms_W),
            (self._share[None], np.array([share])),
        )
        for row, values in rows:
            row[:, k] = values * weight if self._part_s == 0.0 else row[:, k] + values * weight
        self._behind_part = self._behind_part + behind * weight
        self._part_s += seconds
        self._now_s += seconds
        if self._part_s > step_s - _CLOCK_S:
            self._k, self._part_s = k + 1, 0.0
            self._behind, self._behind_part = self._behind_part, np.zeros(len(behind))
            self._now_s = float(self._was.time_s[self._k])
            self._T_C[:, self._k] = self._free_C[:, self._k] + self.forced_K.sum(axis=(1, 2))
            self._note_tank()

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


def _while_free(u: Array, share: Array, fed: Sequence[int]) -> Array:
    """Levels (A, n) while the machine of actuators `fed` was free of its tank, which it charged for a `share` (n,).

    A level by heat or power is none while the tank is charged, a valve may stay open: which of both it is, steps beside
    those without charging tell.
    """
    out = u.copy()
    k = np.flatnonzero((share[1:-1] > CHARGED) & (share[:-2] <= CHARGED) & (share[2:] <= CHARGED)) + 1
    for a in fed:
        beside = 0.5 * (u[a, k - 1] + u[a, k + 1])
        shut = float((beside * share[k]).sum())
        stays = 1.0 if abs(shut) < 1e-9 else float(np.clip((u[a, k].sum() - (beside.sum() - shut)) / shut, 0.0, 1.0))
        out[a] = u[a] / np.maximum(1.0 - share * (1.0 - stays), _LEAST_LEFT)
    return np.clip(out, -1.0, 1.0)
