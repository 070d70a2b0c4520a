"""Synchronous client for one test of a BOPTEST service."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

from boptest_client import answers
from boptest_client.answers import TOLERANCE_S, Point, ServiceClock, ServiceScenario
from boptest_client.errors import (
    AdvanceInterrupted,
    BoptestError,
    ConnectError,
    ConnectionLost,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    UnknownTest,
)
from boptest_client.transport import Transport, TransportConfig

_LOG = logging.getLogger(__name__)
_POLL_S = 0.2
# Time for the first answer of a service, s: its address may be wrong.
FIRST_ANSWER_S = 10.0
_STATUSES = ("Running", "Queued")
# Time for lists of points and the like before a run, s: nothing is simulated for them.
LOOKUP_S = 30.0
# The record is read so many steps beyond the one that is in doubt.
_STEPS_AHEAD = 10

_Parsed = TypeVar("_Parsed")
_Parse = Callable[[str, Any], _Parsed]


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
        self,
        url: str,
        testcase: str,
        *,
        config: TransportConfig | None = None,
        start_timeout_s: float = 120.0,
        stop_timeout_s: float = 10.0,
        testid: str | None = None,
    ) -> None:
        """Select `testcase` and wait until it runs; with `testid`, take up the test of that name instead.

        `start_timeout_s` and `stop_timeout_s`: longest time that the test may be queued, and that a stop may take; the
        former is no longer than patience.
        Lists of points and the like may take 30 s before the test is initialised.

        Raises:
            BadAddress: `url` is not an http(s) address.
            ServiceTimeout: nothing answers there within 10 s, or the test was still queued after `start_timeout_s`.
            UnknownTest: no such test case (the message lists what is offered), or no test `testid`.
            TransportError: the service cannot be reached.
        """
        self.testcase = testcase
        self._transport = Transport(url, config or TransportConfig(), _user_agent())
        self._stopped, self._stop_timeout_s = False, stop_timeout_s
        self._clock = ServiceClock()
        self._names: list[str] = []
        self._find()
        if testid is not None:
            self.testid = testid
            self.status()
            return
        if patience_s := self._transport.config.patience_s:
            start_timeout_s = min(start_timeout_s, patience_s)
        self.testid = self._select(start_timeout_s)
        try:
            self._wait(start_timeout_s)
        except BaseException:
            self.stop_quietly()
            raise

    @property
    def url(self) -> str:
        """Base URL of the service."""
        return self._transport.url

    @property
    def time_s(self) -> float:
        """Time at which the test stands, s: that of the last answer."""
        return self._clock.now_s

    @time_s.setter
    def time_s(self, time_s: float) -> None:
        self._clock.now_s = time_s

    def version(self) -> str:
        """Version of the service. Results of a test case differ between versions."""
        at, call = f"GET {self.url}/version", self._transport.call
        return self._transport.patiently(lambda: answers.text(at, call("GET", "version").payload, "version"))

    def testcases(self) -> tuple[str, ...]:
        """Names of the available test cases."""
        return answers.testcases(f"GET {self.url}/testcases", self._transport.call("GET", "testcases").payload)

    def name(self) -> str:
        """Name of the test case as reported by the service."""
        return self._get("name", lambda at, answer: answers.text(at, answer, "name"))

    def status(self) -> str:
        """'Running' or 'Queued'."""

        def parse(at: str, answer: Any) -> str:
            if answer not in _STATUSES:
                raise ProtocolError(at, f"expected {' or '.join(_STATUSES)}, got {answer!r:.120}")
            return str(answer)

        return self._get("status", parse)

    def inputs(self) -> dict[str, Point]:
        """Inputs by name: `<point>_u` and `<point>_activate`."""
        return self._get("inputs", answers.points)

    def measurements(self) -> dict[str, Point]:
        """Measurements by name."""
        return self._get("measurements", answers.points)

    def forecast_points(self) -> dict[str, Point]:
        """Forecast points by name."""
        return self._get("forecast_points", answers.points)

    def scenario(self) -> ServiceScenario:
        """Current scenario."""
        return self._get("scenario", answers.scenario)

    def set_scenario(self, scenario: ServiceScenario) -> dict[str, float]:
        """Set the scenario; a `time_period` initialises the test (7 days of warm-up): first measurements, else {}."""

        def parse(at: str, payload: Any) -> dict[str, float]:
            answer = answers.mapping(at, payload)
            if scenario.time_period is None:
                return {}
            return self._clock.begin(at, answers.numbers(at, answer.get("time_period")), math.nan)

        self._clock.scenario_ends = scenario.time_period is not None
        # A refusal of a named period is an answer: the service does not know it.
        values = self._put("scenario", asdict(scenario), parse, refusals=2 if scenario.time_period is None else 0)
        self._transport.in_a_run = True
        return values

    def initialize(self, start_time_s: float, warmup_period_s: float) -> dict[str, float]:
        """Start at `start_time_s` after `warmup_period_s` under embedded control; returns the first measurements."""
        self._clock.scenario_ends = False
        body = {"start_time": start_time_s, "warmup_period": warmup_period_s}

        def parse(at: str, payload: Any) -> dict[str, float]:
            return self._clock.begin(at, answers.numbers(at, payload), start_time_s)

        values = self._put("initialize", body, parse, refusals=0)
        self._transport.in_a_run = True
        return values

    def step(self) -> float:
        """Length of a step, s."""
        return self._get("step", answers.step)

    def set_step(self, step_s: float) -> None:
        """Set the length of a step, s; the service is asked whether it has it."""

        def check(at: str, _: Any) -> None:
            if abs((found_s := self.step()) - step_s) > TOLERANCE_S:
                raise ProtocolError(at, f"the step is {found_s:g} s after it was set to {step_s:g} s")

        self._put("step", {"step": step_s}, check)
        self._clock.step_s = float(step_s)

    def advance(self, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
        """Simulate one step; returns measurements and inputs at its end, empty where the service says it is at its end.

        If the answer is lost, an error, nonsense or of another time, the record of the service shows whether the step
        was simulated, before the request is repeated. If it was, the values at its end are read from the record.
        Messages of the service (for example about a clipped input) are logged. Raises `AdvanceInterrupted` where no
        attempt had an answer.
        """
        body, in_doubt = dict(inputs or {}), False

        def attempt() -> dict[str, float]:
            nonlocal in_doubt
            if in_doubt:
                state = self._simulated()
                found = "simulated, its end is read from the record" if state else "not simulated, it is sent again"
                _LOG.warning("%s: the step was %s", self._at("advance"), found)
                if state:
                    return state
            try:
                return self._advance_once(body)
            except (ConnectError, RequestRejected, UnknownTest):
                raise
            except BoptestError as error:
                if math.isnan(self.time_s):
                    why = f"{error.message}; the time before it is unknown"
                    raise AdvanceInterrupted(error.endpoint, why) from error
                in_doubt = True
                raise

        try:
            return self._transport.patiently(attempt)
        except (RequestRejected, UnknownTest, AdvanceInterrupted):
            raise
        except BoptestError as error:
            raise AdvanceInterrupted(error.endpoint, error.message) from error

    def _advance_once(self, body: dict[str, float]) -> dict[str, float]:
        step_s = math.nan if math.isnan(self.time_s) else self._in_force()
        answer = self._transport.call("POST", f"advance/{self.testid}", body)
        if not answer.payload and answer.message.startswith("End of test case"):
            return {}
        state = self._clock.step(self._at("advance"), answers.numbers(self._at("advance"), answer.payload), step_s)
        if answer.message and not answer.message.startswith("Advanced simulation"):
            _LOG.warning("advance: %s", answer.message)
        return state

    def go_on_from(self, time_s: float, step_s: float) -> dict[str, float]:
        """Take the test up at `time_s`, when the last answer was received; `step_s` is the step in force.

        Returns the values at the end of a step that was simulated since then, or nothing; raises `AdvanceInterrupted`
        where the test stands elsewhere.
        """
        self._clock.now_s = self._clock.started_s = time_s
        self._clock.step_s, self._transport.in_a_run = step_s, True
        end_state = self._transport.patiently(self._simulated)
        if self.time_s - time_s > step_s + TOLERANCE_S:
            raise AdvanceInterrupted(
                self._at("results"),
                f"the test stands at {self.time_s:.10g} s, the last answer was of {time_s:.10g} s and a step has "
                f"{step_s:g} s: somebody else advanced the test",
            )
        return end_state

    def forecast(
        self, point_names: Sequence[str], horizon_s: float, interval_s: float, *, patiently: bool = True
    ) -> dict[str, list[float]]:
        """Forecast of points and rising 'time', s, to `horizon_s`; not repeated where it failed unless `patiently`."""
        body = {"point_names": list(point_names), "horizon": horizon_s, "interval": interval_s}

        def parse(at: str, payload: Any) -> dict[str, list[float]]:
            series = answers.series(at, payload, point_names)
            self._clock.check_forecast(at, series["time"], horizon_s, interval_s)
            return series

        return self._put("forecast", body, parse) if patiently else self._put("forecast", body, parse, 0, 0.0)

    def results(self, point_names: Sequence[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        """Recorded values of each point and 'time', s, between two times, warm-up included, at 30-s samples.

        The service answers with status 500 if nothing is recorded between the two, for example in the future.
        """
        body = {"point_names": list(point_names), "start_time": start_s, "final_time": final_s}

        def parse(at: str, payload: Any) -> dict[str, list[float]]:
            series = answers.series(at, payload, point_names)
            if series["time"]:
                self._clock.check_record(at, series["time"], start_s, final_s)
            return series

        return self._put("results", body, parse)

    def kpi(self) -> dict[str, float | None]:
        """Key performance indicators since the end of the warm-up; None for those the test case does not compute."""
        return self._get("kpi", answers.kpis)

    def stop(self) -> None:
        """Stop the test and free its worker; no error if called twice or if the test no longer exists."""
        if self._stopped:
            return
        self._stopped, most_s = True, self._stop_timeout_s
        try:
            self._transport.patiently(
                lambda: self._transport.call("PUT", f"stop/{self.testid}", {}, most_s=most_s), most_s=most_s
            )
        except UnknownTest:
            pass
        finally:
            self._transport.close()

    def leave(self) -> None:
        """Let the test stand at the service, where a client with its `testid` takes it up."""
        self._stopped = True
        self._transport.close()

    def __enter__(self) -> BoptestClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None:
            self.stop()
        else:
            self.stop_quietly()

    def stop_quietly(self) -> None:
        """Stop; a failure is only logged, since raising would hide an earlier error."""
        try:
            self.stop()
        except BoptestError as failed:
            _LOG.warning("the test was not stopped, the service will drop it when idle: %s", failed)

    def _find(self) -> None:
        """Ask for anything: the requests that follow may take minutes, this one not."""
        passing = (ConnectError, ConnectionLost)
        try:
            self._transport.patiently(
                lambda: self._transport.call("GET", "version", most_s=FIRST_ANSWER_S), passing=passing, refusals=0
            )
        except (ServiceError, ProtocolError):
            _LOG.info("%s answers, but tells no version", self.url)
        except BaseException as error:
            self._transport.close()
            if isinstance(error, ServiceTimeout):
                raise ServiceTimeout(error.endpoint, f"{error.message}; is a BOPTEST service running there?") from error
            raise

    def _select(self, most_s: float) -> str:
        path = f"testcases/{self.testcase}/select"
        try:
            # Not repeated: a selection whose answer was lost may have started a test that nobody would stop.
            answer = self._transport.patiently(
                lambda: self._transport.call("POST", path, {}, most_s=most_s), passing=(ConnectError,), refusals=0
            ).payload
            return answers.text(f"POST {self.url}/{path}", answer, "testid")
        except UnknownTest as error:
            offered = self._available_testcases()
            raise UnknownTest(error.endpoint, f"no test case '{self.testcase}'{offered}", error.status) from error
        except BaseException:
            self._transport.close()
            raise

    def _available_testcases(self) -> str:
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
            self._transport.config.sleep(min(_POLL_S, timeout_s))

    def _simulated(self) -> dict[str, float]:
        """The state where the test stands, if it was advanced since the last answer; else an empty one.

        The worker handles requests in order, so its record already includes a step whose request arrived.
        """
        self._names = self._names or [*self.measurements(), *self.inputs()]
        record = self.results(self._names, self.time_s, self.time_s + _STEPS_AHEAD * self._in_force())
        if not record["time"]:
            raise ProtocolError(self._at("results"), f"it has nothing at {self.time_s:.10g} s, where the test stood")
        if not self._clock.moved(record):
            return {}
        return self._clock.move(self._at("results"), {name: values[-1] for name, values in record.items()})

    def _in_force(self) -> float:
        if math.isnan(self._clock.step_s):
            self._clock.step_s = self.step()
        return self._clock.step_s

    def _get(self, what: str, parse: _Parse[_Parsed]) -> _Parsed:
        """The answer to a GET request, parsed with its address, repeated while it fails or is nonsense."""
        path, most_s = f"{what}/{self.testid}", math.inf if self._transport.in_a_run else LOOKUP_S
        return self._transport.patiently(
            lambda: parse(self._at(what), self._transport.call("GET", path, most_s=most_s).payload)
        )

    def _put(
        self, what: str, body: dict[str, Any], parse: _Parse[_Parsed], refusals: int = 2, most_s: float = math.inf
    ) -> _Parsed:
        """The same for PUT; all PUT requests of the protocol may be repeated."""
        path, put = f"{what}/{self.testid}", self._transport.call
        return self._transport.patiently(
            lambda: parse(self._at(what), put("PUT", path, body).payload), refusals=refusals, most_s=most_s
        )

    def _at(self, what: str) -> str:
        return f"{self.url}/{what}/{self.testid}"


def _user_agent() -> str:
    try:
        return f"thermoforce-mpc/{version('thermoforce-mpc')}"
    except PackageNotFoundError:
        return "thermoforce-mpc"
