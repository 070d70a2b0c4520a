"""Heat that an actuator delivers to its zone, from measured points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from thermoforce_mpc.data import Array
from thermoforce_mpc.scenario.settings import Factor, PointName, StrictModel

# Dry air at 20 °C: 1.2 kg/m³ · 1006 J/kgK.
AIR_J_M3K = 1207.0

HEAT_IS = (
    "points whose sum is the delivered heat, W; empty if not measured. With a factor each, heat from metered power: an "
    "efficiency, or for cooling minus the coefficient of performance. Or the supply air of the zone: flow, temperature"
)


class SupplyAir(StrictModel):
    """Heat of a zone's supply air: c · (flow · (T_supply − T_zone) − least · (T_before − T_zone)).

    A box of a variable air volume system always passes some air while the fan runs. What the least flow brings without
    reheat (`least` is `least_flow` or, where it is less, the flow) is no choice of the zone's loops and is taken off.
    """

    flow: PointName = Field(description="measured flow of the supply air, m³/s")
    temperature: PointName = Field(description="measured temperature of the supply air where it enters the zone, K")
    before: PointName | None = Field(None, description="measured temperature of the air before the zone's reheat, K")
    least_flow: float = Field(0.0, ge=0, description="least flow while the fan runs, m³/s")

    @model_validator(mode="after")
    def _together(self) -> SupplyAir:
        if (self.before is not None) != (self.least_flow > 0):
            raise ValueError("before and least_flow go together: the air that the least flow brings, and that flow")
        return self

    @property
    def points(self) -> dict[str, str]:
        """Unit of each point by its name."""
        named = {self.flow: "m3/s", self.temperature: "K"}
        return named if self.before is None else {**named, self.before: "K"}

    def heat_W(self, record: Mapping[str, Array], T_zone: Array) -> Array:
        """Return the heat (n,) of n samples by point, W, with the zone at `T_zone` (n,), K."""
        flow = record[self.flow]
        heat = flow * (record[self.temperature] - T_zone)
        if self.before is not None:
            heat = heat - np.minimum(flow, self.least_flow) * (record[self.before] - T_zone)
        return np.asarray(AIR_J_M3K * heat)


def _form(value: object) -> str:
    """Tag of what tells a heat, so that an error is one of the form that was meant."""
    if isinstance(value, SupplyAir) or (isinstance(value, Mapping) and SupplyAir.model_fields.keys() & value.keys()):
        return "air"
    return "factors" if isinstance(value, Mapping) else "meters"


Heat = Annotated[
    Annotated[tuple[PointName, ...], Tag("meters")]
    | Annotated[dict[PointName, Factor], Tag("factors")]
    | Annotated[SupplyAir, Tag("air")],
    Discriminator(_form),
]


@dataclass(frozen=True)
class HeatMeter:
    """What tells the heat of an actuator whose zone has its sensor at point `zone`."""

    heat: Heat
    zone: str

    @property
    def units(self) -> dict[str, str]:
        """Unit of each point by its name; empty if the heat is not measured."""
        return self.heat.points if isinstance(self.heat, SupplyAir) else dict.fromkeys(self.heat, "W")

    def heat_W(self, record: Mapping[str, Array]) -> Array:
        """Return the heat (n,) of n samples by point, W; it must be measured."""
        if isinstance(self.heat, SupplyAir):
            return self.heat.heat_W(record, record[self.zone])
        return weighted_sum(record, self.heat)


def weighted_sum(record: Mapping[str, Array], points: Sequence[str] | Mapping[str, float]) -> Array:
    """Return the sum of `points` over the samples of `record`, each times its factor where `points` has factors."""
    factors = points if isinstance(points, Mapping) else dict.fromkeys(points, 1.0)
    return np.asarray(np.sum([factor * record[name] for name, factor in factors.items()], axis=0))
