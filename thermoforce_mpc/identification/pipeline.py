"""From recorded runs to a thermal model: actuator map, order, linear fit, monotone-neural gain, power.

Order: refuse what cannot identify; fit the heat map and the electric power to what was measured; fit every order to the
first part of the data and keep the one whose rollouts are best on the rest; fit it to everything; train the modulation
the same way. All steps are deterministic for a given seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.joint import (
    Episode,
    JointFit,
    calibrated,
    fit_joint,
    follows_action,
    forced_columns,
    pair_episode,
    run_episode,
)
from thermoforce_mpc.identification.likelihood import Split, hold_out_pair, residuals, split_run, whole
from thermoforce_mpc.identification.modes import ModePriors, centred_priors, mode_priors, to_operator
from thermoforce_mpc.identification.records import Pair, check_pairs, check_run, check_steps, data_hash
from thermoforce_mpc.identification.two_stage import TwoStageFit, fit_two_stage
from thermoforce_mpc.identification.uncertainty import uncertainty
from thermoforce_mpc.operator.actuator import IDENTITY, ActuatorMap
from thermoforce_mpc.operator.certificate import certificate
from thermoforce_mpc.operator.features import N_FEATURES, feature_matrix
from thermoforce_mpc.operator.parameters import FeatureTemperature, OperatorParameters
from thermoforce_mpc.power import HEAT_SLOPE, POWER_SLOPE, PowerModel, fit_load
from thermoforce_mpc.types import HOUR_S, Array, History
from thermoforce_mpc.world_model import ModelCard, ThermalModel, forced_history

# A lower order must beat a higher one on the held-out rows by this many standard errors and by this share of the
# squared residual: under priors a mode too many does no harm, while a delay left out cannot be made up for.
_SIGNIFICANT = 2.0
_CLEARLY = 0.2
# Orders are told apart by rows that follow an action within hours, and only by enough of them: the others tell how the
# weather was.
_AFTER_ACTION_H = 6.0
_LEAST_JUDGED = 24
# Least share of the whitened variance that the forced response must explain to be believed.
_LEAST_EXPLAINED = 0.1
# Held-out hours below which nothing is said about a network: a quarter of a day decides by chance.
_LEAST_JUDGED_H = 12.0
# While the network is trained on runs, gains and time constants are held to within this relative deviation.
_LINEAR_HELD_SD = 0.02
# Narrowest spread that features are normalised by: °C, °C, W/m², 1.
_LEAST_SCALE = np.array([1.0, 1.0, 50.0, 0.5])
# How far paired training may take pole and gain from where the two stages ended, relative.
_TWO_STAGE_SD = 0.3
# Share of the steps in which heat or power must have been measured to be used.
_MEASURED = 0.5


@dataclass(frozen=True)
class _Case:
    """One run or pair with its histories, in the order of the episode's drives."""

    episode: Episode
    histories: tuple[History, ...]
    start_s: float


@dataclass(frozen=True)
class _Fitted:
    """A fit to the training rows: whitened residuals of the rows judged by, and RMSE of the held-out rollouts, K."""

    fit: JointFit
    priors: ModePriors
    judged: Array
    rollout_rmse_K: float

    @property
    def score(self) -> float:
        """RMS of the whitened residuals of the rows judged by (NaN where no action was held out)."""
        return float(np.sqrt(np.mean(self.judged**2))) if self.judged.size else float("nan")


