"""Options of the identification."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from thermoforce_mpc.model.operator.parameters import GAMMA, HIDDEN
from thermoforce_mpc.scenario.settings import StrictModel

# Modes of the operator: an emitter, the room and its structure.
_MODES = 3


class IdentificationConfig(StrictModel):
    """Options of an identification. The defaults suit a heated house with 1 to 30 days of data."""

    method: Literal["joint", "two_stage"] = Field(
        "joint", description="effects and free part by one network, or the paper's two stages (order 1; pairs train it)"
    )
    order: Literal["auto", 1, 2, 3] = Field(
        "auto", description="modes of the operator; auto: 3, with method two_stage 1"
    )
    heat_input: Literal["auto", "identity"] = Field(
        "auto",
        description="input of the modes; identity: u; auto: u, or measured heat where levels between off and full are "
        "held",
    )
    lowest_level: float | None = Field(
        None, gt=0, le=1, description="level below which the probed machine cycled; default: estimated from the data"
    )
    part_load: bool = Field(
        False,
        description="estimate heat at part load, and so what it costs, from the temperature where heat is not "
        "measured; set where probing takes trial levels",
    )
    power_curve: bool = Field(
        False,
        description="fit power that grows faster than heat, by a term in u²; set where the plan sets a machine's "
        "water. Where levels were tried, what heat costs there has its place",
    )
    cross_effects: bool = Field(True, description="effects of an actuator on zones other than its home")
    sun_on_sensor: bool = Field(
        True, description="look for sun on the zone sensor, and take it off the readings where there is any"
    )
    late_sensor: bool = Field(
        True, description="look for a sensor of a single zone that reads late, and plan for the temperature of the room"
    )
    air_through_windows: bool = Field(
        True,
        description="look for steps in which air came into a room through a window, and let them explain no effect",
    )
    foreign_loads: bool = Field(True, description="look for other loads on meters of power and heat, and take them off")
    modulation: Literal["always", "auto", "linear"] = Field(
        "auto",
        description="gain m(x) of the paper, a network: kept always, or (auto) unless it predicts held-out data "
        "significantly worse than m = 1; linear: m = 1",
    )
    feedback: bool = Field(
        False,
        description="m(x) takes the predicted temperature, actions included, instead of the free response (paper)",
    )
    gamma: float = Field(GAMMA, ge=0, lt=1, description="bound of the modulation, eq:mod")
    hidden: int = Field(HIDDEN, ge=1, le=512, description="hidden units of the modulation")
    optimiser: Literal["lbfgs", "adam"] = Field("lbfgs", description="optimiser of the modulation")
    # L-BFGS ends where it settles (`_FLAT` and `_SETTLED` of `modulation`), else here; Adam takes all.
    epochs: int = Field(350, ge=1, le=5000, description="largest number of training epochs")
    seed: int = Field(1, ge=0, description="seed of the network's initial weights and of splits")

    @model_validator(mode="after")
    def _consistent(self) -> IdentificationConfig:
        if self.method == "two_stage" and self.order not in ("auto", 1):
            raise ValueError(f"method two_stage is of order 1, but order is {self.order}")
        return self

    @property
    def modes(self) -> int:
        """Number of modes of the operator."""
        if self.order == "auto":
            return 1 if self.method == "two_stage" else _MODES
        return self.order
