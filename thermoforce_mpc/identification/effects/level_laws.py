"""What a level gives where heat is not measured: over the outdoor temperature, while it is held, and at part load.

A heat pump gives less heat at full level when it is cold, a circuit on a heating curve gives more. Operation acts most
when it is cold, so a fit that takes every level for the same heat is wrong in one direction, the more certainly so the
longer the record. A valve that opens for short spells, as that of a bedroom, gives more than in hours, since its
emitter is cold: its effect would be said half too large, and too small where a valve is open for most of the time. Each
such law is one parameter c of the drive, v = u + c φ, with φ by levels and T_out, and so one of the network of the
building (`network.room`), estimated beside all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Layout, Record, steps_in
from thermoforce_mpc.data.series import lagged, rms, step_means
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import EFFECT_H
from thermoforce_mpc.model.machine.heat_capacity import kinds_for
from thermoforce_mpc.model.machine.load import LEVEL_EDGE
from thermoforce_mpc.model.machine.power import COMPARED_AT, LevelCost, PowerModel, squares_of
from thermoforce_mpc.model.operator.heat_input import HeatInput

OUTDOORS = "heat_per_K"
"""Law: change of the heat of a level with the outdoor temperature, 1/K."""
HELD = "heat_when_held"
"""Law: how much of its heat a valve loses while it stays open, as a share of that of full level."""
# Heat of a circuit on a heating curve falls to nothing at an outdoor temperature of so much, °C, for a room at
# `_ROOM_C`, and so much lower for each K that the room is warmer: a curve that is set 2 to 4 K higher than the room.
# Least distance to it, K, and standard deviation of the relative change of heat, 1/K: water that is not on a curve, or
# a machine at its limit, changes less. So what 27 circuits of nine drawn houses (seeds 10407, 9881; 2026-11-30) give a
# week later is foretold within 8 % from their mean heat, by the mean alone within 22 %.
_ROOM_C, _NO_HEAT_C, _LOWER_BY, _LEAST_REACH_K, _PER_K_SD = 20.0, 23.0, 1.1, 6.0, 0.025
# Heat of a valve that is open for long, below that of one that was closed for long, as a share of it, mean and standard
# deviation, and with which time constant it falls, h: water meets an emitter that is warm already. By their heat floors
# of these houses have 0.23 to 0.53, radiators 0.04 to 0.32; 1.5 h is as good.
_HELD_PRIOR, _HELD_H = (0.3, 0.15), 3.0
# Levels of part load whose heat is one number: name, above, up to.
PART_LOADS = (("heat_at_low_level", LEVEL_EDGE, 0.375), ("heat_at_middle_level", 0.375, 1.0 - LEVEL_EDGE))
# Largest change of heat with the outdoor temperature, 1/K, and least heat of a level anywhere in the record, as a share
# of that at the mean. By judgement: a heating curve has 0.04 to 0.07, in mild weather up to 0.11.
_MOST_PER_K, _LEAST_FACTOR = 0.15, 0.2
# Heat per level at part load over that at full level: prior without a power meter, and range. Heat is a concave law of
# the level: below 1 an estimate is noise, and would switch an electric heater for a loss that it cannot have.
_HEAT_PRIOR, _LEAST_HEAT = (1.1, 0.25), 1.0
# The same over what the part of the power that goes with the heat says, mean and standard deviation: water that is
# cooler at part load gives more heat for it. Of 25 generated machines 1.04 ± 0.10.
_OF_POWER = (1.04, 0.1)
# A fixed part above this share of full power needs evidence: fans and pumps are a third of it at most, while a valve
# that gives most of its heat at a quarter looks the same on the meter. Power is then taken for heat, and temperatures
# decide: relative standard deviation of that.
_MOST_FIXED, _FLAT_SD = 0.5, 0.35
# A machine whose water reaches its limit in long runs at full level gives less heat and takes less power there than in
# their first half hour. Blocks are such short runs: part load is compared with these where they take so much more
# power. How much more of heat than of power they have, since the water is colder, with its deviation (three generated
# heat pumps, 28 November 2026: 1.05 to 1.1).
_FRESH_S, _WEAKENS, _FRESH_HEAT = 1800.0, 1.05, (1.07, 0.04)
# Relative standard deviation of the cost by what one number for all part load and a linear law of power are not. By
# judgement (2026-11-25).
_COST_SD = 0.03
# Steps at part load from which their heat is estimated. By judgement: probing tries part load for four steps or more.
_LEAST_STEPS = 4


@dataclass(frozen=True)
class LevelLaw:
    """An unknown of what a level gives: φ of levels u (n,) and T_out (n,) °C, and the prior `mean` and `sd` of c."""

    name: str
    mean: float
    sd: float
    phi: Callable[[Array, Array], Array]


Estimates = Mapping[str, tuple[float, float]]
"""c of the laws of an actuator and its standard deviation, by name."""


def levels_only(heat_input: HeatInput, layout: Layout, a: int, config: IdentificationConfig) -> bool:
    """Whether nothing but its level says what actuator `a` gives.

    Not so where heat was measured or is the level itself: signed levels, `heat_input: identity`.
    """
    may_be_fitted = config.method == "joint" and config.heat_input == "auto"
    return may_be_fitted and heat_input.heat is None and layout.u_min[a] == 0.0


def laws_of(
    runs: Sequence[Record], layout: Layout, a: int, heat_input: HeatInput, config: IdentificationConfig
) -> list[LevelLaw]:
    """The laws of actuator `a` in a building whose records are `runs`.

    None without runs, if it never acted and where heat was measured. Part load of a shared machine is left out: what it
    gives to one of several depends on the others too, so that their temperatures say little of it.
    """
    m = layout.machine_of[a]
    shared = len(layout.fed_by(m)) > 1
    if config.method != "joint" or heat_input.law is not None or layout.u_min[a] < 0.0:
        return []
    weather = weather_of(runs, a)
    if weather is None:
        return []
    laws = []
    if levels_only(heat_input, layout, a, config):
        mean_C = weather.mean_C
        is_circuit = shared and layout.signs[a] > 0
        prior = _circuit_prior(runs, layout.home[a], mean_C) if is_circuit else _slope_prior(layout.signs[a])
        laws.append(LevelLaw(OUTDOORS, *prior, lambda u, T: u * (T - mean_C)))
        if is_circuit:
            laws.append(LevelLaw(HELD, *_HELD_PRIOR, partial(_held, runs[0].step_s)))
    if config.part_load and not shared:
        u, power_W = (np.concatenate(rows) for rows in ([r.u[a] for r in runs], [r.power_W[m] for r in runs]))
        fresh = np.concatenate([_fresh(r.u[a], r.step_s) for r in runs])
        bands = [band for band in PART_LOADS if np.count_nonzero(_within(u, *band[1:])) >= _LEAST_STEPS]
        for (name, above, most), (mean, sd) in zip(bands, _heat_priors(u, power_W, fresh, bands), strict=True):
            laws.append(LevelLaw(name, mean - 1.0, sd, partial(_level_within, above, most)))
    return laws


def _heat_priors(
    u: Array, power_W: Array, fresh: NDArray[np.bool_], bands: Sequence[tuple[str, float, float]]
) -> list[tuple[float, float]]:
    """Mean and standard deviation of the heat per level in each of `bands` over that at full level.

    `fresh` (n,): steps in which full level has just begun. A machine that weakens at full level is at its limit only
    later: part load gives as much per level as those steps do.

    A machine at the limit of its water temperature gives less at full level than its level stands for, and takes less
    power in proportion; a fixed loss makes part load dear and gives nothing. Two levels below full tell them apart: the
    curve through the power at them and at full level meets level 0 at the fixed loss. Fewer say nothing.
    """
    rows = [_within(u, *band[1:]) for band in bands] + [u >= 1.0 - LEVEL_EDGE]
    seen = [row & np.isfinite(power_W) for row in rows]
    if len(seen) < 3 or min(np.count_nonzero(row) for row in seen) < _LEAST_STEPS:
        return [_HEAT_PRIOR] * len(bands)
    mean, sd = _OF_POWER
    weakens = _weakening(power_W, seen[-1], fresh)
    if weakens > 1.0:
        return [(mean * weakens * _FRESH_HEAT[0], sd * weakens * _FRESH_HEAT[0])] * len(bands)
    level, power = (np.array([values[row].mean() for row in seen]) for values in (u, power_W))
    power = power / power[-1]
    slopes = np.diff(power) / np.diff(level)
    # A parabola where power saturates, the line through the two levels where it does not.
    bend = max(slopes[0] - slopes[1], 0.0) * level[1] / (level[2] - level[0])
    fixed = float(np.clip(power[0] - level[0] * (slopes[0] + bend), 0.0, 0.9 * power.min()))
    if fixed > _MOST_FIXED:
        fixed, sd = 0.0, _FLAT_SD
    told = np.maximum((power - fixed) / level / (1.0 - fixed), 1.0)[:-1]
    return [(float(mean * heat), float(sd * heat)) for heat in told]


def _fresh(u: Array, step_s: float) -> NDArray[np.bool_]:
    """Which steps (n,) are the first half hour at full level after a step of less than half."""
    full, found = u >= 1.0 - LEVEL_EDGE, np.zeros(u.size, dtype=bool)
    for k in np.flatnonzero(full[1:] & (u[:-1] < 0.5)) + 1:
        found[k : k + steps_in(_FRESH_S, step_s)] = True
    return found & full


def _weakening(power: Array, full: NDArray[np.bool_], fresh: NDArray[np.bool_]) -> float:
    """Power of fresh steps over the mean of those at full level; 1 where it is not clearly more, or not known."""
    known = full & fresh & np.isfinite(power)
    if np.count_nonzero(known) < _LEAST_STEPS or np.count_nonzero(full & ~fresh) < _LEAST_STEPS:
        return 1.0
    ratio = float(power[known].mean() / power[full].mean())
    return ratio if ratio > _WEAKENS else 1.0


def _slope_prior(sign: int) -> tuple[float, float]:
    """Mean and standard deviation of the relative change of heat with T_out, 1/K, over the types of machine."""
    means, sds = np.array([kind.slope for kind in kinds_for(sign)]).T
    return float(means.mean()), float(np.sqrt(np.mean(sds**2 + means**2) - means.mean() ** 2))


def _circuit_prior(runs: Sequence[Record], zone: int, mean_C: float) -> tuple[float, float]:
    """Mean and standard deviation of the relative change of a circuit's heat with T_out about `mean_C`, 1/K."""
    room_C = float(np.nanmean(np.concatenate([run.T_zone_C[zone] for run in runs])))
    reach_K = _NO_HEAT_C - _LOWER_BY * (room_C - _ROOM_C) - mean_C
    return -1.0 / max(reach_K, _LEAST_REACH_K), _PER_K_SD


