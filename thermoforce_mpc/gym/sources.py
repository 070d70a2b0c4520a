"""Where the points of BOPTEST's interface come from: the embedded emulator in this process, or a service."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

import numpy as np

from boptest_client import BoptestClient, ServiceScenario, UnknownTest
from thermoforce_mpc.boundary.weather import MARITIME, synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import Array
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.plants.boptest.plant import failures
from thermoforce_mpc.plants.embedded.cases import CASES
from thermoforce_mpc.plants.registry import emulator_of

Limits = tuple[float | None, float | None]


class PointSource(Protocol):
    """A test of BOPTEST's interface: its points by name, in the units of the interface (K, W, s).

    `perfect`: forecasts depend on the time alone, so that those of an episode can be read at once.
    """

    inputs: Mapping[str, Limits]
    measurements: Sequence[str]
    forecasts: Sequence[str]
    perfect: bool

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""

    def begin(self, start_s: float, warmup_s: float, step_s: float, scenario: Mapping[str, Any]) -> None:
        """Start at `start_s` after `warmup_s` of native control, with steps of `step_s`."""

    def advance(self, inputs: Mapping[str, float]) -> None:
        """Simulate one step with these inputs, `<point>_u` and `<point>_activate`."""

    def measured(self, names: Sequence[str]) -> Array:
        """Values of measurements now (n,)."""

    def past(self, names: Sequence[str], time_s: Array) -> Array:
        """Values of measurements at past times (m,), s: (n, m); before the record its first value."""

    def forecast(self, names: Sequence[str], horizon_s: float, interval_s: float) -> Array:
        """Forecast from now (n, m)."""

    def kpis(self) -> dict[str, float]:
        """KPIs since the start."""

    def close(self) -> None:
        """Release the test."""


class EmbeddedSource:
    """An embedded emulator with the points of `tf-mpc serve` (needs psychrolib)."""

    perfect = True

    def __init__(self, weather: Weather | None, testcase: str) -> None:
        """Build the emulator of `testcase`; raises `ConfigError` where there is none."""
        try:
            from thermoforce_mpc.service.points import served_points
        except ModuleNotFoundError as error:
            raise ConfigError(
                f"BOPTEST's weather points need {error.name}, which is not installed: "
                "pip install 'thermoforce-mpc[gym]'"
            ) from error
        climate = CASES[testcase].climate if testcase in CASES else MARITIME
        self._plant = emulator_of(testcase, weather or synthetic_weather(climate=climate))
        self._points = points = served_points(testcase)
        self.inputs: Mapping[str, Limits] = {name: (info.minimum, info.maximum) for name, info in points.inputs.items()}
        self.measurements: Sequence[str] = tuple(points.measurements)
        self.forecasts: Sequence[str] = tuple(points.forecasts)
        self._step_s = 900.0
        self._now: Mapping[str, float] = {}

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self._plant.now_s

    def begin(self, start_s: float, warmup_s: float, step_s: float, scenario: Mapping[str, Any]) -> None:
        """See `PointSource.begin`; raises `ConfigError` for a scenario that the emulator does not have."""
        for unknown in sorted(set(scenario) - {"electricity_price"}):
            raise ConfigError(f"scenario: '{unknown}' needs a service; the embedded test case knows electricity_price")
        price = scenario.get("electricity_price") or "constant"
        self._step_s = step_s
        self._now = self._plant.reset(start_s, warmup_s, price).points

    def advance(self, inputs: Mapping[str, float]) -> None:
        """See `PointSource.advance`."""
        active = {name[: -len("_activate")] for name, value in inputs.items() if name.endswith("_activate") and value}
        forced = {name: inputs[f"{name}_u"] for name in active}
        self._now = self._plant.advance_points(forced, self._step_s).points

    def measured(self, names: Sequence[str]) -> Array:
        """See `PointSource.measured`."""
        if all(name in self._now for name in names):
            return np.array([self._now[name] for name in names])
        record = self._plant.recorded(self.now_s, self.now_s)
        series = self._points.recorded(self._plant, list(names), record)
        return np.array([series[name][-1] for name in names])

    def past(self, names: Sequence[str], time_s: Array) -> Array:
        """See `PointSource.past`."""
        record = self._plant.recorded(float(time_s.min()) - self._step_s, self.now_s)
        series = self._points.recorded(self._plant, list(names), record)
        return np.array([np.interp(time_s, series["time"], series[name]) for name in names]).reshape(len(names), -1)

    def forecast(self, names: Sequence[str], horizon_s: float, interval_s: float) -> Array:
        """See `PointSource.forecast`."""
        series = self._points.forecast(self._plant, list(names), horizon_s, interval_s)
        return np.array([series[name] for name in names])

    def kpis(self) -> dict[str, float]:
        """See `PointSource.kpis`."""
        return self._plant.kpis()

    def snapshot(self) -> Any:
        """State of the emulator."""
        return self._plant.snapshot(), self._now

    def restore(self, snapshot: Any) -> None:
        """Return to a state."""
        state, self._now = snapshot
        self._plant.restore(state)

    def __copy__(self) -> EmbeddedSource:
        """Another emulator in the same state; both share what no step changes."""
        other = object.__new__(EmbeddedSource)
        other.__dict__.update(self.__dict__, _plant=copy.copy(self._plant))
        return other

    def close(self) -> None:
        """Do nothing: the emulator holds no resources."""


class ServiceSource:
    """A BOPTEST service at `url`; closing stops the test. Raises `ConfigError` where the test case is not offered."""

    perfect = False

    def __init__(self, url: str, testcase: str) -> None:
        with failures():
            try:
                self._client = BoptestClient(url, testcase)
            except UnknownTest as error:
                raise ConfigError(f"testcase: {error}") from error
        # Where one of these fails, nobody else would stop the test.
        with failures(), ExitStack() as stopping:
            stopping.enter_context(self._client)
            inputs = self._client.inputs()
            self.inputs: Mapping[str, Limits] = {name: (point.minimum, point.maximum) for name, point in inputs.items()}
            self.measurements: Sequence[str] = tuple(self._client.measurements())
            self.forecasts: Sequence[str] = tuple(self._client.forecast_points())
            stopping.pop_all()
        self._now: Mapping[str, float] = {}

    @property
    def testid(self) -> str:
        """Name of the test at the service."""
        return self._client.testid

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self._client.time_s

    def begin(self, start_s: float, warmup_s: float, step_s: float, scenario: Mapping[str, Any]) -> None:
        """See `PointSource.begin`; raises `ConfigError` for a key that BOPTEST's scenarios do not have."""
        keys = [name for name in ServiceScenario.__dataclass_fields__ if name != "time_period"]
        for unknown in sorted(set(scenario) - set(keys)):
            raise ConfigError(f"scenario: unknown key '{unknown}'; known: {', '.join(keys)}")
        with failures():
            self._now = self._client.initialize(start_s, warmup_s)
            self._client.set_step(step_s)
            self._client.set_scenario(ServiceScenario(**scenario))

    def advance(self, inputs: Mapping[str, float]) -> None:
        """See `PointSource.advance`."""
        with failures():
            answer = self._client.advance(inputs)
        if not answer:
            raise PlantError(f"the service's scenario is over at {self.now_s:g} s")
        self._now = answer

    def measured(self, names: Sequence[str]) -> Array:
        """See `PointSource.measured`."""
        return np.array([self._now.get(name, np.nan) for name in names])

    def past(self, names: Sequence[str], time_s: Array) -> Array:
        """See `PointSource.past`."""
        with failures():
            answer = self._client.results(names, max(float(time_s.min()), 0.0), self.now_s)
        return np.array([np.interp(time_s, answer["time"], answer[name]) for name in names])

    def forecast(self, names: Sequence[str], horizon_s: float, interval_s: float) -> Array:
        """See `PointSource.forecast`."""
        with failures():
            answer = self._client.forecast(names, horizon_s, interval_s)
        return np.array([answer[name] for name in names])

    def kpis(self) -> dict[str, float]:
        """See `PointSource.kpis`."""
        with failures():
            return {name: value for name, value in self._client.kpi().items() if value is not None}

    def close(self) -> None:
        """Stop the test; safe to call twice."""
        with failures():
            self._client.stop()
