"""`tf-mpc bench detectors`: what each rule claims of clean plants and what that costs, what it finds and saves.

Each house-week is probed, identified and controlled with all defaults. Where a rule claimed something, and on the
plants with the fault that it is for, the week is run again without it: the difference is what it cost or saved. Comfort
counts as the controller counts it, so that cost and discomfort are one figure.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.cases import revision, run_all
from benchmarks.detectors.panel import BuiltCase, PanelCase, built, clean, faulty
from benchmarks.detectors.rules import RULES, ControlledWeek, Detector
from controllers.mpc.config import ObjectiveConfig
from controllers.registry import build_controller
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import DataError, InputError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.identifying import chosen_of, identification_settings, identify_on
from thermoforce_mpc.files import parse_json
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.inputs import UnitDoubts
from thermoforce_mpc.model.screening import limits_of
from thermoforce_mpc.plants.rooms.house import DrawnHouse
from thermoforce_mpc.scenario.scenario import Scenario

_CONTROLLER = "thermoforce_mpc"
_DAYS, _PROBED_DAYS = 7.0, 3.0
# House-weeks of clean plants, plants with each fault, and seed, where nothing else is asked for.
_WEEKS, _FAULTS, _SEED = 200, 4, 62
# Goals: false claims in 100 house-weeks; what a rule saves on the faults it is for, less what it costs on the panel.
_MOST_CLAIMS, _LEAST_BALANCE = 1.0, 0.0
# How many times as late as it is a sensor may be said to be.
_LATER = 2.0
# How certain the interval is in which the rate of false claims lies.
_CERTAIN = 0.95
# What is told of a comparison with an earlier run: share of the cost, and K·h.
_DEARER, _COLDER_KH = 0.003, 0.1

Row = dict[str, Any]


@dataclass(frozen=True)
class WeekOutcome:
    """A house-week: `cost` per m² and discomfort `K_h`, steps not planned, claims by rule, and the week without a rule.

    `without`: (cost, K·h) by rule; `failed`: the reason where there is one.
    """

    case: PanelCase
    cost: float = float("nan")
    K_h: float = float("nan")
    not_planned: int = 0
    claims: Mapping[str, Sequence[str]] = field(default_factory=dict)
    without: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    failed: str = ""
    seconds: float = 0.0

    def worth_without(self, rule: str) -> float:
        """How much less the week would have cost without `rule`, discomfort as the controller counts it, per m²."""
        cost, K_h = self.without.get(rule, (self.cost, self.K_h))
        return (self.cost - cost) + ObjectiveConfig().comfort_weight_per_m2 * (self.K_h - K_h)


def rule_of(fault: str) -> str:
    """The rule that a fault of the panel is for."""
    return re.split(r", | of a unit", fault)[0]


def run_detectors_bench(
    *,
    weeks: int | None = None,
    faults: int | None = None,
    seed: int | None = None,
    only: Sequence[str] = (),
    engine: Engine,
    quick: bool = False,
    against: Path | None = None,
    keep: Path | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run the panel.

    Args:
        weeks: house-weeks of clean plants, the kinds in turn; None: 200, or with `only` none.
        faults: plants with each fault; None: 4.
        seed: of the plants that are drawn; None: 62. With `against` and none of the three: the weeks of
            that run, and those of one plant of each fault (`faulty`) that it lacks, where it has any.
        only: faults whose names begin so; none: all of them.
        engine: where they are run; the result does not depend on it.
        quick: one house-week of each of two kinds, and one fault.
        against: JSON of an earlier run, to compare the weeks that both have: same kind, number, seed and fault.
        keep: folder in which finished weeks are kept, so that a run that was cut off goes on.
        progress: callback for progress lines.

    Raises:
        InputError: no house-weeks, no fault is named as `only` says, `against` is no JSON of this bench, or none of its
            weeks is among those asked for.
    """
    before = _earlier(against) if against else {}
    if before and not quick and not only and (weeks, faults, seed) == (None, None, None):
        cases = _again(list(before))
    else:
        cases = _asked_for(weeks, faults, _SEED if seed is None else seed, only, quick)
    if against and not before.keys() & set(cases):
        raise InputError(
            f"{against}: has none of the weeks asked for, such as '{cases[0].in_words}' (its first is "
            f"'{next(iter(before)).in_words}'); without weeks, faults and seed its own are run"
        )

    def on_done(n: int, value: Mapping[str, Any]) -> None:
        progress(f"[{n}/{len(cases)}] {_line(_outcome(value))}")

    outcomes = [_outcome(value) for value in run_all(run_case, cases, engine, on_done, keep)]
    told = rule_rows(outcomes) + claim_rows(outcomes) + fault_rows(outcomes)
    rows = told + [_row(one) for one in outcomes] + _compared(outcomes, before)
    result = results_json("detectors", rows, targets(outcomes))
    result["environment"] |= {"revision": revision()}
    return result


