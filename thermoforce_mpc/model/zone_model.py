"""Model of one zone with an actuator of its own: what is identified, adapted and judged zone by zone."""

from __future__ import annotations

from dataclasses import dataclass, field

from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.parameters import OperatorParameters


@dataclass(frozen=True)
class ZoneModel:
    """Operator of an actuator on its home zone, power of its machine, linear free model and card of the zone.

    `power` is None where it was not measured, `free` where the zone was identified from pairs alone.
    """

    operator: OperatorParameters
    power: PowerModel | None = None
    free: RcParameters | None = None
    card: ModelCard = field(default_factory=ModelCard)
