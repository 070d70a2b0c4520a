"""The network of a building from its records, fold by fold, as what each zone's fit begins from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.couplings import others_of
from thermoforce_mpc.identification.estimation.records import Pair
from thermoforce_mpc.identification.network.building import BuildingFit, Responses
from thermoforce_mpc.identification.network.effects import building_fit, room_pair, room_run
from thermoforce_mpc.identification.network.estimate import Run
from thermoforce_mpc.identification.network.projection import Modes, projected
from thermoforce_mpc.model.operator.heat_input import HeatInput


class ZoneRows(Protocol):
    """Which rows of a zone a fold may see (`zone.ZoneData`), and the resolution `grid_K` of its sensor, K."""

    @property
    def grid_K(self) -> float: ...  # noqa: D102

    def last_steps(self, fold: str) -> list[int]: ...  # noqa: D102


@dataclass(frozen=True)
class ZoneEffects:
    """What the network of the building says of a zone's actuators, from all rows, from those before the held-out ones,
    and from those before an earlier part.

    `covariance` (A, 2r, 2r): of the effects of the `whole`; `log_odds` that its own actuator acts on it at all.
    """

    whole: Modes
    training: Modes
    earlier: Modes
    covariance: Array
    log_odds: float


def zone_effects(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    layout: Layout,
    heat_inputs: Sequence[HeatInput],
    data: Sequence[ZoneRows],
    config: IdentificationConfig,
    say: Callable[[str], None],
) -> list[ZoneEffects | None]:
    """What the network says of each actuator's home zone (A,), fold by fold; None with method two_stage.

    Without cross effects the neighbours are not part of the network.
    """
    if config.method == "two_stage":
        return [None] * len(data)
    say("fitting the building as a network of heat capacities and conductances")
    joined = config.cross_effects and len(layout.floor_area_m2) > 1
    folds = ("whole", "training", "earlier") if runs else ("whole", "training")
    by_fold: dict[str, BuildingFit] = {}
    for fold in folds:
        rooms = []
        for zone in range(len(layout.floor_area_m2)):
            first = layout.actuators_of(zone)[:1]
            of_zone = data[first[0]] if first else data[0]
            rooms.append(_seen(runs, pairs, zone, layout, heat_inputs, of_zone, fold, joined))
        by_fold[fold] = building_fit(layout, heat_inputs, rooms, joined=joined)
    whole = by_fold["whole"]
    effects: list[ZoneEffects | None] = []
    for a, home in enumerate(layout.home):
        order = [a, *others_of(layout, a, config)]
        signs = np.array([layout.signs[b] for b in order])
        modes = {}
        for fold, fit in by_fold.items():
            found = fit.responses[home]
            modes[fold] = projected(Responses(found.mean[order], found.weather), 0, signs, config.modes)
        covariance = modes["whole"].covariance(whole.covariance[home, order])
        log_odds = whole.rooms[home].gained(layout.actuators_of(home).index(a))
        earlier = modes.get("earlier", modes["training"])
        effects.append(ZoneEffects(modes["whole"], modes["training"], earlier, covariance, log_odds))
    return effects


def _seen(
    runs: Sequence[Record],
    pairs: Sequence[Pair],
    zone: int,
    layout: Layout,
    heat_inputs: Sequence[HeatInput],
    data: ZoneRows,
    fold: str,
    joined: bool,
) -> list[Run]:
    """What a fold may see of a zone."""
    found, steps = [], data.last_steps(fold)
    for run, n in zip(runs, steps, strict=False):
        if n > 1:
            found.append(room_run(run.slice(0, n), zone, layout, heat_inputs, data.grid_K, joined=joined))
    for pair, n in zip(pairs, steps[len(runs) :], strict=True):
        if n > 1:
            found.append(room_pair(pair, zone, layout, heat_inputs, data.grid_K, joined=joined))
    return found