def identify(
    runs: Sequence[History] = (),
    pairs: Sequence[Pair] = (),
    *,
    config: IdentificationConfig | None = None,
    mode: Literal["heating", "cooling"] = "heating",
    floor_area_m2: float | None = None,
    step_s: float | None = None,
    source: str = "identified",
) -> ThermalModel:
    """Identify a thermal model.

    Args:
        runs: recorded runs, each with its own excitation; any number, any length from about a day.
        pairs: runs that share start and weather (paper eq:paired). All records have one step.
        config: options.
        mode: sign of what the actuator does to the zone.
        floor_area_m2: heated floor area, m²; with measured heat it turns the physical priors on.
        step_s: step of the returned operator, s; by default the step of the data.
        source: what the model card says the data are.

    Returns:
        Operator, electric power (where measured), linear free model (where there are runs) and model card.

    Raises:
        DataError: there are no data, or they cannot identify; the message has the numbers and what to do.
    """
    config = config or IdentificationConfig()
    if not runs and not pairs:
        raise DataError("nothing to identify from: give at least one run or pair")
    names = [f"run {i}" if len(runs) > 1 else "run" for i in range(len(runs))]
    for run, name in zip(runs, names, strict=True):
        check_run(run, name)
    if pairs:
        check_pairs(pairs)
    histories = [*runs, *(h for p in pairs for h in (p.a, p.b))]
    check_steps(histories)
    sign = 1 if mode == "heating" else -1
    actuator, notes = _actuator(histories, config, sign)
    if config.method == "two_stage":
        return _two_stage(runs, pairs, names, config, actuator, sign, step_s, source, notes)
    cases = [_Case(run_episode(h, actuator, config), (h,), float(h.time_s[0])) for h in runs]
    cases += [_Case(pair_episode(p, actuator), (p.a, p.b), float(p.a.time_s[0])) for p in pairs]
    splits = _splits(cases, config)

    candidates = {
        order: _fit(cases, splits, mode_priors(order, config, actuator, floor_area_m2), config, sign)
        for order in config.orders()
    }
    order = _choose(candidates)
    priors = candidates[order].priors
    final = fit_joint([c.episode for c in cases], priors, config, sign)
    explained = _explained(cases, final, sign)
    if explained < _LEAST_EXPLAINED:
        raise DataError(
            f"no effect of the actuator with the sign of {mode} was found in the data: it explains "
            f"{100 * max(explained, 0.0):.1f} % of what the weather does not, need {100 * _LEAST_EXPLAINED:g} %; check "
            "the sign of u, whether the actuator reached the zone, or probe harder"
        )
    base_step = histories[0].step_s
    mean, scale = _normalisation(histories)

    def linear(fit: JointFit) -> OperatorParameters:
        return to_operator(
            fit.log_tau,
            fit.gains,
            step_s=base_step,
            bounds_h=priors.bounds_h(),
            sign=sign,
            gamma=config.gamma,
            hidden=config.hidden,
            actuator=actuator,
            feature_mean=mean,
            feature_scale=scale,
        )

    operator = replace(linear(final), feature_temperature=config.features)
    scores = {f"held_out_order_{k}": c.score for k, c in candidates.items()}
    scores["held_out_rollout_rmse_K"] = candidates[order].rollout_rmse_K
    scores["explained_by_actuation"] = explained
    scores["misfit"] = final.misfit
    if config.modulation == "neural":
        operator, neural = _modulate(cases, splits, linear, candidates[order].fit, final, priors, config)
        scores |= neural
    operator = operator.resampled(step_s or base_step)
    _prove(operator)
    return ThermalModel(
        operator=operator,
        power=_power(histories, config),
        free=final.free_model(step_s or base_step, config) if runs else None,
        card=ModelCard(
            source=source,
            data={name: data_hash(h) for name, h in _named(names, runs, pairs)},
            ranges=_ranges(histories),
            scores=scores,
            uncertainty=uncertainty(final, operator.step_s),
            config=config.model_dump(mode="json"),
            notes=tuple(notes),
        ),
    )


def _actuator(histories: Sequence[History], config: IdentificationConfig, sign: int) -> tuple[ActuatorMap, list[str]]:
    """The map in front of the modes: heat where it was measured and wanted, else u itself."""
    if config.actuator == "identity":
        return IDENTITY, ["actuator map: identity, as configured"]
    heat = np.concatenate([h.heat_W for h in histories]) * sign
    measured = float(np.isfinite(heat).mean())
    if measured < _MEASURED:
        if config.actuator == "heat":
            raise DataError(
                f"actuator: heat was asked for, but heat was measured in only {100 * measured:.0f} % of the steps; "
                "name the heat points in the test case, or use actuator: identity"
            )
        return IDENTITY, [f"actuator map: identity, heat was measured in {100 * measured:.0f} % of the steps"]
    fit = fit_load(
        np.concatenate([h.u for h in histories]),
        np.concatenate([h.T_out_C[:-1] for h in histories]),
        heat,
        what="delivered heat",
        lowest_level=config.lowest_level,
        slope=HEAT_SLOPE,
    )
    return ActuatorMap(heat=fit.load), [f"actuator map: heat, RMSE {fit.rmse_W:.0f} W while on, R² {fit.r2:.4f}"]


