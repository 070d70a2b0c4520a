"""BOPTEST service behind the `Plant` protocol. Temperatures are K at the service and °C in the package.

Where BOPTEST_TOKEN may go: it belongs to the services that its owner named, not to one that a file names.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal
from urllib.parse import urlsplit

import numpy as np

from boptest_client import (
    BadAddress,
    BoptestClient,
    BoptestError,
    RequestRejected,
    ServiceScenario,
    TransportConfig,
    UnknownTest,
)
from thermoforce_mpc.data import (
    DAY_S,
    YEAR_S,
    ZERO_C_K,
    Array,
    Boundary,
    Commands,
    Levels,
    Measurement,
    Period,
    PlantInfo,
    Record,
)
from thermoforce_mpc.errors import ConfigError, InputError, NoForecast, NoSuchTest, PlantError
from thermoforce_mpc.files import is_loopback, known_marks, note_marks
from thermoforce_mpc.plants.points import (
    acting_means,
    boundary,
    check_points,
    inputs,
    mean_levels,
    measurement,
    past_record,
)
from thermoforce_mpc.plants.shell import (
    Releasing,
    check_levels,
    check_record_step,
    day_period,
    forecast_times,
    is_day,
    record_times,
)
from thermoforce_mpc.scenario.testcase import PRICES, TestCase


def allow_token(url: str) -> None:
    """Note that the user, not a file, named the service at `url` while BOPTEST_TOKEN was set."""
    if _has_token():
        note_marks([_mark(url)])


def check_token(url: str) -> None:
    """Raise `ConfigError` where BOPTEST_TOKEN would go to a service that neither user, BOPTEST_URL nor this host is."""
    if not _has_token() or is_loopback(urlsplit(url).hostname or ""):
        return
    if _mark(url) not in {_mark(os.environ.get("BOPTEST_URL", "")), *known_marks()}:
        raise ConfigError(
            f"plant.url: {url} is named by a file, and BOPTEST_TOKEN would go there. Where it was set for that "
            f"service, give --url {url} once or set BOPTEST_URL; else unset BOPTEST_TOKEN"
        )


def _has_token() -> bool:
    return bool(os.environ.get("BOPTEST_TOKEN", "").strip())


def _mark(url: str) -> str:
    """Scheme, host and port: paths of one host share its token."""
    parts = urlsplit(url)
    port = parts.port or {"http": 80, "https": 443}.get(parts.scheme)
    return json.dumps(["token", f"{parts.scheme}://{parts.hostname}:{port}"])


_LOG = logging.getLogger(__name__)
# Warm-up under native control and length of a scenario's time period in BOPTEST.
_SCENARIO_WARMUP_S = 7 * DAY_S
_SCENARIO_LENGTH_S = 14 * DAY_S
_CLOCK_TOLERANCE_S = 1e-3

Uncertainty = Literal["none", "low", "medium", "high"]


class BoptestPlant(Releasing):
    """Test case of a BOPTEST service. Closing the plant stops the test.

    ```python
    with BoptestPlant("http://127.0.0.1:8000", testcase) as plant:
        window = plant.period("peak_heat_day")
        plant.reset(window.start_s, window.warmup_s)
        measurement = plant.advance(u=0.5, duration_s=900)
    ```
    """

    def __init__(
        self,
        url: str,
        testcase: TestCase,
        *,
        forecast_uncertainty: Uncertainty = "none",
        seed: int = 1,
        config: TransportConfig | None = None,
        testid: str | None = None,
    ) -> None:
        """Select the test case and check that every point of `testcase` exists there in the expected unit.

        Args:
            forecast_uncertainty: level of the service's weather forecast errors, drawn with `seed`.
            config: time-outs and retries of the client.
            testid: take up the test of this name instead of selecting one; see `go_on`.

        Raises:
            ConfigError: the test case is not offered, does not fit its points, or forecast errors come with seed 0.
            NoSuchTest: the service has no test `testid`.
            PlantError: the service cannot be reached or failed.
        """
        self.testcase, self._points = testcase, testcase.points
        self._url, self._config = url, config
        level = None if forecast_uncertainty == "none" else forecast_uncertainty
        if level and seed < 1:
            why = "means 'no seed' to a BOPTEST service and cannot be repeated; use 1 or more"
            raise ConfigError(f"seed: {seed} {why}")
        self._scenario = ServiceScenario("constant", None, level, level, None if level is None else seed)
        self._start_of: dict[str, float] = {}
        self._step_s = math.nan
        self._now_s = self._begin_s = 0.0
        self._T_zone_C: Array = np.full(len(self._points.zones), math.nan)
        self._last: Measurement | None = None
        self._end_s = math.inf
        self._final_kpis: dict[str, float] | None = None
        self._missed: dict[str, float] = {}
        self._forecasts = True
        self._client = self._select(testid)
        try:
            with failures():
                client = self._client
                check_points(testcase, client.inputs(), client.measurements(), client.forecast_points())
                self._version = self._client.version()
        except BaseException:
            self.close()
            raise

    @property
    def info(self) -> PlantInfo:
        """Service and version; results of different versions must not be mixed."""
        return PlantInfo(
            kind="boptest",
            testcase=self.testcase.name,
            description=f"BOPTEST service at {self._client.url}, version {self._version}",
            weather="the test case's own weather",
            version=self._version,
            details={"url": self._client.url, "testid": self._client.testid},
        )

    def period(self, name: str) -> Period:
        """Return the window of the service's scenario `name`, or of a start day; raises `InputError` for neither.

        The service gives the start of a scenario only by initialising it, so the first call puts the plant there.
        """
        if is_day(name):
            return day_period(name, self._start_of)
        if name not in self._start_of:
            self._start_of[name] = self._initialize_scenario(name).time_s
        return Period(name, self._start_of[name], _SCENARIO_LENGTH_S, _SCENARIO_WARMUP_S)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` after `warmup_s` of native control.

        If the times equal those of a window returned by `period`, the service's scenario is set, which ends after two
        weeks. A test that the service dropped while idle is selected again.

        Raises:
            InputError: a time is not a finite nonnegative number, or the tariff is unknown.
            PlantError: the service failed.
        """
        for label, value in (("start", start_s), ("warm-up", warmup_s)):
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{label} of {value!r} s: expected a finite, nonnegative number of seconds")
        if price not in PRICES:
            raise InputError(f"unknown tariff '{price}'; known: {', '.join(PRICES)}")
        self._scenario = replace(self._scenario, electricity_price=price)
        self._wake()
        if warmup_s == _SCENARIO_WARMUP_S:
            for name, scenario_start_s in self._start_of.items():
                if scenario_start_s == start_s:
                    return self._initialize_scenario(name)
        with failures():
            points = self._client.initialize(start_s, warmup_s)
            self._client.set_scenario(self._scenario)
        return self._at_rest(points, warmup_s, end_s=math.inf)

    def advance(self, u: Levels, duration_s: float, command: Commands = None) -> Measurement:
        """Apply `u` in [0, 1] (None: native control), or the room set-points `command`, °C, for `duration_s`.

        Raises:
            InputError: `u`, `command` or `duration_s` is out of range.
            PlantError: the service failed, or its scenario is over.
        """
        layout = self._points.layout
        block = check_levels(u, duration_s, command, names=layout.names, u_min=layout.u_min)
        applied = inputs(self._points, block, self._T_zone_C, self._last)
        if self._now_s + duration_s > self._end_s + _CLOCK_TOLERANCE_S:
            raise PlantError(
                f"the service's scenario ends at day {self._end_s / DAY_S:g}: a step of {duration_s:g} s "
                f"from day {self._now_s / DAY_S:g} runs past it; score at most 14 days of a named window"
            )
        before_s = self._now_s
        with failures():
            points = self._stepped(applied, duration_s)
            self._read_final_kpis()
            record = self._recorded(before_s, min(self._now_s + duration_s, self._end_s), self._watched_names())
            if record["time"][-1] > self._now_s + _CLOCK_TOLERANCE_S:
                # A proxy may have sent the request twice. What happened is in the record, and the clock tells.
                points = points | {name: float(values[-1]) for name, values in record.items()}
                self._now_s = self._client.time_s = points["time"]
                _LOG.warning("the service simulated %g s instead of %g s", self._now_s - before_s, duration_s)
                self._read_final_kpis()
        edges = np.array([before_s, self._now_s])
        levels = mean_levels(record, self._points, edges, "_u")
        return self._measured(points, acting_means(record, self._points, levels, edges))

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Return the service's forecast from now to `horizon_s` ahead every `interval_s`; NaN where it has no values.

        Raises:
            InputError: horizon or interval is not positive, or the horizon is shorter than the interval.
            NoForecast: it failed (with forecast uncertainty it refuses horizons beyond 48 h), or returned other
                instants than requested. After that it is asked without patience, until it answers again.
            PlantError: the test is gone.
        """
        instants = forecast_times(self._now_s, horizon_s, interval_s)
        tariff = next(name for name in PRICES if name == self._scenario.electricity_price)
        names = self._points.forecast(tariff)
        if self._missed:
            raise NoForecast(f"BOPTEST service: {self._client.url}: its test was advanced; it is asked after a step")
        with failures():
            try:
                data = self._client.forecast(list(names), horizon_s, interval_s, patiently=self._forecasts)
            except UnknownTest:
                raise
            except BoptestError as error:
                self._forecasts = False
                raise NoForecast(f"BOPTEST service: {error}") from error
        self._forecasts = True
        series = {name: np.array(values[: instants.size]) for name, values in data.items()}
        weather = series[self._points.forecast_outdoor] - ZERO_C_K, series[self._points.forecast_solar]
        return boundary(series["time"], series, self._points, tariff, weather)

    def past(self, step_s: float) -> Record:
        """Return the record since the start of the warm-up, without the oldest partial step; raises as `reset`."""
        check_record_step(step_s)
        with failures():
            record = self._recorded(self._begin_s, self._now_s, self._watched_names())
        # Services that do not record the warm-up start the record at the present.
        edges = record_times(float(record["time"][0]), self._now_s, step_s)
        return past_record(record, self._points, mean_levels(record, self._points, edges, "_u"), edges)

    def kpis(self) -> dict[str, float]:
        """Return the service's KPIs since the end of the warm-up; KPIs the test case does not have are omitted."""
        if self._final_kpis is not None:
            return dict(self._final_kpis)
        with failures():
            return self._read_kpis()

    def go_on(
        self,
        last: Measurement,
        *,
        start_s: float,
        warmup_s: float,
        price: str,
        periods: Mapping[str, Period],
        anywhere: bool = False,
    ) -> None:
        """See `OutlivingPlant.go_on`; raises `PlantError` where the test is neither at `last` nor a step after it."""
        self._scenario = replace(self._scenario, electricity_price=price)
        named = {name: period.start_s for name, period in periods.items() if not is_day(name)}
        self._start_of |= named
        scenario = warmup_s == _SCENARIO_WARMUP_S and start_s in named.values()
        self._now_s, self._begin_s = last.time_s, max(start_s - warmup_s, 0.0)
        self._end_s = start_s + _SCENARIO_LENGTH_S if scenario else math.inf
        self._T_zone_C, self._last = last.T_zone_C, last
        with failures():
            self._step_s = self._client.step()
            stands_s = self._now_s
            if anywhere:
                record = self._recorded(stands_s, stands_s + YEAR_S, [self._points.outdoor_temperature])
                stands_s = float(record["time"][-1])
            from_s = max(self._now_s, stands_s - self._step_s)
            self._missed = self._client.go_on_from(from_s, self._step_s)
        if anywhere and self._missed:
            _LOG.warning(
                "the test stands at day %.3f, what is known of it ends at day %.3f: it goes on there, and what is "
                "decided for the time between does not act", stands_s / DAY_S, self._now_s / DAY_S,
            )  # fmt: skip

    def close(self) -> None:
        """Stop the test at the service; a failure is only logged."""
        self._client.stop_quietly()

    def leave(self) -> None:
        """See `OutlivingPlant.leave`."""
        self._client.leave()

    def _stepped(self, applied: Mapping[str, float], duration_s: float) -> dict[str, float]:
        """Points at the end of a step, of a new one or of that whose answer was lost (same inputs); sets the clock."""
        before_s, points = self._now_s, self._missed
        self._missed = {}
        if not points:
            if duration_s != self._step_s:
                self._client.set_step(duration_s)
                self._step_s = duration_s
            points = self._client.advance(applied)
        if not points:
            raise PlantError(f"the service says that its scenario is over, at day {before_s / DAY_S:g}")
        self._now_s = points["time"]
        if self._now_s - before_s - duration_s < -_CLOCK_TOLERANCE_S:
            raise PlantError(f"the service advanced by {self._now_s - before_s:g} s instead of {duration_s:g} s")
        return points

    def _select(self, testid: str | None = None) -> BoptestClient:
        with failures():
            try:
                return BoptestClient(self._url, self.testcase.name, config=self._config, testid=testid)
            except BadAddress as error:
                raise ConfigError(f"plant.url: {error}") from error
            except (RequestRejected, UnknownTest) as error:
                if testid is not None:
                    raise NoSuchTest(
                        f"the service at {self._url} no longer has the test {testid} ({error}): it was stopped, was "
                        "idle for too long, or the service was started anew"
                    ) from error
                raise ConfigError(f"testcase '{self.testcase.name}' is not offered: {error}") from error

    def _wake(self) -> None:
        """Select the test again if the service dropped it; a reset needs no earlier state."""
        with failures():
            try:
                self._client.status()
            except UnknownTest:
                _LOG.info("the service dropped the idle test; selecting it again")
                self.close()
                self._client = self._select()

    def _initialize_scenario(self, name: str) -> Measurement:
        with failures():
            try:
                points = self._client.set_scenario(replace(self._scenario, time_period=name))
            except RequestRejected as error:
                why = f"neither a start day nor a scenario of the service ({error})"
                raise InputError(f"period '{name}': {why}") from error
        return self._at_rest(points, _SCENARIO_WARMUP_S, end_s=points["time"] + _SCENARIO_LENGTH_S)

    def _at_rest(self, points: dict[str, float], warmup_s: float, end_s: float) -> Measurement:
        """Return the measurement right after an initialisation; step means are NaN."""
        self._now_s = points["time"]
        self._begin_s = max(self._now_s - warmup_s, 0.0)
        self._end_s = end_s
        self._final_kpis = None
        self._step_s = math.nan  # initialising may reset the service's step
        return self._measured(points)

    def _measured(self, points: Mapping[str, float], acting: Mapping[str, Array] | None = None) -> Measurement:
        """The measurement of `points`; its zone temperature serves the actuator's map in the next step."""
        latest = measurement(self._now_s, points, self._points, acting)
        self._T_zone_C = np.where(np.isfinite(latest.T_zone_C), latest.T_zone_C, self._T_zone_C)
        self._last = latest
        return latest

    def _watched_names(self) -> list[str]:
        """Points of the weather, and those that levels and means of a step are computed from."""
        p = self._points
        return [p.outdoor_temperature, p.solar, *p.temperatures, *(f"{name}_u" for name in p.sensed), *p.flows]

    def _recorded(self, start_s: float, final_s: float, names: Sequence[str]) -> dict[str, Array]:
        data = self._client.results(list(dict.fromkeys(names)), start_s, final_s)
        if not data["time"]:
            raise PlantError(f"the service recorded nothing between {start_s:g} s and {final_s:g} s")
        return {name: np.array(values) for name, values in data.items()}

    def _read_final_kpis(self) -> None:
        """At the end of a scenario, read the KPIs: later requests may discard the results."""
        if self._final_kpis is None and self._now_s >= self._end_s - _CLOCK_TOLERANCE_S:
            self._final_kpis = self._read_kpis()

    def _read_kpis(self) -> dict[str, float]:
        return {name: value for name, value in self._client.kpi().items() if value is not None}


@contextlib.contextmanager
def failures() -> Iterator[None]:
    """Convert the client's errors to `PlantError`, keeping the service's message."""
    try:
        yield
    except BoptestError as error:
        raise PlantError(f"BOPTEST service: {error}") from error
