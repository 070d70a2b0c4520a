"""Operators from operating records: the candidates of a budget, and the choice among them on validation forecasts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.factual.homes import Prepared
from thermoforce_mpc.data import Array, Boundary, Observation, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification import IdentificationConfig, identify
from thermoforce_mpc.identification.zones.two_stage import fit_two_stage
from thermoforce_mpc.model.free_response.linear_weather import Persistence
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.predictor import Predictor
from thermoforce_mpc.protocols import FreeResponse

# Levels up to this count as off: a meter that idles a little is not heating.
_OFF = 0.05


@dataclass(frozen=True)
class Forced:
    """What acted in a home, split off: `forced_K` (n + 1,) at every boundary of the record, 0 without an operator.

    As the actions applied are those of the record, its later values are also the forced part of every forecast
    (paper, factual query).
    """

    operator: OperatorParameters | None
    meter: str
    forced_K: Array
    note: str


def without_operator(home: Prepared, why: str) -> Forced:
    """No forced part: ThermoForce is then its free response."""
    return Forced(None, "", np.zeros(home.record.n_steps + 1), why)


def candidates(home: Prepared, days: int) -> tuple[list[Forced], list[str]]:
    """Operators of every meter from the last `days` days of the fit part, and why others were refused.

    The paper's two-stage estimator and the joint one with m = 1; both on the record as it was operated, nobody probed.
    """
    found: list[Forced] = []
    refused: list[str] = []
    start, stop = home.budget(days)
    for meter in home.levels:
        run = home.with_level(meter).slice(start, stop)
        if not (run.u > _OFF).any():
            refused.append(f"{meter}: never on in the {days} days")
            continue
        for name in ("two-stage", "joint"):
            try:
                operator = _two_stage(home, run) if name == "two-stage" else _joint(home, run)
            except DataError as error:
                refused.append(f"{meter}, {name}: {str(error).split(';')[0]}")
                continue
            gain = float(operator.steady_gains_K.sum())
            if gain == 0.0:
                refused.append(f"{meter}, {name}: gain 0")
                continue
            hours = ", ".join(f"{tau:.2g}" for tau in operator.time_constants_h)
            record = home.with_level(meter)
            F = Predictor(single(operator), Persistence()).forced_history(record)[0, 0].sum(axis=-1)
            found.append(Forced(operator, meter, F, f"{meter}, {name}: {gain:+.1f} K, time constants {hours} h"))
    return found, refused


def at_levels(home: Prepared, forced: Forced, free: FreeResponse, origin: int, levels: Array, horizon: int) -> Array:
    """Temperatures under constant levels (L,) from `origin` on, (L, horizon), °C, with the operator of `forced`."""
    if forced.operator is None:
        raise DataError(f"{home.home.name}: no operator to ask ({forced.note})")
    record = home.with_level(forced.meter)
    observation = Observation(record.slice(0, origin), Boundary.measured(record.slice(origin, origin + horizon)))
    return Predictor(single(forced.operator), free).context(observation).counterfactuals(levels).total_C[:, 0]


def _two_stage(home: Prepared, run: Record) -> OperatorParameters:
    return fit_two_stage([run], sign=home.home.sign, u_off=_OFF).operator()


def _joint(home: Prepared, run: Record) -> OperatorParameters:
    config = IdentificationConfig(modulation="linear", order=2, heat_input="identity")
    return identify(run, config=config, mode="heating" if home.home.sign > 0 else "cooling").only.operator
