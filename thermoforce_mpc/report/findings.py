"""What came out of a run, in figures and words: its planning, its power cap, gate and watch, and a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from itertools import groupby
from math import inf, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, PlanStatus, steps_in
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.clock import words_of
from thermoforce_mpc.data.plan import NOT_ECONOMICAL, UNDECIDED
from thermoforce_mpc.errors import counted
from thermoforce_mpc.loop.closed_loop import RunResult, StepRecord
from thermoforce_mpc.plants.kpis import PEAK_WINDOW_S, window_means
from thermoforce_mpc.scenario.scenario import Scenario

if TYPE_CHECKING:
    from thermoforce_mpc.model.thermal_model import ThermalModel


COST, DISCOMFORT = "cost_tot", "tdis_tot"
"""KPIs by which runs are judged: cost, currency/m², and discomfort, K·h a zone."""
# Comparable comfort: at most so many times the least discomfort of the group, or so much more, K·h.
_COMPARABLE, _COMPARABLE_KH = 2.0, 0.5
# Share of the steps from which accepted discomfort is told, and how far beyond a bound a zone is planned then, K: what
# only takes from a margin is none.
_WORTH_TELLING, _NOTICED_K = 0.01, 0.05
# Steps without a decision from which they are told.
_A_FEW = 3
# Hours ahead in which accepted discomfort counts.
_SOON_H = 6.0
# What was solved and by whom, by the first word of a solver's status.
_SOLVERS = {
    "ipopt": ("nonlinear programme", "Ipopt"),
    "piqp": ("quadratic programme", "PIQP"),
    "sqp": ("nonlinear programme", "SQP"),
    "highs": ("programme", "HiGHS"),
    "policy": ("answer", "a trained policy"),
}


@dataclass(frozen=True)
class Planning:
    """Counts of a closed loop.

    Attributes:
        steps: control steps.
        plans: steps with a plan of a solver, by solver, most first; what an override did with it is not counted here.
        failed: steps in which a solver was started and gave no plan.
        undecided: steps in which the controller met an error that it has no answer to; native control acted.
        why_undecided: the most frequent of these errors.
        uncomfortable: plans that accept discomfort in the next hours (0.05 K beyond a bound), since heat costs more.
        variables, parameters: of most of the programmes that were solved, the parameters of the operator; 0 without.
        trained: parameters of the operator that were trained; 0 without a model.
    """

    steps: int
    plans: Mapping[str, int]
    failed: int
    undecided: int
    why_undecided: str
    uncomfortable: int
    variables: int
    parameters: int
    trained: int

    def to_json(self) -> dict[str, Any]:
        """The counts, and what they say in words."""
        return {**asdict(self), "in_words": self.in_words()}

    def in_words(self) -> str:
        """One line for people."""
        words = "nothing was planned"
        if self.plans:
            each = [(n, *_SOLVERS.get(solver, ("plan", solver))) for solver, n in self.plans.items()]
            by = [f"{counted(n, what)} by {whom}" for n, what, whom in each]
            words = f"solved {' and '.join(filter(None, (', '.join(by[:-1]), by[-1])))}"
            if self.variables:
                words += f", {counted(self.variables, 'variable')}, {counted(self.parameters, 'parameter')} of the "
                words += "operator in each"
                dropped = self.parameters < self.trained
                words += f" ({self.trained} were trained: a network was not kept)" if dropped else ""
        if self.undecided >= _A_FEW:
            alarm = f"NO DECISION WAS MADE IN {self.undecided} OF {self.steps} STEPS, NATIVE CONTROL ACTED INSTEAD"
            words = f"{alarm} ({self.why_undecided}); {words}"
        words += f"; {counted(self.failed, 'solve')} without a plan" if self.failed else ""
        if self.uncomfortable > _WORTH_TELLING * self.steps:
            words += f"; in {100.0 * self.uncomfortable / self.steps:.0f} % of the steps discomfort in the next "
            words += f"{_SOON_H:g} h {NOT_ECONOMICAL} (controller.options.objective.comfort_weight_per_m2)"
        return words


def _beyond_K(step: StepRecord) -> float:
    """How far a plan lets a zone leave its comfort bounds in the next hours, K; later plans see to what comes after."""
    plan, boundary = step.plan, step.boundary
    n = min(plan.u.shape[1], steps_in(_SOON_H * HOUR_S, boundary.step_s))
    lower_C, upper_C = boundary.lower_C[:, 1 : n + 1], boundary.upper_C[:, 1 : n + 1]
    T_C = plan.T_zone_C[:, : lower_C.shape[1]]
    return float(np.nanmax(excess(T_C, lower_C, upper_C), initial=0.0))


def planning_of(result: RunResult, model: ThermalModel | None) -> Planning:
    """The counts of a closed loop; `model`: what its controller planned with, if anything."""
    plans, undecided = Counter[str](), Counter[str]()
    failed, uncomfortable, sizes = 0, 0, Counter[tuple[int, int]]()
    for step in result.steps:
        solver, _, how = step.plan.solver_status.partition(":")
        if step.plan.u.size:
            plans[solver or "another solver"] += 1
            sizes[step.plan.variables, step.plan.parameters] += 1
            uncomfortable += NOT_ECONOMICAL in step.plan.why and _beyond_K(step) > _NOTICED_K
        elif solver == UNDECIDED:
            undecided[how.strip()] += 1
        else:
            failed += bool(how) or solver == "raised"
    variables, parameters = sizes.most_common(1)[0][0] if sizes else (0, 0)
    return Planning(
        steps=len(result.steps),
        plans=dict(plans.most_common()),
        failed=failed,
        undecided=undecided.total(),
        why_undecided=next((why for why, _ in undecided.most_common(1)), ""),
        uncomfortable=uncomfortable,
        variables=variables,
        parameters=parameters,
        trained=model.operator.n_trained if model else 0,
    )


@dataclass(frozen=True)
class Capped:
    """Mean power of all machines over `steps` windows of `step_s` seconds: how many are `above` `cap_kW`; the highest.

    Windows in which power was not metered are not among them; without any the highest is NaN.
    """

    cap_kW: float
    step_s: float
    above: int
    steps: int
    highest_kW: float

    def in_words(self) -> str:
        """As 'above the cap of 3 kW: 0 of 192 quarter hours, highest 2.90 kW'."""
        of = "quarter hours" if self.step_s == PEAK_WINDOW_S else f"steps of {self.step_s / 60.0:g} min"
        return (
            f"above the cap of {self.cap_kW:g} kW: {self.above} of {self.steps} {of}, highest {self.highest_kW:.2f} kW"
        )


def capped_figures(
    scenario: Scenario, result: RunResult, baselines: Mapping[str, RunResult]
) -> dict[str, dict[str, Any]]:
    """What each run made of the cap of the scenario's controller, as `Capped` in JSON; {} without a cap."""
    cap_kW = (scenario.controller.options.get("objective") or {}).get("power_cap_kW")
    if cap_kW is None or not result.steps:
        return {}
    step_s = sum(sample.duration_s for sample in result.steps[0].samples)
    runs = {result.controller: result, **baselines}
    return {name: asdict(_capped(cap_kW, step_s, run)) for name, run in runs.items()}


