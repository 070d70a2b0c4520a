"""The question of `tf-mpc bench effects`, the windows in which its answer is scored, and the model's band for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import HOUR_S, NORMAL_95, Array
from thermoforce_mpc.identification.estimation.regression import STEP_RESPONSE_H
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.step_response import step_response_of

STEP_S = 900.0
# Hours off, then at full level, and hours from the start of the block that are scored.
OFF_H, BLOCK_H, SCORED_H = 2.0, 6.0, 48.0


@dataclass(frozen=True)
class Window:
    """What of an effect is scored: its mean over `hours` from the start of the block, or its value after them."""

    name: str
    hours: float
    mean: bool = True

    def of(self, effect_K: Array) -> float:
        """The scored number, K, of an effect at the ends of the steps of `block` (n,), K."""
        first = _steps(OFF_H)
        last = first + _steps(self.hours)
        return float(effect_K[first:last].mean() if self.mean else effect_K[last - 1])


LONGEST = Window("48 h", 48.0)
WINDOWS = (Window("6 h, end", BLOCK_H, mean=False), Window("8 h", 8.0), Window("24 h", 24.0), LONGEST)


def block() -> Array:
    """Levels (n,) of the question at steps of `STEP_S`: off, six hours at full level, off."""
    u = np.zeros(_steps(OFF_H + SCORED_H))
    u[_steps(OFF_H) : _steps(OFF_H + BLOCK_H)] = 1.0
    return u


def band_K(model: ThermalModel, window: Window, effect_K: float, z: int = 0, a: int = 0) -> tuple[float, float]:
    """The model's 90 % band, K, of the number of a window, which it says is `effect_K`; NaN where it knows none.

    As wide, relative to the effect of actuator `a` on zone `z`, as that of a step to full level after the hours of the
    window; of an effect that the model leaves out as wide as that of a step.
    """
    mean, sd = step_response_of(model, z, a)
    if not mean.size:
        return float("nan"), float("nan")
    hours = np.array([0.0, *STEP_RESPONSE_H])
    relative = np.interp(window.hours, hours[1:], sd[1:] / np.maximum(np.abs(mean[1:]), 1e-9))
    half = NORMAL_95 * float(abs(effect_K) * relative if effect_K else np.interp(window.hours, hours, sd))
    return effect_K - half, effect_K + half


def _steps(hours: float) -> int:
    return round(hours * HOUR_S / STEP_S)
