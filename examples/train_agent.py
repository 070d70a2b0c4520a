"""Train a small reinforcement-learning agent (PPO of Stable-Baselines3), then put it beside the thermostat and the MPC.

    pip install -e '.[rl]'
    python examples/train_agent.py                       # some minutes on one core
    python examples/train_agent.py --steps 4000 --days 1 --without-mpc

The agent switches the heat pump of the embedded test case on or off every hour. It is trained on random weeks of
the heating season outside the two windows in which all are then judged: two weeks each after a week of native control.
"""

import argparse
import time

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import thermoforce_mpc as tf
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.gym import ID
from thermoforce_mpc.gym.wrappers import DiscretizedActionWrapper
from thermoforce_mpc.plants.embedded import EmbeddedPlant

DAY_S = 86400.0
TESTCASE = "bestest_hydronic_heat_pump"
SUMMER = (173 * DAY_S, 266 * DAY_S)  # nothing to heat, nothing to learn


def environment(**episodes):
    seen = {"predictive_period": 12 * 3600, "regressive_period": 6 * 3600, "step_period": 3600}
    env = gymnasium.make(ID, testcase=TESTCASE, **seen, **episodes)
    return DiscretizedActionWrapper(env, n_bins_act=1)  # off or full level


def trained(steps, windows, seed):
    excluded = [SUMMER, *((window.start_s, window.start_s + window.scored_s) for window in windows.values())]
    options = {"random_start_time": True, "excluding_periods": excluded, "max_episode_length": 7 * DAY_S}
    several = DummyVecEnv([lambda: environment(**options)] * 4)
    several = VecNormalize(several, gamma=0.98)
    agent = PPO(
        "MlpPolicy", several, seed=seed, gamma=0.98, n_steps=168, batch_size=168, n_epochs=8, learning_rate=5e-4,
        device="cpu",
    )  # fmt: skip
    began = time.perf_counter()
    agent.learn(steps)
    return agent, several, time.perf_counter() - began


def judged(agent, scaling, window, days):
    env = environment(
        start_time=window.start_s, random_start_time=False, warmup_period=7 * DAY_S, max_episode_length=days * DAY_S
    )
    observation, _ = env.reset(seed=0)
    torch.manual_seed(0)
    over, spent, steps = False, 0.0, 0
    while not over:
        began = time.perf_counter()
        # Drawn as in training: the likelier of on and off alone would stay off where a third of the time is right.
        action, _ = agent.predict(scaling.normalize_obs(observation), deterministic=False)
        spent, steps = spent + time.perf_counter() - began, steps + 1
        observation, _, _, over, _ = env.step(action)
    return env.unwrapped.get_kpis() | {"ms": 1e3 * spent / steps}


def main(steps, days, seed, with_mpc):
    torch.set_num_threads(1)
    plant = EmbeddedPlant(synthetic_weather())
    windows = {name: plant.period(name) for name in ("peak_heat_day", "typical_heat_day")}
    agent, scaling, seconds = trained(steps, windows, seed)
    print(f"trained on {agent.num_timesteps} steps ({agent.num_timesteps / 24:.0f} days) in {seconds:.0f} s")
    first, *others = ["thermoforce_mpc", "thermostat", "native"] if with_mpc else ["thermostat", "native"]
    for name, window in windows.items():
        rows = {"agent": judged(agent, scaling, window, days)}
        rows |= tf.run(TESTCASE, controller=first, baselines=others, period=name, days=days, progress=False).kpis
        print(f"\n{name}, {days:g} days from day {window.start_s / DAY_S:g}: EUR/m², K·h, ms per step")
        for who, kpis in rows.items():
            spent = kpis.get("ms", 900e3 * kpis["time_rat"] if "time_rat" in kpis else float("nan"))
            print(f"  {who:16s} {kpis['cost_tot']:.4f}  {kpis['tdis_tot']:6.2f}  {spent:8.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="steps of training")
    parser.add_argument("--days", type=float, default=14.0, help="days of each window")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--without-mpc", action="store_true", help="leave out probing and MPC")
    given = parser.parse_args()
    main(given.steps, given.days, given.seed, not given.without_mpc)
