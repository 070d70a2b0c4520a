"""How far a power law can be believed where it says what other levels would have taken.

A law that fits a record may fit for another reason: levels are high when it is cold, and so is power. So the law is
asked of the record beside the weather and the time of the day: what part of the change that it predicts was there? Its
standard error is that of whole days drawn anew, since what the law lacks lasts for hours (hot water, defrosting).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.data.series import means_of, step_means

# Means over so many hours are compared; of a day there must be as many, and so many days at least. By judgement: loops
# answer within three hours, and a week has each day.
COMPARED_H, _LEAST_DAYS = 3.0, 6
_DRAWS, _SEED = 100, 64
UNKNOWN = 1.0
"""Standard error, as a share, of a change of which the record says nothing."""
# Error of a change, as a share, from which its law may be as wrong as the demand of the rooms says. By judgement.
_AS_WRONG = 0.3


def weight_of_demand(spread: float) -> float:
    """How far power may go by what the rooms ask for instead of by its law, 0 to 1; `spread`: see `Share`."""
    return min(spread / _AS_WRONG, 1.0)


@dataclass(frozen=True)
class Share:
    """Part of the change of power by the law that was in the record: `mean`, with its standard error `sd`."""

    mean: float
    sd: float

    @property
    def spread(self) -> float:
        """Root mean square error of a change by the law, as a share of it; at most `UNKNOWN`."""
        return float(min(np.hypot(self.mean - 1.0, self.sd), UNKNOWN))


def share_of_change(expected_W: Array, measured_W: Array, record: Record) -> Share:
    """What part of the change that the law expects (n,) was `measured_W` (n,), W, over the steps of `record`."""
    step_h = record.step_s / HOUR_S
    together = max(1, round(COMPARED_H / step_h))
    n = expected_W.size // together * together
    if not n:
        return Share(1.0, UNKNOWN)
    T_out = means_of(step_means(record.T_out_C), together)
    sun = means_of(step_means(record.solar_W_m2), together)
    x, y, begin_s = means_of(expected_W, together), means_of(measured_W, together), record.time_s[:n:together]
    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(T_out) & np.isfinite(sun)
    day = np.floor(begin_s / DAY_S).astype(np.intp)
    days = np.unique(day[known])
    if days.size < _LEAST_DAYS or np.ptp(x[known]) < 1e-3 * max(float(np.abs(x[known]).max()), 1.0):
        return Share(1.0, UNKNOWN)
    part = np.floor(begin_s % DAY_S / (COMPARED_H * HOUR_S)).astype(np.intp)
    of_day = (part[:, None] == np.unique(part)).astype(np.float64)
    others = np.column_stack([of_day, T_out, sun])

    def share(rows: NDArray[np.intp]) -> float:
        beside, _, _, _ = np.linalg.lstsq(others[rows], np.column_stack([x, y])[rows], rcond=None)
        left = np.column_stack([x, y])[rows] - others[rows] @ beside
        return float(left[:, 0] @ left[:, 1] / max(left[:, 0] @ left[:, 0], 1e-9))

    rows = np.flatnonzero(known)
    by_day = {one: rows[day[rows] == one] for one in days}
    rng = np.random.default_rng(_SEED)
    drawn = [share(np.concatenate([by_day[one] for one in rng.choice(days, days.size)])) for _ in range(_DRAWS)]
    return Share(share(rows), float(np.std(drawn)))
