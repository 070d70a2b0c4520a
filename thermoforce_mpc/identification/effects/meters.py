"""What meters say of heat and power: other loads on them, what a level delivers, and what a machine takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.model.machine.heat_capacity import HeatFit, fit_heat, kinds_for
from thermoforce_mpc.model.machine.load import LEAST_RUNNING, LEVEL_EDGE, MEASURED, NEARLY_FULL, running_share
from thermoforce_mpc.model.machine.other_load import OtherLoad, other_load, own_W
from thermoforce_mpc.model.machine.power import PowerModel, fit_both_directions, fit_power
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

# Loads to try below which a shared machine cycles, as shares of its capacity; 1: its power is proportional to the load.
_CYCLES_BELOW = (0.02, *np.linspace(0.1, 0.6, 11).round(2).tolist(), 1.0)


@dataclass(frozen=True)
class OtherLoads:
    """What else is on the power meter of each machine (M,) and the heat meter of each actuator (A,); None: nothing."""

    power: tuple[OtherLoad | None, ...]
    heat: tuple[OtherLoad | None, ...]
    layout: Layout

    def taken_off(self, record: Record) -> Record:
        """The record with the machines' own power and heat."""
        if any(self.power):
            record = replace(record, power_W=own_W(record.power_W, self.power, record))
        if any(self.heat):
            record = replace(record, heat_W=own_W(record.heat_W, self.heat, record, self.layout.signs))
        return record

    def notes(self, a: int) -> list[str]:
        """What the card of actuator `a` says of them."""
        m, names = self.layout.machine_of[a], self.layout.names
        meters = ((f"power of {names.machines[m]}", self.power[m]), (f"heat of {names.actuators[a]}", self.heat[a]))
        return [f"{meter}: {other.in_words()}" for meter, other in meters if other is not None]


def foreign_loads(histories: Sequence[Record], layout: Layout) -> OtherLoads:
    """What else is on the meters; nothing where signed levels never are off, and without records."""
    if not histories:
        return OtherLoads((None,) * len(layout.names.machines), (None,) * len(layout.home), layout)
    u, power_W, heat_W = (
        np.concatenate([getattr(h, name) for h in histories], axis=1) for name in ("u", "power_W", "heat_W")
    )
    time_s, T_out_C = (np.concatenate([getattr(h, name)[:-1] for h in histories]) for name in ("time_s", "T_out_C"))

    def found(fed: Sequence[int], meter_W: Array) -> OtherLoad | None:
        signed = any(layout.u_min[a] < 0.0 for a in fed)
        return None if signed else other_load(u[list(fed)], time_s, T_out_C, meter_W)

    return OtherLoads(
        tuple(found(layout.fed_by(m), meter_W) for m, meter_W in enumerate(power_W)),
        tuple(found([a], sign * meter_W) for a, (sign, meter_W) in enumerate(zip(layout.signs, heat_W, strict=True))),
        layout,
    )