def _capped(cap_kW: float, step_s: float, run: RunResult) -> Capped:
    samples = (sample for step in run.steps for sample in step.samples)
    starts_s, lengths_s, power_W = np.array([(s.start_s, s.duration_s, s.power_W.sum()) for s in samples]).T
    ends_s = np.append(starts_s[0], starts_s + lengths_s)
    unknown = window_means(ends_s, np.isnan(power_W), step_s) > 0.0
    known_W = window_means(ends_s, np.nan_to_num(power_W), step_s)[~unknown]
    highest_kW = float(known_W.max()) / 1000.0 if known_W.size else float("nan")
    return Capped(cap_kW, step_s, int((known_W > 1000.0 * cap_kW).sum()), known_W.size, highest_kW)


@dataclass(frozen=True)
class GateHeld:
    """Steps of a run in which the competence gate held: `steps` of `total`, and why, of the first."""

    steps: int
    total: int
    why: str

    def in_words(self) -> str:
        """One sentence for people."""
        return f"the gate held in {self.steps} of {self.total} steps: {self.why.removeprefix('gate: ')}"


def gates_held(result: RunResult, others: Mapping[str, RunResult]) -> dict[str, GateHeld]:
    """Return the runs in which the gate held, by controller."""
    gates = {}
    for name, run in {result.controller: result, **others}.items():
        why = [step.plan.why for step in run.steps if step.plan.status is PlanStatus.GATE]
        if why:
            gates[name] = GateHeld(len(why), len(run.steps), why[0])
    return gates


@dataclass(frozen=True)
class Spell:
    """Consecutive steps with the status `watch`: from `start_s` to `end_s`, s, and the reasons of beginning and end.

    `why_back` is empty where the run ended first.
    """

    start_s: float
    end_s: float
    why: str
    why_back: str

    def in_words(self, instant: Callable[[float], str] = words_of) -> str:
        """One sentence for people; `instant`: a time, s, in words."""
        back = f"; {self.why_back}" if self.why_back else "; until the end of the run"
        return f"{instant(self.start_s)}, {(self.end_s - self.start_s) / HOUR_S:.1f} h: {self.why}{back}"


def watch_spells(result: RunResult) -> tuple[Spell, ...]:
    """Return the spells of `result` in which the watch had handed control back."""
    spells, first = [], 0
    for watched, steps in groupby(result.steps, key=lambda step: step.plan.status is PlanStatus.WATCH):
        last = first + sum(1 for _ in steps)
        if watched:
            end = result.steps[last - 1].samples[-1]
            news = result.steps[last].plan.news if last < len(result.steps) else ""
            back = next((note.removeprefix("watch: ") for note in news.split("; ") if note.startswith("watch: ")), "")
            why = result.steps[first].plan.why.removeprefix("watch: ")
            spells.append(Spell(result.steps[first].time_s, end.start_s + end.duration_s, why, back))
        first = last
    return tuple(spells)


