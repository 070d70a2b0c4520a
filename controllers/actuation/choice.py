"""The choice of the actuation where `mode` is auto: what was identified of power and heat at part load.

A machine with a fixed part while it runs needs more power per heat the lower its level: it is switched, in blocks at
its most efficient level. One without modulates. Both laws are affine in the level, so power per heat is monotone in it
and the most efficient level is an end: full, or the lowest.

Where heat is not measured, the choice follows from the expected cost of heat at part load, with the heat estimated from
the temperature (`CostAtPartLoad`). Not knowing that heat makes its expected cost higher, so that an unclear case ends
in blocks: they run the machine at full level, where power and effect are both identified.
"""

from __future__ import annotations

from dataclasses import dataclass

from controllers.actuation.actuator import Actuation, ActuationConfig
from thermoforce_mpc.model.machine.part_load import SWITCH_FROM, CostAtPartLoad, part_load
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import HeatInput


@dataclass(frozen=True)
class ActuationChoice:
    """An actuation whose mode is decided, and the reason in words."""

    actuation: Actuation
    why: str


def choose_actuation(
    config: ActuationConfig, power: PowerModel, heat_input: HeatInput, estimated: CostAtPartLoad | None = None
) -> ActuationChoice:
    """Decide `mode: auto` from the identified laws, or from the cost that was `estimated` without a heat meter.

    A mode other than auto stays.
    """
    if config.mode == "auto" and estimated is not None and heat_input.law is None:
        return _choose_by_cost(config, estimated)
    at_part_load = part_load(power, heat_input.law)
    proportional = at_part_load is not None and abs(at_part_load.at_half - 1.0) <= SWITCH_FROM
    if config.mode != "auto":
        actuation = Actuation(config, proportional=proportional)
        return ActuationChoice(actuation, f"{actuation.in_words}, as configured")
    # Blocks are the choice here, not all that the actuator can do; heat at a part level shows in its meter.
    blocks = Actuation(config.model_copy(update={"mode": "duty"}), part_levels=heat_input.law is not None)
    if at_part_load is None:
        return ActuationChoice(blocks, f"{blocks.in_words}: the data hold off and full level only")
    if at_part_load.at_half > 1.0 + SWITCH_FROM:
        actuation = blocks
    else:
        lowest = 0.0 if proportional else at_part_load.lowest_seen
        modulating = config.model_copy(update={"mode": "modulating", "lowest_level": lowest})
        actuation = Actuation(modulating, proportional=proportional)
    return ActuationChoice(actuation, f"{actuation.in_words}: {at_part_load}")


def _choose_by_cost(config: ActuationConfig, estimated: CostAtPartLoad) -> ActuationChoice:
    """Any level where heat at part load is not expected to cost more by the margin, else blocks.

    With any level, heat and power are both counted in proportion to the level: that is right at full level, and what
    part load gives beyond it, of both, the prediction's offset and the next plans take up.
    """
    if estimated.cost > 1.0 + SWITCH_FROM:
        actuation = Actuation(config.model_copy(update={"mode": "duty"}))
    else:
        modulating = config.model_copy(update={"mode": "modulating", "lowest_level": 0.0})
        actuation = Actuation(modulating, proportional=True)
    return ActuationChoice(actuation, f"{actuation.in_words}: {estimated}")