def _again(kept: list[PanelCase]) -> list[PanelCase]:
    """The weeks of an earlier run, and where that has faults those with one plant of each that it lacks."""
    has_faults = any(case.fault for case in kept)
    return kept + [case for case in faulty(1, kept[0].seed) if has_faults and case not in kept]


def _asked_for(weeks: int | None, faults: int | None, seed: int, only: Sequence[str], quick: bool) -> list[PanelCase]:
    if quick:
        return clean(2, seed) + faulty(1, seed)[-1:]
    n = (0 if only else _WEEKS) if weeks is None else weeks
    cases = clean(n, seed) + faulty(_FAULTS if faults is None else faults, seed, only)
    if not cases:
        raise InputError("neither house-weeks of clean plants nor of faults: expected one at least")
    return cases


def run_case(case: PanelCase) -> dict[str, Any]:
    """One house-week as JSON, see `WeekOutcome`; a failure is recorded."""
    began = time.perf_counter()
    try:
        place = built(case)
        with closing(place.plant):
            outcome = house_week(case, replace(place, period=replace(place.period, scored_s=_DAYS * DAY_S)))
    except Exception as error:  # recorded as failure of this case; the others continue
        outcome = WeekOutcome(case, failed=f"{type(error).__name__}: {error}")
    return asdict(replace(outcome, seconds=time.perf_counter() - began))


def house_week(case: PanelCase, place: BuiltCase) -> WeekOutcome:
    """The week of a built case, and again without each rule that claimed something or is for its fault."""
    ran = follow(place, None)
    claims = {rule.name: found for rule in RULES if (found := rule.claims(ran))}
    if place.fixed and not case.fault:
        claims.pop("fixed part", None)
    if not case.fault and ran.claimed_lag_s() <= _LATER * place.late_s:
        claims.pop("late sensor", None)
    house = getattr(place.plant, "house", None)
    if not case.fault and isinstance(house, DrawnHouse) and ran.gave_all(house):
        claims.pop("shared machine at its limit", None)
    # What acts in `live` alone acts on the plants of its fault alone.
    costs = [rule for rule in RULES if rule.can_be_off and rule.name in claims and not rule.live]
    again = [rule for rule in RULES if rule.can_be_off and (rule in costs or rule.name == rule_of(case.fault))]
    without = {rule.name: _figures(follow(place, rule)) for rule in again}
    cost, K_h = _figures(ran)
    idle = sum(not step.plan.u.size for step in ran.result.steps)
    return without_right_claims(WeekOutcome(case, cost, K_h, idle, claims, without))


def without_right_claims(outcome: WeekOutcome) -> WeekOutcome:
    """The week of a clean plant without claims of rules that act on what is read, unless it is the worse for them."""
    right = {
        rule.name
        for rule in RULES
        if rule.on_readings and rule.name in outcome.without and outcome.worth_without(rule.name) <= 0.0
    }
    if outcome.case.fault or not right:
        return outcome
    return replace(outcome, claims={name: said for name, said in outcome.claims.items() if name not in right})


