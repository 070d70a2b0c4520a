"""What plans would have saved: the identified house lived through a record's weather again, as it was and planned.

Nobody knows the house exactly, so it is lived through several times: as the model has it, and in houses drawn from what
the model does not know, all under the controller of the one model, which plans anew each step and sees what comes.
Energy that the record does not tell lies between what the law of power says of the levels and what the rooms ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.commands.loop import LearnedCommand
from thermoforce_mpc.data import DAY_S, HOUR_S, J_PER_KWH, Array, Boundary, Period, Record
from thermoforce_mpc.data.dataframes import stamps as stamps_at
from thermoforce_mpc.data.dataframes import table
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.estimation.regression import BAND, STEP_RESPONSE_H
from thermoforce_mpc.loop.closed_loop import RunResult, run_closed_loop
from thermoforce_mpc.model.machine.change import Share, weight_of_demand
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.whatif.identified import step_response_of
from thermoforce_mpc.whatif.identified_house import IdentifiedHouse

LEAST_BEFORE_DAYS = 7.0
"""Days of a record before what is lived through again: forecasts begin there."""
# Statuses of plans that the model made.
_PLANNED = ("solved", "bridged", "acceptable")
# An effect is at most so many times as large or small (logarithm).
_MOST_LOG = 1.0
# Error of a change of power, as a share, below which the record bears its law out.
_EXACT = 0.1
# What a plan may be outside the bounds beyond what the house was, K·h a day in all zones, the step by which lower
# bounds are then raised, K, and how often.
_EQUAL_KH, _RAISED_K, _MOST_ROUNDS = 0.3, 0.25, 2


@dataclass(frozen=True)
class Lived:
    """A house under plans: its record, what it cost beside what it was, and K·h outside the bounds in all zones."""

    record: Record
    saved: float
    cost: float
    energy_kWh: float
    outside_Kh: float


@dataclass(frozen=True)
class Worth:
    """What plans would have saved over a stretch of a record.

    `saved` with its 90 % band `low` to `high`, `cost` and `cost_was`, currency; energies, kWh; `outside_Kh`, K·h in all
    zones; `warmer_K` (Z,): mean change of the zones' temperatures. `as_was`, `planned`: records of both, the latter in
    the house that the model takes for the likeliest. `raised_K`: how much bounds of plans were raised until these
    were as comfortable. `power`: how much of what its law says of other levels the record shows, by machine.
    `planned_share`: share of steps that the model planned. `rests_on`: one sentence.
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
    draws: tuple[float, ...]
    raised_K: float
    planned_share: float
    power: tuple[Share, ...]
    rests_on: str

    @property
    def sentence(self) -> str:
        """What is said of it in one sentence."""
        band = f"(90 % band {self.low:.2f} to {self.high:.2f})"
        share = f"{100 * self.saved / max(self.cost_was, 1e-9):.0f} %"
        if self.low > 0.0:
            return f"Plans would have saved {self.saved:.2f} {band} of {self.cost_was:.2f}, {share}"
        if self.high < 0.0:
            band = f"(90 % band {-self.high:.2f} to {-self.low:.2f} more)"
            return f"Plans would have cost {-self.saved:.2f} more {band} than {self.cost_was:.2f}"
        return f"Whether plans would have saved is not certain: {self.saved:.2f} {band} of {self.cost_was:.2f}"

    def to_dataframe(self) -> pd.DataFrame:
        """One row per step, at its start: price; level, temperature at its end and power, as it was and planned."""
        names, columns = self.as_was.names, dict[str, Array]()
        for what, record in (("was", self.as_was), ("planned", self.planned)):
            signals = {"u": record.u, "T_zone_C": record.T_zone_C[:, 1:], "power_W": record.power_W}
            for label, values in names.columns(**signals).items():
                name, bracket, row = label.partition("[")
                columns[f"{name}_{what}{bracket}{row}"] = values
        columns |= names.columns(price_per_kWh=self.price_per_kWh)
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
        error: of the weather forecasts; None: what was measured later.
        seed: of the draws.
        progress: called with a line for each house.

    Raises:
        DataError: the stretch is not in the record, power, a price or a bound is not known, or the model knows no
            uncertainty of an effect.
    """
    step_s = record.step_s
    first, n = round((start_s - record.time_s[0]) / step_s), round(days * DAY_S / step_s)
    if not first * step_s >= LEAST_BEFORE_DAYS * DAY_S or first + n > record.n_steps or n < 1:
        stamps, begin = record.stamps(), stamps_at(np.array([start_s]), record.origin)[0]
        raise DataError(
            f"{days:g} days from {begin} on are not in the record ({stamps[0]} to {stamps[-1]}) with "
            f"{LEAST_BEFORE_DAYS:g} days before: choose another start, or fewer days"
        )
    for name, after in (("lower_C", 1), ("upper_C", 1), ("price_per_kWh", 0)):  # a price is that of a step
        if not np.isfinite(getattr(conditions, name)[:, first : first + n + after]).all():
            raise DataError(f"{name} is not known throughout: name bounds in the map, and give prices of these days")
    spread = effect_spreads(model)
    rng = np.random.default_rng(seed)
    shares = tuple(model.power_change(m, record) for m in range(len(model.machines)))
    houses = [np.ones_like(spread), *(_drawn(rng, spread) for _ in range(draws))]
    unknown = np.vstack([[0.0, 0.5], np.column_stack([rng.standard_normal(draws), rng.random(draws)])])
    period = Period("record", float(record.time_s[first]), n * step_s, 0.0)

    def lived(k: int, raised_K: float) -> tuple[Lived, RunResult, Record]:
        lower_C = np.minimum(conditions.lower_C + raised_K, conditions.upper_C)
        house = IdentifiedHouse(
            model, record, replace(conditions, lower_C=lower_C), effects=houses[k], commands=commands, error=error
        )
        house.reset(period.start_s, 0.0)
        was = replace(record.slice(first, first + n), u=house.u[:, first : first + n])
        was = replace(was, power_W=house.power_W[:, first : first + n])
        result = run_closed_loop(house, controller, period)
        return _counted(model, house, was, conditions, shares, unknown[k], period), result, was

    raised_K = 0.0
    for _ in range(_MOST_ROUNDS + 1):
        likeliest, result, was = lived(0, raised_K)
        outside_was_Kh = _outside_Kh(was, conditions, first)
        progress(f"likeliest house: {likeliest.saved:+.2f}")
        if likeliest.outside_Kh <= outside_was_Kh + _EQUAL_KH * days or raised_K >= _MOST_ROUNDS * _RAISED_K:
            break
        raised_K += _RAISED_K
        progress(f"colder than it was: plans with bounds raised by {raised_K:g} K")
    others = []
    for k in range(1, draws + 1):
        others.append(lived(k, raised_K)[0])
        progress(f"house {k} of {draws}: {others[-1].saved:+.2f}")
    low, high = _band(likeliest.saved, [one.saved for one in others])
    price = conditions.price_per_kWh[:, first : first + n]
    power_kWh = was.power_W * step_s / J_PER_KWH
    planned = sum(count for status, count in result.fallback_levels().items() if status in _PLANNED)
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
        draws=tuple(one.saved for one in others),
        raised_K=raised_K,
        planned_share=planned / max(len(result.steps), 1),
        power=shares,
        rests_on=_rests_on(model, spread, shares, draws, error),
    )


def effect_spreads(model: ThermalModel) -> Array:
    """Relative standard deviation of what a day of each actuator does to each zone, (Z, A); 0 where it does nothing.

    Raises `DataError` where the model's card does not say it.
    """
    spread = np.zeros((len(model.operator.zones), len(model.operator.actuators)))
    at = STEP_RESPONSE_H.index(24) + 1
    for z, a, _ in model.operator.each():
        mean, sd = step_response_of(model, z, a)
        if not mean.size:
            names = model.operator.actuators[a], model.operator.zones[z]
            raise DataError(f"the model does not say how well it knows what {names[0]} does to {names[1]}: identify it")
        spread[z, a] = sd[at] / max(abs(mean[at]), 1e-9)
    return spread


def _drawn(rng: np.random.Generator, spread: Array) -> Array:
    return np.asarray(np.exp(np.clip(spread * rng.standard_normal(spread.shape), -_MOST_LOG, _MOST_LOG)))


def _counted(
    model: ThermalModel,
    house: IdentifiedHouse,
    was: Record,
    conditions: Boundary,
    shares: Sequence[Share],
    unknown: Array,
    period: Period,
) -> Lived:
    """What a house cost under plans beside what it was; `unknown` (2,): standard errors of the change of power, and
    how much of the energy goes by what the rooms ask for, where the record does not tell.
    """
    record = house.lived(period.start_s)
    first = round((period.start_s - conditions.time_s[0]) / record.step_s)
    price = conditions.price_per_kWh[:, first : first + record.n_steps]
    hours, layout = record.step_s / HOUR_S, model.layout
    saved = cost = energy = 0.0
    for m, share in enumerate(shares):
        fed = [layout.home[a] for a in layout.fed_by(m)]
        before, after = (one.power_W[m] * hours / 1000.0 for one in (was, record))
        cost_was, cost_law = float(before @ price[m]), float(after @ price[m])
        lost = [float(np.nanmean(one.T_zone_C[fed, 1:] - one.T_out_C[1:])) for one in (was, record)]
        asked_kWh = float(before.sum()) * max(lost[1], 0.0) / max(lost[0], 1.0)
        by_demand = unknown[1] * weight_of_demand(share.spread)
        factor = 1.0 + by_demand * (asked_kWh / max(float(after.sum()), 1e-9) - 1.0)
        planned = cost_law * factor
        planned += (cost_law - cost_was) * share.spread * unknown[0]
        mean_price = cost_was / max(float(before.sum()), 1e-9)
        stored = _stored_kWh(model, house, was, m, float(before.sum()) / max(period.scored_s / DAY_S, 1e-9))
        saved += cost_was - planned + stored * mean_price
        cost, energy = cost + planned, energy + float(after.sum()) * factor
    return Lived(record, saved, cost, energy, _outside_Kh(record, conditions, first))


def _stored_kWh(model: ThermalModel, house: IdentifiedHouse, was: Record, m: int, kWh_a_day: float) -> float:
    """Energy that machine `m` need not give later since rooms are warmer at the end than they were, kWh.

    What levels brought fades with each mode's time constant; a kelvin for an hour costs what it did in the record.
    """
    layout = model.layout
    fed = [layout.home[a] for a in layout.fed_by(m)]
    over_K = max(float(np.nanmean(was.T_zone_C[fed, 1:] - was.T_out_C[1:])), 1.0)
    warm_Kh = float(house.warmth_Kh[fed].mean())
    return warm_Kh * kWh_a_day / (DAY_S / HOUR_S) / over_K


def _outside_Kh(record: Record, conditions: Boundary, first: int) -> float:
    """K·h outside the bounds in all zones."""
    return float(np.nansum(conditions.outside_K(record.T_zone_C[:, 1:], first)) * record.step_s / HOUR_S)


def _band(saved: float, drawn: Sequence[float]) -> tuple[float, float]:
    """90 % band (low, high) of a saving from those of a few drawn houses: that of one more (Student's t)."""
    from scipy.special import stdtrit

    away = np.array(drawn) - saved
    n = away.size
    half = float(stdtrit(n, 0.95)) if n < 30 else BAND
    half *= float(np.sqrt(np.mean(away**2) * (1.0 + 1.0 / n)))
    return saved - half, saved + half


def _rests_on(
    model: ThermalModel, spread: Array, shares: Sequence[Share], draws: int, error: ForecastError | None
) -> str:
    home = model.operator.home
    own = [float(spread[z, a]) for a, z in enumerate(home)]
    not_fit = [name for name, card in zip(model.operator.actuators, model.cards, strict=True) if card.unfit]
    told = [share.spread <= _EXACT for share in shares]
    parts = [
        f"effects of full level known to ± {100 * float(np.mean(own)):.0f} % on the own room",
        f"{draws} houses that the model cannot exclude",
        "power by its law, which the record bears out"
        if all(told)
        else "power between what its law says of levels and what the rooms ask for, since the record does not tell",
        "the weather as it was measured" + (", with errors as of a forecast" if error is not None else ", known ahead"),
    ]
    if not_fit:
        parts.append(f"{', '.join(not_fit)} left to its own control, since the model may not act there")
    return f"It rests on {'; '.join(parts)}."
