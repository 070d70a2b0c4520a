"""What plans would have saved: the identified house lived through a record's weather again, as it was and planned.

Nobody knows the house exactly, so it is lived through several times: as the model has it, and in houses drawn from what
the model does not know, all under the controller of the one model, which plans anew each step and sees what comes.
Energy that the record does not tell lies between what the law of power says of the levels and what the rooms ask for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from controllers.mpc.commands.costs import meters_of
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.commands.meter import beyond_sd, chance_sd
from thermoforce_mpc.commands.tank import LearnedTank, TankRecord
from thermoforce_mpc.data import (
    DAY_S,
    HOUR_S,
    NORMAL_95,
    Array,
    Boundary,
    Names,
    Period,
    PlanStatus,
    Record,
    energy_kWh,
)
from thermoforce_mpc.data.dataframes import clock_s, table
from thermoforce_mpc.data.dataframes import stamps as stamps_at
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.loop.closed_loop import StepRecord, run_closed_loop
from thermoforce_mpc.model.machine.change import Share, weight_of_demand
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.whatif.identified_house import HouseState, IdentifiedHouse
from thermoforce_mpc.whatif.lived_tank import LivedTank
from thermoforce_mpc.whatif.water import LESS_PER_K, VALVES_SD, of_water, others_by

LEAST_BEFORE_DAYS = 7.0
"""Days of a record before what is lived through again: forecasts begin there."""
PLANS = "plans"
"""What acts where the model's plans do, see `who_acted`."""
_PLANNED = (PlanStatus.SOLVED, PlanStatus.BRIDGED, PlanStatus.ACCEPTABLE)
_OTHERS = {
    PlanStatus.SHIFTED: "the plan before",
    PlanStatus.GUARD: "the comfort guard",
    PlanStatus.RULE: "a rule",
}
# Why something else acts at an actuator than plans.
_WHY = {
    PlanStatus.GATE: "since what it does is not known well enough",
    PlanStatus.WATCH: "since predictions did not come true",
    PlanStatus.THERMOSTAT: "since there was no plan",
    PlanStatus.NATIVE: "since there was no plan",
}
# An effect is at most so many times as large or small (logarithm).
_MOST_LOG = 1.0
# Error of a change of power, as a share, below which the record bears its law out.
_EXACT = 0.1
# What a plan may be outside the bounds more or less than the house was, K·h a day in all zones, the step by which lower
# bounds are then raised or lowered, K, and how often.
_EQUAL_KH, _RAISED_K, _MOST_ROUNDS = 0.3, 0.25, 2
# The same of a tank of hot water: by as much its lowest temperature is raised, K.
_TANK_RAISED_K = 1.0


Acted = Mapping[str, Mapping[str, float]]
"""Share of the steps by what acted, of each actuator by name."""


def who_acted(steps: Sequence[StepRecord], names: Names) -> Acted:
    """What acted at each actuator over `steps`: `PLANS`, or what else and why, with its share of them."""
    return {
        name: {what: n / len(steps) for what, n in Counter(_actor(step, a) for step in steps).most_common()}
        for a, name in enumerate(names.actuators)
    }


def _actor(step: StepRecord, a: int) -> str:
    status = step.acting[a]
    is_own = all(block.u[a] is None and block.command[a] is None for block in step.plan.blocks)
    if step.refused:
        return "its own control, since the plan was refused"
    if status in _PLANNED:
        return "its own control, since no plan was better" if is_own else PLANS
    if status in _OTHERS:
        return _OTHERS[status]
    return f"{'its own control' if is_own else 'the on/off rule'}, {_WHY[status]}"


def planned_share(acted: Acted) -> float:
    """Share of the steps in which plans acted, mean of the actuators."""
    return float(np.mean([shares.get(PLANS, 0.0) for shares in acted.values()]))


@dataclass(frozen=True, eq=False)
class TankWorth:
    """A tank as it was set and under plans, both by its model with what was drawn: temperature (n,) at the end of each
    step, °C, and K·h below what is wanted.
    """

    T_was_C: Array
    T_C: Array
    below_was_Kh: float
    below_Kh: float

    @property
    def in_words(self) -> str:
        """How warm it was in both."""
        return (
            f"Hot water: {self.below_Kh:.1f} instead of {self.below_was_Kh:.1f} K·h below what is wanted, "
            f"{float(np.mean(self.T_C - self.T_was_C)):+.1f} K on average"
        )


