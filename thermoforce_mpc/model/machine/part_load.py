"""What heat costs at part load: by the laws of power and heat, or level by level as it was measured.

Where heat is not measured, it is estimated from the temperature instead. Level by level, costs stand on the model card,
with their uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.machine.water import COMPARED_AT

# Excess of power per heat at half level from which a machine of several actuators is switched. Below it is what a few
# days of data leave uncertain: an exponent of a radiator that is wrong by 0.2 looks like a fixed part of 8 %.
SWITCH_FROM = 0.1
# Excess of the cost of heat over that of full level, and over that of the cheapest level, up to which a lower one is
# taken all the same: it moves a room less.
_SAME_AS_FULL, _SAME_AS_CHEAPEST = 0.03, 0.02
# Names on the model card (`ModelCard.uncertainty`).
_COST, _COST_SD = "cost_of_heat_at_level_", "cost_of_heat_sd_at_level_"
_HEAT, _HEAT_SD = "heat_per_level_at_level_", "heat_per_level_sd_at_level_"
# Share of full power by which a middle level is above the line from the lowest to full level where a machine is at its
# limit; a fixed part, and water that gets hotter, leave none.
_BENT = 0.1
# Weight of full level, which is 1 by definition, in the fit of the shape.
_EXACT = 1e3


@dataclass(frozen=True)
class LevelCost:
    """Power per heat at `level` over that at full level (`cost`), heat per level likewise, and their deviations."""

    level: float
    cost: float
    cost_sd: float
    heat: float
    heat_sd: float

    def numbers(self) -> dict[str, float]:
        """As numbers for a model card."""
        at, values = f"{self.level:.3f}", (self.cost, self.cost_sd, self.heat, self.heat_sd)
        return {name + at: value for name, value in zip((_COST, _COST_SD, _HEAT, _HEAT_SD), values, strict=True)}

    def __str__(self) -> str:
        return (
            f"at level {self.level:.2f} heat costs {self.cost:.2f} ± {self.cost_sd:.2f} times as much as at full level"
        )


def level_costs(uncertainty: Mapping[str, float]) -> tuple[LevelCost, ...]:
    """Read costs from the numbers of a model card, by level; empty where there are none."""
    at = sorted(name.removeprefix(_COST) for name in uncertainty if name.startswith(_COST))
    names = (_COST, _COST_SD, _HEAT, _HEAT_SD)
    return tuple(LevelCost(float(level), *(uncertainty[name + level] for name in names)) for level in at)


def cheapest(costs: Sequence[LevelCost]) -> LevelCost | None:
    """The lowest of the levels at which heat costs about least; None: that is full level."""
    least = min([1.0 + _SAME_AS_FULL - _SAME_AS_CHEAPEST, *(one.cost for one in costs)])
    as_cheap = [one for one in costs if one.cost <= least + _SAME_AS_CHEAPEST]
    return min(as_cheap, key=lambda one: one.level, default=None)


def at_its_limit(costs: Sequence[LevelCost]) -> bool:
    """Whether power hardly rises above a middle level: a machine at a limit gives no more heat there either."""
    levels = [one.level for one in costs] + [1.0]
    power = [one.cost * one.heat * one.level for one in costs] + [1.0]
    return any(
        middle > np.interp(level, [levels[0], 1.0], [power[0], 1.0]) + _BENT
        for level, middle in zip(levels[1:-1], power[1:-1], strict=True)
    )


@dataclass(frozen=True)
class PowerShape:
    """Power over the level, as shares of that at full level: `fixed` while on, `per_u` of u and `curve` of u²."""

    fixed: float
    per_u: float
    curve: float

    @classmethod
    def through(cls, costs: Sequence[LevelCost], heat: Sequence[float]) -> PowerShape:
        """The shape nearest to what heat costs, none of its parts below 0.

        `heat`: heat at each level of `costs`, as a share of that of full level, by the model that plans.
        """
        u = np.array([*(one.level for one in costs), 1.0])
        power = np.array([*(one.cost * share for one, share in zip(costs, heat, strict=True)), 1.0])
        weights = np.append(1.0 / u[:-1], _EXACT)
        parts, _ = nnls(weights[:, None] * np.stack([np.ones(u.size), u, u**2], axis=1), weights * power)
        return cls(*(parts / parts.sum()))

    def of(self, power: PowerModel) -> PowerModel:
        """A machine's power with this shape, and at full level as it is.

        What warm water takes is not in the shape, which compares levels in the same water, and is added to it.
        """
        load, water_W = power.load, power.load.curve_W if power.water_s else 0.0
        low, high = load.T_out_range_C
        (fixed_low, per_low), (fixed_high, per_high) = load.parts(low), load.parts(high)
        other_W = load.curve_W - (1.0 - COMPARED_AT) * water_W
        full_low, full_high = (float(x) + other_W for x in (fixed_low + per_low, fixed_high + per_high))
        curve_W = self.curve * min(full_low, full_high)
        slope = (full_high - full_low) / max(high - low, 1e-9)
        # What the part in u², which has no slope over the outdoor temperature, lacks is in the part per level.
        total = (full_low - curve_W - slope * low, slope)
        share = self.fixed / max(self.fixed + self.per_u, 1e-9)
        rest = 1.0 - share
        # A little of the part per level is left, so that rounding cannot make it negative.
        cold_W = min(COMPARED_AT * water_W, 0.99 * rest * (min(full_low, full_high) - curve_W))
        coefficients = (share * total[0], share * total[1], rest * total[0] - cold_W, rest * total[1])
        curve_W += cold_W / COMPARED_AT
        return replace(power, load=MachineLoad(coefficients, load.T_out_range_C, load.lowest_level, curve_W=curve_W))


@dataclass(frozen=True)
class PartLoad:
    """Shares of full power and full heat that do not depend on the level while the machine runs, in middling weather.

    `heat_fixed` is 0 where heat is not measured and counts as proportional to the level.
    """

    power_fixed: float
    heat_fixed: float

    @property
    def at_half(self) -> float:
        """Power per heat at half level over that at full level."""
        return self.at(0.5)

    def at(self, level: float) -> float:
        """Power per heat at `level` over that at full level."""
        more = 1.0 / level - 1.0
        return (1.0 + more * self.power_fixed) / (1.0 + more * self.heat_fixed)

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
    return PartLoad(fixed / (fixed + per_u), heat_fixed)