def _two_stage(
    runs: Sequence[History],
    pairs: Sequence[Pair],
    names: Sequence[str],
    config: IdentificationConfig,
    actuator: ActuatorMap,
    sign: int,
    step_s: float | None,
    source: str,
    notes: Sequence[str],
) -> ThermalModel:
    """The paper's estimator as a thermal model: order 1; with pairs, paired training (eq:paired) goes on from there."""
    if not runs:
        raise DataError("method two_stage starts from single runs, of which none were given; pairs alone: method joint")
    fit = fit_two_stage(runs, actuator=actuator, sign=sign, u_off=config.u_off)
    step_s = step_s or fit.step_s
    operator = fit.operator()
    scores: dict[str, float] = {}
    histories = [*runs, *(h for p in pairs for h in (p.a, p.b))]
    if pairs:
        operator, scores = _train_on_pairs(fit, pairs, histories, config)
        operator = operator.resampled(step_s)
        _prove(operator)
    return ThermalModel(
        operator=operator.resampled(step_s),
        power=_power(histories, config),
        free=fit.free_model().resampled(step_s),
        card=ModelCard(
            source=source,
            data={name: data_hash(h) for name, h in _named(names, runs, pairs)},
            ranges=_ranges(histories),
            scores={"one_step_rmse_K": fit.rmse_K, "off_steps": fit.n_off, "on_steps": fit.n_on} | scores,
            uncertainty={"pole_sd": fit.a_sd, "gain_sd_K": fit.g_sd},
            config=config.model_dump(mode="json"),
            notes=tuple(notes),
        ),
    )


def _train_on_pairs(
    fit: TwoStageFit, pairs: Sequence[Pair], histories: Sequence[History], config: IdentificationConfig
) -> tuple[OperatorParameters, dict[str, float]]:
    """Pole, gain and modulation from pairs, starting from the two stages and held to them by priors of their size."""
    if fit.g == 0.0:
        raise DataError(
            "two-stage: the second stage found no effect of the expected sign, so paired training has nothing to start "
            "from; check the sign of u, or use method joint"
        )
    first = fit.operator()
    log_tau, slope = np.log(first.time_constants_h), np.abs(first.steady_gains_K) / first.time_constants_h
    start = JointFit(
        log_tau=log_tau,
        gains=slope,
        covariance=np.diag([fit.a_sd, fit.g_sd]) ** 2,
        free_log_tau=np.empty(0),
        free_gains=np.empty((0, 0)),
        misfit=1.0,
        objective=float("nan"),
    )
    weak = mode_priors(1, config.model_copy(update={"time_constants_h": None}), fit.actuator, None)
    priors = centred_priors(weak, log_tau, slope, _TWO_STAGE_SD)
    cases = [_Case(pair_episode(p, fit.actuator), (p.a, p.b), float(p.a.time_s[0])) for p in pairs]
    mean, scale = _normalisation(histories)

    def linear(found: JointFit) -> OperatorParameters:
        return to_operator(
            found.log_tau,
            found.gains,
            step_s=fit.step_s,
            bounds_h=weak.bounds_h(),
            sign=fit.sign,
            # Without modulation only pole and gain are trained.
            gamma=config.gamma if config.modulation == "neural" else 0.0,
            hidden=config.hidden,
            actuator=fit.actuator,
            feature_mean=mean,
            feature_scale=scale,
        )

    return _modulate(cases, _splits(cases, config), linear, start, start, priors, config)


def _power(histories: Sequence[History], config: IdentificationConfig) -> PowerModel | None:
    power = np.concatenate([h.power_W for h in histories])
    if np.isfinite(power).mean() < _MEASURED:
        return None
    fit = fit_load(
        np.concatenate([h.u for h in histories]),
        np.concatenate([h.T_out_C[:-1] for h in histories]),
        power,
        what="electric power",
        lowest_level=config.lowest_level,
        slope=POWER_SLOPE,
    )
    return PowerModel(load=fit.load, rmse_W=fit.rmse_W, r2=fit.r2, source=f"fitted to {fit.n_samples} steps")