@dataclass(frozen=True, eq=False)
class Lived:
    """A house under plans: its record beside what it was, what it cost, its energy, and K·h outside the bounds in all
    zones and below the lower ones. `acted`: see `who_acted`; `after`, `controller`: where both stand at the end.
    """

    record: Record
    was: Record
    saved: float
    cost: float
    energy_kWh: float
    outside_Kh: float
    below_Kh: float
    acted: Acted
    tank: TankWorth | None
    after: HouseState
    controller: object


@dataclass(frozen=True)
class Worth:
    """What plans would have saved over a stretch of a record.

    `saved` with its 90 % band `low` to `high`, `cost` and `cost_was`, currency; energies, kWh; `outside_Kh`, K·h in all
    zones; `warmer_K` (Z,): mean change of the zones' temperatures. `as_was`, `planned`: records of both, the latter in
    the house that the model takes for the likeliest. `raised_K`, `tank_raised_K`: how much lowest temperatures of plans
    were raised, or lowered, until these were as comfortable. `tank`: None where none is lived through. `power`: how
    much of what its law says of other levels the record shows, by machine. `acted`: see `who_acted`. `rests_on`: one
    sentence. `lower_C` (Z, n): lower bound at the end of each step. `currency`: of the prices, '' where not known.
    """

    saved: float
    low: float
    high: float
    cost: float
    cost_was: float
    energy_kWh: float
    energy_was_kWh: float
    outside_Kh: float
    outside_was_Kh: float
    warmer_K: Array
    as_was: Record
    planned: Record
    price_per_kWh: Array
    lower_C: Array
    draws: tuple[float, ...]
    raised_K: float
    tank_raised_K: float
    tank: TankWorth | None
    acted: Acted
    power: tuple[Share, ...]
    rests_on: str
    currency: str = ""

    @property
    def sentence(self) -> str:
        """What is said of it in one sentence."""
        of = f" {self.currency}" if self.currency else ""
        band = f"(90 % band {self.low:.2f} to {self.high:.2f})"
        share = f"{100 * self.saved / max(self.cost_was, 1e-9):.0f} %"
        if self.low > 0.0:
            return f"Plans would have saved {self.saved:.2f}{of} {band} of {self.cost_was:.2f}, {share}"
        if self.high < 0.0:
            band = f"(90 % band {-self.high:.2f} to {-self.low:.2f} more)"
            return f"Plans would have cost {-self.saved:.2f}{of} more {band} than {self.cost_was:.2f}"
        return f"Whether plans would have saved is not certain: {self.saved:.2f}{of} {band} of {self.cost_was:.2f}"

    @property
    def stored(self) -> float:
        """What house and tank hold more at the end than they did is worth, currency; it is in `saved`."""
        return self.saved - (self.cost_was - self.cost)

    @property
    def acted_in_words(self) -> tuple[str, ...]:
        """What acted, a sentence for all actuators of which the same is to say."""
        same: dict[str, list[str]] = {}
        for name, shares in self.acted.items():
            told = "; ".join(f"{what} {100 * share:.0f} %" for what, share in shares.items())
            same.setdefault(told, []).append(name)
        if len(same) == 1:
            return (f"What acted: {next(iter(same))} of the time",)
        return tuple(f"What acted at {', '.join(names)}: {told} of the time" for told, names in same.items())

    def to_dataframe(self) -> pd.DataFrame:
        """One row per step, at its start: price; level, power, and temperatures at its end, as it was and planned."""
        names, columns = self.as_was.names, dict[str, Array]()
        for what, record in (("was", self.as_was), ("planned", self.planned)):
            signals = {"u": record.u, "T_zone_C": record.T_zone_C[:, 1:], "power_W": record.power_W}
            for label, values in names.columns(**signals).items():
                name, bracket, row = label.partition("[")
                columns[f"{name}_{what}{bracket}{row}"] = values
        columns |= names.columns(price_per_kWh=self.price_per_kWh)
        if self.tank is not None:
            columns |= {"T_tank_C_was": self.tank.T_was_C, "T_tank_C_planned": self.tank.T_C}
        return table(self.as_was.time_s[:-1], self.as_was.origin, **columns)


