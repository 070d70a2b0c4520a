"""Scripts written for BOPTEST-Gym, with their import line changed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from boptest_server import Fault, running_service

from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.gym.boptest import BoptestGymEnv, EmbeddedBoptestGymEnv
from thermoforce_mpc.gym.wrappers import DiscretizedActionWrapper, NormalizedActionWrapper, NormalizedObservationWrapper
from thermoforce_mpc.service.server import build_server, effective_port

# The flow of the quick start of github.com/ibpsa/project1-boptest-gym, written anew: an environment with time, a
# measurement and its past, and forecasts; normalised observations, eleven levels; learn, then one evaluated day.
THEIR_IMPORT = "from boptestGymEnv import BoptestGymEnv, NormalizedObservationWrapper, DiscretizedActionWrapper"
OUR_IMPORT = (
    "from thermoforce_mpc.gym.boptest import "
    "EmbeddedBoptestGymEnv as BoptestGymEnv, NormalizedObservationWrapper, DiscretizedActionWrapper"
)
SCRIPT = f"""
{THEIR_IMPORT}
from stable_baselines3 import DQN

service = "https://api.boptest.net"
building = BoptestGymEnv(
    url=service,
    testcase="bestest_hydronic_heat_pump",
    actions=["oveHeaPumY_u"],
    observations={{
        "time": (0, 7 * 86400),
        "reaTZon_y": (280.0, 310.0),
        "TDryBul": (265, 303),
        "HDirNor": (0, 862),
        "InternalGainsRad[1]": (0, 219),
        "PriceElectricPowerHighlyDynamic": (-0.4, 0.4),
        "LowerSetp[1]": (280.0, 310.0),
        "UpperSetp[1]": (280.0, 310.0),
    }},
    predictive_period=86400,
    regressive_period=6 * 3600,
    random_start_time=True,
    excluding_periods=[(16 * 86400, 30 * 86400), (108 * 86400, 122 * 86400)],
    max_episode_length=86400,
    warmup_period=86400,
    step_period=3600,
)
env = DiscretizedActionWrapper(NormalizedObservationWrapper(building), n_bins_act=10)
agent = DQN("MlpPolicy", env, batch_size=24, learning_starts=24, buffer_size=8760, seed=1)
agent.learn(total_timesteps=60)
seen, _ = env.reset()
over, total = False, 0.0
while not over:
    choice, _ = agent.predict(seen, deterministic=True)
    seen, reward, terminated, truncated, _ = env.step(choice)
    over, total = terminated or truncated, total + reward
