"""Verdict on an identified model from its held-out data, and the bar to reach (docs/how-it-works/competence.md).

The fit to the training rows predicts the held-out rows 1, 6 and 24 h ahead with known weather, from every row that far
before them. Whether it predicts better than something simpler is a test, and one held-out part is short for it: an
earlier part, predicted by a fit to what came before that, counts as well. The free part is predicted as in
`likelihood`: given the temperatures until the start, its gains and initial state are conditioned on them. The same is
done without the actuator, with disturbances and time constants chosen anew on the training rows, so that the comparison
is fair. All innovations of all starts come from one Cholesky factor: with C = L Lᵀ and w = L⁻¹ r, the part of r_j that
the rows before i do not predict is Σ_{k=i…j} L_jk w_k.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student_t

from thermoforce_mpc.data import HOUR_S, Array, Record
from thermoforce_mpc.identification.estimation.columns import forced_columns
from thermoforce_mpc.identification.estimation.joint import ModeFit
from thermoforce_mpc.identification.estimation.likelihood import Split, residuals
from thermoforce_mpc.identification.estimation.modes import ModePriors
from thermoforce_mpc.identification.estimation.records import LEAD_REACH
from thermoforce_mpc.identification.validation.blocks import standard_errors_saved
from thermoforce_mpc.identification.validation.held_out import Case
from thermoforce_mpc.model.competence import Competence, HorizonScore

# Lead times that are reported, h, and those that are judged. A plan is made anew every step and pre-heats by hours; a
# day ahead the daily cycle makes persistence good and the weather decides, so that one is reported only.
LEAD_TIMES_H = (1.0, 6.0, 24.0)
JUDGED_H = (1.0, 6.0)
# Largest RMSE by lead time, K. The comfort guard acts 1 K outside the band: a plan that errs by more within the hours
# of a pre-heating is not the one that decides. One step ahead half of it must hold.
MOST_ERROR_K = {1.0: 0.5, 6.0: 1.0}
# The error may exceed that of persistence by this factor, or by more if that may be chance (Student's t, one-sided, at
# this probability): a quiet day held out makes persistence good.
MOST_OVER_PERSISTENCE, WORSE_PROBABILITY = 1.1, 0.95
# The same for being better than the weather alone at one of the judged lead times. Below, what the action does was not
# seen. Of actuators that do nothing, hardly one comes to this test (`python -m benchmarks.zones.placebo`): the odds
# that they act stop them. At 95 % it would stop rooms that need little heat.
BETTER_PROBABILITY = 0.9
# Largest relative standard deviation of the effect of eight hours at full level, the length of a pre-heating; plans of
# later steps correct what comes later. At 0.43 the sign is certain to 99 %; at 0.4 the 90 % interval is a third to five
# thirds of what was planned, which re-planning still corrects.
MOST_RELATIVE_SD = 0.4
EFFECT_H = 8
# Probing ends early at this relative standard deviation, of which 0.05 are what a few nodes are not. It is less than
# what three days of probing give on the heat pump test case (0.07), so that they stay three days there.
WELL_KNOWN_SD = 0.06
# Probing goes on beyond the configured days while it is larger than this: a model that may act is still a poor
# one, and another day of probing is cheap beside a season of its plans.
SETTLED_SD = 0.3
# Blocks of the paired test, h; a short held-out part is divided into this many at least.
_BLOCK_H, _LEAST_BLOCKS = 4.0, 4
# Sizes of the disturbances tried, as a share of the assumed ones.
_SCALES = tuple(np.geomspace(0.03, 2.0, 6).tolist())
# Most extra hours that are advised; beyond, more of the same data is not the answer.
_MOST_ADVISED_H = 30.0 * 24.0
# Below this share of the t statistic needed, more data are not expected to show an effect.
_HOPELESS = 0.25
_NO_EFFECT = (
    "more of the same data will not show an effect: check that the zone sensor is in the room that the actuator "
    "serves, that u is the applied level, and that the mode (heating or cooling) is right"
)
_DARK = "the record has no irradiance: name a signal for the sun"
_OFTENER = "measure the zone temperature without long gaps, in steps that divide an hour"
# Level from which full actuation counts as seen.
_NEARLY_FULL = 0.9
# Correlation of the errors with the sun from which it is named as their cause.
_SUN_CORRELATION = 0.5


@dataclass(frozen=True)
class Fold:
    """A fit, and what it has not seen: `cases` with their `splits`; only runs are judged."""

    cases: Sequence[Case]
    splits: Sequence[Split]
    fit: ModeFit

    @property
    def runs(self) -> list[tuple[Case, Split]]:
        """Runs with held-out rows."""
        return _held_out_runs(self.cases, self.splits)


@dataclass(frozen=True)
class HeldOutErrors:
    """Held-out errors of one lead time, run by run: of model, weather alone and persistence, (n,) each, K.

    `blocks` (n,): block numbers; `solar` (n,): mean irradiance over the lead time, W/m².
    """

    model: Array
    weather: Array
    persistence: Array
    blocks: NDArray[np.intp]
    solar: Array

    @classmethod
    def joined(cls, parts: Sequence[HeldOutErrors]) -> HeldOutErrors:
        """Errors of several parts, one after another."""
        return cls(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls)))


def held_out_h(cases: Sequence[Case], splits: Sequence[Split]) -> float:
    """Return the held-out hours of runs."""
    return sum(
        _span_h(case.regression.rows[int(split.judged[0]) :], case.regression.step_s)
        for case, split in _held_out_runs(cases, splits)
    )


def _held_out_runs(cases: Sequence[Case], splits: Sequence[Split]) -> list[tuple[Case, Split]]:
    """Runs with held-out rows."""
    return [(c, s) for c, s in zip(cases, splits, strict=True) if not c.regression.is_pair and s.judged.size]


def judge(
    fold: Fold,
    earlier: Fold,
    priors: ModePriors,
    uncertainty: dict[str, float],
    log_odds: float,
    sign: int,
    *,
    own_loops: bool = False,
) -> Competence | None:
    """Return the verdict on a model, None where there is no run to judge it on (pairs only).

    Args:
        fold: fit to all but the last rows, which give the errors in K.
        earlier: fit to a part of these rows, tested on the rest of them (`held_out_fit.earlier_fold`).
        priors: those of that fit.
        uncertainty: standard deviations of the final fit, see `identification.uncertainty`.
        log_odds: that the actuator acts, see `network.estimate.RoomFit.gained`.
        sign: +1 heating, −1 cooling.
        own_loops: whether the plant's own loops keep the comfort band, so that a wrong prediction costs energy only.
    """
    if not fold.runs:
        return None
    hours_held_out = held_out_h(fold.cases, fold.splits)
    block_h = min(_BLOCK_H, hours_held_out / _LEAST_BLOCKS)
    last = _errors_of(fold, priors, sign, block_h)
    before = _errors_of(earlier, priors, sign, block_h, number=len(fold.runs))
    effect, sd = (uncertainty[f"step_response_{EFFECT_H}h{what}_K"] for what in ("", "_sd"))
    verdict = Competence(
        competent=True,
        horizons=tuple(_score(hours, last[hours], before[hours]) for hours in LEAD_TIMES_H),
        effect_K=sign * effect,
        effect_sd_K=sd,
        sign_probability=float(norm.cdf(effect / sd)) if sd > 0 else 1.0,
        log_odds=log_odds,
        held_out_h=hours_held_out,
    )
    most_K = dict.fromkeys(JUDGED_H, math.inf) if own_loops else MOST_ERROR_K
    reasons, advice = missed_criteria(verdict, last, [case.histories[0] for case, _ in fold.runs], most_K)
    return replace(verdict, competent=not reasons, reasons=reasons, advice=advice)


def is_settled(verdict: Competence | None) -> bool:
    """Whether probing need not go on: competent, and the effect is known to 30 %; or not judged."""
    return verdict is None or (verdict.competent and verdict.relative_sd <= SETTLED_SD)


def is_well_known(verdict: Competence | None) -> bool:
    """Return whether probing may end before the configured days are over."""
    return verdict is not None and verdict.competent and verdict.relative_sd <= WELL_KNOWN_SD


@dataclass(frozen=True)
class _Innovations:
    """w (m,) and L (m, m) of the rows from `begin` on, in standard deviations and K."""

    begin: int
    white: Array
    factor: Array

    def ahead(self, starts: NDArray[np.intp], targets: NDArray[np.intp]) -> Array:
        """Errors (n,) of the predictions from `starts`, `begin` - 1 or later, to `targets`, K."""
        rows = zip(starts + 1 - self.begin, targets - self.begin, strict=True)
        return np.array([self.factor[j, i : j + 1] @ self.white[i : j + 1] for i, j in rows])


def _innovations(
    runs: Sequence[tuple[Case, Split]], effects: Sequence[Array], choices: Sequence[Array], leads_h: Sequence[float]
) -> list[_Innovations]:
    """Return what predictions of these lead times need of every run, with the likeliest disturbances and modes.

    Likeliest on the training rows, those before the held-out ones; `effects` (rows,) K are what the actions did. The
    size of the disturbances is chosen with the first of the time constants `choices`, which then compete at that size.
    """
    regressions, first = [c.regression for c, _ in runs], [int(s.judged[0]) for _, s in runs]
    rests = [[residuals(e, log_tau) for e in regressions] for log_tau in choices]
    left = [
        [e.target - effect - rest.mean for e, effect, rest in zip(regressions, effects, of_choice, strict=True)]
        for of_choice in rests
    ]

    def likelihoods(choice: int, scales: Sequence[float]) -> Array:
        of_runs = zip(rests[choice], left[choice], first, strict=True)
        return np.asarray(np.sum([rest.log_likelihoods(values, n, scales) for rest, values, n in of_runs], axis=0))

    scale = _SCALES[int(np.argmax(likelihoods(0, _SCALES)))]
    likeliest = int(np.argmax([likelihoods(choice, [scale])[0] for choice in range(len(choices))]))
    innovations = []
    for (case, _), n, rest, values in zip(runs, first, rests[likeliest], left[likeliest], strict=True):
        begin = 1 + min(int(np.min(_held_out(case, n, hours)[0], initial=n - 1)) for hours in leads_h)
        innovations.append(_Innovations(begin, *rest.scaled(scale).later(values, begin)))
    return innovations


def _errors_of(
    fold: Fold, priors: ModePriors, sign: int, block_h: float, number: int = 0
) -> dict[float, HeldOutErrors]:
    """Held-out errors of a fold by lead time; blocks of its runs are numbered from run `number` on."""
    runs = fold.runs
    regressions, first = [c.regression for c, _ in runs], [int(s.judged[0]) for _, s in runs]
    effects = [forced_columns(e, fold.fit.log_tau, sign) @ fold.fit.gains for e in regressions]
    none = [np.zeros(e.rows.size) for e in regressions]
    model = _innovations(runs, effects, [fold.fit.log_tau], LEAD_TIMES_H)
    weather = _innovations(runs, none, [fold.fit.log_tau, priors.log_tau], LEAD_TIMES_H)
    return {
        hours: HeldOutErrors.joined(
            [
                _errors(number + i, case, model[i], weather[i], first[i], hours, block_h)
                for i, (case, _) in enumerate(runs)
            ]
        )
        for hours in LEAD_TIMES_H
    }


def _errors(
    number: int,
    case: Case,
    model: _Innovations,
    weather: _Innovations,
    first: int,
    hours: float,
    block_h: float,
) -> HeldOutErrors:
    """Errors at held-out rows, each predicted from the last row `hours` or more before it."""
    regression, solar = case.regression, case.histories[0].solar_W_m2
    starts, targets = _held_out(case, first, hours)
    rows = regression.rows
    at = rows * regression.step_s / HOUR_S
    sun = np.array([solar[rows[i] : rows[j] + 1].mean() for i, j in zip(starts, targets, strict=True)])
    blocks = number * 10**6 + ((at[targets] - at[first]) // block_h).astype(np.intp)
    persistence = regression.target[targets] - regression.target[starts]
    predicted, alone = model.ahead(starts, targets), weather.ahead(starts, targets)
    return HeldOutErrors(predicted, alone, persistence, np.asarray(blocks, dtype=np.intp), sun)


def _held_out(case: Case, first: int, hours: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Starts and targets (n,) of the predictions `hours` ahead of the rows from `first` on."""
    at = case.regression.rows * case.regression.step_s / HOUR_S
    starts = np.searchsorted(at, at[first:] - hours + 1e-9, side="right") - 1
    targets = np.arange(first, at.size)
    # Where the sensor was silent there may be no row that far before: such a target is left out.
    near = (starts >= 0) & (at[targets] - at[np.maximum(starts, 0)] <= LEAD_REACH * hours + 1e-9)
    return starts[near], targets[near]


