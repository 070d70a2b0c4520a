"""Shares of a limit from powers that buildings have answered with.

The programmes of buildings are convex: what lies between two plans of a building is a plan, and costs no more than what
lies between their costs. The least cost over all such combinations under the limit is a linear programme, the master
problem of Dantzig and Wolfe (1960).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from controllers.coordination.limit import SharedPower
from controllers.coordination.member import Answer
from thermoforce_mpc.data import Array


def combined(
    answers: Mapping[str, Sequence[Answer]], shared: SharedPower, price_over: float
) -> tuple[dict[str, Array], Array] | None:
    """Power of each building (N,), kW: combinations of its answers of least cost, currency, under what is shared.

    What is above the limit costs `price_over`, currency/kW, where no combination keeps it. Also returns the price of
    power in each step (N,), currency/kW. None if the solver fails.
    """
    n = shared.limit_kW.size
    limited = np.flatnonzero(np.isfinite(shared.limit_kW))
    powers = np.array([answer.power_kW for each in answers.values() for answer in each]).T
    costs = np.array([answer.cost for each in answers.values() for answer in each])
    of = np.repeat(np.arange(len(answers)), [len(each) for each in answers.values()])
    columns, over = costs.size, limited.size
    one_each = sparse.csr_matrix((np.ones(columns), (of, np.arange(columns))), shape=(len(answers), columns + over + 1))
    within = np.hstack([powers[limited], -np.eye(over), np.zeros((over, 1))])
    below_peak = np.hstack([powers, np.zeros((n, over)), -np.ones((n, 1))])
    peaks = np.full(n, shared.peak_so_far_kW)
    optimum = linprog(
        np.concatenate([costs, np.full(over, price_over), [shared.peak_price_per_kW]]),
        A_ub=np.vstack([within, below_peak] if shared.peak_price_per_kW else [within]),
        b_ub=np.concatenate([shared.limit_kW[limited], peaks if shared.peak_price_per_kW else peaks[:0]]),
        A_eq=one_each,
        b_eq=np.ones(len(answers)),
        method="highs",
    )
    if optimum.status != 0:
        return None
    price = np.zeros(n)
    price[limited] = -optimum.ineqlin.marginals[:over]
    if shared.peak_price_per_kW:
        price -= optimum.ineqlin.marginals[over:]
    return {
        name: np.asarray(powers[:, of == i] @ optimum.x[:columns][of == i]) for i, name in enumerate(answers)
    }, price
