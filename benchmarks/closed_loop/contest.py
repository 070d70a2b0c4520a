"""`tf-mpc bench contest`: what a choice of model or controller changes, on drawn houses and heat pump windows.

Everyone in a case gets the same probing. What is compared is what the MPC minimises: energy cost, and discomfort at its
default weight.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.cases import run_all
from benchmarks.closed_loop.worth import HEAT_PUMP
from controllers.mpc.config import ObjectiveConfig
from controllers.registry import build_controller, find_entry
from thermoforce_mpc.comparison.outcome import results_json
from thermoforce_mpc.data import DAY_S, HOUR_S, Period
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import Engine
from thermoforce_mpc.experiment.experiment import scored_period
from thermoforce_mpc.experiment.identifying import chosen_of, identification_task
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.probing import Identifying, probe_until_known
from thermoforce_mpc.model.free_response.backbones.base import one_thread
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.plants.drawn_houses import WEEKS
from thermoforce_mpc.plants.registry import build_plant
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Controller
from thermoforce_mpc.scenario.scenario import Scenario

_WEIGHT_PER_M2 = ObjectiveConfig().comfort_weight_per_m2

Row = dict[str, Any]


@dataclass(frozen=True)
class Contestant:
    """A controller with its options, on a model identified with `identification` options beside the defaults."""

    controller: str = "thermoforce_mpc"
    options: Mapping[str, Any] = field(default_factory=dict)
    identification: Mapping[str, Any] = field(default_factory=dict)


# The first of each is what the others are compared with.
CONTESTS: dict[str, dict[str, Contestant]] = {
    "feedback": {"default": Contestant(), "feedback": Contestant(identification={"feedback": True})},
    "policies": {
        "thermoforce_mpc": Contestant(),
        "dpc": Contestant("dpc"),
        "ppo": Contestant("ppo"),
        "thermostat": Contestant("thermostat"),
    },
    "modulation": {
        "auto": Contestant(),
        "always": Contestant(identification={"modulation": "always"}),
        "linear": Contestant(identification={"modulation": "linear"}),
    },
}
"""Who is compared, by name of the contest."""
# Hours that PPO is trained for, on the building itself: half of those of examples/train_agent.py, as time allows.
_PPO_STEPS, _PPO_WEEK_S = 10_000, 7 * DAY_S


@dataclass(frozen=True)
class Case:
    """Contestants on a building in one window of `days`; `weather`: a file for the heat pump case, '' its own."""

    contest: str
    testcase: str
    window: str
    days: float
    weather: str = ""


def run_contest(
    contest: str,
    *,
    houses: int,
    seed: int,
    days: float,
    windows: Sequence[str],
    weather: Path | None,
    engine: Engine,
    keep: Path | None = None,
    progress: Callable[[str], None] = lambda _line: None,
) -> Row:
    """Run everyone of a contest on `houses` of population `seed`, cold and sunny week in turns, and on the heat pump.

    `days` of each window; `windows`: start days of the heat pump case, under `weather`; `keep`: folder of finished
    cases.
    """
    cases = [Case(contest, HEAT_PUMP, window, days, str(weather or "")) for window in windows]
    cases += [Case(contest, f"generated:{seed}:{index}", WEEKS[index % len(WEEKS)], days) for index in range(houses)]

    def told(done: int, rows: list[Row]) -> None:
        progress(f"[{done}/{len(cases)}] {rows[0]['building']} {rows[0]['window']}: {in_words(rows)}")

    runs = [row for rows in run_all(run_case, cases, engine, told, keep) for row in rows]
    ran = [row for row in runs if "refused" not in row]
    refused = [row for row in runs if "refused" in row]
    return results_json(f"contest {contest}", [*ran, *summary(ran), *refused], [])


def in_words(rows: Sequence[Row]) -> str:
    """The figures of a case in a line."""
    if "refused" in rows[0]:
        return f"refused, {rows[0]['refused'][:80]}"
    return ", ".join(f"{row['who']} {row['cost']:.4f} / {row['discomfort_Kh']:.2f}" for row in rows)


def run_case(case: Case) -> list[Row]:
    """Run a case: a row per contestant, or one that says why identification refused."""
    plant_options = {"weather": case.weather} if case.weather else {}
    scenario = Scenario.model_validate(
        {"testcase": case.testcase, "plant": plant_options, "period": case.window, "days": case.days}
    )
    testcase, about = load_testcase(case.testcase), {"building": case.testcase, "window": case.window}
    with closing(build_plant(scenario.plant, testcase, scenario.seed)) as plant:
        window = scored_period(plant, scenario.period, scenario.days)
        task = identification_task(scenario, chosen_of(scenario, testcase))
        identifying = Identifying(testcase, task.identification, task.step_s)
        try:
            probed, look = probe_until_known(
                plant, identifying, before=plant.period(case.window), days=task.days, most_days=task.most_days,
                end_early=task.end_early, seed=task.seed, probing=task.probing,
            )  # fmt: skip
            models = {"{}": identifying.conclude(probed, look)}
        except DataError as error:
            return [about | {"refused": str(error)}]
        rows: list[Row] = []
        for name, one in CONTESTS[case.contest].items():
            key, seconds = str(dict(one.identification)), 0.0
            if key not in models:
                config = task.identification.model_copy(update=dict(one.identification))
                models[key] = Identifying(testcase, config, task.step_s).conclude(probed)
            began = time.process_time()
            if one.controller == "ppo":
                controller = trained_ppo(case, window)
            else:
                model = models[key] if find_entry(one.controller).needs_model else None
                controller = build_controller(one.controller, one.options, testcase, model)
            seconds = time.process_time() - began
            run = run_closed_loop(plant, controller, window)
            cost, discomfort_Kh = run.kpis["cost_tot"], run.kpis["tdis_tot"]
            rows.append(
                about
                | {"who": name, "cost": cost, "discomfort_Kh": discomfort_Kh}
                | {"both": cost + _WEIGHT_PER_M2 * discomfort_Kh, "gain": gain_of(models[key])}
                | {"step_ms": 1e3 * float(np.median([step.plan_seconds for step in run.steps]))}
                | {"build_s": seconds, "plans": {k: n for k, n in run.fallback_levels().items() if n}}
            )
        return rows


def trained_ppo(case: Case, window: Period) -> Controller:
    """An agent that PPO trained for `_PPO_STEPS` hours of the building itself, outside the window; extra [rl].

    Its reward is what the MPC minimises. It has tried what no building would be given to try.
    """
    import gymnasium
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger

    import thermoforce_mpc.gym
    from thermoforce_mpc.gym.wrappers import NormalizedActionWrapper, NormalizedObservationWrapper

    summer = (150 * DAY_S, 260 * DAY_S)  # nothing to heat
    held_out = (window.start_s, window.start_s + window.scored_s)
    weather: dict[str, Any] = {"weather": case.weather} if case.weather else {}
    env: gymnasium.Env[Any, Any] = gymnasium.make(
        "thermoforce_mpc/Building-v0", testcase=case.testcase, step_period=HOUR_S, predictive_period=12 * HOUR_S,
        regressive_period=6 * HOUR_S, random_start_time=True, excluding_periods=[summer, held_out],
        max_episode_length=_PPO_WEEK_S, discomfort_weight=_WEIGHT_PER_M2,
        **weather,
    )  # fmt: skip
    env = NormalizedActionWrapper(NormalizedObservationWrapper(env))
    with one_thread():  # networks this small are slower on several
        agent = PPO("MlpPolicy", env, seed=1, gamma=0.98, n_steps=168 * 4, batch_size=168, n_epochs=8, device="cpu")
        agent.set_logger(Logger(None, []))  # its own makes a folder in /tmp
        agent.learn(_PPO_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        thermoforce_mpc.gym.save(agent, env, Path(folder) / "ppo.zip")
        env.close()
        return build_controller(str(Path(folder) / "ppo.zip"), {}, load_testcase(case.testcase))


def gain_of(model: ThermalModel) -> str:
    """What the gain m(x) of a model is: 1, of the free response, or of the predicted temperature."""
    if model.operator.constant_modulation:
        return "m = 1"
    return "m(T)" if any(pair.feedback_active for *_, pair in model.operator.each()) else "m(T_free)"


def summary(rows: Sequence[Row]) -> list[Row]:
    """A row per kind of building and contestant: what it costs beside the first, with a 95 % interval over cases."""
    found = []
    for kind, heat_pump in (("heat pump windows", True), ("drawn houses", False)):
        mine = [row for row in rows if (row["building"] == HEAT_PUMP) == heat_pump]
        first = {(row["building"], row["window"]): row for row in reversed(mine) if row["who"] == _first(rows)}
        for name in dict.fromkeys(row["who"] for row in mine):
            pairs = [(row, first[row["building"], row["window"]]) for row in mine if row["who"] == name]
            found.append({"buildings": kind, "who": name, "cases": len(pairs)} | _beside(pairs))
    return found


def _first(rows: Sequence[Row]) -> str:
    return str(rows[0]["who"])


def _beside(pairs: Sequence[tuple[Row, Row]]) -> Row:
    """Means, and mean difference of cost and discomfort together beside the first, EUR/m², with its interval."""
    both = np.array([row["both"] - other["both"] for row, other in pairs])
    changed = both[both != 0.0]
    half = stats.t.ppf(0.975, both.size - 1) * stats.sem(both) if both.size > 2 and changed.size else None
    return {
        "cost": float(np.mean([row["cost"] for row, _ in pairs])),
        "discomfort_Kh": float(np.mean([row["discomfort_Kh"] for row, _ in pairs])),
        "dearer": float(sum(row["cost"] for row, _ in pairs) / sum(other["cost"] for _, other in pairs) - 1.0),
        "both_more": float(both.mean()),
        "interval": None if half is None else f"{both.mean() - half:+.4f} to {both.mean() + half:+.4f}",
        "better": int((both < 0.0).sum()),
        "same": int((both == 0.0).sum()),
        "step_ms": float(np.median([row["step_ms"] for row, _ in pairs])),
    }
