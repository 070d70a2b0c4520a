"""Many environments at once whose plant is the identified model: the superposition of free and forced response."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from controllers.policy.trained import FORECAST, SIGNALS, PolicySpec
from thermoforce_mpc.data import HOUR_S, Array, Record, cost_per_W
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.names import check_same_building
from thermoforce_mpc.data.series import interpolated
from thermoforce_mpc.data.superposition import compose, control_free
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.model.forced_state import forced_history
from thermoforce_mpc.model.operator.parameters import feature_matrix
from thermoforce_mpc.model.thermal_model import ThermalModel

# The model knows no persons.
_SEEN = [name for name in SIGNALS if name != "forecast_occupancy"]


class ModelVectorEnv(VectorEnv[Any, Any, Any]):
    """Environments over a record of a building: weather and free response as they were, what actions add by the model.

    An episode begins anywhere in the record with the forced state of that instant; with the record's own actions it
    repeats the record, as far as the model holds. Actions, observations and reward are those of `BuildingEnv` by
    levels, without persons; a forecast is the record's course. An environment that was truncated begins anew in the
    next step, whose action does not count (`AutoresetMode.NEXT_STEP`).

    Args:
        model: identified model with the power of every machine.
        record: a week or more of its building, at the step of the environment.
        lower_C, upper_C: comfort bounds, °C, one number or (Z, n + 1) at the record's instants.
        price_per_kWh: currency/kWh, one number or (M, n + 1).
        area_m2: floor area to which costs are related; by default the model's.
        num_envs: number of environments.
        max_episode_length, predictive_period, forecast_every: s, as of `thermoforce_mpc/Building-v0`.
        discomfort_weight: weight of a K·h, currency/m².
        part_load: what a level is, `blocks` or `held`, see `thermoforce_mpc.model.exported`.

    Raises:
        ConfigError: a power is not known, a machine feeds several actuators, or an episode is longer than the record.
        DataError: the record is of another building, or has a signal without any value.
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012 - Gymnasium's interface

    def __init__(
        self,
        model: ThermalModel,
        record: Record,
        *,
        lower_C: float | Array,
        upper_C: float | Array,
        price_per_kWh: float | Array,
        area_m2: float | None = None,
        num_envs: int = 64,
        max_episode_length: float = 7 * 86400.0,
        predictive_period: float = 0.0,
        forecast_every: float = 3600.0,
        discomfort_weight: float = 1.0,
        part_load: Literal["blocks", "held"] = "blocks",
    ) -> None:
        check_same_building("the model", model.names, "the record", record.names, single_alike=True)
        layout, step_s, n = model.layout, record.step_s, record.n_steps
        for m, machine in enumerate(model.machines):
            if len(layout.fed_by(m)) != 1 or model.power[m] is None:
                why = "feeds several actuators" if len(layout.fed_by(m)) != 1 else "has no power model"
                raise ConfigError(f"machine {machine} {why}: this environment counts the cost of one actuator each")
        area = float(np.sum(model.floor_area_m2)) if area_m2 is None else area_m2
        if not area > 0:
            raise ConfigError(f"area_m2: {area}: the model does not know the floor area; give it")
        self._n = round(max_episode_length / step_s)
        if not 1 <= self._n <= n:
            raise ConfigError(f"max_episode_length: {self._n} steps; the record has {n}, at least 1 is needed")
        self.num_envs, self._step_s, self._weight = num_envs, step_s, discomfort_weight
        blocks = part_load == "blocks"
        self._operator = model.operator.resampled(step_s)
        self._pairs = self._operator.of_actuators
        heat = [one.heat_input for one in self._pairs]
        self._heat = [of.at_lowest_level(1.0) if blocks else of for of in heat]
        powers = [power.at_lowest_level(1.0) if blocks else power for power in model.power if power]
        self._machine_of, self._home = list(layout.machine_of), list(layout.home)
        self._power = [powers[m] for m in self._machine_of]
        rooms = model.in_rooms(record)
        self._start = np.moveaxis(forced_history(self._operator, rooms), 2, 0)
        measured = np.stack([interpolated(of) for of in rooms.T_zone_C]).T
        self._T_free = control_free(measured, self._start.sum(axis=(2, 3)))
        Z, A, M = len(layout.names.zones), len(self._pairs), len(powers)
        self._T_out, solar = interpolated(record.T_out_C), interpolated(record.solar_W_m2)
        bounds = [np.broadcast_to(np.asarray(of, dtype=np.float64), (Z, n + 1)) for of in (lower_C, upper_C)]
        price = np.broadcast_to(np.asarray(price_per_kWh, dtype=np.float64), (M, n + 1))
        self._lower, self._upper = bounds[0].T, bounds[1].T
        self._cost_per_W = cost_per_W(price[self._machine_of].T, step_s) / area
        self._features = np.stack(
            [feature_matrix(of, self._T_out, solar, record.time_s) for of in self._T_free.T], axis=1
        )
        self._gain = np.stack(
            [one.modulation(self._features[:, z]) for one, z in zip(self._pairs, self._home, strict=True)], axis=-1
        )
        self._feedback = any(one.feedback_active for one in self._pairs)
        seen = {"step_s": step_s, "ahead_s": predictive_period, "every_s": max(forecast_every, step_s)}
        self.policy_spec = PolicySpec(
            **asdict(layout.names), u_min=layout.u_min, **seen, observations=dict.fromkeys(_SEEN)
        )
        self.policy_spec.check()
        weather = np.stack([self._T_out, solar])
        rows = {"T_out_C": weather[:1], "solar_W_m2": weather[1:], "occupancy": np.zeros((Z, n + 1))}
        rows |= {"lower_C": bounds[0], "upper_C": bounds[1], "price_per_kWh": price}
        coming, offsets = np.concatenate([rows[name] for name in FORECAST]), self.policy_spec.offsets
        unknown = np.full((1, Z + A), np.nan)
        self._known = np.stack(
            [
                self.policy_spec.values(t, unknown, weather[:, k].tolist(), coming[:, np.minimum(k + offsets, n)])
                for k, t in enumerate(record.time_s)
            ]
        )
        self._own = np.flatnonzero(np.isnan(self._known[0]))  # zone temperatures, then levels
        low, high = np.array([of for _, of in self.policy_spec.entries], dtype=np.float32).T
        self.single_observation_space = gymnasium.spaces.Box(low, high)
        self._least = np.array(layout.u_min)
        self.single_action_space = gymnasium.spaces.Box(self._least.astype(np.float32), np.ones(A, dtype=np.float32))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._at = np.zeros(num_envs, dtype=np.intp)
        self._end = np.zeros(num_envs, dtype=np.intp)
        self._forced, self._u = self._start[self._at].copy(), np.zeros((num_envs, A))

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode in every environment; `options={"start": k}` begins all at the record's step k."""
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        self._begin(np.ones(self.num_envs, dtype=bool), (options or {}).get("start"))
        return self._observe(), {}

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Apply levels (num_envs, A) for a step; what is returned has a row or an entry for each environment."""
        over = self._at >= self._end
        u = np.clip(np.asarray(actions, dtype=np.float64), self._least, 1.0)
        k = np.minimum(self._at, len(self._T_out) - 2)
        T_out, gain = self._T_out[k], self._gain[k]
        if self._feedback:
            each = []
            for a, (one, z) in enumerate(zip(self._pairs, self._home, strict=True)):
                each.append(one.modulation(one.seen(self._features[k, z], self._forced[:, z, a])))
            gain = np.stack(each, axis=-1)
        heat = np.stack([of(u[:, a], T_out) for a, of in enumerate(self._heat)], axis=-1)
        self._forced = self._operator.poles * self._forced + self._operator.gains * (gain * heat)[:, None, :, None]
        self._at, self._u = k + 1, u
        power_W = np.stack([of(u[:, a], T_out) for a, of in enumerate(self._power)], axis=-1)
        cost = (self._cost_per_W[k] * power_W).sum(axis=-1)
        T_C = self._T_zone_C()
        beyond = excess(T_C, self._lower[self._at], self._upper[self._at])
        reward = -(cost + self._weight * beyond.mean(axis=-1) * self._step_s / HOUR_S)
        if over.any():
            self._begin(over, None)
            reward = np.where(over, 0.0, reward)
        return self._observe(), reward, np.zeros_like(over), (self._at >= self._end) & ~over, {}

    def _begin(self, which: NDArray[np.bool_], start: int | None) -> None:
        last = len(self._T_out) - 1 - self._n
        begin = self.np_random.integers(0, last + 1, which.sum()) if start is None else min(max(int(start), 0), last)
        self._at[which], self._u[which] = begin, 0.0
        self._end[which] = self._at[which] + self._n
        self._forced[which] = self._start[self._at[which]]

    def _T_zone_C(self) -> Array:
        return compose(self._T_free[self._at], self._forced.sum(axis=(2, 3)))

    def _observe(self) -> NDArray[np.float32]:
        seen = self._known[self._at]
        seen[:, self._own] = np.concatenate([self._T_zone_C(), self._u], axis=1)
        box = self.single_observation_space
        return np.clip(seen.astype(np.float32), box.low, box.high)  # type: ignore[attr-defined]
