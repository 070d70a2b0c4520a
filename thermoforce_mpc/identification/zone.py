"""Model of one zone from its records: free part beside the network's effects, monotone-neural gain, verdict.

Fit with the effects that the network has of the first part of the data, for the verdict; fit with those of everything;
train the modulation the same way, and keep it unless it is worse; refuse an operator whose actuator is not shown to act
or whose sign is not proven, whatever the method. The zone's own actuator is the first of its records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.effects.level_laws import level_shape
from thermoforce_mpc.identification.estimation.joint import JointFit, ModeFit, fit_joint
from thermoforce_mpc.identification.estimation.likelihood import Split
from thermoforce_mpc.identification.estimation.modes import ModePriors, centred_priors, to_operator
from thermoforce_mpc.identification.estimation.records import Pair, resolution_K
from thermoforce_mpc.identification.estimation.regression import (
    OtherActuator,
    pair_regression,
    run_regression,
)
from thermoforce_mpc.identification.estimation.uncertainty import uncertainty
from thermoforce_mpc.identification.modulation.selection import modulate, prove
from thermoforce_mpc.identification.network.folds import Effects, ZoneEffects
from thermoforce_mpc.identification.two_stage import two_stage_model
from thermoforce_mpc.identification.validation.competence import Fold, judge
from thermoforce_mpc.identification.validation.held_out import Case, held_out, normalisation, ranges
from thermoforce_mpc.identification.validation.held_out_fit import (
    earlier_fold,
    fit_and_judge,
    split_before,
)
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.model.machine.power import PowerModel
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.operator.parameters import OperatorParameters
from thermoforce_mpc.model.sun_on_sensor import SunOnSensor
from thermoforce_mpc.model.zone_model import ZoneModel

# Least log odds that the actuator acts: of 84 random houses with the levels of another one, 2 had more
# (`python -m benchmarks.zones.placebo` for houses of rooms).
_LEAST_LOG_ODDS = 5.0
# Relative standard deviation of what the network says of effects while the free part is fitted beside them, and the
# least of a gain, K or K/h.
_HELD, _LEAST_GAIN = 0.5, 1e-3
# Relative standard deviation of the answer after a day from which a model is called uncertain.
_UNCERTAIN = 0.15


@dataclass(frozen=True)
class ZoneTask:
    """What one zone is identified from.

    Attributes:
        runs, pairs: records of the zone, prepared (`identification.records`); the first level is that of its own
            actuator, the rest are those of `others`.
        heat_input: what the own actuator delivers.
        sign: +1 if it heats, −1 if it cools.
        others: the other actuators of the building.
        step_s: step of the operator, s; None: that of the data.
        source, data, notes: for the model card.
        power: of the machine, where it feeds this actuator alone.
        level_sd: relative standard deviation of the effect that comes from heat that was not measured.
        sun: what shone on the zone sensor, already taken off the records.
        alone: whether the building has no other actuator. Of several, one without an effect must not refuse the rest:
            its model is returned, not competent.
    """

    runs: Sequence[Record]
    pairs: Sequence[Pair]
    heat_input: HeatInput
    sign: int
    others: Sequence[OtherActuator] = ()
    step_s: float | None = None
    source: str = "identified"
    data: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    power: PowerModel | None = None
    alone: bool = True
    level_sd: float = 0.0
    sun: SunOnSensor | None = None


@dataclass(frozen=True)
class ZoneData:
    """A task with its records as regressions: `cases`, which rows of each are held out, and the resolution of the
    sensor, K.
    """

    task: ZoneTask
    config: IdentificationConfig
    cases: Sequence[Case]
    splits: Sequence[Split]
    grid_K: float
    notes: Sequence[str]

    @classmethod
    def of(cls, task: ZoneTask, config: IdentificationConfig) -> ZoneData:
        """The data of a task; of a sensor that reads in steps, their rounding counts as its noise."""
        grid_K, notes = resolution_K(task.runs), list(task.notes)
        if grid_K:
            # Rounding errors are uniform: their standard deviation is a twelfth's root of the resolution.
            sensor_sd_K = float(np.hypot(config.sensor_sd_K, grid_K / np.sqrt(12.0)))
            config = config.model_copy(update={"sensor_sd_K": sensor_sd_K})
            notes.append(f"the zone sensor reads in steps of {grid_K:.2g} K: noise of {sensor_sd_K:.2g} K assumed")
        cases = cases_of(task, config)
        return cls(task, config, cases, held_out(cases, config), grid_K, notes)

    def knowing(self, effects: Effects) -> tuple[list[Case], ModePriors]:
        """The cases with what the network says of levels and, as their prior, of the effects of the other actuators;
        and the prior of that of the own one.
        """
        own, *others = effects.heat_inputs
        acting = [replace(other, heat_input=v) for other, v in zip(self.task.others, others, strict=True)]
        cases = cases_of(replace(self.task, heat_input=own, others=acting), self.config)
        modes = effects.modes
        sd = np.maximum(_HELD * modes.gains[1:], _LEAST_GAIN)
        prior = np.stack([modes.gains[1:], sd], axis=1)
        known = [
            replace(case, regression=replace(case.regression, other_gains=prior, weather_gains=modes.weather))
            for case in cases
        ]
        return known, centred_priors(modes.log_tau, modes.gains[0], _HELD)

    @property
    def histories(self) -> list[Record]:
        """The records of all cases."""
        return [h for case in self.cases for h in case.histories]

    def last_steps(self, fold: str) -> list[int]:
        """How many steps of each case a fold may see, 0 for none: all of the `whole`, those before the held-out rows of
        `training`, and of these, runs only, those before as many held out again of `earlier`.
        """
        seen = []
        for case, split in zip(self.cases, self.splits, strict=True):
            rows, n = case.regression.rows, case.regression.n_steps
            if fold == "whole":
                seen.append(n)
                continue
            train = split.train
            if fold == "earlier" and train.size:
                train = (
                    train[:0]
                    if case.regression.is_pair or not split.judged.size
                    else train[: split_before(case, split, self.config).train.size]
                )
            seen.append(int(rows[train[-1]]) if train.size else 0)
        return seen


def cases_of(task: ZoneTask, config: IdentificationConfig) -> list[Case]:
    """The records of a task as regressions."""
    heat_input, others = task.heat_input, task.others
    runs = [Case(run_regression(h, heat_input, config, others), (h,), float(h.time_s[0])) for h in task.runs]
    pairs = [Case(pair_regression(p, heat_input, others), (p.a, p.b), float(p.a.time_s[0])) for p in task.pairs]
    return [*runs, *pairs]


def identify_zone(
    data: ZoneData, effects: ZoneEffects | None, say: Callable[[str], None]
) -> tuple[ZoneModel, JointFit | None]:
    """Return the zone's model and its linear fit, None with method two_stage, which needs no `effects`.

    Raises:
        DataError: nothing shows that the actuator acts (where it is alone), or its effect has no proven sign.
    """
    task, config = data.task, data.config
    days = sum(h.n_steps * h.step_s for h in data.histories) / DAY_S
    say(f"fitting the forced response to {days:.3g} days at {data.histories[0].step_s:g} s")
    fit = None
    if effects is None:
        model = two_stage_model(
            task.runs, task.pairs, task.data, config, task.heat_input, task.sign, task.step_s, task.source, data.notes
        )
    else:
        model, fit = _joint_model(data, effects, say)
    model = _accepted(model, data)
    model = replace(model, card=replace(model.card, sun_on_sensor=task.sun))
    say(f"identified an operator of order {model.operator.order}")
    return model, fit


def _accepted(model: ZoneModel, data: ZoneData) -> ZoneModel:
    """`model`, not competent where the record does not show that its actuator acts.

    Raises:
        DataError: it does not and the actuator is alone in the building, or its effect has no proven sign.
    """
    missing = _without_effect(model.card.scores["acts_log_odds"], data)
    if missing and data.task.alone:
        raise DataError(missing)
    prove(model.operator)
    if not missing:
        return model
    verdict = replace(model.card.competence or Competence(False), competent=False, reasons=(missing,))
    return replace(model, card=replace(model.card, competence=verdict))


def _without_effect(log_odds: float, data: ZoneData) -> str:
    """What is wrong where the record does not show an effect, and what to do; empty where it does."""
    if log_odds >= _LEAST_LOG_ODDS:
        return ""
    dark = not any(np.any(h.solar_W_m2) for h in data.histories)
    return (
        f"no effect of the actuator with the sign of {'heating' if data.task.sign > 0 else 'cooling'} was found in the "
        f"data: the log odds that it acts are {log_odds:.1f}, need {_LEAST_LOG_ODDS:g}; check the sign of u, whether "
        "the actuator reached the zone, and that the zone sensor is in the room that it serves, or probe "
        f"harder{'; the record has no irradiance: name a signal for the sun' if dark else ''}"
    )


def _joint_model(data: ZoneData, effects: ZoneEffects, say: Callable[[str], None]) -> tuple[ZoneModel, JointFit]:
    """The joint estimator as a zone's model, and its fit: effects from the network, input of the modulation by
    held-out data.
    """
    task, config, splits = data.task, data.config, data.splits
    sign, heat_input, power = task.sign, effects.whole.heat_inputs[0], task.power
    cases, priors = data.knowing(effects.whole)
    seen_cases, seen_priors = data.knowing(effects.training)
    training = fit_and_judge(seen_cases, splits, seen_priors, config, sign)
    final = fit_joint([c.regression for c in cases], priors, config, sign, effects.covariance)
    histories, step_s = data.histories, task.step_s
    base_step = histories[0].step_s
    mean, scale = normalisation(histories)

    def linear(fit: ModeFit) -> OperatorParameters:
        return to_operator(
            fit.log_tau,
            fit.gains,
            step_s=base_step,
            bounds_h=centred_priors(fit.log_tau, fit.gains, _HELD).bounds_h(),
            sign=sign,
            gamma=config.gamma,
            hidden=config.hidden,
            heat_input=heat_input,
            feature_mean=mean,
            feature_scale=scale,
        )

    operator, notes = replace(linear(final), feedback=config.feedback), list(data.notes)
    scores = {"held_out": training.score, "held_out_rollout_rmse_K": training.rollout_rmse_K}
    scores |= {"residual_scale": final.residual_scale, "acts_log_odds": effects.log_odds}
    if config.modulation != "linear":
        say("training the modulation of the gain")
        operator, neural, said = modulate(cases, splits, linear, training.fit, final, priors, config, power)
        scores, notes = scores | neural, [*notes, *said]
    operator = operator.resampled(step_s or base_step)
    certainty = uncertainty(final, operator.step_s, task.level_sd) | {"sensor_resolution_K": data.grid_K}
    shape, shape_notes = level_shape(effects.laws, histories, config, power)
    notes = [*notes, *shape_notes]
    verdict = None
    if task.runs:
        fold = Fold(seen_cases, splits, training.fit)
        before_cases, before_priors = data.knowing(effects.earlier)
        earlier = earlier_fold(before_cases, splits, before_priors, config, sign)
        verdict = judge(
            fold, earlier, seen_priors, certainty, effects.log_odds, sign, own_loops=heat_input.lowest < 0.0
        )
    model = ZoneModel(
        operator=operator,
        power=power,
        free=final.free_model(step_s or base_step, config) if task.runs else None,
        card=ModelCard(
            source=task.source,
            data=task.data,
            ranges=ranges(histories),
            scores=scores,
            uncertainty=certainty | shape,
            config=config.model_dump(mode="json"),
            notes=(*notes, *_warnings(certainty)),
            competence=verdict,
        ),
    )
    return model, final


def _warnings(certainty: Mapping[str, float]) -> list[str]:
    """What a user should know before trusting the model."""
    share = certainty["step_response_24h_sd_K"] / max(certainty["step_response_24h_K"], 1e-9)
    if share <= _UNCERTAIN:
        return []
    return [f"uncertain: the effect of a day of action is known to ± {100 * share:.0f} % only; probe longer or harder"]
