"""From a planned level to what the machine is told: one held level, or on/off blocks at the efficient level.

A heat pump with a large fixed loss while on is efficient off or near full speed. In `duty` mode the plan therefore
decides a *share* of each step, power and heat are linear in it, and this layer turns the share into blocks that
respect minimum on and off times across steps and carries over what could not be realised. In `modulating` mode (the
paper's setting) the level is held for the whole step, off or at least the machine's lowest sensible level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from controllers.errors import ControllerConfigError
from thermoforce_mpc.data import Block, Record
from thermoforce_mpc.scenario.settings import StrictModel

# A share below this asks for the machine to be off; measured means of a step are exact to this, too.
_OFF = 1e-3


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


@dataclass(frozen=True)
class ActuationState:
    """What the machine does: whether it is on, for how long it has been so, s, and the time on still owed to plans, s.

    `native`: the plant's own control acts since, so the rest is not known.
    """

    on: bool = False
    held_s: float = math.inf
    owed_s: float = 0.0
    native: bool = False


# A machine of which nothing is known may just have switched off: it has to stay off for its minimum time first.
_UNKNOWN = ActuationState(on=False, held_s=0.0)


class Actuation:
    """Realises planned levels step after step; the machine's state goes from one step to the next as a value."""

    def __init__(self, config: ActuationConfig) -> None:
        self.config = config

    @property
    def highest(self) -> float:
        """The highest level a plan may ask for."""
        return self.config.level if self.config.mode == "duty" else 1.0

    @property
    def lowest_level(self) -> float:
        """Below this level a plan is made by switching: power and heat are then a share of being on."""
        return self.config.level if self.config.mode == "duty" else max(self.config.lowest_level, 1e-3)

    def check_step(self, step_s: float) -> None:
        """Raises `ControllerConfigError` where a step of `step_s` seconds is too short to be shared by blocks."""
        c = self.config
        if c.mode == "duty" and step_s < 2 * c.block_s:
            raise ControllerConfigError(
                f"controller.options.actuation.block_s: blocks of {c.block_s:g} s cannot share a step of"
                f" {step_s:g} s; use shorter blocks or mode: modulating"
            )

    def now(self, state: ActuationState | None, history: Record) -> ActuationState:
        """The machine as the next step finds it: as it was told, or as `history` shows it where others were in control.

        Others are the plant's own control, in the step before and before the run begins (`state` None).
        """
        if state is not None and not state.native:
            return state
        if not (history.n_steps and np.isfinite(history.u[-1])):
            return ActuationState() if state is None else _UNKNOWN
        return self._seen(history)

    def _seen(self, history: Record) -> ActuationState:
        """What the mean levels of the past steps tell of the machine, where there is a doubt to the side of waiting."""
        u, level = history.u, self.config.level
        off, full = u <= _OFF, u >= level - _OFF
        between = np.isfinite(u) & ~off & ~full
        if off[-1]:
            return ActuationState(on=False, held_s=_last_run(off) * history.step_s)
        if full[-1]:
            return ActuationState(on=True, held_s=_last_run(full) * history.step_s)
        if u.size > 1 and off[-2]:  # it came on in the last step, at the latest when the rest of it makes up the mean
            return ActuationState(on=True, held_s=float(u[-1]) / level * history.step_s)
        if u.size > 1 and between[-2]:  # neither off nor full for several steps: it runs at a level of its own
            return ActuationState(on=True, held_s=_last_run(between) * history.step_s)
        return _UNKNOWN  # full before, or not known: it may have gone off in the last step

    def realise(
        self, u: float | None, step_s: float, state: ActuationState
    ) -> tuple[tuple[Block, ...], ActuationState]:
        """Blocks of `step_s` in total whose mean level is as near to `u` (in [0, `highest`]) as the machine allows.

        `u` None is native control. With the blocks comes the state to give to the next step.
        """
        if u is None:
            return (Block(None, step_s),), ActuationState(native=True)
        if self.config.mode == "modulating":
            return (Block(self._held_level(u), step_s),), state
        return self._duty_blocks(u, step_s, state)

    def _held_level(self, u: float) -> float:
        lowest = self.config.lowest_level
        if u >= lowest:
            return min(u, 1.0)
        return lowest if u > lowest / 2 else 0.0

    def _duty_blocks(self, u: float, step_s: float, state: ActuationState) -> tuple[tuple[Block, ...], ActuationState]:
        c, on = self.config, state.on
        share = min(max(u / c.level, 0.0), 1.0)
        # Nothing is owed to a plan that wants the machine off: an old remainder must not heat a warm house.
        wanted_s = share * step_s + state.owed_s if share > _OFF else 0.0
        stays_s = self._time_in_state(wanted_s, step_s, state)
        on_s = stays_s if on else step_s - stays_s
        # More than one block can only be owed through minimum times; the cap keeps a long refusal from piling up.
        cap = max(c.block_s, c.min_on_s, c.min_off_s)
        owed_s = min(max(wanted_s - on_s, -cap), cap)
        level, other = (c.level, 0.0) if on else (0.0, c.level)
        blocks = tuple(Block(u, t) for u, t in ((level, stays_s), (other, step_s - stays_s)) if t > 0)
        if stays_s < step_s:
            return blocks, ActuationState(not on, step_s - stays_s, owed_s)
        return blocks, ActuationState(on, state.held_s + step_s, owed_s)

    def _time_in_state(self, wanted_s: float, step_s: float, state: ActuationState) -> float:
        """How long the machine stays as it is before it switches, s: that which comes nearest to `wanted_s` on.

        It switches at most once in a step, at a whole block, and not before its minimum time in this state has passed.
        A stretch that begins in this step may be shorter than its minimum: the next step then goes on with it.
        """
        c = self.config
        left_s = max((c.min_on_s if state.on else c.min_off_s) - state.held_s, 0.0)
        blocks = np.arange(0.0, step_s, c.block_s)
        candidates = [*blocks[blocks >= left_s].tolist(), step_s]
        if not state.on:
            # Among equals the later start: what is not needed yet may turn out not to be needed.
            candidates.reverse()
        return min(candidates, key=lambda stays_s: abs((stays_s if state.on else step_s - stays_s) - wanted_s))


def _last_run(flags: NDArray[np.bool_]) -> int:
    """How many of the last `flags` (n,) are set without a break."""
    return int(flags.size if flags.all() else np.argmin(flags[::-1]))
