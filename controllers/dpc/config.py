"""Options of differentiable predictive control."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from controllers.checks import ControllerConfigError
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.scenario.settings import StrictModel


class TrainingConfig(StrictModel):
    """Offline training of the policy; all of it is seeded."""

    iterations: int = Field(400, ge=1, le=100_000, description="steps of the optimiser")
    buildings: int = Field(48, ge=1, le=4096, description="courses of weather, bounds and prices controlled at a time")
    rollout_h: float = Field(24.0, ge=1, le=168, description="length that the gradient goes back through, h")
    hidden: int = Field(32, ge=1, le=1024, description="neurons in each of two hidden layers")
    learning_rate: float = Field(0.02, gt=0, le=1, description="at first; it falls to a tenth")
    seed: int = Field(1, ge=0, description="seed of situations and weights")


class DPCConfig(MPCConfig):
    """Options of the policy: those of the MPC, whose solver it takes the place of, and its training.

    Of the objective it knows energy at the tariff, carbon and comfort.
    """

    solver: Literal["auto"] = Field("auto", description="the policy; no other")
    policy: str | None = Field(
        None, description="folder of a policy that `tf-mpc train` wrote; null: trained when the controller is built"
    )
    training: TrainingConfig = TrainingConfig()

    def check(self) -> None:
        """Raise `ControllerConfigError` for parts of the objective that a policy is not trained for."""
        aims = self.objective
        for name, unused in (
            ("peak_price_per_kW", aims.peak_price_per_kW == 0.0),
            ("power_cap_kW", aims.power_cap_kW is None),
            ("terminal_value", aims.terminal_value == 0.0),
        ):
            if not unused:
                raise ControllerConfigError(
                    f"controller.options.objective.{name}: the policy of dpc is not trained for it; leave it out, or "
                    "use thermoforce_mpc"
                )