def worth(
    model: ThermalModel,
    record: Record,
    conditions: Boundary,
    controller: Controller,
    *,
    start_s: float,
    days: float,
    draws: int = 6,
    commands: Mapping[str, LearnedCommand] | None = None,
    hot_water: LoggedTank | str = "",
    bounds_kept: bool = False,
    error: ForecastError | None = None,
    seed: int = 0,
    progress: Callable[[str], None] = lambda line: None,
) -> Worth:
    """Live through a stretch of a record again under `controller`, which plans for `model` at the record's step.

    Args:
        model: of this building.
        record: a week or more before `start_s`, and the stretch.
        conditions: bounds and prices at the record's boundaries.
        controller: with the same model and commands.
        start_s, days: the stretch.
        draws: houses drawn from what the model does not know, beside the likeliest one; 2 or more.
        commands: learned commands of actuators that the controller sets by them.
        hot_water: the tank that the controller plans with; or the name of a machine that heats one of which nothing is
            known, so that hot water stays as it was; '' without one.
        bounds_kept: plans keep rooms inside `conditions` also where they were not in the record, and the comfort that
            this adds is paid for. Else no room is asked to be warmer than it was, or colder.
        error: of the weather forecasts; None: what was measured later.
        seed: of the draws.
        progress: called with a line when a house begins, which says what the one before it saves.

    Raises:
        DataError: the stretch is not in the record, power, a price or a bound is not known, or the model knows no
            uncertainty of an effect.
    """
    step_s = record.step_s
    first, n = record.nearest(start_s), round(days * DAY_S / step_s)
    if not first * step_s >= LEAST_BEFORE_DAYS * DAY_S or first + n > record.n_steps or n < 1:
        stamps, begin = record.stamps(), stamps_at(np.array([start_s]), record.origin)[0]
        raise DataError(
            f"{days:g} days from {begin} on are not in the record ({stamps[0]} to {stamps[-1]}) with "
            f"{LEAST_BEFORE_DAYS:g} days before: choose another start or fewer days, or give a longer record"
        )
    for name, after in (("lower_C", 1), ("upper_C", 1), ("price_per_kWh", 0)):  # a price is that of a step
        if not np.isfinite(getattr(conditions, name)[:, first : first + n + after]).all():
            raise DataError(f"{name} is not known throughout: name bounds in the map, and give prices of these days")
    logged = None if isinstance(hot_water, str) else hot_water
    houses = Houses(model, record, controller, draws=draws, seed=seed, commands=commands, hot_water=logged)
    asked = conditions if bounds_kept else as_comfortable(conditions, record)
    period = Period("record", float(record.time_s[first]), n * step_s, 0.0)
    span = f"over {days:g} day{'s' * (days != 1)} with a plan every {step_s / HOUR_S:g} h"
    progress(f"house 1 of {draws + 1}, the likeliest, {span}")
    raised = Raised()
    likeliest = houses.lived(0, period, conditions, asked=asked, error=error)
    outside_was_Kh, below_was_Kh = (of(likeliest.was, conditions, first) for of in (outside_Kh, _below_Kh))
    for _ in range(_MOST_ROUNDS):
        spare_Kh = 0.0 if bounds_kept else below_was_Kh - likeliest.below_Kh
        more = raised.further(likeliest, outside_was_Kh, spare_Kh, days)
        if more == raised:
            break
        progress(f"house 1 again, to be as comfortable as it had been: plans with {more.in_words}")
        again = houses.lived(0, period, conditions, asked=asked, raised=more, error=error)
        if more.rooms_K < raised.rooms_K and again.outside_Kh > outside_was_Kh + _EQUAL_KH * days:
            break
        raised, likeliest = more, again
    others: list[Lived] = []
    for k in range(1, draws + 1):
        saved = (others[-1] if others else likeliest).saved
        progress(f"house {k + 1} of {draws + 1}, {span}; house {k} saves {saved:.2f}")
        others.append(houses.lived(k, period, conditions, asked=asked, raised=raised, error=error))
    low, high = band_of(likeliest.saved, [one.saved for one in others])
    price, was = conditions.price_per_kWh[:, first : first + n], likeliest.was
    power_kWh = energy_kWh(was.power_W, step_s)
    return Worth(
        saved=likeliest.saved,
        low=low,
        high=high,
        cost=likeliest.cost,
        cost_was=float((power_kWh * price).sum()),
        energy_kWh=likeliest.energy_kWh,
        energy_was_kWh=float(power_kWh.sum()),
        outside_Kh=likeliest.outside_Kh,
        outside_was_Kh=outside_was_Kh,
        warmer_K=np.nanmean(likeliest.record.T_zone_C - was.T_zone_C, axis=1),
        as_was=was,
        planned=likeliest.record,
        price_per_kWh=price,
        lower_C=conditions.lower_C[:, first + 1 : first + n + 1],
        draws=tuple(one.saved for one in others),
        raised_K=raised.rooms_K,
        tank_raised_K=raised.tank_K,
        tank=likeliest.tank,
        acted=likeliest.acted,
        power=houses.shares,
        rests_on=_rests_on(model, houses.spread, houses.shares, draws, error, likeliest.acted, hot_water),
    )


