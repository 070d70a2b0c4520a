"""Plans for many buildings at one instant: how many a second, with how much memory, and where the time goes.

The buildings are generated houses, probed for three days, identified, and run for a week by the default controller. Of
each house there are many: with gains of their own, at another instant of the last day, and with prices of their own, so
that no two have a model, a controller or an observation in common.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from controllers.many.portfolio import Portfolio
from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from controllers.registry import controller_config
from thermoforce_mpc.data import DAY_S, Observation, Plan
from thermoforce_mpc.experiment.identifying import identify_on
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.random_houses import GeneratedHousePlant, draw_house

# A population that no table of the documentation reports.
_SEED, _CONTROLLER, _WEEK = 7, "thermoforce_mpc", "cold_week"
_PROBED_DAYS, _DAYS = 3.0, 7.0
_GAINS, _PRICES = (0.98, 1.02), (0.5, 2.0)
# Instants planned one after another; the first builds what is built once.
_INSTANTS = 4


@dataclass(frozen=True)
class ManyPlans:
    """Figures for `buildings` planned in `workers` processes, each after the instant before.

    `per_second`: plans a second, median of the instants, from observations to plans in this process; `first_s`: the
    first instant, with the start of processes and the building of controllers. `cpu_ms`: processor time of all
    processes per plan, which other load on the machine changes less. Of a plan's own time, ms: `plan_ms`, and of it
    `forecast_ms` and `solve_ms`. `single_ms`: the same plans by single controllers one after another, in this
    process. `peak_MB`: largest resident memory of all processes together, `worker_MB` of it of those that plan (NaN
    where the system does not tell). `solved`: share of plans that are checked solutions.
    """

    buildings: int
    workers: int
    per_second: float
    first_s: float
    cpu_ms: float
    plan_ms: float
    forecast_ms: float
    solve_ms: float
    single_ms: float
    peak_MB: float
    worker_MB: float
    solved: float

    @property
    def times_faster(self) -> float:
        """Rate over that of single controllers one after another in one process."""
        return self.per_second * self.single_ms / 1000.0


@dataclass(frozen=True)
class Situation:
    """A house at consecutive instants: its model, observations, and the state before the first."""

    model: ThermalModel
    config: MPCConfig
    observations: tuple[Observation, ...]
    state: object


def measure_plan_many(
    counts: Sequence[int] = (1, 10, 100, 1000),
    *,
    houses: int = 3,
    workers: int = 2,
    progress: Callable[[str], None] = lambda _line: None,
) -> list[ManyPlans]:
    """Measure plans of each number of buildings in `counts`, made of so many `houses`.

    Not measured, since it comes once a day for each building: trials by which the forecast's weights are renewed.
    """
    days = [situations for index in range(houses) if (situations := _day_of(index, progress))]
    results = []
    for count in counts:
        results.append(measure(_buildings(days, count), workers))
        progress(in_words(results[-1]))
    return results


def _day_of(index: int, progress: Callable[[str], None]) -> list[Situation]:
    """Situations of one house over the last day of a week of control; none where it cannot be identified."""
    plant = GeneratedHousePlant(draw_house(_SEED, index))
    period = replace(plant.period(_WEEK), scored_s=_DAYS * DAY_S)
    model = identify_on(plant, before=period, days=_PROBED_DAYS, testcase=plant.testcase)
    config = controller_config(_CONTROLLER, {}, plant.testcase)
    assert isinstance(config, MPCConfig)
    followed = _Followed(ThermoForceMPC(model, config))
    run_closed_loop(plant, followed, period)
    # Weights are renewed at whole days from the begin: the first instant of the day is left out.
    last = round(DAY_S / followed.step_s) - 1
    seen = followed.seen[-last:]
    progress(f"house {index}: {plant.house.words}: {len(followed.seen)} plans")
    return [
        Situation(model, config, tuple(one for one, _ in seen[k : k + _INSTANTS]), seen[k][1])
        for k in range(len(seen) - _INSTANTS)
    ]


class _Followed:
    """A controller whose observations and states are kept."""

    def __init__(self, inner: ThermoForceMPC) -> None:
        self.inner, self.name, self.step_s, self.horizon_s = inner, inner.name, inner.step_s, inner.horizon_s
        self.model = inner.model
        self.seen: list[tuple[Observation, object]] = []

    def plan(self, observation: Observation, state: object = None) -> Plan:
        self.seen.append((observation, state))
        return self.inner.plan(observation, state)


def _buildings(days: Sequence[Sequence[Situation]], count: int) -> dict[str, Situation]:
    """`count` buildings, each at another instant, with gains and prices of its own."""
    rng = np.random.default_rng(0)
    found = {}
    for i in range(count):
        day = days[i % len(days)]
        situation = day[(i // len(days) * 7) % len(day)]
        gain, price = rng.uniform(*_GAINS), rng.uniform(*_PRICES)
        operator = _stronger(situation.model.operator, float(gain))
        observations = tuple(
            Observation(one.history, replace(one.boundary, price_per_kWh=price * one.boundary.price_per_kWh))
            for one in situation.observations
        )
        found[f"building {i}"] = replace(
            situation, model=replace(situation.model, operator=operator), observations=observations
        )
    return found


def _stronger(operator: BuildingOperator, factor: float) -> BuildingOperator:
    return operator.map(lambda pair: replace(pair, gains=factor * pair.gains))


def measure(buildings: Mapping[str, Situation], workers: int) -> ManyPlans:
    """Plan for buildings at all their instants, in so many processes."""
    single_ms = _single_ms(list(buildings.values())[:20])
    states: dict[str, object] = {name: one.state for name, one in buildings.items()}
    seconds, cpu_s = [], 0.0
    costs, reasons = list[Mapping[str, float]](), list[str]()
    configs = {name: one.config for name, one in buildings.items()}
    with Portfolio({name: one.model for name, one in buildings.items()}, configs, workers=workers) as portfolio:
        for k in range(len(next(iter(buildings.values())).observations)):
            if k == 1:
                cpu_s = _cpu_s()
            observations = {name: one.observations[k] for name, one in buildings.items()}
            began = time.perf_counter()
            found = portfolio.plan(observations, states)
            seconds.append(time.perf_counter() - began)
            states = {name: one.state for name, one in found.items()}
            costs += [one.seconds for one in found.values()] if k else []
            reasons += [one.reason for one in found.values()] if k else []
        cpu_s = _cpu_s() - cpu_s
        here_MB, *of_workers = (_peak_MB(process) for process in _processes())
    return ManyPlans(
        buildings=len(buildings),
        workers=workers,
        per_second=len(buildings) / statistics.median(seconds[1:]),
        first_s=seconds[0],
        cpu_ms=1000.0 * cpu_s / len(costs),
        plan_ms=_mean_ms(costs, "all"),
        forecast_ms=_mean_ms(costs, "forecast"),
        solve_ms=_mean_ms(costs, "solve"),
        single_ms=single_ms,
        peak_MB=here_MB + sum(of_workers),
        worker_MB=sum(of_workers),
        solved=reasons.count("") / len(reasons),
    )


def in_words(result: ManyPlans) -> str:
    """One line for people."""
    r = result
    rest = r.plan_ms - r.forecast_ms - r.solve_ms
    return (
        f"{r.buildings} buildings in {r.workers} processes: {r.per_second:.0f} plans a second "
        f"({r.times_faster:.1f} times single controllers, {r.single_ms:.1f} ms each), "
        f"{r.cpu_ms:.1f} ms of a processor each; of {r.plan_ms:.1f} ms a plan "
        f"forecast {r.forecast_ms / r.plan_ms:.0%}, solve {r.solve_ms / r.plan_ms:.0%}, rest {rest / r.plan_ms:.0%}; "
        f"at most {r.peak_MB:.0f} MB, {r.worker_MB:.0f} MB of it in the processes; first instant {r.first_s:.1f} s; "
        f"solved {r.solved:.1%}"
    )


def _single_ms(situations: Sequence[Situation]) -> float:
    """Median time of a plan by a controller of its own, ms; the first plan of each is not counted."""
    seconds = []
    for one in situations:
        controller, state = ThermoForceMPC(one.model, one.config), one.state
        for k, observation in enumerate(one.observations):
            began = time.perf_counter()
            state = controller.plan(observation, state).state
            if k:
                seconds.append(time.perf_counter() - began)
    return 1000.0 * statistics.median(seconds)


def _mean_ms(costs: Sequence[Mapping[str, float]], part: str) -> float:
    return 1000.0 * statistics.fmean(seconds.get(part, 0.0) for seconds in costs)


def _processes() -> list[str]:
    """This process and those it started, as named in /proc."""
    return ["self", *(str(process.pid) for process in multiprocessing.active_children())]


def _cpu_s() -> float:
    """Processor time of all processes so far, s (Linux); NaN elsewhere."""
    try:
        stats = [Path(f"/proc/{process}/stat").read_text() for process in _processes()]
    except OSError:
        return float("nan")
    # User and system time are the 14th and 15th field; the second, a name in brackets, may hold spaces.
    ticks = sum(int(ticks) for stat in stats for ticks in stat.rpartition(")")[2].split()[11:13])
    return ticks / os.sysconf("SC_CLK_TCK")


def _peak_MB(process: str) -> float:
    """Largest resident memory of a process so far, MB (Linux); NaN elsewhere."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return float("nan")
    return sum(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024.0