def _held(step_s: float, u: Array, T_out_C: Array) -> Array:
    """Levels (n,) times how much less they were open before than after `EFFECT_H` at full level, in the mean of it."""
    hours = EFFECT_H / _HELD_H
    usual = 1.0 + np.expm1(-hours) / hours
    pole = float(np.exp(-step_s / HOUR_S / _HELD_H))
    begin = float(u[: round(DAY_S / step_s)].mean())
    before = begin + lagged(u - begin, pole)
    return np.asarray(u * (usual - step_means(before)))


@dataclass(frozen=True)
class LevelWeather:
    """Outdoor temperature of a record, °C: its mean weighted by an actuator's level, range, and spread about that."""

    mean_C: float
    range_C: tuple[float, float]
    spread_K: float


def weather_of(runs: Sequence[Record], a: int) -> LevelWeather | None:
    """The weather in which actuator `a` acted; None if it never did."""
    level = np.concatenate([run.u[a] for run in runs]) if runs else np.empty(0)
    if not level.sum() > 0.0:
        return None
    T_out_C = np.concatenate([run.T_out_C[:-1] for run in runs])
    mean_C = float(level @ T_out_C / level.sum())
    spread_K = rms(T_out_C - mean_C)
    return LevelWeather(mean_C, (float(T_out_C.min()), float(T_out_C.max())), spread_K)


