"""The choice of the actuation where `mode` is auto, and the power that plans count with.

Each machine gives heat most cheaply at one level: one with a fixed loss while it runs at a high one, one whose water
gets hotter with the level at a low one. What heat costs at the levels that were tried is on the model card
(`LevelCost`). At the cheapest of them the machine is switched, and higher levels are held where they are needed. Where
nothing is known of part load it is switched at full level, as where power has a fixed part and heat is not measured, or
power depends on the return water, which was cooler in the trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.actuation.actuator import Actuation, ActuationConfig
from controllers.checks import ControllerConfigError
from thermoforce_mpc.model.machine.part_load import (
    SWITCH_FROM,
    LevelCost,
    PowerShape,
    at_its_limit,
    cheapest,
    part_load,
)
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import HeatInput


@dataclass(frozen=True)
class ActuationChoice:
    """An actuation whose mode is decided, the reason in words, and the power that plans count with."""

    actuation: Actuation
    why: str
    power: PowerModel


def choose_actuation(
    config: ActuationConfig,
    power: PowerModel,
    heat_input: HeatInput,
    costs: Sequence[LevelCost] = (),
    *,
    shared: bool = False,
) -> ActuationChoice:
    """Decide `mode: auto`; another mode stays.

    `power`: of the machine, as identified; `heat_input`: of the actuator; `costs`: what heat costs at levels below
    full; `shared`: the machine feeds other actuators too, whose levels say what it costs. By the laws it is then
    switched or any level held, as where there are no `costs`.

    Raises:
        ControllerConfigError: levels above blocks are to be held, and the machine feeds other actuators too.
    """
    if shared and config.mode == "modulating" and config.lowest_level > 0.0:
        raise ControllerConfigError(
            f"controller.options.actuation.lowest_level: {config.lowest_level:g} of an actuator that shares its "
            "machine, whose blocks lie together; use mode: duty, or lowest_level: 0"
        )
    planned = power
    if costs and not shared and (config.mode == "auto" or (config.mode == "modulating" and config.lowest_level > 0.0)):
        T_out_C = np.asarray(heat_input.reference_C)
        full = float(heat_input(np.asarray(1.0), T_out_C))
        heat = [float(heat_input(np.asarray(one.level), T_out_C)) / full for one in costs]
        planned = PowerShape.through(costs, heat).of(power)
    if config.mode != "auto":
        actuation = Actuation(config)
        return ActuationChoice(actuation, f"{actuation.in_words}, as configured", planned)
    # Blocks at full level are the choice here, not all that the actuator can do; a meter shows heat at a part level.
    blocks = Actuation(config.model_copy(update={"mode": "duty"}), part_levels=heat_input.law is not None)
    laws = part_load(power, heat_input.law)
    if shared or not costs:
        if laws is None:
            return ActuationChoice(blocks, f"{blocks.in_words}: the data hold off and full level only", power)
        if laws.at_half <= 1.0 + SWITCH_FROM:
            blocks = Actuation(config.model_copy(update={"mode": "modulating", "lowest_level": 0.0}))
        return ActuationChoice(blocks, f"{blocks.in_words}: {laws}", power)
    best = cheapest(costs)
    guessed = heat_input.law is None and not at_its_limit(costs)
    if best and laws and (guessed or power.water) and laws.at(best.level) > 1.0 + SWITCH_FROM:
        # The meter knows the fixed part; the heat of a level from temperatures alone is known to a tenth at best, and
        # the water of the steps at part load was cooler where it is a factor of the power.
        return ActuationChoice(blocks, f"{blocks.in_words}: {laws}", power)
    if best is None:
        told = min(costs, key=lambda one: one.cost)
        return ActuationChoice(blocks, f"{blocks.in_words}: {told}", power)
    actuation = Actuation(config.model_copy(update={"mode": "modulating", "lowest_level": best.level}))
    return ActuationChoice(actuation, f"{actuation.in_words}: {best}", planned)
