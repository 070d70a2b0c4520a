"""What a plan in levels saves against the building left alone, as far as its record shows how it is left alone.

Nobody knows what a building's own control would set. What the record shows is what rooms are kept at: of each hour of
the day the temperature that they have on days in which their heat acts then. Left alone, each room is given the least
that keeps it there. Whether that is what the record's levels took is looked at: its days are lived again, each by the
habits of the others, and what it takes is compared with what was. Where days differ too much, nothing is said; else
what it takes is put right by them, and the band has what is left. Houses that differ by what the model does not know
are put right each by itself, so that an effect that is larger than it is thought changes little.

Where others are set by commands, what these save is the plan's own figure, by the same levels in both; here their rooms
are kept as usual in both, so that the two add up to what the whole plan saves (`of_both`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Boundary, Plan, PlannedSaving, Record, energy_kWh
from thermoforce_mpc.data.dataframes import clock_s, stamps
from thermoforce_mpc.data.series import bridged, interpolated
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.experiment.worth import effect_spreads
from thermoforce_mpc.model.drawn import expected_saving, free_errors_K, lasting, more_and_less, standard
from thermoforce_mpc.model.forced_state import followed
from thermoforce_mpc.model.forecast_gaps import completed
from thermoforce_mpc.model.machine.change import weight_of_demand
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.operator.parameters import OUTDOOR, feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel

# Last days of a record that are looked at, and least of them; of an hour, in which the heat acts, level of its step.
_DAYS, _LEAST_DAYS, _LEAST_ACTING, _ACTS = 21, 7, 3, 0.02
# Days are alike where what they take differs by so much at most from what habits say, root mean square, and all of them
# by so much; as shares. By judgement.
_ALIKE, _OFF = 0.35, 0.4
# What plans in levels save at all, and error of what is said beyond all else, as shares of the cost of the day left
# alone: what rooms hold at the end of a plan and take later was said 10 % of it wrong, and 10.5 % was saved or lost,
# root mean square of 15 plans of `house:3rooms:31000`, `house:4rooms:31001` to `house:4rooms:31004` (30 November 2026).
_SAVES, _BEYOND = 0.12, 0.1
_DRAWS, _SEED, _MOST_LOG, _ROUNDS, _TABLE = 40, 64, 1.0, 6, 33
LEFT_ALONE = "rooms kept as warm as they were at these hours while their heat acted"
"""What such a saving is compared with."""


def saving_of_levels(
    model: ThermalModel,
    history: Record,
    ahead: Boundary,
    plan: Plan,
    by_commands: Collection[int] = (),
    tank_machine: str = "",
) -> PlannedSaving:
    """What a plan in levels saves over its N steps, by the model and the habits of the record.

    Args:
        model: of the plan.
        history: what was measured until it begins, at its step.
        ahead: weather, bounds and prices of its steps.
        plan: its levels and temperatures.
        by_commands: numbers of its actuators that are set by commands, whose rooms are kept as usual.
        tank_machine: the machine that heats the tank of the plan, whose levels give rooms nothing meanwhile; what the
            tank itself saves is not in the figure.

    Raises:
        DataError: the record does not tell how the building is left alone; says why.
    """
    _check(model, plan)
    whole, _ = bridged(model.in_rooms(history))
    ahead, _ = completed(ahead, whole, None)
    habits = _Habits.of(model, whole)
    operator, rng = model.operator.resampled(whole.step_s), np.random.default_rng(_SEED)
    forced, spread = followed(model.operator, None, whole).forced_K, effect_spreads(model)
    gain = np.exp(np.clip(spread * standard((_DRAWS + 1, *spread.shape), rng), -_MOST_LOG, _MOST_LOG))
    ratio, scatter = habits.against_record(model, operator, whole, forced, gain)
    u, now = np.clip(plan.u, operator.u_min[:, None], 1.0), forced[:, :, -1]
    if plan.hot_water is not None:
        fed = list(model.layout.fed_by(model.layout.names.machines.index(tank_machine)))
        u[fed] *= 1.0 - np.minimum(plan.hot_water.share, 1.0)
    given = u.copy()
    given[list(by_commands)] = np.nan
    T_free_C = plan.T_zone_C - operator.rollout(now, u, _features(plan.T_zone_C, ahead)).sum(axis=(1, 3))
    x = _features(T_free_C, ahead)
    error_K = free_errors_K(model.cards, operator.home, len(operator.zones), ahead.time_s)
    away_K = lasting((len(gain), *T_free_C.shape), whole.step_s, rng) * error_K
    target_C = habits.at(clock_s(ahead.time_s[1:], history.origin), _is_weekend(ahead.time_s[:-1], history))
    begin, T_free_C = np.repeat(now[None], len(gain), axis=0), T_free_C + away_K
    u_alone, T_alone_C, after_alone = _kept(operator, begin, T_free_C, x, target_C, gain)
    u_plan, T_plan_C, after_plan = _kept(operator, begin, T_free_C, x, target_C, gain, given)
    hours = -whole.step_s / HOUR_S / np.log(np.clip(operator.poles, 1e-9, 1.0 - 1e-9))
    warmer_Kh = ((after_plan - after_alone) * hours).sum(axis=(2, 3))
    days = max(u.shape[1] * whole.step_s / DAY_S, 1.0)
    other = np.exp(scatter / np.sqrt(days) * standard(ratio.shape, rng)) / ratio
    both = _Both(u_plan, np.isnan(given[:, 0]), u_alone, other, T_plan_C, T_alone_C, warmer_Kh)
    return _compared([_cost(model, m, whole, ahead, both, rng) for m in range(len(model.machines))], both, ahead, rng)


@dataclass(frozen=True, eq=False)
class _Both:
    """Levels of S houses under a plan and left alone (S, A, N), which take `other` (S,) times what they say, but for
    those of the plan that are `given`, of actuators that do not keep a room (`keeps`, (A,)); temperatures of both
    (S, Z, N), °C, and by how much the plan leaves rooms warmer, `warmer_Kh` (S, Z), K·h.
    """

    u: Array
    keeps: NDArray[np.bool_]
    u_alone: Array
    other: Array
    T_plan_C: Array
    T_alone_C: Array
    warmer_Kh: Array


@dataclass(frozen=True, eq=False)
class _Cost:
    """What S houses cost and take by a plan and left `alone`, currency and kWh (S,); `stored`: what the plan leaves,
    and in the likeliest house `by_demand`: what it saves since its rooms are colder, and `given`: what rooms whose
    levels it gives cost left alone, currency.
    """

    cost: Array
    kWh: Array
    alone: Array
    alone_kWh: Array
    stored: Array
    by_demand: float
    given: float


def _cost(model: ThermalModel, m: int, record: Record, ahead: Boundary, both: _Both, rng: np.random.Generator) -> _Cost:
    """What machine `m` costs in both. Energy that the record does not tell lies between what the law of power says of
    levels and what the rooms ask for; what is used more and less errs each by itself.
    """
    per_W, price, T_out_C = energy_kWh(1.0, record.step_s), ahead.price_per_kWh[m, :-1], ahead.T_out_C
    fed, S = [model.layout.home[a] for a in model.layout.fed_by(m)], len(both.other)
    share = model.power_change(m, record)
    given = np.where(both.keeps[:, None], 0.0, both.u[0])
    idle_W, given_W = (model.power_by_law(m, one, T_out_C[:-1]) for one in (np.zeros_like(given), given))

    def in_houses(levels: Array, known_W: Array) -> Array:
        of_rooms_W = np.stack([model.power_by_law(m, one, T_out_C[:-1]) - known_W for one in levels])
        return np.asarray(known_W + of_rooms_W * both.other[:, None])

    alone_W, plan_W = in_houses(both.u_alone, idle_W), in_houses(both.u, given_W)
    if not np.isfinite(alone_W).all():
        raise DataError(f"the power of {model.layout.names.machines[m]} is not known")
    (alone_kWh, alone), (plan_kWh, law) = ((one.sum(axis=1) * per_W, one @ price * per_W) for one in (alone_W, plan_W))
    T_C = both.T_plan_C, both.T_alone_C
    over_K, over_alone_K = (np.maximum((one[:, fed] - T_out_C[1:]).mean(axis=(1, 2)), 1.0) for one in T_C)
    z_more, z_less = standard((S, 2), rng).T
    asked = alone_kWh * over_K / over_alone_K / np.maximum(plan_kWh, 1e-9)
    goes = np.append(0.5, rng.random(S - 1)) * weight_of_demand(share.spread)
    factor = 1.0 + goes * (asked - 1.0)
    more, less = more_and_less((plan_W[0] - alone_W[0]) * price * per_W, record.step_s)
    errs = more * z_more - less * z_less
    of_rooms = alone - float(idle_W @ price) * per_W
    an_hour_kWh = (alone_kWh - float(idle_W.sum()) * per_W) / (price.size * record.step_s / HOUR_S)
    stored = both.warmer_Kh[:, fed].mean(axis=1) * an_hour_kWh / over_alone_K * alone / np.maximum(alone_kWh, 1e-9)
    by_demand = float(of_rooms[0] * (1.0 - over_K[0] / over_alone_K[0]))
    given_alone = in_houses(np.where(both.keeps[:, None], 0.0, both.u_alone[:1]), idle_W)[0] @ price * per_W
    law = law * factor + share.spread * errs
    return _Cost(law, plan_kWh * factor, alone, alone_kWh, stored, by_demand, float(given_alone))


def _compared(machines: Sequence[_Cost], both: _Both, ahead: Boundary, rng: np.random.Generator) -> PlannedSaving:
    """What a plan saves, of all machines together."""
    cost, kWh, alone, alone_kWh, stored = (
        np.sum([getattr(one, of) for one in machines], axis=0) for of in ("cost", "kWh", "alone", "alone_kWh", "stored")
    )
    by_demand, given = (sum(getattr(one, of) for one in machines) for of in ("by_demand", "given"))
    saved = alone - cost + stored + _BEYOND * given * standard(alone.shape, rng)
    # What colder rooms need less comes true.
    expected, low, high = expected_saving(saved, _SAVES * float(given), float(by_demand))
    step_h = float(ahead.step_s) / HOUR_S
    outside = [float(ahead.outside_K(one[0]).sum()) * step_h for one in (both.T_plan_C, both.T_alone_C)]
    return PlannedSaving(
        saved=expected,
        low=low,
        high=high,
        cost=float(cost[0]) + float(saved[0]) - expected,
        cost_alone=float(alone[0]),
        energy_kWh=float(kWh[0]),
        energy_alone_kWh=float(alone_kWh[0]),
        outside_Kh=outside[0],
        outside_alone_Kh=outside[1],
        gain=expected,
    )


def of_both(commands: PlannedSaving, levels: PlannedSaving) -> PlannedSaving:
    """What a plan saves by its commands, at its levels, and by its levels, with the commands left alone.

    Both are of one model, whose errors may be the same: their bands add up.
    """
    more = {
        of: getattr(levels, f"{of}_alone{unit}") - getattr(levels, f"{of}{unit}")
        for of, unit in (("cost", ""), ("energy", "_kWh"), ("outside", "_Kh"))
    }
    return replace(
        commands,
        saved=commands.saved + levels.saved,
        low=commands.low + levels.low,
        high=commands.high + levels.high,
        cost_alone=commands.cost_alone + more["cost"],
        energy_alone_kWh=commands.energy_alone_kWh + more["energy"],
        outside_alone_Kh=max(commands.outside_alone_Kh + more["outside"], 0.0),
        gain=commands.gain + levels.gain,
    )


def _check(model: ThermalModel, plan: Plan) -> None:
    layout = model.layout
    if plan.u.size == 0 or not plan.followed.all():
        raise DataError("not all actuators follow the plan")
    if any(layout.home.count(z) != 1 for z in layout.home):
        raise DataError("a room has several actuators, and how its own control shares among them is not known")
    if min(layout.u_min) < 0.0 or min(layout.signs) < 0:
        raise DataError("an actuator cools, and its own control is looked at where it heats alone")
    for name, power in zip(layout.names.machines, model.power, strict=True):
        if power is None:
            raise DataError(f"the power of {name} is not known")
    if not np.isfinite(plan.T_zone_C).all():
        raise DataError("the temperature of a room is not known")


@dataclass(frozen=True, eq=False)
class _Habits:
    """What rooms were kept at: of days (D, K steps) temperatures `T_C` (Z, D, K) at the ends of steps, and whether
    their heat acted (Z, D, K); `weekend` (D,); `first`: number of the first step in the record.
    """

    T_C: Array
    acted: NDArray[np.bool_]
    weekend: NDArray[np.bool_]
    first: int

    @classmethod
    def of(cls, model: ThermalModel, record: Record) -> _Habits:
        """Of the last whole days of a record, each from its first step on: steps end when the record does."""
        per_day = DAY_S / record.step_s
        K = round(per_day)
        clock = clock_s(record.time_s, record.origin)
        begins = np.flatnonzero((clock + 1.0) % DAY_S < record.step_s)
        begins = begins[begins + K <= record.n_steps]
        if abs(per_day - K) > 1e-6 or begins.size < _LEAST_DAYS:
            raise DataError(f"the record has {begins.size} whole days, and {_LEAST_DAYS} tell how it is left alone")
        begins = begins[-_DAYS:]
        rows = begins[:, None] + np.arange(K)
        home = list(model.operator.home)
        own_C = record.T_zone_C[:, 1:][:, rows]
        acted = np.zeros(own_C.shape, dtype=bool)
        acted[home] = np.abs(record.u[:, rows]) > _ACTS
        weekend = _is_weekend(record.time_s[begins], record)
        return cls(own_C, acted & np.isfinite(own_C), weekend, int(begins[0]))

    def at(self, clock: Array, weekend: NDArray[np.bool_], without: int | None = None) -> Array:
        """What rooms are kept at at the ends of steps (Z, n), °C, by the clock `clock` (n,), s; −inf where
        no heat acts then. `without`: a day that does not count.
        """
        Z, D, K = self.T_C.shape
        counts = np.ones(D, dtype=bool)
        if without is not None:
            counts[without] = False
        place = (((clock + 1.0) / DAY_S * K).astype(np.intp) - 1) % K
        out = np.empty((Z, clock.size))
        for z in range(Z):
            for n, k in enumerate(place):
                used = counts & self.acted[z, :, k]
                alike = used & (self.weekend == weekend[n])
                used = alike if alike.sum() >= _LEAST_ACTING else used
                out[z, n] = np.median(self.T_C[z, used, k]) if used.sum() >= _LEAST_ACTING else -np.inf
        return out

    def against_record(
        self, model: ThermalModel, operator: BuildingOperator, record: Record, forced: Array, gain: Array
    ) -> tuple[Array, float]:
        """What habits take of what the record's days took, in S houses with effects `gain` (S, Z, A), (S,), and the
        scatter of days around it, as a share.

        Raises `DataError` where days are not alike.
        """
        (_, D, K), S = self.T_C.shape, len(gain)
        took, takes = np.empty(D), np.empty((S, D))
        for d in range(D):
            begin = self.first + round(float(d) * K)
            stretch = record.slice(begin, begin + K)
            free = np.array(
                [interpolated(row) for row in stretch.T_zone_C - forced[:, :, begin : begin + K + 1].sum(axis=(1, 3))]
            )
            x = feature_matrix(free[:, :-1], stretch.T_out_C[:-1], stretch.solar_W_m2[:-1], stretch.time_s[:-1])
            weekend = np.repeat(self.weekend[d], K)
            target = self.at(clock_s(stretch.time_s[1:], record.origin), weekend, without=d)
            state = np.repeat(forced[None, :, :, begin], S, axis=0)
            # What acted before is as the model has it, as at the begin of a plan.
            u, _, _ = _kept(operator, state, np.repeat(free[None, :, 1:], S, axis=0), x, target, gain)
            T_out_C = stretch.T_out_C[:-1]
            idle = model.powers_by_law(np.zeros_like(stretch.u), T_out_C).sum()
            took[d] = model.powers_by_law(stretch.u, T_out_C).sum() - idle
            takes[:, d] = [model.powers_by_law(one, T_out_C).sum() - idle for one in u]
        if not took.sum() > 0.0:
            raise DataError("no heat acted in the record's days")
        ratio = takes.sum(axis=1) / took.sum()
        scatter = float(np.std(takes[0] / max(ratio[0], 1e-9) - took) / took.mean())
        if abs(ratio[0] - 1.0) > _OFF or scatter > _ALIKE:
            raise DataError(
                f"how the building is left alone is no habit: kept as they usually are, rooms of the record's days "
                f"would have taken {100 * ratio[0]:.0f} % of what they took, and single days differ by "
                f"{100 * scatter:.0f} %"
            )
        return ratio, scatter


def _is_weekend(time_s: Array, record: Record) -> NDArray[np.bool_]:
    if record.origin is None:
        return np.zeros(np.shape(time_s), dtype=bool)
    return np.asarray(pd.DatetimeIndex(stamps(np.atleast_1d(time_s), record.origin)).day_of_week >= 5)


def _features(T_free_C: Array, ahead: Boundary) -> Array:
    """Features (Z, N, 4) with what is free at the ends of steps in the place of their beginnings."""
    return feature_matrix(T_free_C, ahead.T_out_C[:-1], ahead.solar_W_m2[:-1], ahead.time_s[:-1])


def _kept(
    operator: BuildingOperator,
    state: Array,
    T_free_C: Array,
    x: Array,
    target_C: Array,
    gain: Array,
    given: Array | None = None,
) -> tuple[Array, Array, Array]:
    """The least levels that keep rooms at `target_C` (Z, N) at the ends of steps: levels (S, A, N), temperatures
    (S, Z, N), and forced states at the end, of S houses with forced states `state` (S, Z, A, r), `T_free_C` (S, Z, N)
    and effects `gain` (S, Z, A) as a multiple. `given` (A, N): levels of actuators that keep no room, NaN of others.
    """
    S, A, N = len(state), len(operator.home), T_free_C.shape[-1]
    per_drive = operator.gains.sum(axis=2) * gain  # (S, Z, A)
    table = np.linspace(0.0, 1.0, _TABLE)
    u, T_C = np.zeros((S, A, N)), np.empty(T_free_C.shape)
    keeps = np.ones(A, dtype=bool) if given is None else np.isnan(given).any(axis=1)
    if given is not None:
        u[:, ~keeps] = given[~keeps]
    for k in range(N):
        faded = operator.poles * state
        at_rest = T_free_C[..., k] + faded.sum(axis=(2, 3))
        factor = operator.modulated(np.ones(A), x[:, k], state[0])
        heat = [
            np.asarray(operator.of_actuator(a).heat_input(table, np.full(_TABLE, x[z, k, OUTDOOR])))
            for a, z in enumerate(operator.home)
        ]
        drive = np.zeros((S, A))
        for a in np.flatnonzero(~keeps).tolist():
            T_out_C = np.full(S, x[operator.home[a], k, OUTDOOR])
            drive[:, a] = factor[a] * operator.of_actuator(a).heat_input(u[:, a, k], T_out_C)
        for _ in range(_ROUNDS):
            for a in np.flatnonzero(keeps).tolist():
                z = operator.home[a]
                others = (
                    at_rest[:, z] + np.einsum("sa,sa->s", per_drive[:, z], drive) - per_drive[:, z, a] * drive[:, a]
                )
                wanted = np.maximum(target_C[z, k] - others, 0.0) / np.maximum(per_drive[:, z, a] * factor[a], 1e-12)
                u[:, a, k] = np.interp(wanted, heat[a], table)
                drive[:, a] = factor[a] * np.interp(u[:, a, k], table, heat[a])
        state = faded + operator.gains * (gain * drive[:, None, :])[..., None]
        T_C[..., k] = T_free_C[..., k] + state.sum(axis=(2, 3))
    return u, T_C, state