def with_outdoors(heat_input: HeatInput, found: Estimates, weather: LevelWeather | None) -> HeatInput:
    """The heat input with what was `found` of it over the outdoor temperature."""
    if OUTDOORS not in found or weather is None:
        return heat_input
    low, high = weather.range_C
    most = min(_MOST_PER_K, (1.0 - _LEAST_FACTOR) / max(high - weather.mean_C, weather.mean_C - low, 1.0))
    per_K = float(np.clip(found[OUTDOORS][0], -most, most))
    return HeatInput(reference_C=weather.mean_C, per_K=per_K, T_out_range_C=weather.range_C)


def outdoors_in_words(found: Estimates, weather: LevelWeather) -> str:
    """A note for the model card."""
    per_K, sd = found[OUTDOORS]
    return (
        f"heat was not measured: from the temperatures that of a level changes by {100 * per_K:+.1f} "
        f"± {100 * sd:.1f} % per K outdoors, effects are those at {weather.mean_C:.1f} °C"
    )


def _within(u: Array, above: float, most: float) -> NDArray[np.bool_]:
    return np.asarray((u > above) & (u <= most))


def _level_within(above: float, most: float, u: Array, T_out_C: Array) -> Array:
    return np.where(_within(u, above, most), u, 0.0)


def part_load_costs(
    found: Estimates, histories: Sequence[Record], power: PowerModel | None, heat_input: HeatInput
) -> list[LevelCost]:
    """What heat costs at the levels of part load: measured power over heat, which is measured too or in `found`."""
    if power is None:
        return []
    u, T_out, power_W, heat_W = (
        np.concatenate([values(h) for h in histories])
        for values in (lambda h: h.u[0], lambda h: h.T_out_C[:-1], lambda h: h.power_W[0], lambda h: h.heat_W[0])
    )
    law = heat_input.law
    kept = np.isfinite(u) & np.isfinite(T_out) & np.isfinite(power_W) & (np.isfinite(heat_W) | (law is None))
    u, T_out, power_W, heat_W = u[kept], T_out[kept], power_W[kept], heat_W[kept]
    fresh = np.concatenate([_fresh(h.u[0], h.step_s) for h in histories])[kept]
    full, level = u >= 1.0 - LEVEL_EDGE, np.maximum(u, LEVEL_EDGE)
    if np.count_nonzero(full) < _LEAST_STEPS:
        return []
    if power.water_s is not None:  # levels are compared in the same water
        power_W = power_W - power.load.curve_W * (squares_of(histories, power.water_s)[kept] - COMPARED_AT * u)
        power = replace(power, load=replace(power.load, curve_W=COMPARED_AT * power.load.curve_W))
    # Per level, relative to full level in the same weather; the laws say how full level depends on it.
    power_per_level = _relative(power_W / level, power(np.ones(u.size), T_out), full)
    heat_per_level = None if law is None else _relative(heat_W / level, law(np.ones(u.size), T_out), full)
    costs: list[LevelCost] = []
    weakens, fresh_heat, fresh_sd = _weakening(power_per_level, full, fresh), 1.0, 0.0
    if weakens > 1.0:
        power_per_level = power_per_level / weakens
        fresh_heat, fresh_sd = weakens * _FRESH_HEAT[0], _FRESH_HEAT[1] / _FRESH_HEAT[0]
        if heat_per_level is not None:
            heat_per_level, fresh_heat, fresh_sd = heat_per_level / heat_per_level[full & fresh].mean(), 1.0, 0.0
    for name, above, most in reversed(PART_LOADS):
        near = _within(u, above, most)
        n = np.count_nonzero(near)
        if n < _LEAST_STEPS:
            continue
        if heat_per_level is not None:
            heat, heat_sd = float(heat_per_level[near].mean()), float(heat_per_level[near].std() / np.sqrt(n))
        elif name in found:
            all_of_it = 1.0 / float(u[near].mean())
            heat = float(np.clip((1.0 + found[name][0]) / fresh_heat, _LEAST_HEAT, all_of_it))
            heat_sd = heat * float(np.hypot(found[name][1] / (1.0 + found[name][0]), fresh_sd))
            if costs and costs[-1].heat > heat:  # heat is a concave law of the level
                heat, heat_sd = costs[-1].heat, costs[-1].heat_sd
        else:
            continue
        if not heat > 0.0:
            continue
        power_, noise = float(power_per_level[near].mean()), float(power_per_level[near].std() / np.sqrt(n))
        # E[1/k] to second order: not knowing the heat makes what it costs dearer in expectation.
        cost = power_ / heat * (1.0 + (heat_sd / heat) ** 2)
        cost_sd = cost * float(np.linalg.norm([heat_sd / heat, noise / max(power_, 1e-9), _COST_SD]))
        costs.append(LevelCost(float(u[near].mean()), cost, cost_sd, heat, heat_sd))
    return costs[::-1]


def _relative(per_level: Array, law: Array, full: NDArray[np.bool_]) -> Array:
    """What was measured per level over the law of full level, which is scaled to what was measured there."""
    relative = per_level / law
    return np.asarray(relative / relative[full].mean())
