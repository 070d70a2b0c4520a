"""What the drawn houses' thermal networks share: constants of EN ISO 13790, and the solver of a step."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit

# Step of the physics and of the samples, and of the grids of weather and schedules, s.
STEP_S, GRID_S = 30.0, 900.0

Mass = Literal["very light", "light", "medium", "heavy", "very heavy"]
# EN ISO 13790:2008, table 12: effective mass area, m² per m² of floor, and heat capacity, J/K per m² of floor.
MASSES: dict[Mass, tuple[float, float]] = {
    "very light": (2.5, 80e3),
    "light": (2.5, 110e3),
    "medium": (2.5, 165e3),
    "heavy": (3.0, 260e3),
    "very heavy": (3.5, 370e3),
}
HEIGHT_M = 2.5
AIR_WH_M3_K = 0.34
WATER_J_KG_K = 4186.0
# Air and furniture, J/K per m² of floor (EN ISO 52016-1); surface to air and surface to structure, W/m²K, and room
# surface per floor area (EN ISO 13790).
AIR_J_M2_K = 10e3
SURFACE_AIR_W_M2_K, SURFACE_MASS_W_M2_K, SURFACE_PER_FLOOR = 3.45, 9.1, 4.5
# First centimetre of plaster or board, J/K per m² of surface.
SURFACE_J_M2_K = 10e3
# Operative temperature: share of the air (EN ISO 13790, C.12).
AIR_SHARE = 0.3
# Share of the air change that is driven by the wind, at the mean wind of the synthetic year, m/s.
WIND_SHARE, MEAN_WIND_M_S = 0.3, 3.9


@njit(cache=True)
def solve(a: np.ndarray, b: np.ndarray) -> None:
    """Solve a x = b in place for a diagonally dominant matrix (n, n); the solution is in `b`.

    Zeros below the diagonal are skipped: nodes with few neighbours come first.
    """
    n = b.size
    for k in range(n):
        for i in range(k + 1, n):
            ratio = a[i, k] / a[k, k]
            if ratio != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= ratio * a[k, j]
                b[i] -= ratio * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]