kpis = env.unwrapped.get_kpis()
"""
OBSERVED = {
    "time": (0, 86400), "reaTZon_y": (280.0, 310.0), "reaPHeaPum_y": (0.0, 10000.0), "TDryBul": (250.0, 320.0),
    "LowerSetp[1]": (280.0, 310.0),
}  # fmt: skip
FLOW = {"predictive_period": 7200, "regressive_period": 3600, "start_time": 20 * 86400, "warmup_period": 86400}


@pytest.fixture(scope="module")
def service() -> Iterator[str]:
    server = build_server(synthetic_weather(), port=0)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{effective_port(server)}"
    server.close()
    thread.join(timeout=120.0)


def test_their_quick_start_runs_with_one_changed_line() -> None:
    pytest.importorskip("stable_baselines3")
    changed = SCRIPT.replace(THEIR_IMPORT, OUR_IMPORT)
    assert sum(a != b for a, b in zip(SCRIPT.splitlines(), changed.splitlines(), strict=True)) == 1
    names: dict[str, object] = {}
    exec(compile(changed, "quick_start", "exec"), names)
    kpis, total, seen = names["kpis"], names["total"], names["seen"]
    assert total == pytest.approx(-(kpis["cost_tot"] + kpis["tdis_tot"]), rel=1e-9)  # type: ignore[index]
    assert np.shape(seen) == (1 + 1 + 6 + 6 * 25,)


def test_service_and_emulator_give_the_same(service: str) -> None:
    far = BoptestGymEnv(service, observations=OBSERVED, **FLOW)
    near = EmbeddedBoptestGymEnv(service, observations=OBSERVED, **FLOW)
    assert far.observations == near.observations
    assert near.observations[3:8] == [
        "reaTZon_y_regr_900", "reaTZon_y_regr_1800", "reaTZon_y_regr_2700", "reaTZon_y_regr_3600",
        "reaPHeaPum_y_regr_900",
    ]  # fmt: skip
    assert near.observations[-1] == "LowerSetp[1]_pred_7200"
    seen = [env.reset(seed=1)[0] for env in (far, near)]
    np.testing.assert_allclose(*seen, rtol=1e-6)
    for level in (0.0, 1.0, 0.5, 0.5, 0.0):
        (a, first, *ends, _), (b, second, *others, _) = (env.step(np.array([level])) for env in (far, near))
        np.testing.assert_allclose(a, b, rtol=1e-6)
        assert first == pytest.approx(second, abs=1e-9)
        assert ends == others
    with pytest.raises(ConfigError, match="cannot be branched"):
        far.branch()
    far.stop()
    far.close()


@pytest.mark.usefixtures("unhurried")
def test_unknown_test_case_and_silent_service_are_named(service: str) -> None:
    with pytest.raises(ConfigError, match="bestest_hydronic_heat_pump"):
        BoptestGymEnv(service, "bestest_air")
    with pytest.raises(PlantError, match=r"127\.0\.0\.1:9"):
        BoptestGymEnv("http://127.0.0.1:9")


def test_derived_classes_change_reward_and_end() -> None:
    class Clipped(EmbeddedBoptestGymEnv):
        def get_reward(self) -> float:
            return float(np.sign(super().get_reward()))

        def compute_truncated(self, res: object, reward: float | None = None) -> bool:
            return super().compute_truncated(res, reward) or self.objective_integrand >= 0.01  # type: ignore[arg-type]

    env = Clipped(start_time=16 * 86400, max_episode_length=86400, warmup_period=86400)
    env.reset(seed=1)
    given = [env.step(np.array([1.0]))[1:4]]
    while not given[-1][2]:
        given.append(env.step(np.array([1.0]))[1:4])
    assert {reward for reward, *_ in given} == {-1.0}
    assert 1 < len(given) < 96


def test_wrappers_scale_and_count() -> None:
    env = EmbeddedBoptestGymEnv(actions=["oveHeaPumY_u", "oveFan_u"], max_episode_length=86400)
    scaled = NormalizedActionWrapper(NormalizedObservationWrapper(env))
    seen, _ = scaled.reset(seed=1)
    assert seen == pytest.approx(2 * (env.reset(seed=1)[0] - 280.0) / 30.0 - 1.0, abs=1e-5)
    assert scaled.action(np.array([-1.0, 0.5])) == pytest.approx([0.0, 0.75])
    binned = DiscretizedActionWrapper(env, n_bins_act=4)
    chosen = {tuple(binned.action(k)) for k in range(int(binned.action_space.n))}
    assert len(chosen) == 25
    assert binned.action(7) == pytest.approx([0.25, 0.5])


def test_episodes_are_drawn(tmp_path: Path) -> None:
    env = EmbeddedBoptestGymEnv(max_episode_length=1800, render_episodes=True, log_dir=str(tmp_path))
    env.reset(seed=1)
    env.step(np.array([0.5]))
    assert not list(tmp_path.iterdir())
    env.step(np.array([0.5]))
    assert (tmp_path / "episode_1.png").stat().st_size > 1000


@pytest.mark.usefixtures("unhurried")
def test_a_test_whose_points_cannot_be_read_is_stopped() -> None:
    with running_service() as service:
        service.faults.append(Fault("measurements/", "moved", times=99))
        with pytest.raises(PlantError, match="a redirect to"):
            BoptestGymEnv(service.url)
        assert len(service.stopped) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("testcase", "action", "room"),
    [("bestest_air", "fcu_oveFan_u", "zon_reaTRooAir_y"), ("bestest_hydronic", "oveTSetSup_u", "reaTRoo_y")],
)
def test_other_embedded_test_cases_by_their_own_points(testcase: str, action: str, room: str) -> None:
    env = EmbeddedBoptestGymEnv(testcase=testcase, actions=[action], start_time=20 * 86400, warmup_period=86400)
    seen, _ = env.reset(seed=1)
    assert env.observations == [room]
    assert 280.0 < seen[0] < 310.0
    for _ in range(4):
        after, reward, *_ = env.step(env.action_space.high)
    assert np.isfinite(reward)
    assert after[0] != seen[0]
