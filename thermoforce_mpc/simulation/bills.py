"""At which price a machine's energy is billed: gas for heating, say, and electricity for cooling."""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data import Array, Layout


def price_paid(u: Array, price: Array, heating_price: Array, layout: Layout) -> Array:
    """Price of each machine's energy (M, n): that of heating unless an actuator of it cools at levels `u` (A, n)."""
    paid = price.copy()
    for m in range(price.shape[0]):
        fed = [a for a in layout.fed_by(m) if layout.signs[a] > 0]
        if fed:
            heats = (np.nan_to_num(u[fed]) >= 0).all(axis=0)
            paid[m] = np.where(heats, heating_price[m], price[m])
    return paid
