"""Native control: the controller built into the plant acts, no input is overwritten."""

from __future__ import annotations

from pydantic import Field

from thermoforce_mpc.data import Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.settings import StrictModel


class NativeConfig(StrictModel):
    """Options of the native controller."""

    step_s: float = Field(3600.0, ge=60, le=86400, description="control step, s")


class NativeController:
    """Leaves the plant under its own control (BOPTEST: no overwrite is activated)."""

    name = "native"

    def __init__(self, config: NativeConfig | None = None) -> None:
        self.config = config or NativeConfig()
        self.step_s = self.horizon_s = self.config.step_s  # no forecast is used

    def plan(self, observation: Observation, state: object = None) -> Plan:
        """One block of native control; stateless."""
        names = observation.names
        blocks = (Block.native(len(names.actuators), self.step_s),)
        return Plan(blocks, PlanStatus.RULE, "the plant's own controller acts", names=names)
