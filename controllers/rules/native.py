"""Native control: the controller built into the plant acts, no input is overwritten."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from thermoforce_mpc.data import Block, Observation, Plan, PlanStatus
from thermoforce_mpc.scenario.comfort import Comfort
from thermoforce_mpc.scenario.settings import StrictModel
from thermoforce_mpc.scenario.testcase import TestCase


class NativeConfig(StrictModel):
    """Options of the native controller."""

    # Nothing is decided, so that it only says how often a journal is written.
    step_s: float = Field(3600.0, ge=60, le=86400, description="control step, s")


def native_for(testcase: TestCase, comfort: Comfort | None, options: Mapping[str, Any]) -> dict[str, Any]:
    """Defaults of its options for a test case, see `Entry.suited`."""
    return {"step_s": testcase.step_s}


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