def _splits(cases: Sequence[_Case], config: IdentificationConfig) -> list[Split]:
    """Last part of every run; all pairs of some start times (pairs of one start share their weather)."""
    starts = sorted({c.start_s for c in cases if c.episode.is_pair})
    held: set[float] = set()
    if len(starts) > 1:
        rng = np.random.default_rng(config.seed)
        count = max(1, min(len(starts) - 1, round(config.validation_share * len(starts))))
        held = {starts[i] for i in rng.permutation(len(starts))[:count]}
    splits = []
    for case in cases:
        if not case.episode.is_pair or len(starts) == 1:
            splits.append(split_run(case.episode, config.validation_share, config.horizon_h))
        else:
            splits.append(hold_out_pair(case.episode) if case.start_s in held else whole(case.episode))
    return splits


def _part(episode: Episode, rows: NDArray[np.intp]) -> Episode:
    """The first rows of an episode (rows are always a leading block, whose Cholesky factor is the leading block)."""
    n = rows.size
    return replace(episode, target=episode.target[:n], rows=episode.rows[:n], factor=episode.factor[:n, :n])


def _fit(
    cases: Sequence[_Case], splits: Sequence[Split], priors: ModePriors, config: IdentificationConfig, sign: int
) -> _Fitted:
    """Fit to the training rows, judge by the held-out rollouts."""
    training = [_part(c.episode, s.train) for c, s in zip(cases, splits, strict=True) if s.train.size]
    fit = fit_joint(training, priors, config, sign)
    judged, errors = [], []
    for case, split in zip(cases, splits, strict=True):
        if not split.judged.size:
            continue
        explained = residuals(case.episode, fit.log_tau)
        residual = case.episode.target - explained.mean - forced_columns(case.episode, fit.log_tau, sign) @ fit.gains
        after_action = split.judged[follows_action(case.episode, _AFTER_ACTION_H)[split.judged]]
        judged.append((explained.whitener() @ residual)[after_action])
        for past, ahead in split.rollouts:
            errors.append(explained.innovation(past, ahead) @ residual[np.concatenate([past, ahead])])
    rollout_rmse_K = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return _Fitted(fit, priors, np.concatenate(judged), rollout_rmse_K)


def _explained(cases: Sequence[_Case], fit: JointFit, sign: int) -> float:
    """Share of the whitened variance (of what neither weather nor drift explains) that the forced response removes."""
    before, after = 0.0, 0.0
    for case in cases:
        explained = residuals(case.episode, fit.log_tau)
        whitener = explained.whitener()
        residual = case.episode.target - explained.mean
        before += float(np.sum((whitener @ residual) ** 2))
        forced = forced_columns(case.episode, fit.log_tau, sign) @ fit.gains
        after += float(np.sum((whitener @ (residual - forced)) ** 2))
    return 1.0 - after / before


def _choose(candidates: dict[int, _Fitted]) -> int:
    """Highest order, unless a lower one predicts the held-out rows clearly and significantly better."""
    chosen = max(candidates)
    if candidates[chosen].judged.size < _LEAST_JUDGED:
        return chosen
    for order in sorted(candidates, reverse=True):
        gain = candidates[chosen].judged ** 2 - candidates[order].judged ** 2
        needed = max(
            _SIGNIFICANT * float(np.std(gain)) / np.sqrt(gain.size), _CLEARLY * float(candidates[chosen].score) ** 2
        )
        if float(np.mean(gain)) > needed:
            chosen = order
    return chosen


def _normalisation(histories: Sequence[History]) -> tuple[Array, Array]:
    """Mean and scale of the features over all steps with a measured temperature; the free one is set by `_features`."""
    stacked = np.concatenate(
        [
            feature_matrix(np.zeros(h.n_steps), h.T_out_C[:-1], h.solar_W_m2[:-1], h.time_s[:-1]).reshape(
                -1, N_FEATURES
            )
            for h in histories
        ]
    )
    return stacked.mean(axis=0), np.maximum(stacked.std(axis=0), _LEAST_SCALE)


