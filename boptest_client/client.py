"""Synchronous client for one test of a BOPTEST service."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from types import TracebackType
from typing import Any, TypeVar

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
from boptest_client.texts import safe_text
from boptest_client.transport import Transport, TransportConfig
from boptest_client.types import Point, Scenario

_LOG = logging.getLogger(__name__)
_POLL_S = 0.2
# Time for the first answer of a service, s: its address may be wrong.
FIRST_ANSWER_S = 10.0
_CLOCK_TOLERANCE_S = 1e-3
# Length of a scenario of a named period, s.
_SCENARIO_S = 14 * 86400.0
_STATUSES = ("Running", "Queued")
# Time for lists of points and the like before a run, s: nothing is simulated for them.
LOOKUP_S = 30.0
# BOPTEST's recording interval, s.
_SAMPLE_S = 30.0
# The record is read so many steps beyond the one that is in doubt.
_STEPS_AHEAD = 10

_Parsed = TypeVar("_Parsed")


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
        service drops an idle test. Lists of points and the like may take 30 s before the test is initialised.

        Raises:
            BadAddress: `url` is not an http(s) address.
            ServiceTimeout: nothing answers there within 10 s, or the test was still queued after `start_timeout_s`.
            UnknownTest: the service does not offer the test case (the message lists what it offers), or has no test
                `testid`.
            TransportError: the service cannot be reached.
        """
        self.testcase = testcase
        self._transport = Transport(url, config or TransportConfig(), _user_agent())
        self._stopped, self._stop_timeout_s = False, stop_timeout_s
        self._scenario_ends = False
        self.time_s = math.nan
        """Time at which the test stands, s: that of the last answer."""
        self._started_s = self._step_s = math.nan
        self._names: list[str] = []
        self._find()
        if testid is not None:
            self.testid = testid
            self.status()
            return
        self.testid = self._select(start_timeout_s)
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

        def parse(payload: Any) -> str:
            return self._text(endpoint, self._mapping(endpoint, payload).get("version"), "version")

        return self._transport.patiently(lambda: parse(self._transport.call("GET", "version").payload))

    def testcases(self) -> tuple[str, ...]:
        """Names of the available test cases."""
        endpoint, answer = f"GET {self.url}/testcases", self._transport.call("GET", "testcases").payload
        if not isinstance(answer, list):
            raise ProtocolError(endpoint, f"not a list of test cases: {answer!r:.120}")
        names = [self._mapping(endpoint, item).get("testcaseid") for item in answer]
        return tuple(sorted(self._text(endpoint, name, "testcaseid") for name in names))

    def name(self) -> str:
        """Name of the test case as reported by the service."""

        at = self._at("name")
        return self._get("name", lambda answer: self._text(at, self._mapping(at, answer).get("name"), "name"))

    def status(self) -> str:
        """'Running' or 'Queued'."""

        def parse(answer: Any) -> str:
            if answer not in _STATUSES:
                raise ProtocolError(self._at("status"), f"expected {' or '.join(_STATUSES)}, got {answer!r:.120}")
            return str(answer)

        return self._get("status", parse)

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

        def parse(answer: Any) -> Scenario:
            at = self._at("scenario")
            values = self._mapping(at, answer)
            for name in Scenario.__dataclass_fields__:
                kind = int if name == "seed" else str
                if not (values.get(name) is None or (isinstance(values[name], kind) and values[name] is not True)):
                    raise ProtocolError(at, f"{name} is {values[name]!r:.120}, expected {kind.__name__} or null")
            return Scenario.from_json(values)

        return self._get("scenario", parse)

    def set_scenario(self, scenario: Scenario) -> dict[str, float]:
        """Set the scenario.

        Returns:
            The first measurements if the scenario names a `time_period`, which initialises the test (7 days of
            warm-up, two scored weeks); otherwise an empty dictionary.
        """

        def parse(payload: Any) -> dict[str, float]:
            answer = self._mapping(self._at("scenario"), payload)
            if scenario.time_period is None:
                return {}
            return self._begun("scenario", answer.get("time_period"))

        self._scenario_ends = scenario.time_period is not None
        # A refusal of a named period is an answer: the service does not know it.
        values = self._put("scenario", scenario.as_json(), parse, refusals=2 if scenario.time_period is None else 0)
        self._transport.in_a_run = True
        return values

    def initialize(self, start_time_s: float, warmup_period_s: float) -> dict[str, float]:
        """Start at `start_time_s` after `warmup_period_s` under embedded control; returns the first measurements."""
        self._scenario_ends = False
        body = {"start_time": start_time_s, "warmup_period": warmup_period_s}

        def parse(payload: Any) -> dict[str, float]:
            return self._begun("initialize", payload, start_time_s)

        values = self._put("initialize", body, parse, refusals=0)
        self._transport.in_a_run = True
        return values

    def step(self) -> float:
        """Length of a step, s."""

        def parse(answer: Any) -> float:
            step_s = self._number(self._at("step"), answer)
            if not (math.isfinite(step_s) and step_s > 0.0):
                raise ProtocolError(self._at("step"), f"not a length of a step: {answer!r:.120}")
            return step_s

        return self._get("step", parse)

    def set_step(self, step_s: float) -> None:
        """Set the length of a step, s; the service is asked whether it has it."""

        def check(_: Any) -> None:
            if abs((found_s := self.step()) - step_s) > _CLOCK_TOLERANCE_S:
                raise ProtocolError(self._at("step"), f"the step is {found_s:g} s after it was set to {step_s:g} s")

        self._put("step", {"step": step_s}, check)
        self._step_s = float(step_s)

    def advance(self, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
        """Simulate one step; returns measurements and inputs at its end, empty where the service says it is at its end.

        If the answer is lost, an error, nonsense or of another time, the record of the service shows whether the step
        was simulated, before the request is repeated. If it was, the values at its end are read from the record.
        Messages of the service (for example about a clipped input) are logged as warnings.

        Raises:
            AdvanceInterrupted: there was no answer to this step in every attempt.
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
                    raise AdvanceInterrupted(
                        error.endpoint, f"{error.message}; the time before it is unknown"
                    ) from error
                in_doubt = True
                raise

        try:
            return self._transport.patiently(attempt)
        except (RequestRejected, UnknownTest, AdvanceInterrupted):
            raise
        except BoptestError as error:
            raise AdvanceInterrupted(
                error.endpoint, f"{error.message}, and no better answer within {self._transport.patience_s:g} s"
            ) from error

    def _advance_once(self, body: dict[str, float]) -> dict[str, float]:
        step_s = math.nan if math.isnan(self.time_s) else self._in_force()
        answer = self._transport.call("POST", f"advance/{self.testid}", body)
        if not answer.payload and answer.message.startswith("End of test case"):
            return {}
        state = self._numbers("advance", answer.payload)
        found_s = state.get("time", math.nan)
        # A scenario ends on time, whatever the step.
        cut = self._scenario_ends and abs(found_s - self._started_s - _SCENARIO_S) <= _CLOCK_TOLERANCE_S
        if not cut and (abs(found_s - self.time_s - step_s) > _CLOCK_TOLERANCE_S or math.isnan(found_s)):
            raise ProtocolError(
                self._at("advance"),
                f"its time is {found_s:.10g} s, expected is that of a step of {step_s:g} s from {self.time_s:.10g} s",
            )
        if answer.message and not answer.message.startswith("Advanced simulation"):
            _LOG.warning("advance: %s", answer.message)
        return self._with_time("advance", state)

    def go_on_from(self, time_s: float, step_s: float) -> dict[str, float]:
        """Take the test up at `time_s`, when the last answer was received; `step_s` is the step in force.

        Returns:
            The values at the end of a step that was simulated since then; nothing if there was none.

        Raises:
            AdvanceInterrupted: the test stands elsewhere.
        """
        self.time_s = self._started_s = time_s
        self._step_s, self._transport.in_a_run = step_s, True
        end_state = self._transport.patiently(self._simulated)
        if self.time_s - time_s > step_s + _CLOCK_TOLERANCE_S:
            raise AdvanceInterrupted(
                self._at("results"),
                f"the test stands at {self.time_s:.10g} s, the last answer was of {time_s:.10g} s and a step has "
                f"{step_s:g} s: somebody else advanced the test",
            )
        return end_state

    def forecast(
        self, point_names: Sequence[str], horizon_s: float, interval_s: float, *, patiently: bool = True
    ) -> dict[str, list[float]]:
        """Forecast of each point and strictly increasing 'time', s, from now to `horizon_s` every `interval_s`.

        Where `patiently` is false, a request that failed is not repeated.
        """
        body = {"point_names": list(point_names), "horizon": horizon_s, "interval": interval_s}

        def parse(payload: Any) -> dict[str, list[float]]:
            series = self._series("forecast", payload, [*point_names, "time"])
            clock = series["time"]
            if clock and abs(clock[0] - self.time_s) > _CLOCK_TOLERANCE_S:
                raise ProtocolError(
                    self._at("forecast"),
                    f"it begins at {clock[0]:.10g} s, expected is {self.time_s:.10g} s, where the test stands",
                )
            if not clock or any(a == b for a, b in pairwise(clock)):
                raise ProtocolError(self._at("forecast"), f"its clock ('time') does not rise: {clock[:3]} …")
            n = math.floor(horizon_s / interval_s + 1e-9) + 1
            steps = [(i, time_s - clock[0]) for i, time_s in enumerate(clock[:n])]
            if len(clock) < n or any(abs(after_s - i * interval_s) > _CLOCK_TOLERANCE_S for i, after_s in steps):
                raise ProtocolError(
                    self._at("forecast"),
                    f"asked for {n} instants every {interval_s:g} s, got {len(clock)} from {clock[0]:g} s to "
                    f"{clock[-1]:g} s",
                )
            return series

        if patiently:
            return self._put("forecast", body, parse)
        return self._put("forecast", body, parse, refusals=0, most_s=0.0)

    def results(self, point_names: Sequence[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        """Recorded values of each point and 'time', s, between two times, warm-up included, at 30-s samples.

        The service answers with status 500 if nothing is recorded between the two, for example in the future.
        """
        body = {"point_names": list(point_names), "start_time": start_s, "final_time": final_s}

        def parse(payload: Any) -> dict[str, list[float]]:
            series = self._series("results", payload, [*point_names, "time"])
            if series["time"]:
                self._check_record(series["time"], start_s, final_s)
            return series

        return self._put("results", body, parse)

    def kpi(self) -> dict[str, float | None]:
        """Key performance indicators since the end of the warm-up; None for those the test case does not compute."""

        def parse(payload: Any) -> dict[str, float | None]:
            values = self._numbers("kpi", payload)
            if not any(name.endswith("_tot") for name in values):
                raise ProtocolError(self._at("kpi"), f"the answer contains no indicator: {payload!r:.120}")
            return {key: None if math.isnan(value) else value for key, value in values.items()}

        return self._get("kpi", parse)

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
            testid = self._text(f"POST {self.url}/{path}", self._mapping(path, answer).get("testid"), "testid")
        except UnknownTest as error:
            offered = self._available_testcases()
            raise UnknownTest(error.endpoint, f"no test case '{self.testcase}'{offered}", error.status) from error
        except BaseException:
            self._transport.close()
            raise
        return testid

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
            time.sleep(min(_POLL_S, timeout_s))

    def _with_time(self, what: str, state: dict[str, float]) -> dict[str, float]:
        """The state in the answer to `what`, which must contain a finite 'time'."""
        if not math.isfinite(state.get("time", math.nan)):
            raise ProtocolError(self._at(what), "the measurements have no time")
        self.time_s = state["time"]
        return state

    def _begun(self, what: str, payload: Any, at_s: float = math.nan) -> dict[str, float]:
        """The state after an initialisation, which must be of `at_s` where that is known, s."""
        state = self._numbers(what, payload)
        found_s = state.get("time", math.nan)
        if abs(found_s - at_s) > _CLOCK_TOLERANCE_S:
            raise ProtocolError(self._at(what), f"its time is {found_s:.10g} s, expected is {at_s:.10g} s")
        self._started_s, self._step_s = found_s, math.nan  # it may reset the step
        return self._with_time(what, state)

    def _simulated(self) -> dict[str, float]:
        """The state where the test stands, if it was advanced since the last answer; else an empty one.

        The worker handles requests in order, so its record already includes a step whose request arrived.
        """
        self._names = self._names or [*self.measurements(), *self.inputs()]
        record = self.results(self._names, self.time_s, self.time_s + _STEPS_AHEAD * self._in_force())
        if not record["time"]:
            raise ProtocolError(self._at("results"), f"it has nothing at {self.time_s:.10g} s, where the test stood")
        if record["time"][-1] <= self.time_s + _CLOCK_TOLERANCE_S:
            return {}
        return self._with_time("results", {name: values[-1] for name, values in record.items()})

    def _in_force(self) -> float:
        """Length of a step, s, asked for once."""
        if math.isnan(self._step_s):
            self._step_s = self.step()
        return self._step_s

    def _check_record(self, clock: Sequence[float], start_s: float, final_s: float) -> None:
        """Raise `ProtocolError` for a record of other times than asked for, or that lacks what was simulated."""
        first, last, now_s = clock[0], clock[-1], self.time_s
        whole = start_s - _CLOCK_TOLERANCE_S <= first and last <= final_s + _CLOCK_TOLERANCE_S
        since_s, until_s = max(start_s, self._started_s), min(final_s, now_s)  # some services record no warm-up
        if math.isfinite(now_s) and since_s <= until_s:
            whole &= first <= since_s + _SAMPLE_S and last >= until_s - _SAMPLE_S
        if last > now_s + _CLOCK_TOLERANCE_S:  # steps that we do not know of; or the clock is wrong
            whole &= first <= start_s + _CLOCK_TOLERANCE_S
        if not whole:
            raise ProtocolError(
                self._at("results"),
                f"its times are {first:.10g} to {last:.10g} s, asked for {start_s:.10g} to {final_s:.10g} s while the "
                f"test stands at {now_s:.10g} s",
            )

    def _get(self, what: str, parse: Callable[[Any], _Parsed]) -> _Parsed:
        """The parsed answer to a GET request, repeated while it fails or is nonsense."""
        path, most_s = f"{what}/{self.testid}", math.inf if self._transport.in_a_run else LOOKUP_S
        return self._transport.patiently(lambda: parse(self._transport.call("GET", path, most_s=most_s).payload))

    def _put(
        self,
        what: str,
        body: dict[str, Any],
        parse: Callable[[Any], _Parsed],
        refusals: int = 2,
        most_s: float = math.inf,
    ) -> _Parsed:
        """The same for PUT; all PUT requests of the protocol may be repeated."""
        path = f"{what}/{self.testid}"
        return self._transport.patiently(
            lambda: parse(self._transport.call("PUT", path, body).payload), refusals=refusals, most_s=most_s
        )

    def _at(self, what: str) -> str:
        """Address of the endpoint `what` of this test, for an error message."""
        return f"{self.url}/{what}/{self.testid}"

    def _points(self, what: str) -> dict[str, Point]:
        """Points of a list; one of them at least must have a unit, which JSON of another kind does not."""
        at = self._at(what)

        def parse(payload: Any) -> dict[str, Point]:
            entries = {
                safe_text(name): self._mapping(f"{at}: {safe_text(name)}", data)
                for name, data in self._mapping(at, payload).items()
                if name != "time"
            }
            if not any("Unit" in data for data in entries.values()):
                raise ProtocolError(at, f"not a list of points: {payload!r:.120}")
            return {name: Point.from_json(name, data) for name, data in entries.items()}

        return self._get(what, parse)

    def _mapping(self, endpoint: str, answer: Any) -> Mapping[str, Any]:
        if not isinstance(answer, Mapping):
            raise ProtocolError(endpoint, f"expected names and values, got {answer!r:.120}")
        return answer

    def _text(self, endpoint: str, answer: Any, what: str) -> str:
        if not isinstance(answer, str) or not answer:
            raise ProtocolError(endpoint, f"no {what} in the answer ({answer!r:.120})")
        return safe_text(answer)

    def _number(self, endpoint: str, answer: Any) -> float:
        """A number, which services also write as text; NaN for null, since JSON has no NaN."""
        if answer is None:
            return math.nan
        try:
            if not isinstance(answer, bool):
                return float(answer)
        except (TypeError, ValueError, OverflowError):
            pass
        raise ProtocolError(endpoint, f"a value is not a number ({answer!r:.120})")

    def _numbers(self, what: str, answer: Any) -> dict[str, float]:
        at = self._at(what)
        return {key: self._number(at, value) for key, value in self._mapping(at, answer).items()}

    def _series(self, what: str, answer: Any, names: Sequence[str]) -> dict[str, list[float]]:
        """Values of `names` at the instants 'time', which never fall; none where none are recorded."""
        endpoint = f"PUT {self._at(what)}"
        mapping = self._mapping(endpoint, answer)
        missing = [name for name in names if name not in mapping]
        if missing:
            raise ProtocolError(endpoint, f"no values for {', '.join(missing)}")
        for name in names:
            if not isinstance(mapping[name], list):
                raise ProtocolError(endpoint, f"{name} is not a list of numbers: {mapping[name]!r:.120}")
        series = {name: [self._number(endpoint, value) for value in mapping[name]] for name in names}
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
