"""Options of differentiable predictive control, apart from what loads torch."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from controllers.mpc.config import MPCConfig
from thermoforce_mpc.scenario.settings import StrictModel


class PolicyConfig(StrictModel):
    """The network of a policy and its training."""

    # With these and the defaults below a policy of a heat pump is trained in 16 s and answers in 8 ms, most unseen
    # instances within 1 to 5 of costs of 5 to 40 (2026-11-28).
    hidden: int = Field(32, ge=1, le=512, description="units of each of two hidden layers")
    # See `hidden`.
    instances: int = Field(1024, ge=64, le=100_000, description="drawn instances that it is trained on")
    # See `hidden`.
    epochs: int = Field(20, ge=1, le=10_000, description="how often each is seen")
    seed: int = Field(1, ge=0, description="seed of instances and initial weights")


class DPCConfig(MPCConfig):
    """Options of differentiable predictive control: those of the MPC but for its solver, and the policy's."""

    policy: PolicyConfig = PolicyConfig()
    solver: Literal["auto"] = Field("auto", description="none but the policy: leave it out")

    @field_validator("solver", mode="before")
    @classmethod
    def _no_solver(cls, solver: str) -> str:
        if solver != "auto":
            raise ValueError("dpc plans by its policy, with no solver: leave it out, or use thermoforce_mpc")
        return solver