def _features(operator: OperatorParameters, history: History, temperature: FeatureTemperature) -> Array:
    """x_t of each step of a run: T − F by the linear operator (F feeds no gradient), or T as it was measured."""
    forced = forced_history(operator, history).sum(axis=1) if temperature == "free" else 0.0
    free = history.T_zone_C - forced
    steps = np.arange(free.size)
    known = np.isfinite(free)
    free = np.interp(steps, steps[known], free[known])
    return feature_matrix(free[:-1], history.T_out_C[:-1], history.solar_W_m2[:-1], history.time_s[:-1])


def _modulate(
    cases: Sequence[_Case],
    splits: Sequence[Split],
    linear: Callable[[JointFit], OperatorParameters],
    part_fit: JointFit,
    final: JointFit,
    priors: ModePriors,
    config: IdentificationConfig,
) -> tuple[OperatorParameters, dict[str, float]]:
    """Train m(x) on part of the data to see whether it is worth it, then on all of it."""
    from thermoforce_mpc.identification.train import TrainingEpisode, train

    base = linear(final)
    features = [tuple(_features(base, h, config.features) for h in c.histories) for c in cases]
    free = np.concatenate([x[:, 0] for xs in features for x in xs])
    mean, scale = base.feature_mean.copy(), base.feature_scale.copy()
    mean[0], scale[0] = free.mean(), max(float(free.std()), float(_LEAST_SCALE[0]))

    def started(fit: JointFit) -> OperatorParameters:
        return replace(linear(fit), feature_mean=mean, feature_scale=scale)

    def episodes(fit: JointFit, chosen: Sequence[Split]) -> list[TrainingEpisode]:
        return [
            TrainingEpisode(e, x, residuals(e, fit.log_tau), s)
            for e, x, s in zip(calibrated([c.episode for c in cases], fit.misfit), features, chosen, strict=True)
        ]

    def known(fit: JointFit) -> ModePriors:
        # A run's slow gain was found under disturbances taken for large: the network's closer look must not undo it.
        if all(c.episode.is_pair for c in cases):
            return priors
        return centred_priors(priors, fit.log_tau, fit.gains, _LINEAR_HELD_SD)

    search = train(started(part_fit), episodes(part_fit, splits), known(part_fit), config)
    scores = {
        "held_out_linear": search.linear_score,
        "held_out_neural": search.score,
        "neural_improvement_in_standard_errors": search.improvement_in_standard_errors,
    }
    judged_h = sum(_hours(c.episode, s.judged) for c, s in zip(cases, splits, strict=True))
    scores["modulation_kept"] = float(search.worth_it and judged_h >= _LEAST_JUDGED_H)
    if not scores["modulation_kept"]:
        return replace(started(final), feature_temperature=config.features), scores
    everything = [whole(c.episode) for c in cases]
    # Trained on measured temperatures as features, so nothing recurs; in use the predicted one takes their place.
    trained = train(started(final), episodes(final, everything), known(final), config).operator
    return replace(trained, feature_temperature=config.features), scores


def _hours(episode: Episode, rows: NDArray[np.intp]) -> float:
    """Time that these compared rows stand for, h."""
    return rows.size * (episode.n_steps / max(1, episode.rows.size)) * episode.step_s / HOUR_S


def _prove(operator: OperatorParameters) -> None:
    """Refuse an operator whose effect has no proven sign: only `features: total` can lead to one."""
    proof = certificate(operator)
    if not proof.certified:
        raise DataError(f"the identified operator is not certified: {'; '.join(proof.reasons)}")


def _ranges(histories: Sequence[History]) -> dict[str, tuple[float, float]]:
    out = {}
    for name in ("T_zone_C", "T_out_C", "solar_W_m2", "u"):
        values = np.concatenate([getattr(h, name) for h in histories])
        out[name] = (float(np.nanmin(values)), float(np.nanmax(values)))
    out["days"] = (0.0, sum(h.n_steps * h.step_s for h in histories) / (24 * HOUR_S))
    return out


def _named(names: Sequence[str], runs: Sequence[History], pairs: Sequence[Pair]) -> list[tuple[str, History]]:
    named = list(zip(names, runs, strict=True))
    for i, pair in enumerate(pairs):
        label = pair.label or str(i)
        named += [(f"pair {label} a", pair.a), (f"pair {label} b", pair.b)]
    return named
