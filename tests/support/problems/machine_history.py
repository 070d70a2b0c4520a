"""A run of a machine in a room that stays at 21 °C: what fits of heat and of power are tried on."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array, Record


def machine_history(u: Array, T_out_C: Array, *, power_W: Array | None = None, heat_W: Array | None = None) -> Record:
    """Quarter-hour steps of these levels, outdoor temperatures and loads, (n,) each; a load not given is NaN."""
    n = len(u)
    silent = np.full(n, np.nan)
    return Record(
        time_s=np.arange(n + 1) * 900.0,
        T_zone_C=np.full(n + 1, 21.0),
        T_out_C=np.append(T_out_C, T_out_C[-1]),
        solar_W_m2=np.zeros(n + 1),
        u=u,
        power_W=silent if power_W is None else power_W,
        heat_W=silent if heat_W is None else heat_W,
    )
