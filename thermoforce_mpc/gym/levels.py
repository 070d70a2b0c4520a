"""This package's own convention: levels of actuators in, temperatures, weather and forecasts in °C out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from gymnasium import spaces

from controllers.policy.trained import FORECAST, PolicySpec
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.gym.view import ObservationBox, View
from thermoforce_mpc.model.forecast_gaps import lengthened
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.scenario.testcase import TestCase


class LevelsView(View):
    """Any plant by the levels of its actuators.

    Actions (A,) are levels in [0, 1]. Observations, in this order: sine and cosine of the hour of the day; zone
    temperatures (Z), °C; outdoor temperature, °C; global irradiance, W/m²; mean levels of the last step (A); the zone
    temperatures and levels of earlier steps, latest first; and the forecast from now to `ahead_s` every `every_s` of
    outdoor temperature, irradiance, occupancy and comfort bounds (Z each) and price (M). `PolicySpec` puts them
    together, `spec` here.
    """

    changes = ("_now", "_past", "_table")

    def __init__(
        self,
        plant: Plant,
        testcase: TestCase,
        *,
        step_s: float,
        ahead_s: float,
        every_s: float,
        behind_s: float = 0.0,
        observations: Mapping[str, tuple[float, float] | None] | None = None,
        perfect: bool,
    ) -> None:
        """Look at a plant.

        Args:
            step_s: length of a step, s.
            ahead_s: length of the forecast, s.
            every_s: distance of its instants, s, a whole number of steps.
            behind_s: length of the past that is observed, s.
            observations: what is observed (`SIGNALS`), with its bounds, None for the default ones; by default all.
            perfect: forecasts depend on the time alone, so that those of an episode can be read at once.

        Raises `ConfigError` for actuators that take room set-points instead of levels, lengths that do not fit the
        step, or observations that there are not.
        """
        for name, value, least in (("predictive_period", ahead_s, 0.0), ("regressive_period", behind_s, 0.0)):
            if not (np.isfinite(value) and value >= least):
                raise ConfigError(f"{name}: {value!r} s: expected {least:g} s or more")
        if any(isinstance(point.actuator, RoomSetpoints) for point in testcase.points.actuators):
            raise ConfigError(
                f"test case '{testcase.name}' is run by room set-points, not by levels: choose convention='boptest' "
                "where their points are actions"
            )
        self.plant, self._layout, self._perfect = plant, testcase.layout, perfect
        self._step_s, self._ahead_s = step_s, ahead_s
        names, u_min = self._layout.names, self._layout.u_min
        chosen = {} if observations is None else {"observations": dict(observations)}
        seen = {"step_s": step_s, "ahead_s": ahead_s, "every_s": every_s, "behind_s": behind_s, **chosen}
        self.spec = validate(PolicySpec, {**asdict(names), "u_min": u_min, **seen}, "the environment")
        self.spec.check()
        self._behind, self.action_names = self.spec.n_behind, names.actuators
        self.action_space = spaces.Box(np.array(u_min, np.float32), np.ones(len(u_min), np.float32))
        self.box = ObservationBox.of(self.spec.entries)

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self._now.time_s

    def begin(self, start_s: float, warmup_s: float, length_s: float, scenario: Mapping[str, Any]) -> None:
        """See `View.begin`; raises `ConfigError` for another key in the scenario than `electricity_price`."""
        for unknown in sorted(set(scenario) - {"electricity_price"}):
            raise ConfigError(f"scenario: unknown key '{unknown}'; this convention knows electricity_price")
        price = scenario.get("electricity_price") or "constant"
        self._now = self.plant.reset(start_s, warmup_s, price)
        self._past = self.spec.past(self.plant.past(self._step_s), self._now.T_zone_C)
        if np.isnan(self._now.u).any():  # right after a reset, what the native control did in the step before
            self._now = replace(self._now, u=np.nan_to_num(self._past[0, len(self._now.T_zone_C) :]))
        self._table = (start_s, self._forecast(length_s + self._ahead_s)) if self._perfect else (start_s, np.empty(0))

    def act(self, action: Array) -> None:
        """Apply levels (A,) for one step; of actuators that exclude one another the one with the highest level acts."""
        levels: list[float | None] = [float(level) for level in action]
        for a in self._layout.excluded(levels) if self._layout.exclusive else ():
            levels[a] = 0.0
        self._now = self.plant.advance(levels, self._step_s)
        if self._behind:
            row = np.concatenate([self._now.T_zone_C, self._now.u])
            self._past = np.concatenate([row[None], self._past[:-1]])

    def observe(self) -> Array:
        """The observation now, in the order of the class's description."""
        now = self._now
        past = np.vstack([np.concatenate([now.T_zone_C, now.u]), self._past[1:]])
        return self.spec.values(now.time_s, past, (now.T_out_C, now.solar_W_m2), self._coming())

    def state(self) -> dict[str, float]:
        """Time, temperatures, levels and comfort bounds now."""
        names, coming = self._layout.names, self._coming()
        values = {"time": self.now_s, "T_out_C": float(self._now.T_out_C)}
        values |= {names.label("T_zone_C", z): float(T) for z, T in enumerate(self._now.T_zone_C)}
        zones = len(names.zones)
        for i, name in enumerate(("lower_C", "upper_C"), start=1):
            values |= {names.label(name, z): float(coming[2 + i * zones + z, 0]) for z in range(zones)}
        return values

    def _coming(self) -> Array:
        start_s, table = self._table
        first = round((self.now_s - start_s) / self._step_s)
        if not table.size or first + self.spec.offsets[-1] >= table.shape[1]:
            first, table = 0, self._forecast(self._ahead_s)
        return np.asarray(table[:, first + self.spec.offsets])

    def _forecast(self, horizon_s: float) -> Array:
        """Forecast from now at every step (signals, n); NaN at instants that the plant leaves out."""
        steps = max(int(horizon_s / self._step_s + 1e-9), 1)
        boundary = lengthened(self.plant.forecast(steps * self._step_s, self._step_s), steps, self._step_s)
        return np.vstack([np.atleast_2d(getattr(boundary, name)) for name in FORECAST])
