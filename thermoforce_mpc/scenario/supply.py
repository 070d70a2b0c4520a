"""Water of a machine as warm as the planned heat takes, behind valves that are open or closed."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from thermoforce_mpc.data import ZERO_C_K
from thermoforce_mpc.scenario.strict_model import PointName, StrictModel, check_kelvin


class Supply(StrictModel):
    """Set-point of a machine's supply water, by which its valves give the heat that is asked of them.

    A heat pump needs less power for the same heat the cooler its water is. What heat some water gives depends on how
    warm the floor is already, so the set-point is corrected in every block by what the last one lacked. Water that is a
    kelvin warmer gives at most `flow_W_per_K` more, so the correction never overshoots.
    """

    point: PointName = Field(description="overwrite point of the set-point, K, without the `_u` ending")
    minimum: float = Field(description="coolest water, K")
    maximum: float = Field(description="warmest water that a plan may ask for, K")
    flow_W_per_K: float = Field(
        gt=0, description="heat capacity of the water that flows through an open valve, W/K: kg/s times 4186 J/kgK"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Supply:
        check_kelvin(minimum=self.minimum, maximum=self.maximum)
        if not self.minimum < self.maximum:
            raise ValueError(f"minimum ({self.minimum}) must be below maximum ({self.maximum})")
        return self

    def value(self, heat_W: float, T_floor_C: float, last_K: float = math.nan, gave_W: float = math.nan) -> float:
        """Return the set-point, K, for `heat_W` through an open valve.

        `last_K`, `gave_W`: set-point of the last block and the valve's mean heat in it, W; NaN where it was closed. The
        water then comes back at `T_floor_C` °C, NaN: unknown.
        """
        more_W = heat_W - gave_W
        if math.isfinite(last_K + more_W):
            wanted = last_K + more_W / self.flow_W_per_K
        elif math.isfinite(T_floor_C):
            wanted = T_floor_C + ZERO_C_K + heat_W / self.flow_W_per_K
        else:
            wanted = self.maximum
        return min(max(wanted, self.minimum), self.maximum)
