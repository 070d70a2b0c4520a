"""From a planned level to what the machine is told: one held level, or on/off blocks at the efficient level.

A heat pump with a large fixed loss while on is efficient off or near full speed. In `duty` mode the plan therefore
decides a *share* of each step, power and heat are linear in it, and this layer turns the share into blocks that
respect minimum on and off times and carries over what could not be realised. In `modulating` mode (the paper's
setting) the level is held for the whole step, off or at least the machine's lowest sensible level.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from thermoforce_mpc.testcase import StrictModel
from thermoforce_mpc.types import Block


class ActuationConfig(StrictModel):
    """How a planned level reaches the machine."""

    mode: Literal["duty", "modulating"] = Field("duty", description="on/off blocks, or one level held for the step")
    level: float = Field(1.0, gt=0, le=1, description="duty: level while on")
    block_s: float = Field(300.0, ge=30, description="duty: blocks are multiples of this, s")
    min_on_s: float = Field(600.0, ge=0, description="duty: shortest time on, s")
    min_off_s: float = Field(600.0, ge=0, description="duty: shortest time off, s")
    lowest_level: float = Field(0.3, ge=0, le=1, description="modulating: off below half of this, else at least this")

    @model_validator(mode="after")
    def _consistent(self) -> ActuationConfig:
        for name in ("min_on_s", "min_off_s"):
            if getattr(self, name) % self.block_s:
                raise ValueError(f"{name} must be a multiple of block_s ({self.block_s:g} s)")
        return self


class Actuation:
    """Realises planned levels step after step; remembers the machine's state and the share still owed."""

    def __init__(self, config: ActuationConfig) -> None:
        self.config = config
        self._owed_s = 0.0
        self._on = False

    @property
    def highest(self) -> float:
        """The highest level a plan may ask for."""
        return self.config.level if self.config.mode == "duty" else 1.0

    @property
    def lowest_level(self) -> float:
        """Below this level a plan is made by switching: power and heat are then a share of being on."""
        return self.config.level if self.config.mode == "duty" else max(self.config.lowest_level, 1e-3)

    def realise(self, u: float, step_s: float) -> tuple[Block, ...]:
        """Blocks of `step_s` in total whose mean level is as near to `u` (in [0, `highest`]) as the machine allows."""
        if self.config.mode == "modulating":
            return (Block(self._held_level(u), step_s),)
        return self._duty_blocks(u, step_s)

    def _held_level(self, u: float) -> float:
        lowest = self.config.lowest_level
        if u >= lowest:
            return min(u, 1.0)
        return lowest if u > lowest / 2 else 0.0

    def _duty_blocks(self, u: float, step_s: float) -> tuple[Block, ...]:
        c = self.config
        share = min(max(u / c.level, 0.0), 1.0)
        # Nothing is owed to a plan that wants the machine off: an old remainder must not heat a warm house.
        wanted_s = share * step_s + self._owed_s if share > 1e-3 else 0.0
        on_s = self._feasible_on_time(wanted_s, step_s)
        # More than one block can only be owed through minimum times; the cap keeps a long refusal from piling up.
        cap = max(c.block_s, c.min_on_s, c.min_off_s)
        self._owed_s = min(max(wanted_s - on_s, -cap), cap)
        on, off = Block(c.level, on_s), Block(0.0, step_s - on_s)
        # Continue in the state the machine is in: half as many starts.
        ordered = (on, off) if self._on else (off, on)
        blocks = tuple(block for block in ordered if block.duration_s > 0)
        self._on = blocks[-1].u != 0.0
        return blocks

    def _feasible_on_time(self, wanted_s: float, step_s: float) -> float:
        """The time on nearest to `wanted_s` that is a whole number of blocks and respects the minimum times."""
        c = self.config
        candidates = {0.0, step_s}
        n = int(step_s // c.block_s)
        candidates |= {
            k * c.block_s
            for k in range(1, n + 1)
            if k * c.block_s >= c.min_on_s and (step_s - k * c.block_s) >= c.min_off_s
        }
        return min(sorted(candidates), key=lambda on_s: abs(on_s - wanted_s))
