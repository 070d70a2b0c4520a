"""The joint optimum of buildings that share power, as one programme: what coordination is judged by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from controllers.checks import ControllerConfigError
from controllers.coordination.limit import SharedPower
from controllers.coordination.member import QPMember, diagonal
from controllers.optimisation.solvers.qp_backends import Clarabel, QPConfig, QPData
from thermoforce_mpc.data import Array


def solve_jointly(members: Sequence[QPMember], shared: SharedPower, config: QPConfig) -> tuple[float, Array]:
    """Least cost of all members together, currency, and the power of each (members, N), kW.

    Raises:
        ControllerConfigError: the solver does not reach the optimum.
    """
    parts = [member.data for member in members]
    unit, n, width = max(part.unit for part in parts), shared.limit_kW.size, sum(p.linear.size for p in parts)
    starts = np.cumsum([0, *(part.linear.size for part in parts)])
    powers = np.array([start + member.of_power for start, member in zip(starts, members, strict=False)])
    count = len(members)
    sums = sparse.csc_matrix((np.ones(count * n), (np.tile(np.arange(n), count), powers.ravel())), shape=(n, width + 1))
    limited = sums[np.isfinite(shared.limit_kW)]
    # The last variable is the peak above the one so far.
    above = sparse.csc_matrix((np.ones(n), (np.arange(n), np.full(n, width))), shape=(n, width + 1))
    G = sparse.vstack(
        [sparse.hstack([sparse.block_diag([p.G for p in parts]), _nothing(sum(p.G.shape[0] for p in parts))]),
         limited, sums - above], format="csc")  # fmt: skip
    A = sparse.hstack([sparse.block_diag([p.A for p in parts]), _nothing(sum(p.A.shape[0] for p in parts))])
    scale = [part.unit / unit for part in parts]
    data = QPData(
        diagonal(np.concatenate([*(p.quadratic.data * s for p, s in zip(parts, scale, strict=True)), [0.0]])),
        np.concatenate([*(p.linear * s for p, s in zip(parts, scale, strict=True)), [shared.peak_price_per_kW / unit]]),
        sparse.csc_matrix(A),
        np.concatenate([p.b for p in parts]),
        G,
        np.concatenate([*(p.low for p in parts), np.full(limited.shape[0] + n, -np.inf)]),
        np.concatenate(
            [
                *(p.high for p in parts),
                shared.limit_kW[np.isfinite(shared.limit_kW)],
                np.full(n, shared.peak_so_far_kW),
            ]
        ),
        np.concatenate([*(p.x_low for p in parts), [0.0]]),
        np.concatenate([*(p.x_high for p in parts), [np.inf]]),
        unit,
        sum(p.constant for p in parts),
    )
    answer = Clarabel(config)(data)
    if not answer.solved:
        raise ControllerConfigError(f"{count} buildings together: the solver ended with {answer.status}")
    return data.objective(answer.x), answer.x[powers]


def _nothing(rows: int) -> sparse.csc_matrix:
    return sparse.csc_matrix((rows, 1))
