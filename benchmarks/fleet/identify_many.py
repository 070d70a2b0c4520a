"""Identification of many generated houses: time a house, and the joint estimation against its plain formulation.

The plain formulation is that of `joint` as one would write it down first, one house after another: a search without
derivatives, of which every evaluation filters each weather signal for each mode, solves with the dense Cholesky factor
of the disturbances' covariance and hands the bounded regression to scipy. It was the package's own until November 2026.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear, minimize
from scipy.signal import lfilter

from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Record
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.columns import free_prior, free_time_constants, start_sd
from thermoforce_mpc.identification.estimation.joint import fit_modes
from thermoforce_mpc.identification.estimation.modes import TIME_CONSTANTS_H, ModePriors, poles, wide_priors
from thermoforce_mpc.identification.estimation.regression import FREE_PRIOR, RegressionData, run_regression
from thermoforce_mpc.identification.estimation.system import System
from thermoforce_mpc.identification.pipeline import BuildingRecords, Identified, identify_many
from thermoforce_mpc.identification.probing.probe import Probing
from thermoforce_mpc.model.free_response.rc import INPUTS
from thermoforce_mpc.model.operator.heat_input import IDENTITY
from thermoforce_mpc.plants.drawn_houses.weeks import WEEKS
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house
from thermoforce_mpc.scenario.scenario import Scenario
from thermoforce_mpc.simulation.models.identifying import identification_settings

# Population of the bench; that of `bench buildings` is another.
SEED = 7
PROBED_DAYS = 3.0
_CONTROLLER = "thermoforce_mpc"
# Tolerances of ln τ: one that would do, and one at which a search without derivatives has the optimum to 1e-6.
_PLAIN, _SETTLED = 0.01, 1e-8

_T = TypeVar("_T")


@dataclass(frozen=True)
class JointTimes:
    """Joint estimation of `houses`, each with all orders on its record.

    `package_s` a house; of the first `plain_houses`, `plain_s` with the plain formulation's search ended where ln τ
    moves by 0.01, `settled_s` by 1e-8. `difference`: largest of ln(τ/h) and, relative to the largest gain of a fit, of
    the gains, between package and settled search; of `fits`, `differing` differ by more than 1e-6.
    """

    houses: int
    plain_houses: int
    fits: int
    plain_s: float
    settled_s: float
    package_s: float
    difference: float
    differing: int

    @property
    def ratio(self) -> float:
        """How many times faster the package is than the search to 0.01."""
        return self.plain_s / self.package_s


@dataclass(frozen=True)
class ManyTimes:
    """Identification of `houses` with its defaults: `one_by_one_s` a house by `identify`, `many_s` by `identify_many`.

    `refused` and `failed` have no model. `difference`: largest of poles and gains of the two ways.
    """

    houses: int
    refused: int
    failed: int
    one_by_one_s: float
    many_s: float
    difference: float
    joint: JointTimes


def measure(
    houses: int = 100,
    plain_houses: int = 10,
    seed: int = SEED,
    progress: Callable[[str], None] = lambda _line: None,
) -> ManyTimes:
    """Probe `houses` of population `seed` for three days and time their identification in this process.

    Args:
        houses: number of houses, half of them before each of the two weeks of the benches.
        plain_houses: of these, so many are estimated by the plain formulation too.
        seed: of the population.
        progress: callback for progress lines.
    """
    buildings = []
    for index in range(houses):
        progress(f"probing house {index + 1} of {houses}")
        buildings.append(probed_house(seed, index))
    list(identify_many(buildings[:1]))  # compiled functions are loaded before the clock starts
    progress("joint estimation, plain and by the package")
    joint = compare_joint([building.runs[0] for building in buildings], plain_houses)
    progress(f"identifying {houses} houses, one by one and as many")
    one_by_one_s, alone = _timed(lambda: [next(identify_many([building])) for building in buildings])
    many_s, many = _timed(lambda: list(identify_many(buildings)))
    return ManyTimes(
        houses=houses,
        refused=sum(found.refused for found in many),
        failed=sum(found.model is None and not found.refused for found in many),
        one_by_one_s=one_by_one_s / houses,
        many_s=many_s / houses,
        difference=max(_apart(*both) for both in zip(alone, many, strict=True)),
        joint=joint,
    )


def probed_house(seed: int, index: int) -> BuildingRecords:
    """House `index` of population `seed` with three days of probing as `tf-mpc run` does them before a week."""
    plant = GeneratedHousePlant(draw_house(seed, index))
    testcase, scenario = plant.testcase, Scenario(testcase=plant.testcase.name)
    probing, config = identification_settings(scenario, testcase, _CONTROLLER)
    period = plant.period(list(WEEKS)[index % len(WEEKS)])
    start_s = period.start_s - period.warmup_s - PROBED_DAYS * DAY_S
    if start_s < 0.0:
        start_s = (365.0 - PROBED_DAYS) * DAY_S
    run = Probing(plant, start_s, seed=scenario.seed, layout=testcase.layout, config=probing, identification=config)
    run.go_on(PROBED_DAYS)
    return BuildingRecords(f"house {index}", [run.record], (), testcase.layout, config, testcase.step_s)


def compare_joint(records: Sequence[Record], plain_houses: int) -> JointTimes:
    """Joint estimation of records of one heated zone each, the first `plain_houses` by the plain formulation too."""
    config = IdentificationConfig()
    regressions = [run_regression(record, IDENTITY, config) for record in records]
    priors = [wide_priors(order) for order in (1, 2, 3)]

    def package(regression: RegressionData) -> list[tuple[Array, Array]]:
        fits = [fit_modes(System([regression], of.order, 1), of, config) for of in priors]
        return [(fit.log_tau, fit.gains) for fit in fits]

    def plain(tolerance: float) -> list[list[tuple[Array, Array]]]:
        return [[plain_fit(e, of, config, tolerance) for of in priors] for e in regressions[:plain_houses]]

    package_s, ours = _timed(lambda: [package(regression) for regression in regressions])
    plain_s, _ = _timed(lambda: plain(_PLAIN))
    settled_s, theirs = _timed(lambda: plain(_SETTLED))
    apart = np.array(
        [
            max(np.abs(a[0] - b[0]).max(), np.abs(a[1] - b[1]).max() / np.abs(b[1]).max())
            for mine, other in zip(ours, theirs, strict=False)
            for a, b in zip(mine, other, strict=True)
        ]
    )
    return JointTimes(
        houses=len(records),
        plain_houses=len(theirs),
        fits=apart.size,
        plain_s=plain_s / len(theirs),
        settled_s=settled_s / len(theirs),
        package_s=package_s / len(records),
        difference=float(apart.max()),
        differing=int((apart > 1e-6).sum()),
    )


def plain_fit(
    regression: RegressionData, priors: ModePriors, config: IdentificationConfig, tolerance: float = _SETTLED
) -> tuple[Array, Array]:
    """ln(τ/h) (r,) to this tolerance and gains (r,) of a run of a heated zone, by the plain formulation."""
    log_bounds = np.log(priors.bounds_h())
    assumed = cholesky(regression.disturbance.covariance(), lower=True)

    def solved(log_tau: Array, factor: Array) -> tuple[Array, float, float]:
        design, low, mean, sd = _plain_columns(regression, log_tau, priors)
        whole = np.concatenate([solve_triangular(factor, design, lower=True), np.diag(1.0 / sd)])
        target = np.concatenate([solve_triangular(factor, regression.target, lower=True), mean / sd])
        values = lsq_linear(whole, target, bounds=(low, np.inf), method="bvls").x
        residual, away = whole @ values - target, (log_tau - priors.log_tau) / priors.log_tau_sd
        rms = float(np.sqrt(np.mean(residual[: regression.rows.size] ** 2)))
        return values, 0.5 * float(residual @ residual + away @ away), rms

    def searched(start: Array, factor: Array) -> Array:
        simplex = np.vstack([start, start + np.eye(start.size) * priors.log_tau_sd])
        options = {
            "maxfev": 1000,
            "xatol": tolerance,
            "fatol": max(100.0 * tolerance**2, 1e-12),
            "initial_simplex": np.clip(simplex, *log_bounds.T),
        }
        found = minimize(
            lambda log_tau: solved(log_tau, factor)[1], start, method="Nelder-Mead", bounds=log_bounds, options=options
        )
        return np.asarray(found.x)

    log_tau = searched(priors.log_tau, assumed)
    values, _, rms = solved(log_tau, assumed)
    scale = min(1.0, config.disturbance_margin * rms)
    if scale < 1.0:
        log_tau = searched(log_tau, assumed * scale)
        values, _, _ = solved(log_tau, assumed * scale)
    return log_tau, values[: priors.order]


def _plain_columns(regression: RegressionData, log_tau: Array, priors: ModePriors) -> tuple[Array, Array, Array, Array]:
    """Columns of all parameters (rows, p), and lower bound, mean and standard deviation of each."""
    free, step_s = free_time_constants(log_tau), regression.step_s

    def lagged(signal: Array, log_mode: float) -> Array:
        pole = float(poles(np.array(log_mode), step_s))
        return np.concatenate([[0.0], lfilter([1.0 - pole], [1.0, -pole], signal)])

    tau, lags = np.exp(log_tau), [lagged(regression.drive, mode) for mode in log_tau]
    columns = [tau[0] * lags[0], *(lag - tau[0] / t * lags[0] for lag, t in zip(lags[1:], tau[1:], strict=True))]
    for name, (unit, *_) in FREE_PRIOR.items():
        columns += [lagged(regression.inputs[:, INPUTS.index(name)] * unit, mode) for mode in free]
    columns.append(np.ones(regression.n_steps + 1))
    fastest = log_tau[0] if log_tau.size > 1 else np.log(TIME_CONSTANTS_H[3][0])
    hours = np.arange(regression.n_steps + 1) * step_s / HOUR_S
    columns += [np.exp(-hours / np.exp(mode)) for mode in (fastest, *free)]
    gain_mean, gain_sd = priors.gains_at(log_tau)
    free_mean, free_sd, free_low = free_prior(free.size)
    starts = start_sd(free.size + 1)
    return (
        np.stack(columns, axis=1)[regression.rows],
        np.concatenate([np.zeros(log_tau.size), free_low, np.full(starts.size, -np.inf)]),
        np.concatenate([gain_mean, free_mean, np.zeros(starts.size)]),
        np.concatenate([gain_sd, free_sd, starts]),
    )


def _timed(work: Callable[[], _T]) -> tuple[float, _T]:
    began = perf_counter()
    found = work()
    return perf_counter() - began, found


def _apart(one: Identified, other: Identified) -> float:
    """Largest difference of poles and gains of two results for a building; infinite if only one has a model."""
    if one.model is None or other.model is None:
        return 0.0 if one.reason == other.reason and one.model is other.model else float("inf")
    a, b = one.model.operator, other.model.operator
    return float(max(np.abs(a.poles - b.poles).max(), np.abs(a.gains - b.gains).max()))