@dataclass(frozen=True)
class LoggedTank:
    """A tank of hot water as it was learned, and what was measured of it over a record."""

    tank: LearnedTank
    logged: TankRecord


@dataclass(frozen=True)
class Raised:
    """By how much lowest temperatures of plans, of rooms and of the tank, are raised, K; below 0: lowered."""

    rooms_K: float = 0.0
    tank_K: float = 0.0

    @property
    def in_words(self) -> str:
        """What is raised by how much."""
        way = "raised" if self.rooms_K > 0.0 else "lowered"
        parts = [f"bounds {way} by {abs(self.rooms_K):g} K"] * (self.rooms_K != 0.0)
        return " and ".join(parts + [f"a tank warmer by {self.tank_K:g} K"] * (self.tank_K > 0.0))

    def of_bounds(self, conditions: Boundary) -> Boundary:
        """Bounds of rooms with lower ones that are raised, to the upper ones at most."""
        return replace(conditions, lower_C=np.minimum(conditions.lower_C + self.rooms_K, conditions.upper_C))

    def further(self, lived: Lived, outside_was_Kh: float, spare_Kh: float, days: float) -> Raised:
        """What is colder than it was over `days` raised by a step more, to two steps; rooms that are below their lower
        bounds by `spare_Kh` less than they were lowered.
        """
        rooms_K, tank_K, equal_Kh = self.rooms_K, self.tank_K, _EQUAL_KH * days
        if rooms_K >= 0.0 and lived.outside_Kh > outside_was_Kh + equal_Kh:
            rooms_K = min(rooms_K + _RAISED_K, _MOST_ROUNDS * _RAISED_K)
        elif rooms_K <= 0.0 and spare_Kh > equal_Kh:
            rooms_K = max(rooms_K - _RAISED_K, -_MOST_ROUNDS * _RAISED_K)
        if lived.tank is not None and lived.tank.below_Kh > lived.tank.below_was_Kh + equal_Kh:
            tank_K = min(tank_K + _TANK_RAISED_K, _MOST_ROUNDS * _TANK_RAISED_K)
        return Raised(rooms_K, tank_K)


_AS_IT_IS = Raised()


@dataclass(frozen=True, eq=False)
class _Beside:
    """What commands and a tank take on meters beside levels, more than as they were: `kWh` (M, n) in n steps,
    `later_kWh` (M,).
    """

    kWh: Array
    later_kWh: Array


