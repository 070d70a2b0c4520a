"""The network of a building from its records, fold by fold, as what each zone's fit begins from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import others_of
from thermoforce_mpc.identification.effects.level_laws import Estimates, LevelLaw, laws_of, weather_of, with_outdoors
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.estimation.uncertainty import Effect
from thermoforce_mpc.identification.network.building import BuildingFit
from thermoforce_mpc.identification.network.effects import Actuators, building_fit, room_pair, room_run
from thermoforce_mpc.identification.network.estimate import RoomFit, Run
from thermoforce_mpc.identification.network.free_part import free_part
from thermoforce_mpc.identification.network.projection import projected
from thermoforce_mpc.identification.zones.data import Effects, ZoneData
from thermoforce_mpc.model.operator.heat_input import HeatInput


@dataclass(frozen=True)
class ZoneEffects:
    """What the network of the building says of a zone's actuators, from all rows, from those before the held-out ones,
    and from those before an earlier part.

    `of_responses` (1 + K, T, T) K²: covariance of the step responses of the `whole`; `laws`: what was found of the
    level of its own actuator; `log_odds` that this acts on it at all.
    """

    whole: Effects
    training: Effects
    earlier: Effects
    of_responses: Array
    laws: Estimates
    log_odds: float

    @property
    def known(self) -> list[Effect]:
        """The effects of the `whole` (1 + K,) with their covariance."""
        modes = self.whole.modes
        each = zip(modes.log_tau, modes.gains, modes.covariance(self.of_responses), strict=True)
        return [Effect(log_tau, gains, covariance) for log_tau, gains, covariance in each]


def zone_effects(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    layout: Layout,
    data: Sequence[ZoneData],
    config: IdentificationConfig,
    say: Callable[[str], None],
) -> list[ZoneEffects | None]:
    """What the network says of each actuator's home zone (A,), fold by fold; None with method two_stage.

    Without cross effects the neighbours are not part of the network.
    """
    if config.method == "two_stage":
        return [None] * len(data)
    say("fitting the building as a network of heat capacities and conductances")
    by_fold: dict[str, BuildingFit] = {}
    inputs: dict[str, list[HeatInput]] = {}
    fit: BuildingFit | None = None
    # A fold has all that the one before it had, whose optimum is a good start.
    for fold in ("earlier", "training", "whole") if runs else ("training", "whole"):
        # Weather and levels of held-out rows are not seen either.
        seen = [run.slice(0, n) for run, n in zip(runs, data[0].last_steps(fold), strict=False) if n > 1]
        heat_inputs = [of_zone.heat_input_of(fold) for of_zone in data]
        laws = [laws_of(seen, layout, a, heat_input, config) for a, heat_input in enumerate(heat_inputs)]
        actuators, rooms = Actuators(layout, heat_inputs, laws, config.cross_effects), []
        for zone in range(len(layout.floor_area_m2)):
            first = layout.actuators_of(zone)[:1]
            rooms.append(_seen(runs, pairs, zone, actuators, data[first[0]] if first else data[0], fold))
        by_fold[fold] = fit = building_fit(actuators, rooms, fit)
        inputs[fold] = [
            with_outdoors(v, _found(fit, a, laws[a]), weather_of(seen, a)) for a, v in enumerate(heat_inputs)
        ]
    whole = by_fold["whole"]
    estimates = [_estimates(whole, a, laws[a]) for a in range(len(heat_inputs))]
    effects: list[ZoneEffects | None] = []
    for a, home in enumerate(layout.home):
        order, k = [a, *others_of(layout, a, config)], layout.actuators_of(home).index(a)
        signs, folds = np.array([layout.signs[b] for b in order]), {}
        without = {fold: fit.without(home, k) for fold, fit in by_fold.items()}
        for fold, fit in by_fold.items():
            modes = projected(fit.responses[home, order], 0, signs, config.modes, fit.longest_h)
            free, alone = free_part(fit, home), free_part(without[fold], home)
            folds[fold] = Effects(modes, tuple(inputs[fold][b] for b in order), free, alone)
        of_responses = whole.covariance[home, order]
        log_odds = without["whole"].rooms[home].value - whole.rooms[home].value
        training, earlier = folds["training"], folds.get("earlier", folds["training"])
        effects.append(ZoneEffects(folds["whole"], training, earlier, of_responses, estimates[a], log_odds))
    return effects


def _places(fit: BuildingFit, a: int, laws: Sequence[LevelLaw]) -> tuple[RoomFit, dict[str, int]]:
    """The room of actuator `a`, and where its laws stand in θ."""
    home = fit.layout.home[a]
    room, k = fit.rooms[home], fit.layout.actuators_of(home).index(a)
    return room, {law.name: room.room.place[f"{law.name}_{k}"] for law in laws}


def _found(fit: BuildingFit, a: int, laws: Sequence[LevelLaw]) -> dict[str, float]:
    """What a fit says of the laws of actuator `a`."""
    room, places = _places(fit, a, laws)
    return {name: float(room.theta[place]) for name, place in places.items()}


def _estimates(fit: BuildingFit, a: int, laws: Sequence[LevelLaw]) -> Estimates:
    """`_found` with standard deviations."""
    room, places = _places(fit, a, laws)
    return {name: (float(room.theta[i]), float(np.sqrt(room.covariance[i, i]))) for name, i in places.items()}


def _seen(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    zone: int,
    actuators: Actuators,
    data: ZoneData,
    fold: str,
) -> list[Run]:
    """What a fold may see of a zone."""
    found, steps = [], data.last_steps(fold)
    for run, n in zip(runs, steps, strict=False):
        if n > 1:
            found.append(room_run(run.slice(0, n), zone, actuators, data.grid_K))
    for pair, n in zip(pairs, steps[len(runs) :], strict=True):
        if n > 1:
            found.append(room_pair(pair, zone, actuators, data.grid_K))
    return found