def figures_of(
    scenario: Scenario, plant: Mapping[str, Any], result: RunResult, baselines: Mapping[str, RunResult], equal: str
) -> dict[str, Any]:
    """The content of `kpis.json`; `plant` is a `PlantInfo` in JSON, `equal` what is as comfortable, in words."""
    return {
        "testcase": plant.get("testcase", ""),
        "plant": f"{plant.get('kind')}: {plant.get('description')}",
        "weather": plant.get("weather", ""),
        "period": scenario.period,
        "start_day": result.period.start_s / DAY_S,
        "scored_days": result.period.scored_s / DAY_S,
        "price": scenario.price,
        "controller": result.controller,
        "kpis": without_times(result.kpis),
        "baselines": {name: without_times(baseline.kpis) for name, baseline in baselines.items()},
        "equal_comfort": equal,
        "gate": {name: asdict(gate) for name, gate in gates_held(result, baselines).items()},
        "power_cap": capped_figures(scenario, result, baselines),
    }


def without_times(kpis: Mapping[str, float]) -> dict[str, float]:
    """KPIs without that of the computing time, which no two runs have in common."""
    return {key: value for key, value in kpis.items() if key != "time_rat"}


def most_comparable_Kh(least_Kh: float) -> float:
    """Most discomfort that is comparable to the least of a group, K·h."""
    return max(_COMPARABLE * least_Kh, least_Kh + _COMPARABLE_KH)


def best_values(everyone: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Least of each KPI among the controllers whose discomfort is comparable to the least; of discomfort, of all."""
    least = min((kpis[DISCOMFORT] for kpis in everyone.values() if DISCOMFORT in kpis), default=inf)
    warm = [kpis for kpis in everyone.values() if kpis.get(DISCOMFORT, least) <= most_comparable_Kh(least)]
    known = [(key, value) for kpis in warm for key, value in kpis.items() if isfinite(value)]
    return {key: min(value for other, value in known if other == key) for key, _ in known}


Kpis = Mapping[str, float]
# Costs that differ by less are the same.
_SAME = 0.005
_CALLED = {"native": "the building's own controller", "thermostat": "an on/off thermostat", "pi": "a PI controller"}


def verdict(controller: str, everyone: Mapping[str, Kpis], currency: str, days: float) -> str:
    """One sentence on `controller` beside the others of a run, by `cost_tot`, `currency`/m², and `tdis_tot`, K·h."""
    own = everyone[controller]
    if not own.keys() >= {COST, DISCOMFORT}:
        return f"{controller}: the plant gives no cost or no discomfort."
    others = {name: kpis for name, kpis in everyone.items() if name != controller and kpis.keys() >= {COST, DISCOMFORT}}
    # The one that is hardest to beat first: the thermostat.
    ordered = sorted(others, key=lambda name: name != "thermostat")
    beside = [f"{_difference(own[COST], others[name][COST], currency)} {_CALLED.get(name, name)}" for name in ordered]
    text = f"{controller}: {own[COST]:.3g} {currency}/m²" + (f", {' and '.join(beside)}" if beside else "")
    text += f"; comfort missed by {_Kh(own)} K·h in {_days(days)}"
    if others:
        text += " (" + ", ".join(f"{name} {_Kh(others[name])}" for name in ordered) + ")"
    calmer = [name for name in ordered if own[DISCOMFORT] > others[name][DISCOMFORT] + _COMPARABLE_KH]
    cheaper = [name for name in calmer if own[COST] < others[name][COST]]
    if cheaper:
        text += f". It leaves more discomfort than {' and '.join(cheaper)}: compare costs at equal comfort"
    return text + "."


def _Kh(kpis: Kpis) -> str:
    return f"{kpis[DISCOMFORT]:.2f}" if kpis[DISCOMFORT] < 10 else f"{kpis[DISCOMFORT]:.0f}"


def _difference(own: float, other: float, currency: str) -> str:
    """'7 % less than', '2 % more than' or 'as much as'; in currency where the other costs nothing, or earns."""
    if other > 0 and own >= 0 and isfinite(own):
        share = own / other - 1.0
        if abs(share) < _SAME:
            return "as much as"
        return f"{100.0 * abs(share):.0f} % {'less' if share < 0 else 'more'} than"
    return f"{abs(own - other):.3g} {currency}/m² {'less' if own < other else 'more'} than"


def _days(days: float) -> str:
    weeks = {7: "one week", 14: "two weeks", 21: "three weeks", 28: "four weeks"}
    return weeks.get(int(days) if days == int(days) else -1, f"{days:g} day{'s' * (days != 1)}")
