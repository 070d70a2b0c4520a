"""Environments over plants: Gymnasium's checker, conventions, seeds, vectors, snapshot and branch."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import ConfigError, InputError
from thermoforce_mpc.gym import ID
from thermoforce_mpc.gym.env import BuildingEnv, Episodes
from thermoforce_mpc.plants.embedded import EmbeddedPlant

_DAY = {"max_episode_length": DAY_S, "random_start_time": False, "start_time": 16 * DAY_S}


def made(**options: object) -> BuildingEnv:
    env = gymnasium.make(ID, **{**_DAY, **options}).unwrapped
    assert isinstance(env, BuildingEnv)
    return env


def rewards(env: BuildingEnv, actions: np.ndarray) -> list[float]:
    return [env.step(action)[1] for action in actions]


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"random_start_time": True, "regressive_period": 3600.0, "scenario": {"electricity_price": "dynamic"}},
        {"testcase": "house:2rooms", "forecast_every": 1800.0},
        {"convention": "boptest"},
    ],
)
def test_passes_gymnasiums_checker(options: dict[str, object]) -> None:
    check_env(made(**options))


def test_rewards_sum_to_the_kpis_of_the_plant() -> None:
    env = made(discomfort_weight=3.0)
    env.reset(seed=1)
    given = sum(rewards(env, np.full((96, 1), 0.1, np.float32)))
    plant = EmbeddedPlant(synthetic_weather())
    plant.reset(16 * DAY_S, DAY_S)
    for _ in range(96):
        plant.advance(float(np.float32(0.1)), 900.0)
    kpis = plant.kpis()
    assert kpis["tdis_tot"] > 0.1
    assert given == pytest.approx(-(kpis["cost_tot"] + 3.0 * kpis["tdis_tot"]), rel=1e-9)


def test_observation_holds_measurement_past_and_forecast_by_name() -> None:
    env = made(regressive_period=1800.0, predictive_period=2 * 3600.0)
    first, _ = env.reset(seed=1)
    later = [env.step(np.array([level], np.float32))[0] for level in (1.0, 0.25, 0.0)]
    named = dict(zip(env.observations, later[-1], strict=True))
    before = dict(zip(env.observations, later[-2], strict=True))
    start = dict(zip(env.observations, first, strict=True))
    assert named["T_zone_C-900s"] == before["T_zone_C"]
    assert [named["u"], named["u-900s"], named["u-1800s"]] == [0.0, 0.25, 1.0]
    plant = EmbeddedPlant(synthetic_weather())
    plant.reset(16 * DAY_S, DAY_S)
    for level in (1.0, 0.25, 0.0):
        plant.advance(level, 900.0)
    coming = plant.forecast(2 * 3600.0, 3600.0)
    assert named["T_out_C+3600s"] == pytest.approx(coming.T_out_C[1], rel=1e-6)
    assert named["lower_C+7200s"] == coming.lower_C[0, 2]
    assert start["hour_cos"] == 1.0
    assert named["hour_sin"] == pytest.approx(np.sin(2 * np.pi * 0.75 / 24), rel=1e-6)


def test_seed_determines_the_episode() -> None:
    first, second = (made(random_start_time=True) for _ in range(2))
    actions = np.random.default_rng(1).random((20, 1), dtype=np.float32)
    a, _ = first.reset(seed=7)
    first.reset()
    again, _ = first.reset(seed=7)
    b, _ = second.reset(seed=7)
    assert (a == again).all()
    assert (a == b).all()
    assert rewards(first, actions) == rewards(second, actions)
    assert {made_start(second) for _ in range(5)} > {second.start_time}


def made_start(env: BuildingEnv) -> float:
    env.reset()
    return env.start_time


def test_drawn_starts_keep_clear_of_excluded_periods_and_the_year() -> None:
    excluded = [(10 * DAY_S, 200 * DAY_S), (203 * DAY_S, 365 * DAY_S)]
    episodes = Episodes(
        max_episode_length=2 * DAY_S, random_start_time=True, excluding_periods=excluded, behind=DAY_S, ahead=DAY_S
    )
    starts = episodes.possible_starts
    assert starts.min() == DAY_S
    assert starts.max() == 201 * DAY_S
    late = (starts > 8 * DAY_S) & (starts < 200 * DAY_S)
    assert not late.any()
    with pytest.raises(ConfigError, match="excluding_periods"):
        Episodes(max_episode_length=12 * DAY_S, random_start_time=True, excluding_periods=excluded)


@pytest.mark.parametrize("period", [(285 * DAY_S, 105 * DAY_S), (0.0, float("nan")), (0.0,), 5.0, "ab", ("0", "1")])
def test_an_excluded_period_that_is_none_is_refused(period: object) -> None:
    with pytest.raises(ConfigError, match=r"excluding_periods.*two of them"):
        Episodes(random_start_time=True, excluding_periods=[period])  # type: ignore[list-item]


@pytest.mark.parametrize("name", ["predictive_period", "regressive_period"])
def test_a_length_without_end_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name}: inf"):
        made(**{name: float("inf")}, random_start_time=True)


@pytest.mark.slow
def test_branch_leaves_the_episode_alone_and_restore_repeats_it() -> None:
    for options in ({"regressive_period": 3600.0}, {"testcase": "house:2rooms"}, {"convention": "boptest"}):
        env = made(**options)
        env.reset(seed=1)
        n = env.action_space.shape[0]  # type: ignore[index]
        rewards(env, np.full((10, n), 0.5, np.float32))
        here, other = env.snapshot(), env.branch()
        off = rewards(other, np.zeros((10, n), np.float32))
        full = rewards(env, np.ones((10, n), np.float32))
        assert full != off
        env.restore(here)
        assert len(env.episode_rewards) == 10
        assert rewards(env, np.ones((10, n), np.float32)) == full
        env.restore(here)
        assert rewards(env, np.zeros((10, n), np.float32)) == off


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectors_give_what_single_environments_give(mode: str) -> None:
    together = gymnasium.make_vec(ID, num_envs=2, vectorization_mode=mode, **{**_DAY, "random_start_time": True})
    try:
        seen, _ = together.reset(seed=3)
        action = np.full((2, 1), 0.5, np.float32)
        for _ in range(3):
            stepped, reward, *_ = together.step(action)
    finally:
        together.close()
    for i in range(2):
        env = made(random_start_time=True)
        alone, _ = env.reset(seed=3 + i)
        assert (seen[i] == alone).all()
        for _ in range(3):
            alone, given, *_ = env.step(action[i])
        assert (stepped[i] == alone).all()
        assert reward[i] == given


def test_episode_ends_in_time_and_asks_for_a_reset() -> None:
    env = made()
    env.reset(seed=1)
    ends = [env.step(np.array([0.0], np.float32))[2:4] for _ in range(96)]
    assert ends[-1] == (False, True)
    assert not any(any(end) for end in ends[:-1])
    with pytest.raises(ResetNeeded):
        env.step(np.array([0.0], np.float32))


@pytest.mark.parametrize(("start", "error"), [("noon", ConfigError), (-900.0, ConfigError), (1e9, InputError)])
def test_after_a_start_that_was_refused_no_episode_runs(start: object, error: type[Exception]) -> None:
    env = made()
    env.reset(seed=1)
    with pytest.raises(error, match="start"):
        env.reset(options={"start_time": start})
    if error is InputError:  # only the plant knew
        with pytest.raises(ResetNeeded):
            env.step(np.array([0.0], np.float32))
    else:
        assert env.start_time == 16 * DAY_S


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"testcase": "house:0rooms"}, "house:Nrooms"),
        ({"testcase": "bestest_air"}, "by room set-points, not by levels"),
        ({"testcase": "singlezone_commercial_hydronic"}, "no embedded plant implements"),
        ({"convention": "bopted"}, "convention"),
        ({"step_period": 1.0}, "step_period"),
        ({"forecast_every": 1000.0}, "forecast_every"),
        ({"scenario": {"price": "dynamic"}, "url": None}, "unknown key 'price'"),
        ({"convention": "boptest", "actions": ["oveHeatPumY_u"]}, "did you mean 'oveHeaPumY_u'"),
        ({"convention": "boptest", "observations": {"reaTZone_y": (280, 310)}}, "did you mean 'reaTZon_y'"),
        ({"convention": "boptest", "observations": {"TDryBul": (265, 303)}}, "predictive_period"),
        ({"convention": "boptest", "observations": {"reaTZon_y": (310, 280)}}, "low < high"),
        ({"convention": "boptest", "regressive_period": 0.0}, "regressive_period"),
        ({"convention": "boptest", "testcase": "singlezone_commercial_hydronic"}, "BoptestGymEnv"),
    ],
)
def test_wrong_arguments_are_named(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        made(**options).reset()


def test_actions_outside_the_limits_are_clipped_and_nonsense_is_refused() -> None:
    env = made()
    env.reset(seed=1)
    assert env.step(np.array([7.0]))[0][env.observations.index("u")] == 1.0
    for wrong in (np.array([np.nan]), np.zeros(2), "on"):
        with pytest.raises((ConfigError, ValueError)):
            env.step(wrong)


def test_picture_of_an_episode() -> None:
    env = made(render_mode="rgb_array")
    env.reset(seed=1)
    rewards(env, np.full((4, 1), 0.5, np.float32))
    first = env.render()
    assert first is not None
    assert first.shape[2] == 3
    rewards(env, np.zeros((4, 1), np.float32))
    assert not np.array_equal(first, env.render())


@pytest.mark.slow
def test_an_fmu_gives_what_the_emulator_inside_gives(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    pytest.importorskip("pythonfmu")
    from benchmarks.chaos.fmu.building import build_house

    options = {"start_time": 16 * DAY_S, "warmup_period": 3600.0, "max_episode_length": 1800.0}
    far, near = made(fmu=str(build_house(tmp_path)), **options), made(**options)
    try:
        for a, b in [(far.reset(seed=1)[0], near.reset(seed=1)[0])] + [
            (far.step(action)[0], near.step(action)[0]) for action in (np.ones(1), np.zeros(1))
        ]:
            np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-3)
        with pytest.raises(ConfigError, match="cannot be branched"):
            far.snapshot()
    finally:
        far.close()
