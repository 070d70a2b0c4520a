"""What machines took in a stretch of a record, and what they would have taken under other levels.

By the law of power that a model has of each machine, corrected by what the meter said of the stretch, with a band: of
the law, of valves that are held, of emitters whose valves are less open, and of rooms that are colder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, NORMAL_95, Array, Record, energy_kWh, steps_in
from thermoforce_mpc.data.series import rms
from thermoforce_mpc.model.machine.change import Share
from thermoforce_mpc.model.machine.other_load import own_W
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.days import LEAST_MEASURED
from thermoforce_mpc.whatif.water import EMITTERS, VALVES_SD, emitted, of_water, others_by

# Error of a change of power, as a share, up to which its law alone counts.
_EXACT = 0.1
# A level is held between off and full where it lies between these and stays within a range for an hour; a record in
# which a valve did so in a smaller share of the time that it was open does not tell what it takes then. Emitters of
# valves that only open and close are warm while they are open: valves held at 0.2 to 0.7 took 1.2 to 2.2 times the
# energy that the record's law says (`house:3rooms:101`, 28 November 2026); the band reaches to `_HELD` times.
_PART, _WITHIN, _SEEN, _HELD = (0.1, 0.9), 0.15, 0.05, 2.5
# What a level takes more per K by which a day of other levels makes its room colder, as a share, where water of several
# valves carries it, beside what its emitter takes, and its standard deviation: with 0.03 days without heat at night, or
# with levels of three hours later, come out right in the mean in eight houses (3.9 and 2.3 % root mean square; 5.0 and
# 2.2 % with 0, 9.4 and 4.0 % with 0.08; seeds 33021 and 33022 of `bench effects --mode operation`, 30 November 2026).
_COLDER = (0.03, 0.04)
# A valve that was open less than this share of a record says little of its heat: standard deviation of that, as a
# share. Where such valves of four drawn houses (seeds 33021, 33022) open every other hour with all others, laws say 12
# to 23 % too little.
_RARE, _RARE_SD = 0.05, 0.4
# Least days of a record that tell how far its law is off on one, and what it is with fewer. By judgement.
_LEAST_DAYS, _FEW_DAYS_SD = 6, 0.1


@dataclass(frozen=True)
class Energies:
    """What machines took, and would have taken: `was_kWh`, `other_kWh`, and the 90 % band of the latter from `low_kWh`
    to `high_kWh`, each (M,); `power_W`, `power_other_W` (M, N): by the law. NaN where a machine has none.
    """

    was_kWh: Array
    other_kWh: Array
    low_kWh: Array
    high_kWh: Array
    power_W: Array
    power_other_W: Array


@dataclass(frozen=True)
class _Told:
    """What a record tells of the power of a machine: how much of a change by its law, see `_beside_law`, and which of
    its actuators (a,) hardly acted.
    """

    share: Share
    metered: float
    usual: float
    errors: float
    rare: NDArray[np.bool_]


class _Emitters(NamedTuple):
    """Emitters of valves: how well they `take` heat, see `EMITTERS`; how warm they are before a stretch, `warmth` (A,);
    the level over the heat of one that is used as usual; `as_it_was` (M,): what machines took, over their law.
    """

    take: float
    warmth: Array
    usual: float
    as_it_was: Array


@dataclass(frozen=True)
class StretchEnergy:
    """The energy of a stretch: of `record` from step `first` to the end of `whole`, which is the record without gaps
    until then. What is asked of any other levels is worked out once.
    """

    model: ThermalModel
    record: Record
    whole: Record
    first: int

    @cached_property
    def stretch(self) -> Record:
        """The stretch, without gaps."""
        return self.whole.slice(self.first, self.whole.n_steps)

    @cached_property
    def applied(self) -> Array:
        """Levels that were applied (A, N)."""
        return np.clip(self.stretch.u, self.model.operator.u_min[:, None], 1.0)

    @cached_property
    def beside_kWh(self) -> Array:
        """What other loads on the meters of machines (M,) took, kWh."""
        loads = [None if power is None else power.foreign for power in self.model.power]
        time_s, T_out_C = self.stretch.time_s[:-1], self.stretch.T_out_C[:-1]
        each = [0.0 if one is None else float(one(time_s, T_out_C).sum()) for one in loads]
        return energy_kWh(np.array(each), self.stretch.step_s)

    def under(self, levels: Array, effect_K: Array) -> Energies:
        """Energies under `levels` (A, N), which change the rooms by `effect_K` (Z, N)."""
        power_W, power_other_W = self._by_law_W(self.applied), self._by_law_W(levels)
        was, other = (energy_kWh(power.sum(axis=1), self.stretch.step_s) for power in (power_W, power_other_W))
        more, more_sd = self._of_emitters(levels)
        each = zip(was, other * more, other * more_sd, strict=True)
        was, other, low, high = np.array([self._energy(m, levels, effect_K, *one) for m, one in enumerate(each)]).T
        unseen = [self._never_held(m, levels) for m in range(len(self.model.machines))]
        high = np.where(unseen, np.fmax(high, _HELD * other), high)
        return Energies(was, other, low, high, power_W, power_other_W)

    def _by_law_W(self, levels: Array) -> Array:
        return self.model.powers_by_law(levels, self.stretch.T_out_C[:-1])

    def _energy(
        self, m: int, u: Array, effect_K: Array, was: float, other: float, emitters_sd: float
    ) -> tuple[float, float, float, float]:
        """Energy of machine `m` as it was and under levels `u` (A, N) with its 90 % band, kWh.

        `was`, `other`: by the law of power, the latter with what emitters take more, known to `emitters_sd`; `effect_K`
        (Z, N): what the levels change. What the meter said more or less than the law of the stretch it says of the
        other levels too. Rooms that are colder take more from the water.
        """
        if not np.isfinite(other):
            return was, other, np.nan, np.nan
        model, stretch, told = self.model, self.stretch, self._told(m)
        metered, usual, share = told.metered, told.usual, told.share
        known = bool(np.isfinite(metered)) and was > 0.0
        # What the law lacks on all days goes with levels, and others may not have it; on this one alone it is weather.
        ratio = metered / was / usual if known else 1.0
        shift = metered - was * usual if known else 0.0
        fed = list(model.layout.fed_by(m))
        homes = [model.operator.home[a] for a in fed]
        weights: Array = u[fed] * (np.array(model.layout.weights) * of_water(model))[fed, None]
        warmer_K = float((weights * effect_K[homes]).sum() / max(float(weights.sum()), 1e-9))
        less, less_sd = _COLDER
        colder = float(np.clip(1.0 - less * warmer_K, 0.0, None))
        by_law, said = (other + shift) * colder, other * ratio * colder
        was = metered if known else was
        differs = others_by(stretch.u[fed], u[fed])
        several = VALVES_SD if weights.any() else 0.0
        opened: Array = (weights * np.maximum(u[fed] - stretch.u[fed], 0.0))[told.rare]
        of_rare = _RARE_SD * float(opened.sum() / max(float(weights.sum()), 1e-9))
        of_change, of_levels = share.sd * abs(said - was), float(np.hypot(several, told.errors)) * differs * said
        of_rooms = less_sd * warmer_K * other * ratio
        sd = float(np.linalg.norm([of_change, of_levels, of_rare * said, of_rooms, emitters_sd * ratio]))
        ends = [was + (said - was) * share.mean + sign * NORMAL_95 * sd for sign in (-1.0, 1.0)]
        ends += [said, by_law, said * usual]
        if share.spread > _EXACT:  # levels that follow the demand stand for it in the law
            over_K = stretch.T_zone_C[homes, 1:] - stretch.T_out_C[1:]
            asked = np.nanmean(over_K + effect_K[homes]) / max(float(np.nanmean(over_K)), 1.0)
            ends.append(was * max(float(asked), 0.0))
        return was, said, max(min(ends), 0.0), max(ends)

    @cached_property
    def _told(self) -> Callable[[int], _Told]:
        @cache
        def told(m: int) -> _Told:
            rare = np.nanmean(self.record.u[self.model.layout.fed_by(m)], axis=1) < _RARE
            return _Told(self.model.power_change(m, self.record), *self._beside_law(m), rare)

        return told

    def _beside_law(self, m: int) -> tuple[float, float, float]:
        """What the meter said of the stretch, kWh, NaN where it was not read; what it says of all days, over what the
        law does, and the standard deviation of single days around it, as a share.
        """
        record, stretch, power = self.record, self.stretch, self.model.power[m]
        assert power is not None  # it has a law
        law_W = self.model.power_by_law_of(m, record)
        metered_W = own_W(record.power_W[m : m + 1], [power.foreign], record, of_days=True)[0]
        part = metered_W[self.first : self.first + stretch.n_steps]
        read = np.isfinite(part).mean() >= LEAST_MEASURED
        metered = energy_kWh(float(np.nanmean(part)), stretch.n_steps * record.step_s) if read else float("nan")
        n = steps_in(DAY_S, record.step_s)
        both = np.isfinite(law_W) & np.isfinite(metered_W)
        starts = [k for k in range(0, record.n_steps - n + 1, n) if both[k : k + n].mean() >= LEAST_MEASURED]
        law, meter = (np.array([one[k : k + n][both[k : k + n]].mean() for k in starts]) for one in (law_W, metered_W))
        if len(starts) < _LEAST_DAYS or not law.sum() > 0.0 or not meter.sum() > 0.0:
            return metered, 1.0, _FEW_DAYS_SD
        usual = float(meter.sum() / law.sum())
        return metered, usual, float(rms(meter - usual * law) / meter.mean())

    def _of_emitters(self, levels: Array) -> tuple[Array, Array]:
        """How much more machines (M,) take under `levels` (A, N) than their laws say beside the levels applied, and its
        standard deviation: emitters whose valves are less open take more from the water.
        """
        if not self._valves.any():
            return np.ones(len(self.model.machines)), np.zeros(len(self.model.machines))
        likely, better = (self._over_law(levels, one) / one.as_it_was for one in self._emitters)
        return likely, np.abs(better - likely)

    @cached_property
    def _valves(self) -> NDArray[np.bool_]:
        """Which actuators (A, 1) take heat from water that others share."""
        return of_water(self.model)[:, None] > 0.0

    @cached_property
    def _emitters(self) -> tuple[_Emitters, _Emitters]:
        """The likely ones, and ones that take heat better by a standard deviation."""
        median, log_sd = EMITTERS
        return self._emitters_that_take(median), self._emitters_that_take(median * float(np.exp(log_sd)))

    def _emitters_that_take(self, heat: float) -> _Emitters:
        before = self.whole.u[:, : self.first]
        past, warmth = emitted(before, self.whole.step_s, heat)
        here, _ = emitted(self.applied, self.whole.step_s, heat, warmth)
        usual = (before.sum() + self.applied.sum()) / max(float(past.sum() + here.sum()), 1e-9)
        found = _Emitters(heat, warmth, usual, np.ones(len(self.model.machines)))
        return found._replace(as_it_was=self._over_law(self.applied, found))

    def _over_law(self, levels: Array, emitters: _Emitters) -> Array:
        """What machines (M,) take where `emitters` take the heat of `levels` (A, N), over what the law says of them."""
        heat = emitters.usual * emitted(levels, self.whole.step_s, emitters.take, emitters.warmth)[0]
        W, by_law_W = (self._by_law_W(u).sum(axis=1) for u in (np.where(self._valves, heat, levels), levels))
        return np.divide(W, by_law_W, out=np.ones(len(by_law_W)), where=by_law_W > 0.0)

    def _never_held(self, m: int, levels: Array) -> bool:
        """Whether valves of machine `m` are asked to be held between off and full, and hardly were in the record."""
        record, fed = self.record, list(self.model.layout.fed_by(m))
        if len(fed) < 2:
            return False
        step_s = record.step_s
        return any(_held_between(levels[a], step_s) > _SEEN > _held_between(record.u[a], step_s) for a in fed)


def _held_between(u: Array, step_s: float) -> float:
    """In which share of the hours of `u` (n,), in which the level is not off, it is held between off and full."""
    n = min(max(2, round(HOUR_S / step_s)), u.size)
    hours = np.lib.stride_tricks.sliding_window_view(u, n)
    acting = np.nanmean(hours, axis=1) if np.isfinite(hours).any() else np.zeros(len(hours))
    held = (acting > _PART[0]) & (acting < _PART[1]) & (np.ptp(hours, axis=1) < _WITHIN)
    return float(held.sum() / max(np.count_nonzero(acting > _PART[0]), 1))