def identified_heat_input(
    histories: Sequence[Record], config: IdentificationConfig, sign: int, u_min: float = 0.0, alone: bool = True
) -> tuple[HeatInput, list[str]]:
    """Return the heat input of the modes (measured heat where available, else u) and notes on it.

    Signed levels, `u_min` below 0, are heat themselves. `alone`: whether the building has no other actuator; of
    several, one that was hardly on must not refuse the rest.

    Raises:
        DataError: heat is that of the other mode, or cannot be fitted.
    """
    if u_min < 0.0:
        return HeatInput(u_min=u_min), ["heat input: identity, the level is heat over full heat"]
    if config.heat_input == "identity":
        return IDENTITY, ["heat input: identity, as configured"]
    heat = np.concatenate([h.heat_W[0] for h in histories]) * sign
    measured = float(np.isfinite(heat).mean())
    if measured < MEASURED:
        return IDENTITY, [f"heat input: identity, heat was measured in {100 * measured:.0f} % of the steps"]
    u = np.concatenate([h.u[0] for h in histories])
    on = int((np.isfinite(heat) & (u > LEVEL_EDGE)).sum())
    if on < LEAST_RUNNING and not alone:
        return IDENTITY, [f"heat input: identity, the actuator was on in {on} steps with measured heat"]
    if float(np.nansum(heat)) < 0.0:
        metered, mode = ("cooling", "heating") if sign > 0 else ("heating", "cooling")
        raise DataError(
            f"the measured heat is that of {metered}, but the mode is {mode}: {metered} says nothing of what "
            f"{mode} does; record while the building is in use for {mode}, or check the sign of the heat"
        )
    T_out_C = np.concatenate([h.T_out_C[:-1] for h in histories])
    fit = fit_heat(
        u, T_out_C, heat, kinds=kinds_for(sign), step_s=histories[0].step_s, lowest_level=config.lowest_level
    )
    rmse_W, r2 = fit.quality.rmse_W, fit.quality.r2
    note = f"measured heat: machine of kind '{fit.kind}', RMSE {rmse_W:.0f} W while on, R² {r2:.4f}"
    return HeatInput(heat=fit.load, reference_C=float(T_out_C.mean())), [note, *_unseen(histories, fit)]


def _unseen(histories: Sequence[Record], fit: HeatFit) -> list[str]:
    """Return a warning if the records contain no level of 0.9 or more, else []."""
    highest = max(float(np.max(h.u[0])) for h in histories)
    if highest >= NEARLY_FULL:
        return []
    return [
        f"heat at full level is extrapolated from levels up to {highest:.2g} and the prior of a {fit.kind}: "
        f"± {100 * fit.full_sd:.0f} %; probe at full level"
    ]


def power_of_machine(
    histories: Sequence[Record], config: IdentificationConfig, layout: Layout, machine: int
) -> PowerModel | None:
    """Return the power model of a machine over its own level; None if measured in less than half of the steps."""
    fed, records = layout.fed_by(machine), [machine_record(h, layout, machine) for h in histories]
    if np.isfinite(np.concatenate([h.power_W[0] for h in records])).mean() < MEASURED:
        return None
    u, weights = np.concatenate([h.u[fed] for h in histories], axis=1), layout.weights[fed]
    if any(layout.u_min[a] < 0.0 for a in fed):
        return fit_both_directions(records, weights @ np.maximum(u, 0.0), weights @ np.maximum(-u, 0.0))
    squares = weights @ u**2 if config.power_curve else None
    if len(fed) == 1:
        return fit_power(records, lowest_level=config.lowest_level, squares=squares)
    return fit_power(records, running=_running(u, weights, config.lowest_level), squares=squares)


def _running(u: Array, weights: Array, lowest_level: float | None) -> list[tuple[float, Array]]:
    """Loads below which a machine may cycle, each with the share of each step (n,) that it then runs.

    On-times of levels `u` (A, n) begin together, as `PowerModel.of_actuators` and plans have it. A law that was fitted
    to levels held for the step instead and then used like that was 60 to 190 W of 430 to 1,010 too low, most in the
    cold (`bench commands`, five houses on a heating curve, 2026-11-28: share of the scatter of hours explained -0.37 to
    0.62, now 0.25 to 0.83).
    """
    loads = _CYCLES_BELOW if lowest_level is None else (lowest_level,)
    return [(below, running_share(u, np.minimum(weights / below, 1.0))) for below in loads]


def machine_record(record: Record, layout: Layout, machine: int) -> Record:
    """Return the record of a machine: its power over its own level, the levels it feeds by their shares of it.

    Raises:
        DataError: the machine feeds no actuator.
    """
    fed = layout.fed_by(machine)
    if not fed:
        raise DataError(f"machine {layout.names.machines[machine]} feeds no actuator")
    part = record.part(layout.home[fed[0]], fed[:1], [machine])
    if len(fed) == 1:
        return part
    level = np.clip(layout.weights[fed] @ record.u[fed], min(0.0, *(layout.u_min[a] for a in fed)), 1.0)
    return replace(part, u=level, heat_W=record.heat_W[fed].sum(axis=0))