def follow(place: BuiltCase, without: Detector | None) -> ControlledWeek:
    """The week of a plant, probed and controlled with the defaults, without one rule."""
    testcase = place.testcase
    identification = dict(without.identification) if without else {}
    options = dict(without.options(testcase.layout)) if without else {}
    scenario = Scenario(testcase=testcase.name)
    spec = scenario.identification
    probing, config = identification_settings(scenario, chosen_of(scenario, testcase, _CONTROLLER))
    model: Any
    try:
        model = identify_on(
            place.plant,
            before=place.period,
            days=_PROBED_DAYS,
            most_days=spec.most_days,
            end_early=spec.end_early,
            testcase=testcase,
            seed=scenario.seed,
            probing=probing,
            config=config.model_copy(update=identification),
        )
    except DataError as error:
        model = str(error)
    controller = place.acts(build_controller(_CONTROLLER, options, testcase, model), without.name if without else "")
    units = UnitDoubts(testcase.layout, model, testcase.currency)
    allowed = limits_of(controller, sum(testcase.layout.floor_area_m2))
    result = run_closed_loop(place.plant, controller, place.period, allowed=allowed, units=units)
    doubts = dict.fromkeys(note for step in result.steps for note in step.notes if note.startswith("unit of"))
    return ControlledWeek(model, result, tuple(doubts), getattr(controller, "actuation_in_words", ""))


def rule_rows(outcomes: Sequence[WeekOutcome]) -> list[Row]:
    """A row for each rule: claims on clean plants and what they cost; hits on its faults, and what it saved there."""
    rows = []
    weeks = [one for one in outcomes if not one.case.fault and not one.failed]
    for rule in RULES:
        claimed = [one for one in weeks if rule.name in one.claims]
        faults = [one for one in outcomes if one.case.fault and rule_of(one.case.fault) == rule.name and not one.failed]
        cost = sum(one.worth_without(rule.name) for one in claimed)
        saved = 0.0 - sum(one.worth_without(rule.name) for one in faults)  # not -0.0 where there is nothing
        rows.append(
            {
                "rule": rule.name,
                "changes": rule.changes,
                "house-weeks": len(weeks),
                "with a false claim": len(claimed),
                "in 100 house-weeks": 100.0 * len(claimed) / len(weeks) if weeks else float("nan"),
                **_certainty(len(claimed), len(weeks)),
                "they cost per m²": cost if rule.can_be_off and not rule.live else None,
                "faults": len(faults),
                "found": sum(rule.name in one.claims for one in faults),
                "saved there per m²": saved if rule.can_be_off and faults else None,
            }
        )
    return rows


def _certainty(claimed: int, weeks: int) -> Row:
    """Between what the rate of false claims in 100 house-weeks lies, and whether that shows that the goal is met."""
    from scipy.stats import binomtest

    if not weeks:
        return {"95 % between": "–", "goal": "not shown"}
    # The interval that holds for any rate (Clopper and Pearson 1934): of few weeks without a claim little follows.
    found = binomtest(claimed, weeks).proportion_ci(_CERTAIN, method="exact")
    low, high = 100.0 * found.low, 100.0 * found.high
    shown = "met" if high <= _MOST_CLAIMS else "missed" if low > _MOST_CLAIMS else "not shown"
    return {"95 % between": f"{low:.1f} and {high:.1f}", "goal": shown}


def claim_rows(outcomes: Sequence[WeekOutcome]) -> list[Row]:
    """A row for each rule that claimed something in a week of a clean plant: what it said, and what that cost."""
    return [
        {
            "false claim": rule,
            "in": one.case.in_words,
            "said": texts[0],
            **_both_ways(one, rule),
            "it cost per m²": one.worth_without(rule) if rule in one.without else None,
        }
        for one in outcomes
        if not one.case.fault and not one.failed
        for rule, texts in one.claims.items()
    ]


def fault_rows(outcomes: Sequence[WeekOutcome]) -> list[Row]:
    """A row for each week of a plant with a fault: whether its rule found it, and what that saved."""
    return [
        {
            "fault": one.case.in_words,
            "found": "yes" if rule in one.claims else "no",
            **_both_ways(one, rule),
            "it saved per m²": -one.worth_without(rule) if rule in one.without else None,
        }
        for one in outcomes
        if one.case.fault and not one.failed
        for rule in (rule_of(one.case.fault),)
    ]


def _both_ways(one: WeekOutcome, rule: str) -> Row:
    """Cost per m² and K·h of a week with a rule and without it."""
    without = "{:.4f} / {:.2f}".format(*one.without[rule]) if rule in one.without else "–"
    return {"with it": f"{one.cost:.4f} / {one.K_h:.2f}", "without": without}


