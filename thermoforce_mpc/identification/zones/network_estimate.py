"""What the network of a building, fitted to its records fold by fold, says of each zone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import others_of
from thermoforce_mpc.identification.effects.level_laws import (
    Estimates,
    LevelLaw,
    laws_of,
    levels_only,
    weather_of,
    with_outdoors,
)
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.estimation.regression import (
    STEP_RESPONSE_H,
    Effect,
    RegressionData,
    unit_steps,
    without_others,
)
from thermoforce_mpc.identification.network.building import (
    RESPONSE_H,
    BuildingFit,
    NetworkInputs,
    building_fit,
    room_run,
)
from thermoforce_mpc.identification.network.circuits import circuit_of
from thermoforce_mpc.identification.network.estimate import RoomRun
from thermoforce_mpc.identification.network.free_part import free_part
from thermoforce_mpc.identification.network.projection import Modes, projected
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.identification.zones.data import Estimate, ZoneData, fold_of
from thermoforce_mpc.model.operator.heat_input import HeatInput

# What a few modes do not follow of a response, as a share of its largest: as in the estimator before networks
# (2026-11-26), whose bands of generated houses held.
_MODES_SD = 0.006
# Rooms beside each other whose heat is not measured: what levels stand for differs with water, valves and the other
# rooms for weeks alike, so that a longer record tells ever less beside the prior: one of n days counts as
# n D / (n + D). Of seven drawn houses of 3 to 5 rooms in ordinary operation (28 days, seeds 101 to 107, 28 November
# 2026) the median error of cross effects is 0.36 of their size with all of it, 0.24 with D of 3 and 7; of one of them
# held-out errors a day ahead are 0.33 K with all, 0.57 K with 3, 0.27 K with 10.
_LEVELS_D = 8.0
# Of such a record, variance of what an actuator does to its own room over what the fit says: emitters are colder or
# warmer, and the machine is nearer to its limit, than in the mean of operation. Bands of 90 % hold 0.97 of 180 own
# effects of 12 drawn houses (see `network.building`), with 1 they hold 0.90; then valves that follow one schedule may
# act in `gate_levels_in_plan`, of which the record does not tell which one did what.
_OWN_VARIANCE = 2.0
# Where in `RESPONSE_H` the responses stand whose certainty is stored.
_STORED = np.searchsorted(RESPONSE_H, STEP_RESPONSE_H)
_OF_DAY = int(np.searchsorted(RESPONSE_H, 24.0))


def network_estimates(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    layout: Layout,
    data: Sequence[ZoneData],
    config: IdentificationConfig,
    sizes: Array | None = None,
) -> list[Estimate]:
    """What the network says of each actuator's home zone (A,), fold by fold.

    Without cross effects the neighbours are not part of the network. `sizes` (Z,): see `BuildingFit`.
    """
    by_fold: dict[str, BuildingFit] = {}
    inputs: dict[str, list[HeatInput]] = {}
    fit: BuildingFit | None = None
    # A fold has all that the one before it had, whose optimum is a good start.
    for fold in ("earlier", "training", "whole") if runs else ("training", "whole"):
        # Weather and levels of held-out rows are not seen either.
        seen = [run.slice(0, n) for run, n in zip(runs, data[0].last_steps(fold), strict=False) if n > 1]
        heat_inputs = [of_zone.heat_input_of(fold) for of_zone in data]
        laws = [laws_of(seen, layout, a, heat_input, config) for a, heat_input in enumerate(heat_inputs)]
        actuators, rooms = NetworkInputs(layout, heat_inputs, laws, config.cross_effects), []
        for zone in range(len(layout.floor_area_m2)):
            first = layout.actuators_of(zone)[:1]
            weight = _weight(seen, zone, layout, heat_inputs, config)
            rooms.append(_seen(runs, pairs, zone, actuators, data[first[0]] if first else data[0], fold, weight))
        fit = replace(building_fit(actuators, rooms, fit, aired=config.air_through_windows), sizes=sizes)
        circuits = {}
        for a, (home, heat_input) in enumerate(zip(layout.home, heat_inputs, strict=True)):
            circuit = circuit_of(
                fit.rooms[home].room, fit.thetas[home], a, seen, rooms[home][: len(seen)], layout, heat_input
            )
            if circuit is not None:
                circuits[a] = circuit
        by_fold[fold] = fit = replace(fit, circuits=circuits)
        inputs[fold] = [
            v.with_law(circuits[a].load)
            if a in circuits
            else with_outdoors(v, _found(fit, a, laws[a]), weather_of(seen, a))
            for a, v in enumerate(heat_inputs)
        ]
    if not runs:
        by_fold["earlier"], inputs["earlier"] = by_fold["training"], inputs["training"]
    return [_estimate(a, data[a], layout, by_fold, inputs, laws[a]) for a in range(len(data))]


def _estimate(
    a: int,
    data: ZoneData,
    layout: Layout,
    by_fold: Mapping[str, BuildingFit],
    inputs: Mapping[str, Sequence[HeatInput]],
    laws: Sequence[LevelLaw],
) -> Estimate:
    """What the fits of all folds, with v of each actuator in `inputs`, say of the home zone of actuator `a`."""
    home, order = layout.home[a], [a, *others_of(layout, a, data.config)]
    k, signs = layout.actuators_of(home).index(a), [layout.signs[b] for b in order]
    folds: dict[str, Fold] = {}
    modes, without = dict[str, Modes](), {name: fit.without(home, k) for name, fit in by_fold.items()}
    for name, fit in by_fold.items():
        modes[name] = projected(fit.responses[home, order], np.array(signs), data.config.modes, fit.longest_h)
        log_tau, gains, (own, *others) = modes[name].log_tau, modes[name].gains, (inputs[name][b] for b in order)
        # The others share time constants.
        regressions = [without_others(e, others, signs[1:], log_tau[-1], gains[1:]) for e in data.of_fold(name, own)]
        regressions = _with_air(regressions, fit.rooms[home].runs)
        if regressions:
            free, alone = free_part(fit, home), free_part(without[name], home)
            folds[name] = fold_of(regressions, log_tau[0], gains[0], layout.signs[a], own, free, alone)
    whole, everything = by_fold["whole"], folds["whole"]
    of_others = list(zip(modes["whole"].log_tau, modes["whole"].gains, strict=True))[1:]
    variances = np.diagonal(whole.covariance[home, order], axis1=-2, axis2=-1)[:, _STORED]
    if whole.rooms[home].surely_wrong:
        variances = variances * np.where(np.array(layout.home)[order] == home, _OWN_VARIANCE, 1.0)[:, None]
    effects = []
    for (log_tau, gains), variance in zip([(everything.log_tau, everything.gains), *of_others], variances, strict=True):
        floor_K = _MODES_SD * float(unit_steps(log_tau, RESPONSE_H).max(axis=0) @ gains)
        effects.append(Effect(log_tau, gains, np.sqrt(variance + floor_K**2)))
    scores = {"acts_log_odds": without["whole"].rooms[home].value - whole.rooms[home].value}
    together_K, covariance = whole.together
    sd_K = float(np.sqrt(covariance[home, _OF_DAY, _OF_DAY]))
    together_sd = sd_K / max(abs(float(together_K[home, _OF_DAY])), 1e-9)
    found = _found(whole, a, laws, sd=True)
    return Estimate(everything, folds["training"], folds.get("earlier"), effects, scores, together_sd, found)


def _with_air(regressions: Sequence[RegressionData], runs: Sequence[RoomRun]) -> list[RegressionData]:
    """The regressions of a zone with what came in with air, as its network's `runs` say.

    A fit leaves out runs that say too little: those of the same readings are the same.
    """
    air_K = {run.readings.tobytes(): run.air_K for run in runs if run.aired_K2 is not None}
    return [replace(e, air_K=air_K.get(e.histories[0].T_zone_C[0].tobytes())) for e in regressions]


def _found(fit: BuildingFit, a: int, laws: Sequence[LevelLaw], *, sd: bool = False) -> Estimates:
    """What a fit says of the laws of actuator `a`, with standard deviations, which take a while, where asked for."""
    home = fit.layout.home[a]
    theta, k = fit.thetas[home], fit.layout.actuators_of(home).index(a)
    places = {law.name: fit.rooms[home].room.place[f"{law.name}_{k}"] for law in laws}
    sds = fit.joint.sds[home] if sd else np.full(theta.size, np.nan)
    return {name: (float(theta[i]), float(sds[i])) for name, i in places.items()}


def _seen(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    zone: int,
    actuators: NetworkInputs,
    data: ZoneData,
    fold: str,
    weight: float,
) -> list[RoomRun]:
    """What a fold may see of a zone; runs count with `weight`, pairs, in which the weather cancels, wholly."""
    records: list[tuple[Record, Record | None]] = [*((run, None) for run in runs), *((p.a, p.b) for p in pairs)]
    return [
        room_run(record.slice(0, n), zone, actuators, data.grid_K, less and less.slice(0, n), 1.0 if less else weight)
        for (record, less), n in zip(records, data.last_steps(fold), strict=True)
        if n > 1
    ]


def _weight(
    runs: Sequence[Record], zone: int, layout: Layout, heat_inputs: Sequence[HeatInput], config: IdentificationConfig
) -> float:
    """How much of the log likelihood of the runs counts for a zone, see `_LEVELS_D`."""
    if len(layout.floor_area_m2) == 1 or not config.cross_effects:
        return 1.0
    acting = layout.actuators_of(zone) or range(len(layout.home))
    if not any(levels_only(heat_inputs[a], layout, a, config) for a in acting):
        return 1.0
    return _LEVELS_D / (_LEVELS_D + sum(run.n_steps * run.step_s for run in runs) / DAY_S)
