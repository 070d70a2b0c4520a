"""Fallback policy of one actuator after a failed forecast or solve: previous plan, on/off rule, native control."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from thermoforce_mpc.data import HOUR_S, Array, Boundary, Observation
from thermoforce_mpc.data.limits import SENSOR_STEP_K
from thermoforce_mpc.model.card import FAR_K
from thermoforce_mpc.model.free_response.substitute import COLD_AFTER
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K
from thermoforce_mpc.scenario.settings import StrictModel

# Set-points of the on/off rule stay within this, whatever the bounds say, °C: below, pipes would freeze; above, no
# building is wanted.
_RULE_C = (5.0, 35.0)
# A plan is followed while its error is within this many half-widths of its 80 % band. By judgement
# (2026-11-22): beyond, the plan is of another weather or machine.
_TRUSTED_BANDS = 3.0


class FallbackConfig(StrictModel):
    """Options of the fallback policy."""

    stand_back: Literal["native", "rule"] = Field(
        "native",
        description="who acts while the model is not competent or does not hold: the plant's own control, or the on/off"
        " rule",
    )
    # Steps for which the previous plan is followed: three quarters of an hour, in which weather and people are still
    # those it was made for. By judgement; `tf-mpc bench fallback` runs with it.
    follow_steps: ClassVar[int] = 3
    # The previous plan is dropped when its predicted zone temperature is off by more, K, or by
    # three times the half-width of its own 80 % band.
    trust_K: ClassVar[float] = FAR_K
    # On/off rule: set-point above the lower bound (cooling: below the upper), K.
    setpoint_above_bound_K: ClassVar[float] = THERMOSTAT_INSIDE_K
    # On/off rule: window ahead over which the tightest bound is taken, h.
    look_ahead_h: ClassVar[float] = 3.0
    # On/off rule: set-points of heating and of cooling where comfort bounds are missing, °C: in a home the lower limit
    # of category II in winter, and about the upper one of category I in summer (EN 16798-1: 20 and 25.5).
    safe_C: ClassVar[tuple[float, float]] = (20.0, 25.0)
    # Consecutive failures after which forecasts and solves begin anew, without what they kept.
    cold_after: ClassVar[int] = COLD_AFTER


@dataclass(frozen=True)
class GoodPlan:
    """The last solved plan: its time, s, levels `u` (A, N), and predicted zone temperatures `T_zone_C` (Z, N), °C.

    `band_K` (Z, N): half-width of the 80 % band of its forecast. A zone that was never measured has NaN in both.
    `margin_K` (2, Z): what it kept inside the lower and the upper bound in all, mean over its first 6 h.
    """

    time_s: float
    u: Array
    T_zone_C: Array
    band_K: Array
    margin_K: Array = field(default_factory=lambda: np.zeros((2, 1)))

    def age(self, time_s: float, step_s: float) -> int:
        """Age of the plan in steps of `step_s` seconds."""
        return round((time_s - self.time_s) / step_s)

    def ahead(self, time_s: float, step_s: float, steps: int) -> Array | None:
        """Levels (A, steps) that it has for the steps from `time_s` on, NaN beyond its end; None where it has none."""
        age = self.age(time_s, step_s)
        if not 0 <= age < self.u.shape[1]:
            return None
        left = self.u[:, age : age + steps]
        return np.pad(left, ((0, 0), (0, steps - left.shape[1])), constant_values=np.nan)


class FallbackPolicy:
    """Level of one actuator to apply when there is no new plan for it.

    `mode` is heating, cooling, or both: the plant's own loops then keep the comfort bounds, and native control acts, as
    where an actuator is set by a command.
    `zone` is the number of the zone that the actuator serves.
    """

    def __init__(self, config: FallbackConfig, step_s: float, level: float, mode: str, zone: int = 0) -> None:
        self.config, self.step_s, self.level, self.mode, self.zone = config, step_s, level, mode, zone

    def level_to_follow(self, good: GoodPlan | None, observation: Observation, actuator: int = 0) -> float | None:
        """Level of the last solved plan for now; None when it is too old or its prediction did not come true.

        The error may be three times the half-width of the plan's own band, at least 0.1 K and at most `trust_K`.
        """
        if good is None or self.mode == "both":
            return None
        age = good.age(observation.time_s, self.step_s)
        if not 1 <= age <= min(self.config.follow_steps, good.u.shape[1] - 1):
            return None
        # A missing reading does not invalidate the plan; a prediction error does.
        planned_C = float(good.T_zone_C[self.zone, age - 1])
        if not math.isfinite(planned_C):
            return None
        error_K = abs(float(observation.T_zone_C[self.zone]) - planned_C)
        promised_K = max(_TRUSTED_BANDS * float(good.band_K[self.zone, age - 1]), SENSOR_STEP_K)
        if math.isfinite(error_K) and error_K > min(self.config.trust_K, promised_K):
            return None
        return min(max(float(good.u[actuator, age]), 0.0), self.level)

    def standing_back(self, observation: Observation, T_zone_C: Array | None = None) -> tuple[float | None, str]:
        """Level, or None for native control, while the model must not act (`stand_back`), and who acts, as text."""
        return (None, "native control") if self.config.stand_back == "native" else self.rule(observation, T_zone_C)

    def rule(self, observation: Observation, T_zone_C: Array | None = None) -> tuple[float | None, str]:
        """Level of an on/off rule on the tightest comfort bound of the next hours, and the reason as text.

        `T_zone_C` (Z,), °C: temperatures to act on where they are not those of the observation. The level is None
        (native control) while the zone temperature is unknown. Where no bound is known, `safe_C` takes their place.
        """
        T = float((observation.T_zone_C if T_zone_C is None else T_zone_C)[self.zone])
        return self.rule_at(T, observation.boundary, observation.time_s)

    def rule_at(self, T_zone_C: float, bounds: Boundary, time_s: float) -> tuple[float | None, str]:
        """The same for a temperature of the zone, °C, at a time within `bounds`, s."""
        if self.mode == "both":
            return None, "native control"
        if not math.isfinite(T_zone_C):
            return None, "zone temperature unknown: native control"
        (setpoint,), (known,) = self.setpoints_C(bounds, np.array([time_s]))
        level, note = self.switched(T_zone_C, float(setpoint)), "" if known else " (no bounds)"
        return level, f"{T_zone_C:.2f} °C against {setpoint:.2f} °C{note}: {'on' if level else 'off'}"

    def setpoints_C(self, bounds: Boundary, time_s: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Set-points of the rule at times (k,) within `bounds`, s, and whether a bound was known for each."""
        heating, inside_K = self.mode == "heating", self.config.setpoint_above_bound_K
        limits_C = (bounds.lower_C if heating else bounds.upper_C)[self.zone]
        begin_s, end_s = time_s[:, None] - 1.0, time_s[:, None] + self.config.look_ahead_h * HOUR_S
        ahead = (bounds.time_s >= begin_s) & (bounds.time_s <= end_s) & np.isfinite(limits_C)
        known = np.asarray(ahead.any(axis=1))
        if heating:
            setpoint = np.where(ahead, limits_C, -np.inf).max(axis=1, initial=-np.inf) + inside_K
        else:
            setpoint = np.where(ahead, limits_C, np.inf).min(axis=1, initial=np.inf) - inside_K
        setpoint = np.where(known, setpoint, self.config.safe_C[0 if heating else 1])
        return np.clip(setpoint, *_RULE_C), known

    def switched(self, T_zone_C: float, setpoint_C: float) -> float:
        """Level of the rule at a temperature of the zone and a set-point, °C."""
        on = setpoint_C > T_zone_C if self.mode == "heating" else setpoint_C < T_zone_C
        return self.level if on else 0.0
