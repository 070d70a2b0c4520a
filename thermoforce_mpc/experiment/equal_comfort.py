"""A thermostat as comfortable as a controller: the set-point at which its discomfort is the controller's + 0.1 K·h.

A baseline at a set-point of its own is warmer or colder than the controller, so their costs say little of each other.
Discomfort falls with the set-point until zones get too warm: doubled steps to where it falls, then bisection.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from controllers.entries.entry import Chosen
from controllers.rules.thermostat import ThermostatConfig, shifted
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.report.findings import COST, DISCOMFORT

THERMOSTAT = "thermostat"
SET_POINTS = {"setpoints_C", "cooling_setpoint_C"}
"""Its options that are shifted."""

# What a thermostat may be less comfortable, K·h.
ALLOWED_KH = 0.1
# Step of the set-point, K; the first steps of the search and the farthest from where it begins, as numbers of steps.
_STEP_K, _FIRST, _FARTHEST = 0.05, 4, 32

Kpis = Mapping[str, float]


@dataclass(frozen=True)
class AsComfortable:
    """A thermostat beside a controller.

    `shift_K`: its set-points above those it has by default; `comparable`: whether its discomfort is at most the
    controller's + 0.1 K·h. Where no set-point is, it is the one with the least discomfort.
    """

    shift_K: float
    kpis: Kpis
    comparable: bool

    def saving(self, cost: float) -> float:
        """Share of its cost that a controller of this `cost` saves; NaN where the thermostat costs nothing."""
        return 1.0 - cost / self.kpis[COST] if self.kpis[COST] > 0.0 else float("nan")

    def in_words(self, cost: float, currency: str) -> str:
        """What it is beside a controller of this `cost`."""
        at = f"{self.shift_K:+.2f} K from" if self.shift_K else "at"
        figures = f"{self.kpis[COST]:.4f} {currency}/m², {self.kpis[DISCOMFORT]:.2f} K·h"
        saving = self.saving(cost)
        less = f"{100.0 * abs(saving):.1f} % {'less' if saving >= 0.0 else 'more'} than a thermostat {at} its set-point"
        return f"{less} ({figures}){' at equal comfort' if self.comparable else '; no set-point is as comfortable'}"

    def to_json(self, cost: float, currency: str) -> dict[str, Any]:
        """What a record of a comparison holds of it, for a controller of this `cost`."""
        figures = {name: self.kpis[name] for name in (COST, DISCOMFORT)}
        found = {"shift_K": self.shift_K, "kpis": figures, "comparable": self.comparable}
        saving = self.saving(cost)
        return found | {"saving": saving if isfinite(saving) else None, "in_words": self.in_words(cost, currency)}

    def beaten(self, cost: float) -> bool | None:
        """Whether a controller of this `cost` is cheaper; None: dearer, and more comfortable than any set-point."""
        cheaper = cost < self.kpis[COST]
        return cheaper if cheaper or self.comparable else None


def as_comfortable(run: Callable[[float], Kpis], default: Kpis, discomfort_Kh: float) -> AsComfortable:
    """Search the thermostat that is as comfortable as a controller with `discomfort_Kh` K·h.

    `run`: KPIs of the thermostat with its set-points raised by so many K; `default`: those without.
    """
    tried = {0: default}  # by number of steps

    def discomfort_of(steps: int) -> float:
        if steps not in tried:
            tried[steps] = run(steps * _STEP_K)
        return tried[steps][DISCOMFORT]

    def enough(steps: int) -> bool:
        return discomfort_of(steps) <= discomfort_Kh + ALLOWED_KH

    def nearer(sign: int) -> int:
        """The shift reached by doubled steps in one direction while discomfort falls and is too much."""
        shift, step = 0, _FIRST
        while not enough(shift) and abs(shift + sign * step) <= _FARTHEST:
            if not discomfort_of(shift + sign * step) < discomfort_of(shift):
                break
            shift, step = shift + sign * step, 2 * step
        return shift

    # Too cold is what a higher set-point mends, too warm by the sun a lower one.
    warm = nearer(1)
    if not enough(warm):
        warm = nearer(-1)
    if not enough(warm):
        least = min(tried, key=lambda steps: tried[steps][DISCOMFORT])
        return AsComfortable(least * _STEP_K, tried[least], False)
    step = _FIRST
    while warm - step >= -_FARTHEST and enough(warm - step):
        warm, step = warm - step, 2 * step
    cold = max((steps for steps in tried if steps < warm), default=warm)
    while warm - cold > 1:
        middle = (warm + cold) // 2
        warm, cold = (middle, cold) if enough(middle) else (warm, middle)
    cheapest = min((steps for steps in tried if enough(steps)), key=lambda steps: tried[steps][COST])
    return AsComfortable(cheapest * _STEP_K, tried[cheapest], True)


def run_shifted(thermostat: Chosen, run: Callable[[Controller], Kpis]) -> Callable[[float], Kpis]:
    """KPIs of a thermostat with its set-points raised by so many K, each found by a `run` of it."""

    def kpis(shift_K: float) -> Kpis:
        return run(raised(thermostat, shift_K).build())

    return kpis


def raised(thermostat: Chosen, shift_K: float) -> Chosen:
    """A thermostat with its set-points raised by so many K."""
    config = thermostat.config
    assert isinstance(config, ThermostatConfig)
    return replace(thermostat, config=shifted(config, thermostat.testcase.layout, shift_K))
