"""The machines' own power in records whose meters hold other loads too (`model.machine.foreign_load`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thermoforce_mpc.data import Layout, Record
from thermoforce_mpc.model.machine.foreign_load import ForeignLoad, foreign_load


def foreign_loads(histories: Sequence[Record], layout: Layout) -> list[ForeignLoad | None]:
    """What else is on the meter of each machine (M,); None where nothing is, and where signed levels never are off."""
    found = []
    for m in range(len(layout.names.machines)):
        fed = layout.fed_by(m)
        u = np.concatenate([h.u[fed] for h in histories], axis=1)
        time_s, T_out_C, power_W = (
            np.concatenate([values(h) for h in histories])
            for values in (lambda h: h.time_s[:-1], lambda h: h.T_out_C[:-1], lambda h, m=m: h.power_W[m])
        )
        signed = any(layout.lowest[a] < 0.0 for a in fed)
        found.append(None if signed else foreign_load(u, time_s, T_out_C, power_W))
    return found


def without_foreign(record: Record, foreign: Sequence[ForeignLoad | None]) -> Record:
    """The record with the machines' own power (M,)."""
    if not any(foreign):
        return record
    time_s, T_out_C = record.time_s[:-1], record.T_out_C[:-1]
    own_W = [
        power_W if other is None else np.maximum(power_W - other(time_s, T_out_C), 0.0)
        for power_W, other in zip(record.power_W, foreign, strict=True)
    ]
    return replace(record, power_W=np.stack(own_W))