class Houses:
    """Houses that a model of a record's house cannot exclude, the likeliest first, to be lived through it again.

    `spread` (Z, A): how well the model knows effects, see `effect_spreads`; `shares`: of what the law of power says of
    other levels, by machine.
    """

    def __init__(
        self,
        model: ThermalModel,
        record: Record,
        controller: Controller,
        *,
        draws: int,
        seed: int,
        commands: Mapping[str, LearnedCommand] | None,
        hot_water: LoggedTank | None = None,
    ) -> None:
        """Draw `draws` houses beside the likeliest; see `worth`. Raises as `effect_spreads` and `LivedTank`."""
        self._model, self._record, self._controller, self._commands = model, record, controller, commands
        self.spread, rng = effect_spreads(model), np.random.default_rng(seed)
        self.shares = tuple(model.power_change(m, record) for m in range(len(model.machines)))
        self._effects = [np.ones_like(self.spread), *(_drawn(rng, self.spread) for _ in range(draws))]
        mean, sd = LESS_PER_K
        self._of_water = of_water(model)
        self._less_per_K = np.outer([mean, *np.maximum(rng.normal(mean, sd, draws), 0.0)], self._of_water)
        # Standard errors of the change of power; how much of the energy goes by what the rooms ask for, where the
        # record does not tell; and standard errors of what other valves open together cost.
        of_law = np.column_stack([rng.standard_normal(draws), rng.random(draws), rng.standard_normal(draws)])
        self._unknown = np.vstack([[0.0, 0.5, 0.0], of_law])
        # What commands do on meters beside levels, in each house, and standard errors of that beyond it.
        found = meters_of(model, (commands or {}).values())
        drawn = [
            {name: replace(one, mean=one.drawn(rng.standard_normal(one.mean.size))) for name, one in found.items()}
            for _ in range(draws)
        ]
        self._meters, self._beyond = [found, *drawn], np.append(0.0, rng.standard_normal(draws))
        self._tanks: list[LivedTank | None] = [None] * (draws + 1)
        if hot_water is not None:
            z = np.vstack([np.zeros(3), rng.standard_normal((draws, 3))])
            self._tanks = [LivedTank(_drawn_tank(hot_water.tank, one), hot_water.logged, record) for one in z]

    def lived(
        self,
        k: int,
        period: Period,
        conditions: Boundary,
        *,
        asked: Boundary | None = None,
        raised: Raised = _AS_IT_IS,
        error: ForecastError | None = None,
        forecasts: Mapping[float, Boundary] | None = None,
        before: HouseState | None = None,
        state: object = None,
    ) -> Lived:
        """House `k` lived through `period` under plans.

        `asked`: with the bounds of plans, else those of `conditions`, by which comfort is counted; `raised`: by how
        much lowest temperatures of plans are higher; `before`, `state`: where house and controller stand at its begin,
        for others see `IdentifiedHouse`.
        """
        model, record, controller = self._model, self._record, self._controller
        asked = conditions if asked is None else asked
        if raised.tank_K:
            assert isinstance(controller, ThermoForceMPC)  # it plans a tank
            controller = controller.with_warmer_tank(raised.tank_K)
        first, n = record.nearest(period.start_s), round(period.scored_s / record.step_s)
        if (tank := self._tanks[k]) is not None:
            tank.check(period.start_s, period.start_s + period.scored_s)
        house = IdentifiedHouse(
            model,
            record,
            raised.of_bounds(asked),
            effects=self._effects[k],
            less_per_K=self._less_per_K[k],
            commands=self._commands,
            meters=self._meters[k],
            error=error,
            forecasts=forecasts,
            before=before,
            tank=tank,
        )
        was = replace(record.slice(first, first + n), u=house.u[:, first : first + n])
        was = replace(was, power_W=house.power_W[:, first : first + n])
        house.reset(period.start_s, 0.0)
        began_Kh, began_kWh = house.warmth_Kh, house.later_kWh
        result = run_closed_loop(house, controller, period, state=state)
        lived, price = house.lived(period.start_s), conditions.price_per_kWh[:, first : first + n]
        beside_kWh = energy_kWh(house.beside_W[:, first : first + n], record.step_s)
        beside = _Beside(beside_kWh, house.later_kWh - began_kWh)
        counted = self._counted(k, lived, was, price, house.warmth_Kh - began_Kh, beside)
        return Lived(
            lived,
            was,
            *counted,
            outside_Kh(lived, conditions, first),
            _below_Kh(lived, conditions, first),
            who_acted(result.steps, record.names),
            None if tank is None else _of_tank(house, slice(first + 1, first + n + 1)),
            house.state,
            result.state,
        )

    def _counted(
        self, k: int, record: Record, was: Record, price: Array, warmer_Kh: Array, beside: _Beside
    ) -> tuple[float, float, float]:
        """What house `k` saved under plans, what it cost and its energy; `warmer_Kh` (Z,): of its rooms at the end.

        What commands do on meters is no heat of the rooms. Heat that is stored then need not be given later: it fades
        with each mode's time constant, and a kelvin for an hour costs what it did in the record. What meters hold
        beside the levels, such as hot water, warms no room.
        """
        hours, layout = record.step_s / HOUR_S, self._model.layout
        of_law, of_demand, of_valves = self._unknown[k]
        saved = cost = energy = 0.0
        for m, share in enumerate(self.shares):
            fed = [layout.home[a] for a in layout.fed_by(m)]
            before, after = (energy_kWh(one.power_W[m], record.step_s) for one in (was, record))
            after = after - beside.kWh[m]
            cost_was, cost_law = float(before @ price[m]), float(after @ price[m])
            lost_K = [max(float(np.nanmean(one.T_zone_C[fed, 1:] - one.T_out_C[1:])), 0.0) for one in (was, record)]
            over_K = max(lost_K[0], 1.0)
            rooms_kWh = self._of_levels_kWh(m, was)
            asked_kWh = float(before.sum()) + rooms_kWh * (lost_K[1] / over_K - 1.0)
            by_demand = of_demand * weight_of_demand(share.spread)
            factor = 1.0 + by_demand * (asked_kWh / max(float(after.sum()), 1e-9) - 1.0)
            planned = cost_law * factor
            planned += (cost_law - cost_was) * share.spread * of_law
            valves = [a for a in layout.fed_by(m) if self._of_water[a]]
            planned += cost_law * VALVES_SD * others_by(was.u[valves], record.u[valves]) * of_valves
            mean_price = cost_was / max(float(before.sum()), 1e-9)
            an_hour_kWh = rooms_kWh / max(record.n_steps * hours, 1e-9)
            stored_kWh = float(warmer_Kh[fed].mean()) * an_hour_kWh / over_K
            of_commands, later = float(beside.kWh[m] @ price[m]), float(beside.later_kWh[m]) * mean_price
            planned += of_commands
            saved += cost_was - planned + stored_kWh * mean_price - later
            saved += self._beyond[k] * self._beyond_sd(m, of_commands + later, record, price[m])
            cost, energy = cost + planned, energy + float(after.sum()) * factor + float(beside.kWh[m].sum())
        return saved, cost, energy

    def _beyond_sd(self, m: int, moved: float, record: Record, price: Array) -> float:
        """Standard error of what commands do on the meter of machine `m`, currency, of which `moved` is said."""
        meter = self._meters[0].get(self._model.names.machines[m])
        if meter is None or moved == 0.0:
            return 0.0
        at_s = clock_s(record.time_s[:-1], record.origin)
        return beyond_sd(moved, 0.0, 0.0, chance_sd(meter.scatter_W, price, at_s, record.step_s))

    def _of_levels_kWh(self, m: int, was: Record) -> float:
        """What levels took of the energy of machine `m`, kWh, by the law; where there is none, all of it."""
        metered_kWh = energy_kWh(float(was.power_W[m].sum()), was.step_s)
        T_out_C = was.T_out_C[:-1]
        by_law_W, idle_W = (self._model.power_by_law(m, u, T_out_C) for u in (was.u, np.zeros_like(was.u)))
        of_levels_kWh = energy_kWh(float((by_law_W - idle_W).sum()), was.step_s)
        return min(max(of_levels_kWh, 0.0), metered_kWh) if np.isfinite(of_levels_kWh) else metered_kWh


