"""What one zone is identified from: its records as regressions, and what each fold of them may see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.level_laws import Estimates
from thermoforce_mpc.identification.effects.meters import identified_heat_input
from thermoforce_mpc.identification.estimation.records import Pair, resolution_K
from thermoforce_mpc.identification.estimation.regression import (
    Effect,
    RegressionData,
    before_held_out,
    held_out,
    pair_regression,
    run_regression,
    seen_rows,
)
from thermoforce_mpc.identification.estimation.rest import fitted_to_pairs
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.measurements.checks import Remark
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.free_response.rc import RcParameters
from thermoforce_mpc.model.operator.heat_input import IDENTITY, HeatInput

# Least gain, K or K/h: an effect that the record denies keeps the sign of its actuator.
_LEAST_GAIN = 1e-12


@dataclass(frozen=True)
class ZoneData:
    """What one zone is identified from.

    Attributes:
        runs, pairs: records of the zone, prepared (`estimation.records`); the first level is that of its own actuator,
            the rest are those of the others.
        heat_input: what the own actuator delivers.
        sign: +1 if it heats, −1 if it cools.
        step_s: step of the operator, s; None: that of the data.
        card: what the model card says already.
        alone: whether the building has no other actuator. Of several, one without an effect must not refuse the rest:
            its model is returned, not competent.
        bars: what says that the level is none, so that the model may not act.
        area_m2: floor area of the zone, m², NaN where it is not known.
    """

    config: IdentificationConfig
    runs: Sequence[Record]
    pairs: Sequence[Pair]
    heat_input: HeatInput
    sign: int
    step_s: float | None = None
    card: ModelCard = field(default_factory=lambda: ModelCard("identified"))
    alone: bool = True
    bars: Sequence[Remark] = ()
    area_m2: float = float("nan")

    @cached_property
    def grid_K(self) -> float:
        """Resolution of the sensor, K; 0 where it has none."""
        return resolution_K(self.runs)

    @cached_property
    def regressions(self) -> list[RegressionData]:
        """The records as regressions, the last rows held out."""
        runs = [run_regression(run, self.heat_input) for run in self.runs]
        pairs = [pair_regression(pair, self.heat_input) for pair in self.pairs]
        return held_out([*runs, *pairs], self.config)

    def of_fold(self, fold: str, heat_input: HeatInput) -> list[RegressionData]:
        """The regressions of a fold (`last_steps`) with v of the own actuator, its held-out rows marked."""
        regressions = replace(self, heat_input=heat_input).regressions
        if fold == "whole":
            return [replace(e, held=0) for e in regressions]
        return before_held_out(regressions, self.config) if fold == "earlier" else regressions

    @property
    def histories(self) -> list[Record]:
        """The records of all regressions."""
        return [h for e in self.regressions for h in e.histories]

    def last_steps(self, fold: str) -> list[int]:
        """How many steps of each regression a fold may see, 0 for none: `whole` all, `training` those before the
        held-out rows, `earlier` of these, runs only, those before as many held out anew.
        """
        if fold == "whole":
            return [e.n_steps for e in self.regressions]
        steps = []
        for e in self.regressions:
            n = e.seen
            if fold == "earlier":
                n = 0 if e.is_pair else sum(before.seen for before in before_held_out([e], self.config))
            steps.append(int(e.rows[n - 1]) if n else 0)
        return steps

    def heat_input_of(self, fold: str) -> HeatInput:
        """What the own actuator delivers, as a fold may know it: by a heat meter's readings until its last steps.

        The level where these are too few.
        """
        if fold == "whole" or self.heat_input.law is None:
            return self.heat_input
        ends = [n for e, n in zip(self.regressions, self.last_steps(fold), strict=True) for _ in e.histories]
        seen = [history.slice(0, n) for history, n in zip(self.histories, ends, strict=True) if n > 1]
        try:
            return identified_heat_input(seen, self.config, self.sign, alone=self.alone)[0] if seen else IDENTITY
        except DataError:
            return IDENTITY


@dataclass(frozen=True)
class Estimate:
    """A linear estimate of a zone, from which its model is made and judged.

    Attributes:
        everything: the fit to all rows.
        last, before: the fits without the held-out rows and without an earlier part, None where there is none.
        effects: of the own actuator and of others (1 + K,) by all rows.
        scores: for the model card; `acts_log_odds` that the actuator acts.
        together_sd: relative standard deviation of what all actuators of the building at full level do to the zone in a
            day, NaN where it was not estimated.
        laws: what was found of the level of the own actuator.
        unjudged: why the model cannot be judged, empty where it can.
    """

    everything: Fold
    last: Fold
    before: Fold | None
    effects: Sequence[Effect]
    scores: Mapping[str, float]
    together_sd: float = float("nan")
    laws: Estimates = field(default_factory=dict)
    unjudged: str = ""


def fold_of(
    regressions: Sequence[RegressionData],
    log_tau: Array,
    gains: Array,
    sign: int,
    heat_input: HeatInput,
    free: RcParameters | None,
    alone: RcParameters | None,
) -> Fold:
    """A fold with modes ln(τ/h) and [slope, G_2 … G_r], fitted to what pairs show beside: no loop biases a difference.

    For the rest see `Fold`.
    """
    pairs = [e for e in seen_rows(regressions) if e.is_pair]
    if pairs:
        log_tau, gains = fitted_to_pairs(pairs, log_tau, gains, sign)
    return Fold(regressions, log_tau, np.maximum(gains, _LEAST_GAIN), sign, heat_input, free, alone)
