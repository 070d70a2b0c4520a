"""What a machine's laws say of part load: fixed shares of power and heat, and power per heat at half level."""

from __future__ import annotations

from dataclasses import dataclass

from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel


@dataclass(frozen=True)
class PartLoad:
    """Part load in the middle of the outdoor range of the power law.

    `power_fixed`, `heat_fixed`: share of full power and of full heat that does not depend on the level while the
    machine runs (heat: 0 where it is not measured and counts as proportional to the level); `lowest_seen`: the lowest
    level the laws were fitted to.
    """

    power_fixed: float
    heat_fixed: float
    lowest_seen: float

    @property
    def at_half(self) -> float:
        """Power per heat at half level over that at full level."""
        return (1.0 + self.power_fixed) / (1.0 + self.heat_fixed)

    def __str__(self) -> str:
        return (
            f"{100 * self.power_fixed:.0f} % of full power and {100 * self.heat_fixed:.0f} % of full heat are a fixed "
            f"part while on; at half level {self.at_half:.2f} times the power per heat of full level"
        )


def part_load(power: PowerModel, heat: MachineLoad | None) -> PartLoad | None:
    """Return the part load of a machine; None if the power law was fitted to off and full level only."""
    law = power.load
    if not law.levels_seen:
        return None
    T = 0.5 * sum(law.T_out_range_C)
    fixed, per_u = (float(part) for part in law.parts(T))
    heat_fixed = 0.0
    if heat is not None and heat.levels_seen:
        heat_on, heat_per_u = (float(part) for part in heat.parts(T))
        heat_fixed = heat_on / (heat_on + heat_per_u)
    return PartLoad(fixed / (fixed + per_u), heat_fixed, law.lowest_level)