def effect_spreads(model: ThermalModel) -> Array:
    """Relative standard deviation of what a day of each actuator does to each zone, (Z, A); 0 where it does nothing.

    Raises `DataError` where the model's card does not say it.
    """
    spread = np.zeros((len(model.operator.zones), len(model.operator.actuators)))
    for z, a, _ in model.operator.each():
        spread[z, a] = model.relative_sd(z, a)
        if not np.isfinite(spread[z, a]):
            names = model.operator.actuators[a], model.operator.zones[z]
            raise DataError(f"the model does not say how well it knows what {names[0]} does to {names[1]}: identify it")
    return spread


def _drawn(rng: np.random.Generator, spread: Array) -> Array:
    return np.asarray(np.exp(np.clip(spread * rng.standard_normal(spread.shape), -_MOST_LOG, _MOST_LOG)))


def as_comfortable(conditions: Boundary, record: Record) -> Boundary:
    """The bounds as far as `record` kept them, at the same times: a saving is one at equal comfort."""
    T_C = record.T_zone_C
    return replace(conditions, lower_C=np.fmin(conditions.lower_C, T_C), upper_C=np.fmax(conditions.upper_C, T_C))


def outside_Kh(record: Record, conditions: Boundary, first: int) -> float:
    """K·h outside the bounds in all zones."""
    return float(np.nansum(conditions.outside_K(record.T_zone_C[:, 1:], first)) * record.step_s / HOUR_S)


