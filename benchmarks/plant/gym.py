"""Benchmark of the Gymnasium environments: steps per second beside the same environment over REST."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import gymnasium
import numpy as np

from boptest_client import BoptestClient
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.gym import ID

_TESTCASE = "bestest_hydronic_heat_pump"
_START_S = 16 * DAY_S
_WEEK = {"start_time": _START_S, "max_episode_length": 120 * DAY_S, "step_period": 900.0, "random_start_time": False}
# The observation of BOPTEST-Gym's own example, besides the zone temperature alone.
_EXAMPLE: dict[str, Any] = {
    "observations": {
        "time": (0, 604800), "reaTZon_y": (280.0, 310.0), "TDryBul": (265, 303), "HDirNor": (0, 862),
        "InternalGainsRad[1]": (0, 219), "PriceElectricPowerHighlyDynamic": (-0.4, 0.4),
        "LowerSetp[1]": (280.0, 310.0), "UpperSetp[1]": (280.0, 310.0),
    },
    "predictive_period": 24 * HOUR_S,
    "regressive_period": 6 * HOUR_S,
    "warmup_period": DAY_S,
}  # fmt: skip

Progress = Callable[[str], None]


def run_gym_bench(*, quick: bool = False, progress: Progress = lambda line: None) -> dict[str, Any]:
    """Time steps of 15 min of environments in turn, several rounds, and report the best round of each.

    A REST step of an environment is `POST advance` and `GET kpi` (the reward), with the requests of its observation;
    the service is `tf-mpc serve` on this machine in a process of its own.
    """
    # Short turns, of which each environment finds some on a busy machine that nothing interrupts.
    rounds, far, near = (10, 10, 60) if quick else (40, 20, 120)
    with _service() as url:
        made: dict[str, tuple[Callable[[int], None], int]] = {}
        opened: list[Any] = []

        def add(name: str, steps: int, **options: Any) -> None:
            progress(f"building: {name}")
            env = gymnasium.make(ID, **{**_WEEK, **options})
            opened.append(env)
            made[name] = (_Stepped(env), steps)

        client = BoptestClient(url, _TESTCASE)
        client.initialize(_START_S, 0.0)
        client.set_step(900.0)
        made["one POST advance, no environment"] = (partial(_advances, client), far)
        add("BOPTEST points over REST", far, convention="boptest", url=url)
        add("BOPTEST points, embedded", near, convention="boptest")
        add("BOPTEST-Gym's example over REST", far // 2, convention="boptest", url=url, **_EXAMPLE)
        add("BOPTEST-Gym's example, embedded", near, convention="boptest", **_EXAMPLE)
        add("levels, embedded", near)
        add("levels, house:5rooms", near // 2, testcase="house:5rooms")
        for mode, n in (("sync", 8), ("async", 2)):
            progress(f"building: {n} environments, {mode}")
            # Spawned: a fork would take the signal handlers of the command line along.
            options: dict[str, Any] = {"vector_kwargs": {"context": "spawn"} if mode == "async" else {}, **_WEEK}
            several = gymnasium.make_vec(ID, num_envs=n, vectorization_mode=mode, **options)
            opened.append(several)
            made[f"levels, embedded, {n} together ({mode})"] = (_Stepped(several), near // n)
        seconds: dict[str, list[float]] = {name: [] for name in made}
        for i in range(rounds):
            if i % 10 == 9:
                progress(f"round {i + 1} of {rounds}")
            for name, (advance, steps) in made.items():
                advance(2)
                began = time.perf_counter()
                advance(steps)
                together = next((n for n in (8, 2) if f", {n} together" in name), 1)
                seconds[name].append((time.perf_counter() - began) / steps / together)
        branching_s = _branching(opened[4].unwrapped)
        for one in opened:
            one.close()
        client.stop()
    return _result(seconds, branching_s)


def _result(seconds: Mapping[str, list[float]], branching_s: float) -> dict[str, Any]:
    best = {name: min(values) for name, values in seconds.items()}
    base = best["one POST advance, no environment"]

    rows: list[dict[str, Any]] = [
        {
            "environment": name,
            "steps_per_s": 1.0 / value,
            "ms_per_step": 1e3 * value,
            "times_one_advance": base / value,
        }
        for name, value in best.items()
    ]
    rows.append({"what": "snapshot, branch and one step of the branch, after a week", "ms": 1e3 * branching_s})
    targets = [
        Target(
            "embedded over REST, same environment (advance and KPIs)",
            best["BOPTEST points over REST"] / best["BOPTEST points, embedded"],
            20.0,
            "at least",
        ),
        Target(
            "embedded over REST, observation of BOPTEST-Gym's example",
            best["BOPTEST-Gym's example over REST"] / best["BOPTEST-Gym's example, embedded"],
            20.0,
            "at least",
        ),
        Target("embedded over one POST advance alone", base / best["BOPTEST points, embedded"], 20.0, "at least"),
    ]
    return results_json("gym", rows, targets)


class _Stepped:
    """An environment, or several together, stepped with one action; it is reset at its first step."""

    def __init__(self, env: Any) -> None:
        self._env, self._begun = env, False
        self._action = np.full(env.action_space.shape, 0.5, dtype=np.float32)

    def __call__(self, steps: int) -> None:
        if not self._begun:
            self._env.reset(seed=1)
            self._begun = True
        for _ in range(steps):
            self._env.step(self._action)


def _advances(client: BoptestClient, steps: int) -> None:
    for _ in range(steps):
        client.advance({"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1.0})


def _branching(env: Any) -> float:
    """Time of a snapshot with a branch that takes a step, s, median of 20."""
    env.reset(seed=1)
    action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
    for _ in range(7 * 96):
        env.step(action)
    times = []
    for _ in range(20):
        began = time.perf_counter()
        env.restore(env.snapshot())
        env.branch().step(action)
        times.append(time.perf_counter() - began)
    return float(np.median(times))


@contextmanager
def _service() -> Iterator[str]:
    """`tf-mpc serve` on a free port of this machine, in another process."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there,), daemon=True)
    process.start()
    try:
        with closing(here):
            if not here.poll(120.0):
                raise TimeoutError("the service did not start within 120 s")
            port = here.recv()
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.join()


def _serve(told: Connection) -> None:
    from thermoforce_mpc.service.server import build_server, effective_port

    server = build_server(synthetic_weather(), port=0)
    told.send(effective_port(server))
    server.run()
