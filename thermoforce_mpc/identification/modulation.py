"""The modulation m(x) of an operator: trained on the rows that a fold sees, kept unless m = 1 predicts better.

Training goes over multi-step rollouts (paper eq:operator to eq:mod) of modes that are known. The forced response is
linear in the drive m(x) v, so that a run is one matrix: whitened responses at the training rows to the drive of each
step. m(x) starts at 1; where heat was measured beside v = u, at the measured heat of full level over T_out: the meter
knows that better than a few days of temperatures, also in weather that they did not see. Tests compare the gradient
with automatic differentiation by torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.data.clock import PLAN_H, PLAN_STEP_S
from thermoforce_mpc.data.series import interpolated, rms
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.estimation.regression import RegressionData
from thermoforce_mpc.identification.estimation.rest import Rest
from thermoforce_mpc.identification.validation.errors_ahead import (
    Fold,
    block_numbers,
    is_significant,
    standard_errors_saved,
)
from thermoforce_mpc.model.forced_state import forced_history
from thermoforce_mpc.model.machine.load import LEVEL_EDGE, NEARLY_FULL, MachineLoad
from thermoforce_mpc.model.machine.power import SWITCH_FROM, PowerModel, part_load
from thermoforce_mpc.model.operator.building import single
from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OUTDOOR, OperatorParameters, feature_matrix

# A held-out comparison decides at this probability (Student's t, one-sided), if the RMS is below this share. The usual
# level; the share is by judgement: less is not worth a network.
_SIGNIFICANT, _RELEVANT = 0.95, 0.98
# Lower limit of the features' scale: °C, °C, W/m², 1. A third more changes effects by 0.2 %, and with them the on/off
# decisions of a day of `generated:4242:1` (cost + 3.3 %, nothing on the heat pump; `benchmarks.constants`, 2026-11-28).
_LEAST_SCALE = np.array([5.0, 8.0, 150.0, 0.5])
# Largest output bias of the network: beyond it m(x) is at an end of its range.
_LARGEST_BIAS = 5.0
# Fixed share of heat up to which it counts as in proportion to the level. By judgement.
_PROPORTIONAL = 0.1
# Change of the heat of full level per K outdoors from which it is that of a heating curve: the circuits of
# `office:3rooms:771300` have 0.066, the machine of `bestest_hydronic_heat_pump` 0.024 (2026-11-28).
_STEEP_1_K = 0.04
# Share of the steps on from which levels below full are not mere trials. By judgement.
_OFTEN = 0.25
# Initial standard deviation of hidden weights: features are normalised, so slopes of order 1 use the range of tanh. A
# third more does what it does for `_LEAST_SCALE`.
_HIDDEN_SD = 0.5
# Hidden weight of the unit that starts as the measured heat of full level: tanh is straight within 1 % over ± 2
# standard deviations of T_out, and bends far outside.
_STRAIGHT = 0.1
# Largest part of γ that m(x) starts at: at all of it tanh would be flat, and its bias infinite.
_MOST = 0.99
# Prior standard deviation of m(x) around its start: smaller where measured heat includes the dependence on T_out. A
# third more changes effects by 0.2 % (drawn house) and 0.02 % (heat pump, metered; `benchmarks.constants`, 2026-11-28).
_MODULATION_SD, _MODULATION_SD_METERED = 0.15, 0.02
# The usual start of Adam for networks of this size.
_LEARNING_RATE = 0.01  # of Adam
# L-BFGS: history size; convergence tolerances of the gradient's largest element and of the loss's relative change.
_MEMORY, _FLAT, _SETTLED = 30, 1e-6, 1e-9


def modulate(
    everything: Fold, last: Fold, before: Fold | None, config: IdentificationConfig, power: PowerModel | None
) -> tuple[OperatorParameters, tuple[Fold, Fold | None], dict[str, float], list[str]]:
    """Train m(x) on the training rows, compare it with m = 1 on the held-out ones, and train it on `everything`.

    Where heat was measured, v = u unless levels are held. The operator is that with m = 1 where the network is
    significantly worse than that and is not kept `always`. Whether what is judged on the rows that `last` holds out has
    a network is chosen on those of `before`: rows may not judge what they chose.

    Returns:
        The operator; `last` and `before` (None where there is none) as they are judged; held-out scores; notes.
    """
    by_level, notes = False, []
    heat = everything.heat_input.heat
    if heat is not None:
        held_levels = _held_levels(heat, everything, power)
        by_level = not held_levels
        notes.append("heat input: the level, v = u" if by_level else f"heat input: measured heat, since {held_levels}")
    of_all, of_last = (_Candidate(fold, config, by_level) for fold in (everything, last))
    of_before = None if before is None else _Candidate(before, config, by_level)
    if of_last.kept:
        # With feedback, training uses measured temperatures, so there is no recursion; prediction uses predicted ones.
        operator = of_all.trained
    else:
        notes.append(f"network not kept: m = 1 instead, since {of_last.worse}")
        dropped = of_last.trained
        operator = replace(of_all.untrained, hidden_weight=dropped.hidden_weight, hidden_bias=dropped.hidden_bias)
    last = of_last.modulated if of_before is None or of_before.kept else last
    before = None if of_before is None else of_before.modulated
    return replace(operator, feedback=config.feedback), (last, before), of_last.scores, notes


@dataclass(frozen=True)
class _Candidate:
    """The network of a fold, trained when it is asked for; `by_level`: whether v = u where heat was measured."""

    fold: Fold
    config: IdentificationConfig
    by_level: bool

    @cached_property
    def features(self) -> list[tuple[Array, ...]]:
        """x_t (n, 4) of each record; control-free temperatures are those of the linear fit."""
        base = self.fold.operator(self.config)
        own = () if self.config.feedback else (base,)
        return [tuple(_features(own, e.others, h) for h in e.histories) for e in self.fold.regressions]

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
        from scipy.optimize import brentq

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
        linear, neural = (rms(left) for left in self.left)
        return {"held_out_linear": linear, "held_out_neural": neural, "modulation_kept": float(self.kept)}

    @property
    def kept(self) -> bool:
        """Whether the network is kept in the place of m = 1."""
        return self.config.modulation == "always" or not self.worse

    @cached_property
    def worse(self) -> str:
        """That m = 1 predicts held-out rows better by 2 % and significantly, block by block, in words; else empty."""
        linear, neural = self.left
        blocks = [block_numbers(i, e.rows[e.seen :], e.step_s) for i, e in enumerate(self.fold.regressions)]
        statistic = standard_errors_saved(neural, linear, np.concatenate(blocks))
        if rms(linear) >= _RELEVANT * rms(neural) or not is_significant(*statistic, _SIGNIFICANT):
            return ""
        return (
            f"held-out data are predicted better with it: error {rms(linear):.3g} instead of {rms(neural):.3g} "
            "standard deviations"
        )

    @property
    def _is_level(self) -> bool:
        return self.by_level and self.untrained.heat_input.heat is not None


def _features(own: Sequence[OperatorParameters], others: Sequence[OperatorParameters], history: Record) -> Array:
    """x_t (n, 4) of a run, with T − F (no gradient through F) as predictions have it: F is what all actuators do.

    `own`: none where the network adds what that does itself (feedback); `others`: those of the other levels.
    """
    operators = [*enumerate(own), *enumerate(others, start=1)]
    each = [forced_history(single(operator), history.part(0, [a])).sum(axis=(0, 1, 3)) for a, operator in operators]
    free = interpolated(history.T_zone_C[0] - np.sum(each, axis=0))
    return feature_matrix(free[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])


def _held_levels(heat: MachineLoad, everything: Fold, power: PowerModel | None) -> str:
    """Why plans need the heat that was measured, in words; empty where v = u will do.

    Where heat is in proportion to the level, or the machine is switched at full level, it will. Not so on a heating
    curve: a network that saw days of one weather does not go on as the heat does in another.
    """
    middle_C = 0.5 * sum(heat.T_out_range_C)
    fixed, per_u = (float(part) for part in heat.parts(middle_C))
    slope = sum(
        float(colder) - float(warmer)
        for colder, warmer in zip(heat.parts(middle_C - 1.0), heat.parts(middle_C), strict=True)
    )
    if abs(slope) > _STEEP_1_K * (fixed + per_u):
        return f"that of full level changes by {100.0 * abs(slope) / (fixed + per_u):.0f} % per K outdoors"
    if not heat.levels_seen or fixed <= _PROPORTIONAL * (fixed + per_u):
        return ""
    u = np.concatenate([h.u[0] for e in everything.regressions for h in e.histories])
    on = u > LEVEL_EDGE
    held = np.count_nonzero(on & (u < NEARLY_FULL)) > _OFTEN * np.count_nonzero(on)
    at_part_load = None if power is None else part_load(power, heat)
    if not held and (at_part_load is None or at_part_load.at_half > 1.0 + SWITCH_FROM):
        return ""
    return "levels between off and full are held, whose heat is not in proportion to the level"


def prove(operator: OperatorParameters) -> None:
    """Raise `DataError` if the sign of the effect is not certified for plans, possible only with `feedback: true`.

    It must be at the operator's own step and at the controllers', over their horizon (the file states 48 steps).
    """
    for step_s in dict.fromkeys((operator.step_s, PLAN_STEP_S)):
        proof = certificate(operator.resampled(step_s), max(48, round(PLAN_H * HOUR_S / step_s)))
        if not proof.certified:
            raise DataError(f"the identified operator at {step_s:g} s is not certified: {'; '.join(proof.reasons)}")


@dataclass(frozen=True)
class TrainingData:
    """Regression with its features x_t (n, 4) of each run, in the order of its drives, and what is left of it."""

    regression: RegressionData
    features: tuple[Array, ...]
    rest: Rest


class Misfit:
    """Σ of squared whitened residuals of the training rows and of the network's prior, per row, of its parameters (P,).

    Parameters, in this order: hidden weights (H, 4) and biases (H,), output weights (H,) and bias.

    Args:
        start: operator that gives all but these parameters; where they are expected.
        data: runs and pairs.
        modulation_sd: prior standard deviation of m(x) around that of `start`.
    """

    def __init__(self, start: OperatorParameters, data: Sequence[TrainingData], modulation_sd: float) -> None:
        self._start = start
        data = [e for e in data if e.regression.seen]
        runs = [(s * v, x) for e in data for (s, v), x in zip(e.regression.drives, e.features, strict=True)]
        self._heat = np.concatenate([drive for drive, _ in runs])
        self._x = (np.concatenate([x for _, x in runs]) - start.feature_mean) / start.feature_scale
        self._matrices = [_responses(start, e) for e in data]
        self._targets = [e.rest.white((e.regression.target - e.rest.mean)[: e.regression.seen]) for e in data]
        self._n = sum(target.size for target in self._targets)
        weights = 0.0 if start.gamma == 0.0 else (start.gamma / modulation_sd) ** 2
        # Output weights are such that m has `modulation_sd`, hidden ones have sd 1, or as much less as they move m.
        # Both about 0 instead of the start would take units that the data say little of to exactly nothing.
        H, hidden = start.hidden_bias.size, 1.0 + weights * start.output_weight**2
        self._precision = np.concatenate([np.repeat(hidden, 4), hidden, np.full(H, H * weights), [weights]])
        self.begin = np.concatenate(
            [start.hidden_weight.ravel(), start.hidden_bias, start.output_weight, [start.output_bias]]
        )

    def __call__(self, network: Array) -> tuple[float, Array]:
        """The misfit and its gradient (P,)."""
        H, gamma = self._start.hidden_bias.size, self._start.gamma
        output = network[5 * H : 6 * H]
        hidden = np.tanh(self._x @ network[: 4 * H].reshape(H, 4).T + network[4 * H : 5 * H])
        out = np.tanh(hidden @ output + network[6 * H])
        drive, by_drive = (1.0 + gamma * out) * self._heat, np.empty(out.size)
        squares, first = 0.0, 0
        for matrix, target in zip(self._matrices, self._targets, strict=True):
            steps = slice(first, first + matrix.shape[1])
            residual = target - matrix @ drive[steps]
            squares += float(residual @ residual)
            by_drive[steps] = -2.0 * (residual @ matrix)
            first = steps.stop
        by_out = by_drive * self._heat * gamma * (1.0 - out**2)
        by_hidden = by_out[:, None] * output * (1.0 - hidden**2)
        away = network - self.begin
        gradient = np.concatenate(
            [(by_hidden.T @ self._x).ravel(), by_hidden.sum(axis=0), by_out @ hidden, [by_out.sum()]]
        )
        value = squares + float(self._precision @ away**2)
        return value / self._n, (gradient + 2.0 * self._precision * away) / self._n

    def operator(self, network: Array) -> OperatorParameters:
        """The operator with these parameters (P,)."""
        H = self._start.hidden_bias.size
        weight, bias, output = np.split(network[: 6 * H], [4 * H, 5 * H])
        return replace(
            self._start,
            hidden_weight=weight.reshape(H, 4),
            hidden_bias=bias,
            output_weight=output,
            output_bias=float(network[-1]),
        )


def _responses(operator: OperatorParameters, data: TrainingData) -> Array:
    """Whitened responses (rows, k n), K, of the training rows to the drive of each step of the k runs."""
    e = data.regression
    impulse = operator.impulse(e.n_steps)
    lags = e.rows[: e.seen, None] - 1 - np.arange(e.n_steps)
    response = data.rest.white(np.where(lags >= 0, impulse[lags], 0.0))
    return np.tile(response, (1, len(e.drives)))


def train(
    linear: OperatorParameters, regressions: Sequence[TrainingData], config: IdentificationConfig
) -> OperatorParameters:
    """Train the network of the `linear` operator for at most the configured number of epochs."""
    metered = linear.heat_input.law is not None
    start = with_network(linear, config.seed)
    misfit = Misfit(start, regressions, _MODULATION_SD_METERED if metered else _MODULATION_SD)
    end, _ = minimise(misfit, misfit.begin, config)
    return misfit.operator(end)


def with_network(linear: OperatorParameters, seed: int) -> OperatorParameters:
    """Return the operator with the network that training starts from; its normalisation of features is set."""
    rng, H, gamma = np.random.default_rng(seed), linear.hidden_bias.size, linear.gamma
    weight, bias = rng.normal(0.0, _HIDDEN_SD, (H, N_FEATURES)), rng.normal(0.0, _HIDDEN_SD, H)
    output, output_bias = np.zeros(H), 0.0
    if linear.heat_input.metered is not None and gamma > 0.0:
        T_out_C = linear.feature_mean[OUTDOOR] + linear.feature_scale[OUTDOOR] * np.array([-1.0, 1.0])
        share = (linear.heat_input.full_share(T_out_C) - 1.0) / gamma
        low, high = np.arctanh(np.clip(share, -_MOST, _MOST))
        weight[0], bias[0] = _STRAIGHT * np.eye(N_FEATURES)[OUTDOOR], 0.0
        output[0], output_bias = 0.5 * (high - low) / np.tanh(_STRAIGHT), 0.5 * (high + low)
    return replace(linear, hidden_weight=weight, hidden_bias=bias, output_weight=output, output_bias=float(output_bias))


def minimise(
    misfit: Callable[[Array], tuple[float, Array]], start: Array, config: IdentificationConfig
) -> tuple[Array, list[float]]:
    """Minimise `misfit`, loss and gradient (P,), from `start` (P,) with the configured optimiser.

    Returns the end (P,) and the loss of each epoch (evaluation of loss and gradient).
    """
    from scipy.optimize import minimize

    losses: list[float] = []

    def evaluate(parameters: Array) -> tuple[float, Array]:
        value, gradient = misfit(parameters)
        losses.append(value)
        return value, gradient

    if config.optimiser == "adam":
        import torch  # slow to load, and for the paper's optimiser only

        parameters = torch.nn.Parameter(torch.from_numpy(start.copy()))
        optimiser = torch.optim.Adam([parameters], lr=_LEARNING_RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, config.epochs)
        for _ in range(config.epochs):
            parameters.grad = torch.from_numpy(evaluate(parameters.detach().numpy())[1])
            optimiser.step()
            schedule.step()
        return parameters.detach().numpy(), losses
    # The loss is smooth and deterministic, so L-BFGS needs a fraction of the steps (Nocedal 1980).
    options = {"maxcor": _MEMORY, "maxiter": config.epochs, "maxfun": config.epochs, "gtol": _FLAT, "ftol": _SETTLED}
    result = minimize(evaluate, start, jac=True, method="L-BFGS-B", options=options)
    return np.asarray(result.x), losses
