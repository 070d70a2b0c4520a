"""Synchronous client for one test of a BOPTEST service."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from types import TracebackType
from typing import Any

from boptest_client.errors import (
    AdvanceInterrupted,
    BoptestError,
    ConnectionLost,
    ProtocolError,
    ServiceTimeout,
    UnknownTest,
)
from boptest_client.transport import Transport, TransportConfig
from boptest_client.types import Point, Scenario

_LOG = logging.getLogger(__name__)
_POLL_S = 0.2
_CLOCK_TOLERANCE_S = 1e-3


class BoptestClient:
    """One selected test case. As a context manager it stops the test when the block ends, also after an exception.

    ```python
    with BoptestClient("http://127.0.0.1:8000", "bestest_hydronic_heat_pump") as test:
        test.set_scenario(Scenario(time_period="peak_heat_day", electricity_price="constant"))
        test.set_step(3600)
        measured = test.advance({"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1})
    ```

    All errors are `BoptestError`s that name the endpoint. Not thread-safe.
    """

    def __init__(
        self, url: str, testcase: str, *, config: TransportConfig | None = None, start_timeout_s: float = 120.0
    ) -> None:
        """Select `testcase` and wait until it runs.

        Raises:
            BadAddress: `url` is not an http(s) address.
            UnknownTest: the service does not offer the test case; the message lists what it offers.
            ServiceTimeout: the test was still queued after `start_timeout_s`.
            TransportError: the service cannot be reached.
        """
        self.testcase = testcase
        self._transport = Transport(url, config or TransportConfig(), _user_agent())
        self._stopped = False
        self._time_s = math.nan
        self._step_s = math.nan
        self.testid = self._select()
        try:
            self._wait(start_timeout_s)
        except BaseException:
            self._stop_quietly()
            raise

    @property
    def url(self) -> str:
        """Base URL of the service."""
        return self._transport.url

    def version(self) -> str:
        """Version of the service. Results of a test case differ between versions."""
        endpoint = f"GET {self.url}/version"
        answer = self._mapping(endpoint, self._transport.call("GET", "version", repeatable=True).payload)
        if "version" not in answer:
            raise ProtocolError(endpoint, f"no version in {answer!r}")
        return str(answer["version"])

    def testcases(self) -> tuple[str, ...]:
        """Names of the available test cases."""
        answer = self._transport.call("GET", "testcases", repeatable=True).payload
        try:
            return tuple(sorted(str(item["testcaseid"]) for item in answer))
        except (TypeError, KeyError) as error:
            raise ProtocolError(f"GET {self.url}/testcases", f"not a list of test cases: {answer!r:.120}") from error

    def name(self) -> str:
        """Name of the test case as reported by the service."""
        answer = self._mapping(self._at("name"), self._get("name"))
        if "name" not in answer:
            raise ProtocolError(self._at("name"), f"no name in {answer!r}")
        return str(answer["name"])

    def status(self) -> str:
        """'Running' or 'Queued'."""
        return str(self._get("status"))

    def inputs(self) -> dict[str, Point]:
        """Inputs by name: `<point>_u` and `<point>_activate`."""
        return self._points("inputs")

    def measurements(self) -> dict[str, Point]:
        """Measurements by name."""
        return self._points("measurements")

    def forecast_points(self) -> dict[str, Point]:
        """Forecast points by name."""
        return self._points("forecast_points")

    def scenario(self) -> Scenario:
        """Current scenario."""
        return Scenario.from_json(self._mapping(self._at("scenario"), self._get("scenario")))

    def set_scenario(self, scenario: Scenario) -> dict[str, float]:
        """Set the scenario.

        Returns:
            The first measurements if the scenario names a `time_period`, which initialises the test (7 days of
            warm-up, two scored weeks); otherwise an empty dictionary.
        """
        answer = self._mapping(self._at("scenario"), self._put("scenario", scenario.as_json()))
        if scenario.time_period is None:
            return {}
        return self._timed("scenario", self._numbers("scenario", answer.get("time_period")))

    def initialize(self, start_time_s: float, warmup_period_s: float) -> dict[str, float]:
        """Start at `start_time_s` after `warmup_period_s` under embedded control; returns the first measurements."""
        body = {"start_time": start_time_s, "warmup_period": warmup_period_s}
        return self._timed("initialize", self._numbers("initialize", self._put("initialize", body)))

    def step(self) -> float:
        """Length of a step, s."""
        answer = self._get("step")
        try:
            return float(answer)
        except (TypeError, ValueError, OverflowError) as error:
            raise ProtocolError(self._at("step"), f"not a number: {answer!r:.120}") from error

    def set_step(self, step_s: float) -> None:
        """Set the length of a step, s."""
        self._put("step", {"step": step_s})
        self._step_s = float(step_s)

    def advance(self, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
        """Simulate one step; returns measurements and inputs at its end, empty after the end of the scenario.

        If the answer is lost, the recorded time shows whether the step was simulated. If it was, the values at its end
        are read from the record; if not, the request is repeated. Messages of the service (for example about a
        clipped input) are logged as warnings.

        Raises:
            AdvanceInterrupted: no answer, and it is unknown whether the step was simulated.
        """
        body = dict(inputs or {})
        for _ in range(self._transport.config.retries + 1):
            try:
                answer = self._transport.call("POST", f"advance/{self.testid}", body, repeatable=False)
            except (ConnectionLost, ServiceTimeout) as lost:
                state = self._state_after(lost)
                if state:
                    self._time_s = state["time"]
                    return state
                _LOG.warning("%s; the step was not simulated and is sent again", lost)
                interrupted = lost
                continue
            if answer.message and not answer.message.startswith(("Advanced simulation", "End of test case")):
                _LOG.warning("advance: %s", answer.message)
            # An empty payload marks the end of the scenario.
            over = answer.payload is None or answer.payload == {}
            return {} if over else self._timed("advance", self._numbers("advance", answer.payload))
        raise AdvanceInterrupted(interrupted.endpoint, f"{interrupted.message}, in every attempt") from interrupted

    def forecast(self, point_names: Sequence[str], horizon_s: float, interval_s: float) -> dict[str, list[float]]:
        """Forecast of each point and strictly increasing 'time', s, from now to `horizon_s` every `interval_s`."""
        body = {"point_names": list(point_names), "horizon": horizon_s, "interval": interval_s}
        series = self._series("forecast", self._put("forecast", body), [*point_names, "time"])
        if not series["time"] or any(a == b for a, b in pairwise(series["time"])):
            raise ProtocolError(self._at("forecast"), f"its clock ('time') does not rise: {series['time'][:3]} …")
        return series

    def results(self, point_names: Sequence[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        """Recorded values of each point and 'time', s, between two times, warm-up included, at 30-s samples.

        The service answers with status 500 if nothing is recorded between the two, for example in the future.
        """
        body = {"point_names": list(point_names), "start_time": start_s, "final_time": final_s}
        return self._series("results", self._put("results", body), [*point_names, "time"])

    def kpi(self) -> dict[str, float | None]:
        """Key performance indicators since the end of the warm-up; None for those the test case does not compute."""
        values = self._numbers("kpi", self._get("kpi"))
        if not values:
            raise ProtocolError(self._at("kpi"), "the answer contains no indicator")
        return {key: None if math.isnan(value) else value for key, value in values.items()}

    def stop(self) -> None:
        """Stop the test and free its worker; no error if called twice or if the test no longer exists."""
        if self._stopped:
            return
        self._stopped = True
        try:
            self._transport.call("PUT", f"stop/{self.testid}", {}, repeatable=False)
        except UnknownTest:
            pass
        finally:
            self._transport.close()

    def __enter__(self) -> BoptestClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.stop()
        else:
            self._stop_quietly()

    def _stop_quietly(self) -> None:
        """Stop during the handling of another error, which a failure to stop must not replace."""
        try:
            self.stop()
        except BoptestError as failed:
            _LOG.warning("the test was not stopped, the service will drop it when idle: %s", failed)

    def _select(self) -> str:
        path = f"testcases/{self.testcase}/select"
        try:
            # Not repeated: a selection whose answer was lost may have started a test that nobody would stop.
            answer = self._transport.call("POST", path, {}, repeatable=False).payload
            if not isinstance(answer, dict) or "testid" not in answer:
                raise ProtocolError(f"POST {self.url}/{path}", f"no testid in {answer!r:.120}")
        except UnknownTest as error:
            offered = self._offered()
            raise UnknownTest(error.endpoint, f"no test case '{self.testcase}'{offered}", error.status) from error
        except BaseException:
            self._transport.close()
            raise
        return str(answer["testid"])

    def _offered(self) -> str:
        """Available test cases, for an error message; empty if the service does not list them."""
        try:
            return f"; the service offers {', '.join(self.testcases())}"
        except BoptestError:
            return ""
        finally:
            self._transport.close()

    def _wait(self, timeout_s: float) -> None:
        until = time.monotonic() + timeout_s
        while (status := self.status()) != "Running":
            if time.monotonic() > until:
                raise ServiceTimeout(f"GET {self.url}/status/{self.testid}", f"still '{status}' after {timeout_s:g} s")
            time.sleep(min(_POLL_S, timeout_s))

    def _timed(self, what: str, state: dict[str, float]) -> dict[str, float]:
        """The state in the answer to `what`, which must contain a finite 'time'."""
        if not math.isfinite(state.get("time", math.nan)):
            raise ProtocolError(self._at(what), "the measurements have no time")
        self._time_s = state["time"]
        return state

    def _state_after(self, lost: ConnectionLost | ServiceTimeout) -> dict[str, float]:
        """The state at the end of a step whose answer was lost, or an empty one if the step was not simulated.

        The worker handles requests in order, so its record already includes the step if the request arrived.
        """
        unknown = f"{lost.message}; whether the step was simulated is unknown, start the run again"
        try:
            step_s = self.step() if math.isnan(self._step_s) else self._step_s
            names = [*self.measurements(), *self.inputs()]
            record = self.results(names, self._time_s, self._time_s + step_s)
        except BoptestError as error:
            raise AdvanceInterrupted(lost.endpoint, f"{unknown} ({error})") from lost
        last_s = record["time"][-1] if record["time"] else math.nan
        if abs(last_s - self._time_s) <= _CLOCK_TOLERANCE_S:
            return {}
        if abs(last_s - self._time_s - step_s) <= _CLOCK_TOLERANCE_S:
            return {name: values[-1] for name, values in record.items()}
        raise AdvanceInterrupted(lost.endpoint, f"{unknown} (the record ends at {last_s:g} s)") from lost

    def _get(self, what: str) -> Any:
        return self._transport.call("GET", f"{what}/{self.testid}", repeatable=True).payload

    def _put(self, what: str, body: dict[str, Any]) -> Any:
        # All PUT requests of the protocol are idempotent.
        return self._transport.call("PUT", f"{what}/{self.testid}", body, repeatable=True).payload

    def _at(self, what: str) -> str:
        """Address of the endpoint `what` of this test, for an error message."""
        return f"{self.url}/{what}/{self.testid}"

    def _points(self, what: str) -> dict[str, Point]:
        answer = self._mapping(self._at(what), self._get(what))
        return {
            name: Point.from_json(name, self._mapping(self._at(what), data or {}))
            for name, data in answer.items()
            if name != "time"
        }

    def _mapping(self, endpoint: str, answer: Any) -> Mapping[str, Any]:
        if not isinstance(answer, Mapping):
            raise ProtocolError(endpoint, f"expected names and values, got {answer!r:.120}")
        return answer

    def _numbers(self, what: str, answer: Any) -> dict[str, float]:
        # JSON has no NaN; the service writes null.
        try:
            return {
                key: math.nan if value is None else float(value)
                for key, value in self._mapping(self._at(what), answer).items()
            }
        except (TypeError, ValueError, OverflowError) as error:
            raise ProtocolError(self._at(what), f"a value is not a number ({error!s:.200})") from error

    def _series(self, what: str, answer: Any, names: Sequence[str]) -> dict[str, list[float]]:
        """Values of `names` at the instants 'time', which never fall; none where nothing is told."""
        endpoint = f"PUT {self._at(what)}"
        mapping = self._mapping(endpoint, answer)
        missing = [name for name in names if name not in mapping]
        if missing:
            raise ProtocolError(endpoint, f"no values for {', '.join(missing)}")
        try:
            series = {name: [math.nan if v is None else float(v) for v in mapping[name]] for name in names}
        except (TypeError, ValueError, OverflowError) as error:
            raise ProtocolError(endpoint, f"a value is not a number ({error!s:.200})") from error
        if any(len(values) != len(series["time"]) for values in series.values()):
            raise ProtocolError(endpoint, "series differ in length")
        clock = series["time"]
        if not (all(map(math.isfinite, clock)) and all(a <= b for a, b in pairwise(clock))):
            raise ProtocolError(endpoint, "its clock ('time') has gaps or runs back")
        return series


def _user_agent() -> str:
    try:
        return f"thermoforce-mpc/{version('thermoforce-mpc')}"
    except PackageNotFoundError:
        return "thermoforce-mpc"