def _score(hours: float, errors: HeldOutErrors, before: HeldOutErrors) -> HorizonScore:
    """RMSE of the errors; tests of these and of those `before` together."""

    def rmse(values: Array) -> float:
        return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")

    both = HeldOutErrors.joined([errors, before])
    better_t, blocks, still_t = float("nan"), 0, float("nan")
    if both.model.size:
        better_t, blocks = standard_errors_saved(both.weather, both.model, both.blocks)
        still_t = standard_errors_saved(both.model, both.persistence, both.blocks)[0]
    return HorizonScore(
        hours, rmse(errors.model), rmse(errors.persistence), rmse(errors.weather), better_t, blocks, still_t
    )


def missed_criteria(
    verdict: Competence, errors: dict[float, HeldOutErrors], records: Sequence[Record], most_K: Mapping[float, float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the criteria that are missed, and what to do about them."""
    reasons, advice = [], []
    longer = 1.0  # factor on the length of the record
    scores = []
    for score in verdict.horizons:
        if score.hours not in JUDGED_H:
            continue
        if np.isfinite(score.model_K):
            scores.append(score)
            continue
        reasons.append(
            f"{score.hours:g} h ahead it cannot be judged: no held-out temperature has another {score.hours:g} to "
            f"{LEAD_REACH * score.hours:g} h before it"
        )
        advice.append(_OFTENER)
    if not verdict.relative_sd <= MOST_RELATIVE_SD:
        percent = _above(100 * MOST_RELATIVE_SD, 100 * verdict.relative_sd, 0)
        need = f"{100 * MOST_RELATIVE_SD:.0f} %"
        reasons.append(f"the effect of 8 h at full level is known to ± {percent} % only, need {need}")
        longer = (verdict.relative_sd / MOST_RELATIVE_SD) ** 2
        advice += [_levels(records), *([_DARK] if _dark(records) else [])]
    for score in scores:
        off = f"{score.hours:g} h ahead it errs by {score.model_K:.2f} K"
        if not score.model_K <= most_K[score.hours]:
            off_K, need_K = _above(most_K[score.hours], score.model_K, 2), most_K[score.hours]
            reasons.append(f"{score.hours:g} h ahead it errs by {off_K} K, need {need_K:g} K")
            advice.append(_signals(errors[score.hours], records))
        worse = score.persistence_t > float(student_t.ppf(WORSE_PROBABILITY, max(score.blocks - 1, 1)))
        if worse and not score.model_K <= MOST_OVER_PERSISTENCE * score.persistence_K:
            reasons.append(f"{off}, an unchanged temperature by {score.persistence_K:.2f} K")
            advice.append(_signals(errors[score.hours], records))
    needs = [float(student_t.ppf(BETTER_PROBABILITY, max(score.blocks - 1, 1))) for score in scores]
    if scores and not any(score.better_t > need for score, need in zip(scores, needs, strict=True)):
        each = " and ".join(
            f"{score.hours:g} h ahead {score.model_K:.2f} K against {score.weather_K:.2f} K, t = {score.better_t:.1f}, "
            f"need {need:.1f}"
            for score, need in zip(scores, needs, strict=True)
        )
        reasons.append(f"it is not shown to predict better than the weather alone: {each}")
        share = max(np.nan_to_num(score.better_t) / need for score, need in zip(scores, needs, strict=True))
        if share < _HOPELESS:
            advice.append(_NO_EFFECT)
        else:
            longer = max(longer, share**-2.0)
    if longer > 1.0 and _NO_EFFECT not in advice:
        advice.append(_more(sum(r.n_steps * r.step_s for r in records) / HOUR_S, longer))
    return tuple(reasons), tuple(dict.fromkeys(advice))


def _above(most: float, value: float, decimals: int) -> str:
    """A value above `most`, rounded; up where it would read as if it were not."""
    rounded = f"{value:.{decimals}f}"
    return f"{np.ceil(value * 10**decimals) / 10**decimals:.{decimals}f}" if float(rounded) <= most else rounded


def _more(hours: float, factor: float) -> str:
    """Advice on hours: variances fall, and t² rises, with the length of the record."""
    more_h = hours * (factor - 1.0)
    if more_h > _MOST_ADVISED_H:
        return "more of the same data is not enough: excite harder, or add the missing signal"
    return f"probe about {max(6.0, math.ceil(more_h / 6.0) * 6.0):g} hours more"


def _dark(records: Sequence[Record]) -> bool:
    """Whether no record has irradiance."""
    return all(not np.any(r.solar_W_m2) for r in records)


def _levels(records: Sequence[Record]) -> str:
    """Advice on levels."""
    highest = max(float(np.max(r.u[0])) for r in records)
    if highest < _NEARLY_FULL:
        return f"the highest level was {highest:.2g}: probe full level too"
    return "hold full level and off for 4 hours or longer at times, as far as comfort allows: the slow part shows then"


def _signals(errors: HeldOutErrors, records: Sequence[Record]) -> str:
    """Advice on signals, from what the errors go with."""
    if _dark(records):
        return _DARK
    if errors.model.size > 2 and np.std(errors.solar) > 0 and np.std(errors.model) > 0:
        together = float(np.corrcoef(errors.model, errors.solar)[0, 1])
        if abs(together) >= _SUN_CORRELATION:
            return (
                "the errors go with the sun: probe over more days with different sun, or measure the irradiance that "
                "reaches the windows"
            )
    return (
        "the zone moves with something that the record does not hold: look for a signal of other heat sources, windows "
        "or a second actuator, and check the zone sensor; a light zone needs shorter and smaller actions"
    )


def _span_h(rows: NDArray[np.intp], step_s: float) -> float:
    return float(rows[-1] - rows[0]) * step_s / HOUR_S
