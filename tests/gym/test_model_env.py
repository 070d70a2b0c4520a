"""Environments over the identified model: the record with its own actions, and what others add by the operator."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from simple_house import FIXED_W, PER_U_W, SimpleHouse, bounds_C, simple_model

from thermoforce_mpc.data import Boundary, Observation
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym import ModelVectorEnv

DAYS = 3


@pytest.fixture(scope="module")
def record():
    house = SimpleHouse()
    house.reset(10 * 86400.0, DAYS * 86400.0)
    return house.past(3600.0)


def environment(record, model=None, **options) -> ModelVectorEnv:
    lower, upper = bounds_C(record.time_s)
    given = {"max_episode_length": 86400.0, "num_envs": 4, "area_m2": 100.0} | options
    bounds = {"lower_C": lower[None], "upper_C": upper[None]}
    return ModelVectorEnv(model or simple_model(), record, **bounds, price_per_kWh=0.25, **given)


def zone(env, seen):
    return seen[:, [name.startswith("T_zone") for name, _ in env.policy_spec.entries]][:, 0]


def test_with_the_actions_of_the_record_its_temperatures_come_back(record):
    env = environment(record)
    seen, _ = env.reset(seed=1, options={"start": 5})
    np.testing.assert_allclose(zone(env, seen), record.T_zone_C[0, 5], rtol=1e-6)
    for k in range(5, 28):
        seen, reward, terminated, truncated, _ = env.step(np.full((4, 1), record.u[0, k]))
        np.testing.assert_allclose(zone(env, seen), record.T_zone_C[0, k + 1], rtol=1e-6)
        power_W = (FIXED_W + PER_U_W) * record.u[0, k]  # in blocks, a share of the step at full level
        lower, upper = bounds_C(record.time_s[k + 1])
        beyond = max(lower - record.T_zone_C[0, k + 1], record.T_zone_C[0, k + 1] - upper, 0.0)
        np.testing.assert_allclose(reward, -(0.25 * power_W / 1000.0 / 100.0 + beyond), rtol=1e-4, atol=1e-6)
        assert not terminated.any()
        assert truncated.all() == (k == 28), "a day"


def test_other_actions_add_what_the_operator_says(record):
    pair = simple_model().operator.of_actuator(0)
    env = environment(record, num_envs=2)
    env.reset(options={"start": 0})
    for _ in range(12):
        seen, *_ = env.step(np.array([[0.0], [1.0]]))
    assert zone(env, seen)[1] - zone(env, seen)[0] == pytest.approx(pair.impulse(12).sum(), rel=1e-5)


def test_an_agent_sees_what_its_policy_sees_in_a_run(record):
    env = environment(record, predictive_period=4 * 3600.0, forecast_every=2 * 3600.0)
    env.reset(options={"start": 30})
    seen, *_ = env.step(np.full((4, 1), record.u[0, 30]))
    k = 31
    ahead = slice(k, k + 6)
    lower, upper = bounds_C(record.time_s[ahead])
    same = np.ones(6)
    boundary = Boundary(
        record.time_s[ahead], record.T_out_C[ahead], record.solar_W_m2[ahead], 0 * same, lower, upper, 0.25 * same, same
    )
    told = env.policy_spec.observe(Observation(record.slice(0, k), boundary))
    np.testing.assert_allclose(seen[0], told, rtol=1e-5)
    assert env.single_observation_space.contains(seen[0])


def test_a_truncated_episode_begins_anew_in_the_next_step(record):
    env = environment(record)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first, _ = env.reset(seed=3)
    again, _ = environment(record).reset(seed=3)
    np.testing.assert_array_equal(first, again)
    for k in range(25):
        seen, reward, _, truncated, _ = env.step(np.zeros((4, 1)))
        assert truncated.all() == (k == 23)
    assert (reward == 0.0).all()
    assert env.observation_space.contains(seen)


def test_what_cannot_be_counted_is_refused(record):
    with pytest.raises(ConfigError, match="no power model"):
        environment(record, replace(simple_model(), power=(None,)))
    with pytest.raises(ConfigError, match=r"the record has 72"):
        environment(record, max_episode_length=4 * 86400.0)
    with pytest.raises(ConfigError, match="floor area"):
        environment(record, area_m2=None)


def test_fifty_thousand_steps_a_second(record):
    env = environment(record, num_envs=512)
    env.reset(seed=1)
    actions = env.action_space.sample()
    began, n = time.process_time(), 0
    while time.process_time() - began < 0.2:
        env.step(actions)
        n += env.num_envs
    assert n / (time.process_time() - began) > 50_000
