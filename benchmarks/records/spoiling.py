"""Faults of several sizes put into clean records: what is spoiled, how, and what a check should call it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.records.drawing import STEP_S, Drawn
from thermoforce_mpc.data import HOUR_S, Array, Record, steps_in
from thermoforce_mpc.measurements.checks.common import Kind

Spoil = Callable[[Drawn, np.random.Generator], Record | None]
# Share of full power that a household takes beside the heating, in the mean, and how long a load stays, h.
_HOUSEHOLD_H = 1.0


@dataclass(frozen=True)
class Fault:
    """A fault: what it should be called, its size in words, and the spoiled record, None where it cannot be put in."""

    kind: Kind
    size: str
    spoil: Spoil


def faults() -> list[Fault]:
    """Every class of fault at its sizes."""
    found = [Fault("stamps late", f"{_minutes(k)} min", _moved(k)) for k in (1, 2, 4)]
    found += [Fault("stamps early", f"{_minutes(k)} min", _moved(-k)) for k in (1, 2, 4)]
    for power, heat in ((1.0, 4.0), (1.0, 0.25), (4.0, 1.0), (0.25, 1.0), (4.0, 4.0), (0.25, 0.25)):
        size = f"Wh: power x {power:g}, heat x {heat:g}"
        found.append(Fault("unit of power", size, _scaled(power, heat)))
    for power, heat in ((1e-3, 1e-3), (1e3, 1e3), (1e-3, 1.0), (1.0, 1e-3)):
        size = f"kW: power x {power:g}, heat x {heat:g}"
        found.append(Fault("unit of power", size, _scaled(power, heat)))
    found.append(Fault("unit of temperature", "outdoors in °F", _in_fahrenheit))
    found.append(Fault("level is no level", "set-point, metered", _set_point(metered=True)))
    found.append(Fault("level is no level", "set-point, no meter", _set_point(metered=False)))
    found += [Fault("meter holds another load", f"hot water {k} h a day", _hot_water(k)) for k in (0.5, 1.0, 2.0)]
    found += [
        Fault("meter holds another load", f"household, {100 * k:g} % of full power", _household(k))
        for k in (0.1, 0.2, 0.4)
    ]
    return found


def _minutes(steps: int) -> str:
    return f"{steps * STEP_S / 60.0:g}"


def _moved(steps: int) -> Spoil:
    """What acts, recorded so many steps late (above 0) or early."""

    def moved(row: Array) -> Array:
        blank = np.full((row.shape[0], abs(steps)), np.nan)
        return np.hstack([blank, row[:, :-steps]] if steps > 0 else [row[:, -steps:], blank])

    def spoil(drawn: Drawn, rng: np.random.Generator) -> Record:
        r = drawn.record
        return replace(r, u=moved(r.u), heat_W=moved(r.heat_W), power_W=moved(r.power_W))

    return spoil


def _scaled(power: float, heat: float) -> Spoil:
    """Power and heat times a factor; None where only one of them is, and heat is not metered."""

    def spoil(drawn: Drawn, rng: np.random.Generator) -> Record | None:
        r = drawn.record
        metered = bool(np.isfinite(r.heat_W).any())
        if (power != heat and not metered) or not np.isfinite(r.power_W).any():
            return None
        return replace(r, power_W=power * r.power_W, heat_W=heat * r.heat_W)

    return spoil


def _in_fahrenheit(drawn: Drawn, rng: np.random.Generator) -> Record:
    return replace(drawn.record, T_out_C=32.0 + 1.8 * drawn.record.T_out_C)


def _set_point(*, metered: bool) -> Spoil:
    """The set-points that thermostats followed, scaled to 0 … 1, as levels; nothing else is metered, or power is."""

    def spoil(drawn: Drawn, rng: np.random.Generator) -> Record | None:
        if not np.isfinite(drawn.setpoint_C).any():
            return None
        least = drawn.setpoint_C.min(axis=1, keepdims=True)
        u = (drawn.setpoint_C - least) / np.ptp(drawn.setpoint_C, axis=1, keepdims=True)
        r = replace(drawn.record, u=u, heat_W=np.full_like(drawn.record.heat_W, np.nan))
        return r if metered else replace(r, power_W=np.full_like(r.power_W, np.nan))

    return spoil


def _hot_water(hours: float) -> Spoil:
    """Full power for so long a day in three draws at drawn times, beside the heating."""

    def spoil(drawn: Drawn, rng: np.random.Generator) -> Record:
        r, step_h = drawn.record, drawn.record.step_s / HOUR_S
        full = np.nanpercentile(r.power_W, 99.0, axis=1, keepdims=True)
        drawing = np.zeros(r.n_steps)
        for day in range(0, r.n_steps, round(24 / step_h)):
            for hour in (7, 13, 20):
                first = (hour + rng.uniform(-1.5, 1.5)) / step_h + day
                at = np.arange(r.n_steps)
                drawing += np.clip(np.minimum(at + 1, first + hours / 3 / step_h) - np.maximum(at, first), 0.0, 1.0)
        return replace(r, power_W=r.power_W + full * drawing)

    return spoil


def _household(share: float) -> Spoil:
    """Loads that come and go at random beside the heating, with a mean of `share` of full power (exponential)."""

    def spoil(drawn: Drawn, rng: np.random.Generator) -> Record:
        r = drawn.record
        full = np.nanpercentile(r.power_W, 99.0, axis=1, keepdims=True)
        long = steps_in(_HOUSEHOLD_H * HOUR_S, r.step_s)
        load = np.repeat(rng.exponential(share, -(-r.n_steps // long)), long)[: r.n_steps]
        return replace(r, power_W=r.power_W + full * load)

    return spoil
