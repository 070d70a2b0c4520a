"""The modulation m(x) of a fold's gain: trained on the rows that the fold sees, compared with m = 1 on the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from thermoforce_mpc.data import Array, Record
from thermoforce_mpc.data.series.gaps import interpolated
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.modulation.training import TrainingData, train
from thermoforce_mpc.identification.validation.blocks import block_numbers, is_significant, standard_errors_saved
from thermoforce_mpc.identification.validation.errors_ahead import Fold
from thermoforce_mpc.model.forced_history import forced_history
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.features import feature_matrix
from thermoforce_mpc.model.operator.parameters import OperatorParameters

# A held-out comparison decides at this probability (Student's t, one-sided), if the RMS is below this share.
_SIGNIFICANT, _RELEVANT = 0.95, 0.98
# Lower limit of the features' scale: °C, °C, W/m², 1.
_LEAST_SCALE = np.array([5.0, 8.0, 150.0, 0.5])
# Largest output bias of the network: beyond it m(x) is at an end of its range.
_LARGEST_BIAS = 5.0


@dataclass(frozen=True)
class Candidate:
    """The network of a fold, trained when it is asked for; `by_level`: whether v = u where heat was measured."""

    fold: Fold
    config: IdentificationConfig
    by_level: bool

    @cached_property
    def features(self) -> list[tuple[Array, ...]]:
        """x_t (n, 4) of each record; control-free temperatures are those of the linear fit."""
        base = self.fold.operator(self.config)
        return [tuple(_features(base, h, self.config.feedback) for h in e.histories) for e in self.fold.regressions]

    @cached_property
    def untrained(self) -> OperatorParameters:
        """The linear operator; its features are normalised by the rows that the fold sees."""
        pairs = [(e, x) for e, xs in zip(self.fold.regressions, self.features, strict=True) for x in xs if e.seen]
        stacked = np.concatenate([x[: int(e.rows[e.seen - 1])] for e, x in pairs])
        scale = np.maximum(stacked.std(axis=0), _LEAST_SCALE)
        return replace(self.fold.operator(self.config), feature_mean=stacked.mean(axis=0), feature_scale=scale)

    @cached_property
    def driven(self) -> list[RegressionData]:
        """The regressions with what drives the network.

        A level that was held counts as the share of time at full level that gives its heat, as levels of a plan do.
        """
        if not self._is_level:
            return list(self.fold.regressions)
        heat_input, found = self.untrained.heat_input, []
        for e in self.fold.regressions:
            full = [heat_input(np.asarray(1.0), history.T_out_C[:-1]) for history in e.histories]
            drives = tuple((sign, drive / most) for (sign, drive), most in zip(e.drives, full, strict=True))
            found.append(replace(e, drives=drives))
        return found

    @cached_property
    def trained(self) -> OperatorParameters:
        """The operator with the network trained on the rows that the fold sees.

        Runs say by what the gain changes, not its size: that is the linear fit's, which follows the building's rooms.
        """
        heat_input = self.untrained.heat_input
        start = replace(self.untrained, heat_input=heat_input.by_level if self._is_level else heat_input)
        data = [TrainingData(*each) for each in zip(self.driven, self.features, self.fold.rests, strict=True)]
        operator = train(start, data, self.config)
        pairs_only = all(e.is_pair for e in self.fold.regressions)
        return operator if pairs_only or self.config.method == "two_stage" else self._as_large(operator)

    def _as_large(self, operator: OperatorParameters) -> OperatorParameters:
        """`operator` with the bias at which it gives as much in all, in the rows that the fold sees, as m = 1."""
        seen = []
        for e, driven, xs in zip(self.fold.regressions, self.driven, self.features, strict=True):
            n = int(e.rows[e.seen - 1]) if e.seen else 0
            seen += [(v[:n], w[:n], x[:n]) for (_, v), (_, w), x in zip(e.drives, driven.drives, xs, strict=True)]
        linear, driving, x = (np.concatenate(column) for column in zip(*seen, strict=True))

        def more(bias: float) -> float:
            return float(np.abs(driving) @ replace(operator, output_bias=bias).modulation(x) - np.abs(linear).sum())

        if not more(-_LARGEST_BIAS) < 0.0 < more(_LARGEST_BIAS):
            return operator
        return replace(operator, output_bias=float(brentq(more, -_LARGEST_BIAS, _LARGEST_BIAS)))

    @cached_property
    def modulated(self) -> Fold:
        """The fold with what the actions did by the network."""
        operator, driven = self.trained, []
        for e, xs in zip(self.driven, self.features, strict=True):
            drives = tuple((sign, v * operator.modulation(x)) for (sign, v), x in zip(e.drives, xs, strict=True))
            driven.append(replace(e, drives=drives))
        return replace(self.fold, modulated=replace(self.fold, regressions=driven).effects)

    @cached_property
    def left(self) -> tuple[Array, Array]:
        """Held-out residuals (rows,) with m = 1 and with the network, standard deviations, each given those before."""
        both = []
        for effects in (self.fold.effects, self.modulated.effects):
            each = zip(self.fold.regressions, self.fold.rests, effects, strict=True)
            both.append(np.concatenate([rest.white(e.target - rest.mean - k)[e.seen :] for e, rest, k in each]))
        return both[0], both[1]

    @property
    def scores(self) -> dict[str, float]:
        """Held-out errors without and with the network, standard deviations, and whether it is kept."""
        linear, neural = (_rms(left) for left in self.left)
        return {"held_out_linear": linear, "held_out_neural": neural, "modulation_kept": float(self.kept)}

    @property
    def kept(self) -> bool:
        """Whether the network is kept in the place of m = 1."""
        return self.config.modulation == "always" or not self.worse

    @cached_property
    def worse(self) -> str:
        """In what m = 1 predicts the held-out rows better, in words; empty unless by 2 % and significantly, block by
        block.
        """
        linear, neural = self.left
        blocks = [block_numbers(i, e.rows[e.seen :], e.step_s) for i, e in enumerate(self.fold.regressions)]
        statistic = standard_errors_saved(neural, linear, np.concatenate(blocks))
        if _rms(linear) >= _RELEVANT * _rms(neural) or not is_significant(*statistic, _SIGNIFICANT):
            return ""
        return (
            f"held-out data are predicted better with it: error {_rms(linear):.3g} instead of {_rms(neural):.3g} "
            "standard deviations"
        )

    @property
    def _is_level(self) -> bool:
        return self.by_level and self.untrained.heat_input.heat is not None


def _features(operator: OperatorParameters, history: Record, feedback: bool) -> Array:
    """Return the features x_t (n, 4) of a run, with T − F (no gradient through F) or, with feedback, measured T."""
    # Of a zone's own actuator, summed over modes.
    forced = 0.0 if feedback else forced_history(single(operator), history.part(0, [0])).sum(axis=(0, 1, 3))
    free = interpolated(history.T_zone_C[0] - forced)
    return feature_matrix(free[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2))) if residuals.size else float("nan")