def _below_Kh(record: Record, conditions: Boundary, first: int) -> float:
    """K·h below the lower bounds in all zones."""
    no_upper = replace(conditions, upper_C=np.full_like(conditions.upper_C, np.inf))
    return outside_Kh(record, no_upper, first)


def band_of(saved: float, drawn: Sequence[float]) -> tuple[float, float]:
    """90 % band (low, high) of a saving from those of a few drawn houses: that of one more (Student's t)."""
    from scipy.special import stdtrit

    away = np.array(drawn) - saved
    n = away.size
    half = float(stdtrit(n, 0.95)) if n < 30 else NORMAL_95
    half *= float(np.sqrt(np.mean(away**2) * (1.0 + 1.0 / n)))
    return saved - half, saved + half


def _drawn_tank(tank: LearnedTank, z: Array) -> LearnedTank:
    """A tank that `tank` cannot exclude: its energy, standing loss and band by standard normal numbers `z` (3,)."""
    share = float(np.clip(tank.energy_sd / tank.energy[0] * z[0], -_MOST_LOG, _MOST_LOG))
    return replace(
        tank,
        energy=tank.energy * np.exp(share),
        loss_1_h=max(tank.loss_1_h + tank.loss_sd * float(z[1]), 0.0),
        band_K=max(tank.band_K + tank.band_sd * float(z[2]), 0.0),
    )


def _of_tank(house: IdentifiedHouse, at: slice) -> TankWorth:
    was_Kh, now_Kh = house.tank_below_Kh.tolist()
    return TankWorth(house.tank_C[0, at], house.tank_C[1, at], was_Kh, now_Kh)


def without_tank(machine: str) -> str:
    """What is said where `machine` heats a tank of hot water too, of which the identified house knows nothing."""
    return (
        f"hot water of {machine} as it was, since the house is lived through without its tank: what plans do with it"
        " is not counted"
    )


def _rests_on(
    model: ThermalModel,
    spread: Array,
    shares: Sequence[Share],
    draws: int,
    error: ForecastError | None,
    acted: Acted,
    hot_water: LoggedTank | str,
) -> str:
    home = model.operator.home
    own = [float(spread[z, a]) for a, z in enumerate(home)]
    cards = zip(model.operator.actuators, model.cards, strict=True)
    doubted = [name for name, card in cards if card.unfit and acted[name].get(PLANS)]
    told = [share.spread <= _EXACT for share in shares]
    parts = [
        f"effects of full level known to ± {100 * float(np.mean(own)):.0f} % on the own room",
        f"{draws} houses that the model cannot exclude",
        "power by its law, which the record bears out"
        if all(told)
        else "power between what its law says of levels and what the rooms ask for, since the record does not tell",
        "the weather as it was measured" + (", with errors as of a forecast" if error is not None else ", known ahead"),
    ]
    if isinstance(hot_water, LoggedTank):
        parts.append(
            "hot water by the model of its tank, whose energy is known to "
            f"± {100 * NORMAL_95 * hot_water.tank.energy_sd / hot_water.tank.energy[0]:.0f} %, with what was drawn then"
        )
    elif hot_water:
        parts.append(without_tank(hot_water))
    if doubted:
        parts.append(f"plans for {', '.join(doubted)}, although the verdict on the model there is that it may not act")
    return f"It rests on {'; '.join(parts)}."
