"""Registry of all compared methods. To add one, write its file and add an entry here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.interventions.methods.base import Predictor, Training
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.free_response.registry import build_free_response
from thermoforce_mpc.protocols import FreeResponse


@dataclass(frozen=True)
class Method:
    """One row of the table; `ours`: a ThermoForce variant, not a baseline; `in_paper`: also compared in the paper.

    `build` gets the frozen forecaster of the paper's free response.
    """

    name: str
    label: str
    ours: bool
    in_paper: bool
    build: Callable[[Training, FreeResponse], Predictor]


def _raw(training: Training, free: FreeResponse) -> Predictor:
    from benchmarks.interventions.methods.raw import RawForecast

    return RawForecast(free)


def _covariates(autoregressive: bool) -> Callable[[Training, FreeResponse], Predictor]:
    def build(training: Training, free: FreeResponse) -> Predictor:
        from benchmarks.interventions.methods.covariates import build_covariates

        return build_covariates(training, free, autoregressive=autoregressive)

    return build


def _observational(training: Training, free: FreeResponse) -> Predictor:
    from benchmarks.interventions.methods.grey_box import build_observational

    return build_observational(training)


def _grey_box_on_probe(training: Training, free: FreeResponse) -> Predictor:
    from benchmarks.interventions.methods.grey_box import build_on_probe

    return build_on_probe(training)


def _surrogate(training: Training, free: FreeResponse) -> Predictor:
    from benchmarks.interventions.methods.surrogate import build_surrogate

    return build_surrogate(training, free)


def _unconstrained(training: Training, free: FreeResponse) -> Predictor:
    from benchmarks.interventions.methods.unconstrained import build_unconstrained

    return build_unconstrained(training, free)


def _thermoforce(
    *orders: int, curve: bool = False, residual: bool = False
) -> Callable[[Training, FreeResponse], Predictor]:
    def build(training: Training, free: FreeResponse) -> Predictor:
        from benchmarks.interventions.methods.curve import EXPONENTS
        from benchmarks.interventions.methods.thermoforce import build_thermoforce

        forecaster = free
        if residual:  # intervals are not needed: only the median is scored
            forecaster = build_free_response("residual", calibrate=False)
        return build_thermoforce(training, forecaster, orders=orders, exponents=EXPONENTS if curve else (1.0,))

    return build


MONOTONE, TWO_STATE, BEST = "thermoforce", "thermoforce_two_state", "thermoforce_curve"

METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        Method("tsfm", "TSFM raw", False, True, _raw),
        Method("tsfm_covariates", "TSFM + covariates (ridge)", False, True, _covariates(False)),
        Method("tsfm_covariates_ar", "TSFM + covariates + AR", False, True, _covariates(True)),
        Method("rc", "Observational RC", False, True, _observational),
        Method("rc_probe", "RC on the probe days", False, False, _grey_box_on_probe),
        Method("surrogate", "Distillation surrogate", False, True, _surrogate),
        Method("thermoforce_unconstrained", "ThermoForce (unconstr. gain)", True, True, _unconstrained),
        Method(MONOTONE, "ThermoForce (monotone)", True, True, _thermoforce(1, curve=True)),
        Method(TWO_STATE, "ThermoForce (two-state)", True, False, _thermoforce(2)),
        Method(BEST, "ThermoForce (2–3 states, curve)", True, False, _thermoforce(2, 3, curve=True, residual=True)),
    )
}


def find_method(name: str) -> Method:
    """The method called `name`; raises `ConfigError` with the known names."""
    if name not in METHODS:
        raise ConfigError(f"unknown method '{name}'; known: {', '.join(METHODS)}")
    return METHODS[name]
