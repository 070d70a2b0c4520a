"""Rooms as thermal networks whose parameters are known, and what their sensors would have read."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from houses import weather
from scipy.linalg import expm

from thermoforce_mpc.data import Layout, Names
from thermoforce_mpc.identification.network.estimate import RoomFit, RoomRun
from thermoforce_mpc.identification.network.room import RoomNetwork
from thermoforce_mpc.model.free_response.rc import INPUTS, weather_inputs

Rule = Callable[[float, float], float]
"""Level of an actuator from the hour and the temperature that is read, °C."""

# Two rooms of a building, the second with two actuators.
AREA_M2 = (20.0, 30.0)
LAYOUT = Layout(
    Names(("bath", "hall"), ("radiator", "floor", "fan"), ("boiler", "chiller")),
    signs=(1, 1, -1),
    home=(0, 1, 1),
    machine_of=(0, 0, 1),
    u_min=(0.0, 0.0, 0.0),
    shares=(0.5, 0.5, 0.0),
    floor_area_m2=AREA_M2,
)
ROOMS = (RoomNetwork(neighbours=1), RoomNetwork((1, -1), (float("nan"),) * 2, neighbours=1))


class KnownFit(RoomFit):
    """A room at θ, of whose parameters the covariance (p, p), or one variance of all, is the same everywhere."""

    def __init__(
        self, room: RoomNetwork, theta: np.ndarray, covariance: np.ndarray | float, runs: Sequence[RoomRun] = ()
    ) -> None:
        super().__init__(room, theta, 0.0, runs)
        everywhere = covariance if isinstance(covariance, np.ndarray) else covariance * np.eye(theta.size)
        self.__dict__["everywhere"] = everywhere

    def covariance_at(self, theta: np.ndarray) -> np.ndarray:
        return self.__dict__["everywhere"]

    def posterior(self, theta: np.ndarray) -> tuple[float, np.ndarray]:
        slope = np.linalg.solve(self.__dict__["everywhere"], theta - self.theta)
        return 0.5 * float(slope @ (theta - self.theta)), slope


def theta_of(room: RoomNetwork, **values: float) -> np.ndarray:
    """Parameters at the prior's medians, but for the positive ones that are given."""
    theta = room.mean.copy()
    for name, value in values.items():
        theta[room.place[name]] = np.log(value)
    return theta


def random_theta(room: RoomNetwork, rng: np.random.Generator, sd: float = 1.0) -> np.ndarray:
    """Parameters drawn from the prior, `sd` times as wide."""
    return room.mean + sd * room.sd * rng.normal(size=room.mean.size)


def transition(room: RoomNetwork, theta: np.ndarray, step_h: float) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and B (n, m) of a step."""
    n, m = room.n_states, room.n_inputs
    whole = expm(step_h * np.vstack([room.equations(theta).matrix, np.zeros((m, n + m))]))
    return whole[:n, :n], whole[:n, n:]


def effect_K(room: RoomNetwork, theta: np.ndarray, hours: float, actuator: int = 0) -> float:
    """What full level of an actuator does to the room after some hours, K, its neighbours held."""
    return float(transition(room, theta, hours)[1][0, room.drive(actuator)])


def simulated(
    room: RoomNetwork, theta: np.ndarray, rules: tuple[Rule, ...], days: float, seed: int, step_h: float = 0.25
) -> RoomRun:
    """A run of the room from a steady state, with its disturbances, while `rules` answer what its sensor reads."""
    rng = np.random.default_rng(seed)
    time_s, T_out_C, solar = weather(days, 3600.0 * step_h, seed)
    N, n, drives = time_s.size, room.n_states, slice(room.drive(0), room.drive(len(room.signs)))
    inputs = np.zeros((N, room.n_inputs))
    inputs[:-1, : len(INPUTS)] = weather_inputs(time_s, T_out_C, solar)
    hours = time_s[:, None] / 3600.0
    inputs[:, len(INPUTS) : drives.start] = 20.0 + np.sin(hours / (5.0 + np.arange(room.neighbours)))
    A, B = transition(room, theta, step_h)
    Q, stationary, reading = room.noise(theta, step_h)
    x, readings = np.full(n, 19.0), np.empty(N)
    x[room.disturbances] = rng.normal(size=stationary.size) * np.sqrt(stationary)
    for k in range(N):
        readings[k] = x[0] + np.sqrt(reading) * rng.normal()
        inputs[k, drives] = [rule(float(hours[k, 0]), readings[k]) for rule in rules]
        x = A @ x + B @ inputs[k] + np.sqrt(Q) * rng.normal(size=n)
    return RoomRun(inputs, readings, step_h)


def with_gap(run: RoomRun, *places: slice) -> RoomRun:
    """The run without its readings at some places."""
    readings = run.readings.copy()
    for place in places:
        readings[place] = np.nan
    return RoomRun(run.inputs, readings, run.step_h, run.rounding_K2, run.pair)
