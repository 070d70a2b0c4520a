"""What `gymnasium.make("thermoforce_mpc/Building-v0", …)` calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.experiment.experiment import Experiment
from thermoforce_mpc.gym.boptest import BoptestGymEnv, EmbeddedBoptestGymEnv, check_keywords
from thermoforce_mpc.gym.env import BuildingEnv, Episodes
from thermoforce_mpc.gym.view import LevelsView
from thermoforce_mpc.plants.boptest.plant import allow_token
from thermoforce_mpc.plants.testcases import load_scenario

CONVENTIONS = ("levels", "boptest")


def building(
    testcase: str = "bestest_hydronic_heat_pump",
    *,
    convention: str = "levels",
    url: str | None = None,
    fmu: str | None = None,
    weather: str = "synthetic",
    **options: Any,
) -> BuildingEnv:
    """The environment of a test case.

    Args:
        testcase: a test case that ships, `house:Nrooms`, `generated:SEED:INDEX`, or a YAML file.
        convention: 'levels' (see `levels_env`), or 'boptest' for BOPTEST-Gym's points (see `BoptestGymEnv`).
        url: address of a BOPTEST service, instead of a plant of our own.
        fmu: the test case's FMU, instead of a plant of our own ('levels').
        weather: 'synthetic', or a .mos / .epw file of an embedded test case.
        options: arguments of the convention.

    Raises `ConfigError`, which names the argument that is wrong, `PlantError` where plant or service failed.
    """
    if convention not in CONVENTIONS:
        raise ConfigError(f"convention: '{convention}': expected one of {', '.join(CONVENTIONS)}")
    if convention == "levels":
        check_keywords(options, building, levels_env)
        return levels_env(testcase, url=url, fmu=fmu, weather=weather, **options)
    if fmu is not None:
        raise ConfigError("fmu: BOPTEST's points need an embedded test case or url=…; take convention='levels'")
    if url is not None:
        if weather != "synthetic":
            raise ConfigError("weather: a service has its own weather; leave it out")
        return BoptestGymEnv(url, testcase, **options)
    year = None if weather == "synthetic" else load_weather(Path(weather))
    return EmbeddedBoptestGymEnv("", testcase, **options, weather=year)


def levels_env(
    testcase: str,
    *,
    url: str | None = None,
    fmu: str | None = None,
    weather: str = "synthetic",
    forecast_uncertainty: str = "none",
    plant_seed: int = 1,
    step_period: float = 900.0,
    max_episode_length: float = 7 * DAY_S,
    warmup_period: float = DAY_S,
    start_time: float = 0.0,
    random_start_time: bool = True,
    excluding_periods: Sequence[tuple[float, float]] | None = None,
    predictive_period: float = 12 * HOUR_S,
    forecast_every: float = HOUR_S,
    regressive_period: float = 0.0,
    scenario: Mapping[str, Any] | None = None,
    observations: Mapping[str, tuple[float, float] | None] | None = None,
    discomfort_weight: float = 1.0,
    reward: Callable[[BuildingEnv], float] | None = None,
    render_mode: str | None = None,
) -> BuildingEnv:
    """Any plant by the levels of its actuators; `LevelsView` describes actions and observations.

    Args:
        testcase: see `building`, also for `url`, `fmu` and `weather`.
        forecast_uncertainty: BOPTEST's level of weather forecast errors: none, low, medium or high.
        plant_seed: their seed.
        step_period: length of a step, s.
        max_episode_length: length of an episode, s.
        warmup_period: native control before each episode, s.
        start_time: start of the episodes, s since 1 January, without `random_start_time`.
        random_start_time: draw the start of each episode, see `Episodes`.
        excluding_periods: pairs of times, s, that no drawn episode overlaps.
        predictive_period: length of the observed forecast, s.
        forecast_every: distance of its instants, s.
        regressive_period: length of the observed past, s.
        scenario: `{"electricity_price": "constant" | "dynamic" | "highly_dynamic"}`.
        observations: what is observed (`SIGNALS`), with its bounds or None for the default ones; by default all.
        discomfort_weight: weight of tdis_tot beside cost_tot in the reward.
        reward: see `BuildingEnv`, also for `render_mode`.

    Raises as `building` does.
    """
    plant: dict[str, Any] = {"weather": weather, "forecast_uncertainty": forecast_uncertainty}
    if url is not None:
        plant |= {"kind": "boptest", "url": url}
        allow_token(url)
    if fmu is not None:
        plant |= {"kind": "fmu", "path": fmu}
    content = {"testcase": testcase, "plant": plant, "controller": {"name": "native"}, "baselines": []}
    chosen = load_scenario(None, {**content, "seed": plant_seed})
    experiment = Experiment.of(chosen)
    episodes = Episodes(
        step_period=float(step_period),
        max_episode_length=float(max_episode_length),
        warmup_period=float(warmup_period),
        start_time=float(start_time),
        random_start_time=random_start_time,
        excluding_periods=excluding_periods,
        ahead=float(predictive_period),
        behind=float(regressive_period),
    )
    built = experiment.plant.build()
    try:
        view = LevelsView(
            built,
            experiment.testcase,
            step_s=episodes.step_period,
            ahead_s=float(predictive_period),
            every_s=float(forecast_every),
            behind_s=float(regressive_period),
            observations=observations,
            perfect=url is None and forecast_uncertainty == "none",
        )
        return BuildingEnv(
            view,
            episodes,
            scenario=scenario,
            discomfort_weight=discomfort_weight,
            reward=reward,
            render_mode=render_mode,
        )
    except BaseException:
        built.close()
        raise