def targets(outcomes: Sequence[WeekOutcome]) -> list[Target]:
    """Few false claims, and no rule that costs more a week of the panel than it saves a week with its fault."""
    found = [Target("house-weeks that failed", float(sum(bool(one.failed) for one in outcomes)), 0.0)]
    for row in rule_rows(outcomes):
        found.append(Target(f"{row['rule']}: false claims in 100 house-weeks", row["in 100 house-weeks"], _MOST_CLAIMS))
        if row["saved there per m²"] is not None:
            a_week = (row["they cost per m²"] or 0.0) / max(row["house-weeks"], 1)
            balance, name = (
                row["saved there per m²"] / row["faults"] - a_week,
                f"{row['rule']}: saved less cost, a week",
            )
            found.append(Target(name, balance, _LEAST_BALANCE, "at least"))
    return found


def _figures(ran: ControlledWeek) -> tuple[float, float]:
    return float(ran.result.kpis["cost_tot"]), float(ran.result.kpis["tdis_tot"])


def _outcome(value: Mapping[str, Any]) -> WeekOutcome:
    without = {name: (pair[0], pair[1]) for name, pair in value["without"].items()}
    return WeekOutcome(**{**value, "case": PanelCase(**value["case"]), "without": without})


def _row(one: WeekOutcome) -> Row:
    told = [f"{rule}: {texts[0]}" for rule, texts in one.claims.items()]
    changed = [f"{rule} {cost:.4f} / {K_h:.2f}" for rule, (cost, K_h) in one.without.items()]
    return {
        "week": one.case.in_words,
        "cost": one.cost,
        "K_h": one.K_h,
        "not planned": one.not_planned,
        "claims": "; ".join(told) or one.failed,
        "without": "; ".join(changed),
    }


def _line(one: WeekOutcome) -> str:
    said = f"{one.cost:.4f} / {one.K_h:.2f}" if not one.failed else f"FAILED, {one.failed}"
    claims = f", claims: {', '.join(one.claims)}" if one.claims else ""
    return f"{one.case.in_words}, {one.seconds:.0f} s: {said}{claims}"


def _earlier(path: Path) -> dict[PanelCase, Row]:
    """The weeks of an earlier result that did not fail, by case."""
    rows = parse_json(path.read_bytes(), str(path), InputError).get("rows", [])
    weeks = [row for row in rows if isinstance(row, dict) and row.get("week") and row.get("cost") is not None]
    if not weeks:
        raise InputError(f"{path}: holds no weeks of bench detectors; give the file of its --json")
    try:
        return {PanelCase.named(row["week"]): row for row in weeks}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _compared(outcomes: Sequence[WeekOutcome], before: Mapping[PanelCase, Row]) -> list[Row]:
    """How many weeks were compared, and those that are dearer or less comfortable than before by more than noise, have
    more steps without a plan, or fail.
    """
    both = [(one, before[one.case]) for one in outcomes if one.case in before]
    if not both:
        return []
    worse = [row for one, then in both if (row := _worse(one, then))]
    ran = [(one, then) for one, then in both if not one.failed]
    total = {
        "weeks of both": len(both),
        "worse": len(worse),
        "then": f"{sum(then['cost'] for _, then in ran):.4f} / {sum(then['K_h'] for _, then in ran):.2f}",
        "now": f"{sum(one.cost for one, _ in ran):.4f} / {sum(one.K_h for one, _ in ran):.2f}",
    }
    return [*worse, total]


def _worse(one: WeekOutcome, then: Row) -> Row | None:
    dearer, colder = one.cost / max(then["cost"], 1e-9) - 1.0, one.K_h - then["K_h"]
    idle = one.not_planned - (then.get("not planned") or 0)
    if not (one.failed or dearer > _DEARER or colder > _COLDER_KH or idle > 0):
        return None
    return {
        "worse than before": one.case.in_words,
        "then": f"{then['cost']:.4f} / {then['K_h']:.2f}",
        "now": f"failed: {one.failed}" if one.failed else f"{one.cost:.4f} / {one.K_h:.2f}",
        "dearer": "–" if one.failed else f"{dearer:+.1%}",
        "steps not planned": "–" if one.failed else f"{idle:+d}",
    }
