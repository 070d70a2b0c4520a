"""What is known of part load: fixed shares of power and heat, and power per heat at half level.

Where heat is not measured, what heat costs at part load is estimated from the temperature instead, with its
uncertainty, and stands on the model card.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel

# Excess of power per heat at half level from which a machine is switched. Below it is what a few days of data leave
# uncertain: an exponent of a radiator that is wrong by 0.2 looks like a fixed part of 8 %.
SWITCH_FROM = 0.1
# Names on the model card (`ModelCard.uncertainty`), see `CostAtPartLoad`.
LEVEL, HEAT, HEAT_SD = "part_load_level", "part_load_heat", "part_load_heat_sd"
COST, COST_SD = "part_load_cost", "part_load_cost_sd"


@dataclass(frozen=True)
class CostAtPartLoad:
    """What heat costs at `level`, estimated without a heat meter.

    `heat`: heat per level there over that at full level; `cost`: expected power per heat there over that at full
    level. Each with its standard deviation.
    """

    level: float
    heat: float
    heat_sd: float
    cost: float
    cost_sd: float

    @classmethod
    def of(cls, uncertainty: Mapping[str, float]) -> CostAtPartLoad | None:
        """Read it from the numbers of a model card; None where it was not estimated."""
        names = (LEVEL, HEAT, HEAT_SD, COST, COST_SD)
        return cls(*(uncertainty[name] for name in names)) if COST in uncertainty else None

    def __str__(self) -> str:
        return (
            f"at level {self.level:.2f} the temperature says {self.heat:.2f} ± {self.heat_sd:.2f} times the heat per "
            f"level of full level, which costs {self.cost:.2f} ± {self.cost_sd:.2f} times as much"
        )


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
