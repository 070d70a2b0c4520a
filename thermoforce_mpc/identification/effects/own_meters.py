"""The machines' own power and heat in records whose meters hold other loads too (`model.machine.foreign_load`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.data import Array, Layout, Record
from thermoforce_mpc.model.machine.foreign_load import ForeignLoad, foreign_load, own_W


@dataclass(frozen=True)
class ForeignLoads:
    """What else is on the power meter of each machine (M,) and the heat meter of each actuator (A,); None: nothing."""

    power: tuple[ForeignLoad | None, ...]
    heat: tuple[ForeignLoad | None, ...]
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


def foreign_loads(histories: Sequence[Record], layout: Layout) -> ForeignLoads:
    """What else is on the meters; nothing where signed levels never are off."""
    u, power_W, heat_W = (
        np.concatenate([getattr(h, name) for h in histories], axis=1) for name in ("u", "power_W", "heat_W")
    )
    time_s, T_out_C = (np.concatenate([getattr(h, name)[:-1] for h in histories]) for name in ("time_s", "T_out_C"))

    def found(fed: Sequence[int], meter_W: Array) -> ForeignLoad | None:
        signed = any(layout.lowest[a] < 0.0 for a in fed)
        return None if signed else foreign_load(u[list(fed)], time_s, T_out_C, meter_W)

    return ForeignLoads(
        tuple(found(layout.fed_by(m), meter_W) for m, meter_W in enumerate(power_W)),
        tuple(found([a], sign * meter_W) for a, (sign, meter_W) in enumerate(zip(layout.signs, heat_W, strict=True))),
        layout,
    )
