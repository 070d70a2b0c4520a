"""A policy trained in an environment, run as a controller: it sees and does the same in both."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

import thermoforce_mpc.gym as tf_gym
from controllers.policy.trained import PolicyController, PolicySpec, policy_entry
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, Observation, Period
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.gym import ID
from thermoforce_mpc.gym.wrappers import (
    DiscretizedActionWrapper,
    NormalizedActionWrapper,
    NormalizedObservationWrapper,
)
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.plants.testcases import load_testcase

_TESTCASE = "bestest_hydronic_heat_pump"
_STEP_S = 3600.0
_SEEN = {"step_period": _STEP_S, "regressive_period": 2 * _STEP_S, "predictive_period": 6 * _STEP_S}


def made(**options: object) -> gymnasium.Env:
    given = {"testcase": _TESTCASE, "random_start_time": False, "start_time": 16 * DAY_S, "max_episode_length": DAY_S}
    return gymnasium.make(ID, **{**given, **_SEEN, **options})


class Rule:
    """A policy that heats where it is cold, and keeps what it has seen."""

    def __init__(self) -> None:
        self.seen: list[np.ndarray] = []

    def predict(self, observation, *, deterministic):
        assert deterministic
        self.seen.append(observation)
        return np.int64(observation[2] < -0.1), None


def test_a_policy_sees_in_a_run_what_it_saw_in_its_environment() -> None:
    env = NormalizedObservationWrapper(DiscretizedActionWrapper(made(), n_bins_act=1))
    rule, seen = Rule(), []
    observation, _ = env.reset(seed=1)
    over = False
    while not over:
        seen.append(observation)
        observation, _, _, over, _ = env.step(rule.predict(observation, deterministic=True)[0])
    plant, testcase = env.unwrapped.view.plant, load_testcase(_TESTCASE)
    period = Period("day", start_s=16 * DAY_S, scored_s=DAY_S, warmup_s=DAY_S)
    controller = PolicyController(tf_gym.spec_of(env), Rule(), testcase.layout, name="rule")
    result = run_closed_loop(plant, controller, period)
    np.testing.assert_allclose(controller.agent.seen[0], seen[0], atol=1e-6)
    assert result.kpis["cost_tot"] == pytest.approx(env.unwrapped.get_kpis()["cost_tot"])
    np.testing.assert_allclose(controller.agent.seen, seen, atol=1e-6)
    assert {sample.u_applied for step in result.steps for sample in step.samples} == {(0.0,), (1.0,)}


def observed(env: gymnasium.Env) -> Observation:
    """What a controller sees where the environment stands."""
    plant = env.unwrapped.view.plant
    return Observation(plant.past(_STEP_S), plant.forecast(6 * _STEP_S, _STEP_S))


@pytest.mark.parametrize("observations", [None, {"T_zone_C": (15.0, 25.0), "u": None, "forecast_T_out_C": None}])
def test_observe_gives_the_observation_of_the_environment(observations) -> None:
    env = made(observations=observations)
    env.reset(seed=1)
    for _ in range(3):
        expected, *_ = env.step(np.array([0.4], np.float32))
    found = tf_gym.observe(tf_gym.spec_of(env), observed(env))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5)
    if observations:
        names = env.unwrapped.observations
        assert names[:4] == ["T_zone_C", "u", "T_zone_C-3600s", "u-3600s"]
        assert len(names) == 6 + 7
        assert env.observation_space.low[0] == 15.0


def test_an_observation_of_another_step_is_refused() -> None:
    env = made()
    env.reset(seed=1)
    plant = env.unwrapped.view.plant
    other = Observation(plant.past(900.0), plant.forecast(6 * _STEP_S, 900.0))
    with pytest.raises(DataError, match="its step is 900 s, the policy's 3600 s"):
        tf_gym.observe(tf_gym.spec_of(env), other)


def test_actions_mean_the_same_in_a_run() -> None:
    env = DiscretizedActionWrapper(NormalizedActionWrapper(made()), n_bins_act=4)
    spec = tf_gym.spec_of(env)
    assert [spec.levels(number).tolist() for number in range(5)] == [[0.0], [0.25], [0.5], [0.75], [1.0]]
    assert [env.env.action(env.action(number))[0] for number in range(5)] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_what_cannot_be_repeated_in_a_run_is_refused() -> None:
    with pytest.raises(ConfigError, match="what TransformReward changes cannot be repeated"):
        tf_gym.spec_of(gymnasium.wrappers.TransformReward(made(), lambda reward: reward))
    with pytest.raises(ConfigError, match="convention='levels' only"):
        tf_gym.spec_of(gymnasium.make(ID, convention="boptest"))


def test_rewards_and_observations_of_ones_own() -> None:
    env = made(reward=lambda env: -env.get_kpis()["ener_tot"])
    env.reset(seed=1)
    *_, reward, _, _, _ = env.step(np.array([1.0], np.float32))
    assert reward == -env.unwrapped.get_kpis()["ener_tot"] < 0.0
    with pytest.raises(
        ConfigError, match=r"'T_zone' cannot be observed, did you mean 'T_zone_C'.*known: hour, T_zone_C"
    ):
        made(observations={"T_zone": None})


@pytest.mark.parametrize("options", [{}, {"convention": "boptest"}, {"convention": "boptest", "url": "http://none"}])
def test_an_unknown_argument_is_named_with_those_there_are(options) -> None:
    expected = "unknown argument 'max_episode_lenght', did you mean 'max_episode_length'.*known: .*discomfort_weight"
    with pytest.raises(ConfigError, match=expected):
        gymnasium.make(ID, max_episode_lenght=3600, **options)


def test_a_generated_house_is_an_environment() -> None:
    env = made(testcase="generated:2026:0")
    env.reset(seed=1)
    assert np.isfinite(env.step(env.action_space.sample())[1])


def test_pictures_of_episodes_go_to_a_folder_that_is_made(tmp_path: Path) -> None:
    hour = {"max_episode_length": 3600, "render_episodes": True, "log_dir": str(tmp_path / "a" / "b")}
    env = gymnasium.make(ID, convention="boptest", step_period=3600, **hour)
    env.reset(seed=1)
    env.step(env.action_space.sample())
    assert (tmp_path / "a" / "b" / "episode_1.png").is_file()


def test_a_policy_that_is_not_there_or_of_another_building_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.zip"
    with pytest.raises(ConfigError, match=r"no file .*policy\.zip; `thermoforce_mpc\.gym\.save"):
        policy_entry(str(path))
    path.touch()
    spec = tf_gym.spec_of(made()).model_copy(update={"algorithm": "PPPO"})
    path.with_suffix(".json").write_text(spec.model_dump_json())
    with pytest.raises(ConfigError, match="unknown 'PPPO', did you mean 'PPO'"):
        policy_entry(str(path))
    with pytest.raises(ConfigError, match="the policy"):
        PolicyController(spec, Rule(), load_testcase("house:2rooms").layout, name="rule")


def test_files_of_policies_call_the_lowest_level_as_those_of_before_do() -> None:
    spec = tf_gym.spec_of(made())
    written = json.loads(spec.model_dump_json())
    assert written["lowest"] == list(spec.u_min)
    assert "u_min" not in written
    assert PolicySpec.model_validate(written) == spec


@pytest.mark.slow
def test_the_documented_lines_train_save_and_run_a_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("stable_baselines3")
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "gym.md").read_text(encoding="utf-8")
    block = next(block for block in page.split("```python\n") if "gym.save" in block).split("```")[0]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "gym", None)  # else this folder stands in for the package of that name
    exec(block.replace("200_000", "64"), {})
    assert json.loads((tmp_path / "policy.json").read_text())["algorithm"] == "PPO"
    words = ("run", "--testcase", _TESTCASE, "--controller", "policy.zip", "--baselines", "", "--days", "1")
    done = CliRunner().invoke(cli, [*words, "--out", "run"])
    assert done.exit_code == 0, done.output
    assert "policy.zip" in done.output
    reasons = (tmp_path / "run" / "steps.csv").read_text()
    assert "the policy's levels" in reasons
