"""Many seeded episodes on a served embedded plant, and the table of what came of them."""

from __future__ import annotations

import functools
import itertools
import math
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import TaskFailed
from benchmarks.chaos.episode import Outcome, Setting, run_episode
from benchmarks.chaos.files import TRIAL_CLASSES, TRIALS, prepared, run_trial
from benchmarks.chaos.troubles import CLASSES, Trouble, drawn
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.execution import LocalEngine, Task, execute
from thermoforce_mpc.execution import TaskOutcome as Executed
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task, run_identification
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.plants.testcases import load_scenario, load_testcase
from thermoforce_mpc.service.server import serving

TESTCASE = "bestest_hydronic_heat_pump"
# The weather model alone, since no episode depends on what the forecaster says.
OPTIONS: Mapping[str, Any] = {"free_response": {"name": "linear_weather"}}
# Discomfort beside that without faults: as a factor, and K·h more.
_FACTOR, _MORE_KH = 1.5, 1.0
_START_DAY = 16
_MOST_TESTS = 100


def run_chaos(
    *,
    episodes: int,
    seed: int,
    days: float = 2.0,
    controller: str = "thermoforce_mpc",
    model: ThermalModel | None = None,
    options: Mapping[str, Any] = OPTIONS,
    keep: Path | None = None,
    jobs: int = 1,
    progress: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Run `episodes` of `days` and judge each; the same seed gives the same troubles.

    An interrupt (Ctrl-C) ends the run; what was done until then is judged.

    Args:
        model: by default the embedded plant is probed for three days.
        keep: folder where journals are kept, one folder an episode.
        jobs: number of processes, each with a service of its own; an episode whose process dies is lost, and wrong.
        progress: called with one line an episode.
    """
    testcase = load_testcase(TESTCASE)
    if model is None:
        progress("probing and identifying")
        named = {"testcase": TESTCASE, "period": str(_START_DAY), "controller": {"name": controller}}
        plant = EmbeddedPlant(synthetic_weather())
        scenario = load_scenario(None, named)
        model = run_identification(identification_task(scenario, chosen_of(scenario, testcase)), plant)
    found: dict[int, Outcome] = {}
    with serving(synthetic_weather(), most_tests=_MOST_TESTS) as url:
        setting = Setting(url, testcase, model, dict(options), controller, _START_DAY * DAY_S, days)
        calm = run_episode(setting, (), 0)
    progress(f"without faults: {_line(calm)}")
    most_Kh = _FACTOR * calm.discomfort_Kh + _MORE_KH
    tasks = [
        Task(f"{n:04d}", f"episode {n}", _episode_apart, (setting, most_Kh, seed, keep, n)) for n in range(episodes)
    ]
    try:
        with LocalEngine(jobs) as engine:
            # A process that dies is what is looked for here: its episode is not begun again.
            for done in execute(tasks, engine, most_attempts=1):
                outcome = found[done.task.inputs[-1]] = _outcome_of(done, setting, seed)
                told = "; ".join(trouble.in_words() for trouble in outcome.troubles)
                progress(f"{len(found):4d}: {told}: {_line(outcome)}")
    except KeyboardInterrupt:
        if not found:
            raise
        progress(f"interrupted after {len(found)} of {episodes} episodes")
    outcomes = [found[n] for n in sorted(found)]
    if len(found) == episodes:
        outcomes += _trials(max(len(TRIALS), episodes // 4), seed, progress)
    return results_json("chaos", _rows(calm, outcomes), _targets(calm, outcomes))


def _trials(n: int, seed: int, progress: Callable[[str], None]) -> list[Outcome]:
    """As many trials with files as `n`, of all kinds in turn."""
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="tf-mpc-chaos-") as scratch:
        folder = prepared(Path(scratch))
        for i, kind in zip(range(n), itertools.cycle(TRIALS), strict=False):
            outcomes.append(run_trial(kind, (seed, i), folder))
            progress(f"{kind} {i}: {_line(outcomes[-1])}")
    return outcomes


def _troubles(setting: Setting, seed: int, n: int) -> tuple[tuple[Trouble, ...], int]:
    """The troubles of an episode, and their seed."""
    rng = np.random.default_rng([seed, n])
    return drawn(rng, setting.days), int(rng.integers(2**31))


def _episode(setting: Setting, most_Kh: float, seed: int, keep: Path | None, n: int) -> Outcome:
    troubles, own = _troubles(setting, seed, n)
    return run_episode(setting, troubles, own, most_Kh, keep / f"{n:04d}" if keep else None)


@functools.cache
def _url() -> str:
    """A service of the plant in this process, until it ends."""
    return _services.enter_context(serving(synthetic_weather(), most_tests=_MOST_TESTS))


_services = ExitStack()


def _episode_apart(inputs: tuple[Setting, float, int, Path | None, int]) -> Outcome:
    """Task: an episode on the service of its process."""
    setting, most_Kh, seed, keep, n = inputs
    return _episode(replace(setting, url=_url()), most_Kh, seed, keep, n)


def _outcome_of(task: Executed, setting: Setting, seed: int) -> Outcome:
    """The outcome of an episode; also of one that was killed, for lack of memory or by compiled code, say."""
    if not task.reason:
        return task.value
    if not task.poisoned:
        raise TaskFailed(task)
    troubles, _ = _troubles(setting, seed, task.task.inputs[-1])
    why = "ended with its process, which died: nothing of it is known"
    return Outcome(troubles, "process died", why, {}, 0, 0, math.nan, 0.0, (why,))


def _line(outcome: Outcome) -> str:
    made = sum(outcome.made.values())
    line = f"{outcome.ended}, {outcome.steps} steps, {made} faults made, {outcome.discomfort_Kh:.2f} K·h"
    return "; ".join([f"{line}, {outcome.seconds:.0f} s", *(f"WRONG: {fault}" for fault in outcome.faults)])


def _rows(calm: Outcome, outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """One row a kind of trouble, by class; an episode stands in the row of each kind that it met."""
    rows = [_row("", "none", [calm])]
    for group, kinds in {**CLASSES, **TRIAL_CLASSES}.items():
        met = [(kind, [outcome for outcome in outcomes if kind in outcome.made]) for kind in kinds]
        rows += [_row(group, kind, those) for kind, those in met if those]
    return [*rows, _row("", "all", outcomes)]


def _row(group: str, kind: str, outcomes: list[Outcome]) -> dict[str, Any]:
    every = kind in ("all", "none")
    done = [outcome for outcome in outcomes if outcome.ended == "done"]
    return {
        "class": group,
        "trouble": kind,
        "episodes": len(outcomes),
        "made": sum(sum(o.made.values()) if every else o.made[kind] for o in outcomes),
        "done": len(done),
        "ended": len(outcomes) - len(done),
        "steps": sum(outcome.steps for outcome in outcomes),
        "ran_ahead": sum(outcome.jumps for outcome in outcomes),
        "discomfort_Kh": max((outcome.discomfort_Kh for outcome in done), default=None),
        "wrong": sum(bool(outcome.faults) for outcome in outcomes),
        "what": next((fault for outcome in outcomes for fault in outcome.faults), ""),
    }


def _targets(calm: Outcome, outcomes: list[Outcome]) -> list[Target]:
    """What must not be, with the number of episodes in which it was."""
    kinds = {
        "ended in an error that could be waited out, or in one without a name": "ended with",
        "an action out of range": " was sent",
        "a step lost, doubled without a word, or not in the journal": "step",
        "the test not stopped": "not stopped",
        "a wrong unit that is not said": "not said",
        "discomfort above 1.5 times that without faults and 1 K·h": "discomfort",
        "a file outside a folder written": "outside",
        "a refusal that took longer than a minute": "took",
        "no word for 10 s": "silent",
        "a model that cannot be right taken": "was taken",
    }
    found = []
    for name, words in kinds.items():
        n = sum(any(_kind(fault, words) for fault in outcome.faults) for outcome in [calm, *outcomes])
        found.append(Target(f"episodes with {name}", float(n), 0.0))
    return found


def _kind(fault: str, words: str) -> bool:
    if fault.startswith("ended with"):  # its text may say anything
        return words == "ended with"
    return words in fault
