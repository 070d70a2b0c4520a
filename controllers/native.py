"""The controller built into the plant: nothing is overwritten."""

from __future__ import annotations

from pydantic import Field

from thermoforce_mpc.data import Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class NativeConfig(StrictModel):
    """Options of the native controller."""

    step_s: float = Field(3600.0, ge=60, le=86400, description="how often to look, s")


class NativeController:
    """Leaves the plant to its own control (BOPTEST: no overwrite is activated)."""

    name = "native"

    def __init__(self, config: NativeConfig | None = None) -> None:
        self.config = config or NativeConfig()

    @property
    def step_s(self) -> float:
        """How long a plan is followed, s."""
        return self.config.step_s

    @property
    def horizon_s(self) -> float:
        """One step: no foresight is used."""
        return self.config.step_s

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One block of native control; there is no state."""
        return Plan((Block(None, self.step_s),), PlanStatus.RULE, "the plant's own controller acts")
