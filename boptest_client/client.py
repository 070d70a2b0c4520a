"""A synchronous client for one test of a BOPTEST service."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from types import TracebackType
from typing import Any

from boptest_client.errors import BoptestError, ProtocolError, ServiceTimeout, TransportError
from boptest_client.transport import Transport, TransportConfig
from boptest_client.types import Point

_POLL_S = 0.5


class BoptestClient:
    """One selected test case. Use it as a context manager: the test is stopped however the block ends.

    ```python
    with BoptestClient("http://127.0.0.1:8000", "bestest_hydronic_heat_pump") as test:
        test.set_scenario(time_period="peak_heat_day", electricity_price="constant")
        test.set_step(3600)
        measured = test.advance({"oveHeaPumY_u": 0.5, "oveHeaPumY_activate": 1})
    ```
    """

    def __init__(
        self, url: str, testcase: str, *, config: TransportConfig | None = None, start_timeout_s: float = 120.0
    ) -> None:
        """Select `testcase` and wait until it runs.

        Raises:
            RequestRejected, UnknownTest: the service does not know the test case.
            TransportError: the service cannot be reached.
            ServiceTimeout: the test was still queued after `start_timeout_s`.
        """
        self.testcase = testcase
        self._transport = Transport(url, config or TransportConfig(), _user_agent())
        self._stopped = False
        # Selecting twice would leave an orphan behind, so it is not repeated.
        answer = self._transport.call("POST", f"testcases/{testcase}/select", {}, repeatable=False)
        if not isinstance(answer, dict) or "testid" not in answer:
            raise ProtocolError(f"POST testcases/{testcase}/select", f"no testid in {answer!r}")
        self.testid = str(answer["testid"])
        try:
            self._wait(start_timeout_s)
        except BaseException:
            self.stop()
            raise

    @property
    def url(self) -> str:
        """Base URL of the service."""
        return self._transport.url

    def version(self) -> str:
        """Version of the service; different versions give different results for the same test case."""
        answer = self._transport.call("GET", "version", repeatable=True)
        return str(answer.get("version", answer)) if isinstance(answer, dict) else str(answer)

    def name(self) -> str:
        """Name of the test case as the service tells it."""
        answer = self._get("name")
        return str(answer.get("name", answer)) if isinstance(answer, dict) else str(answer)

    def status(self) -> str:
        """'Running', 'Queued', ..."""
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

    def scenario(self) -> dict[str, Any]:
        """The scenario in force."""
        return dict(self._mapping("scenario", self._get("scenario")))

    def set_scenario(self, **options: Any) -> dict[str, Any]:
        """Set `electricity_price`, `time_period`, `temperature_uncertainty`, `solar_uncertainty`, `seed`.

        A `time_period` initialises the test (7 days of warm-up, two scored weeks); the answer then holds the first
        measurements under 'time_period'.
        """
        return dict(self._mapping("scenario", self._put("scenario", options)))

    def initialize(self, start_time: float, warmup_period: float) -> dict[str, float]:
        """Start at `start_time` after `warmup_period` of the embedded control, s; returns the first measurements."""
        body = {"start_time": start_time, "warmup_period": warmup_period}
        return self._numbers("initialize", self._put("initialize", body))

    def step(self) -> float:
        """Length of a step, s."""
        return float(self._get("step"))

    def set_step(self, step_s: float) -> None:
        """Set the length of a step, s."""
        self._put("step", {"step": step_s})

    def advance(self, inputs: Mapping[str, float] | None = None) -> dict[str, float]:
        """Simulate one step; returns the measurements at its end, empty once the scenario is over.

        Never repeated by itself: time may have moved although no answer came.

        Raises:
            TransportError: no answer came; whether the step was simulated is unknown.
        """
        try:
            answer = self._transport.call("POST", f"advance/{self.testid}", dict(inputs or {}), repeatable=False)
        except TransportError as error:
            raise type(error)(
                error.endpoint, f"{error.message}; the step may or may not have been simulated, start the run again"
            ) from error
        return self._numbers("advance", answer)

    def forecast(self, point_names: Sequence[str], horizon_s: float, interval_s: float) -> dict[str, list[float]]:
        """Forecast of each point and of 'time', from now to `horizon_s` every `interval_s`."""
        body = {"point_names": list(point_names), "horizon": horizon_s, "interval": interval_s}
        return self._series("forecast", self._put("forecast", body), [*point_names, "time"])

    def results(self, point_names: Sequence[str], start_s: float, final_s: float) -> dict[str, list[float]]:
        """What was recorded of each point, and 'time', between two times; 30-s samples."""
        body = {"point_names": list(point_names), "start_time": start_s, "final_time": final_s}
        return self._series("results", self._put("results", body), [*point_names, "time"])

    def kpi(self) -> dict[str, float | None]:
        """Key performance indicators since the end of the warm-up; None where the test case has none."""
        answer = self._mapping("kpi", self._get("kpi"))
        return {key: None if value is None else float(value) for key, value in answer.items()}

    def stop(self) -> None:
        """Stop the test and free its worker; safe to call twice. A service that is gone is not an error here."""
        if not self._stopped:
            self._stopped = True
            with contextlib.suppress(BoptestError):
                self._transport.call("PUT", f"stop/{self.testid}", {}, repeatable=False)
        self._transport.close()

    def __enter__(self) -> BoptestClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _wait(self, timeout_s: float) -> None:
        until = time.monotonic() + timeout_s
        while (status := self.status()) != "Running":
            if time.monotonic() > until:
                raise ServiceTimeout(f"GET status/{self.testid}", f"still '{status}' after {timeout_s:g} s")
            time.sleep(_POLL_S)

    def _get(self, what: str) -> Any:
        return self._transport.call("GET", f"{what}/{self.testid}", repeatable=True)

    def _put(self, what: str, body: dict[str, Any]) -> Any:
        # Setting the same thing twice, or asking twice, changes nothing.
        return self._transport.call("PUT", f"{what}/{self.testid}", body, repeatable=True)

    def _points(self, what: str) -> dict[str, Point]:
        return {name: Point.from_json(name, data or {}) for name, data in self._mapping(what, self._get(what)).items()}

    def _mapping(self, what: str, answer: Any) -> Mapping[str, Any]:
        if not isinstance(answer, Mapping):
            raise ProtocolError(f"{what}/{self.testid}", f"expected names and values, got {str(answer)[:120]!r}")
        return answer

    def _numbers(self, what: str, answer: Any) -> dict[str, float]:
        try:
            return {key: float(value) for key, value in self._mapping(what, answer or {}).items()}
        except (TypeError, ValueError) as error:
            raise ProtocolError(f"{what}/{self.testid}", f"a value is not a number ({error})") from error

    def _series(self, what: str, answer: Any, names: Sequence[str]) -> dict[str, list[float]]:
        mapping = self._mapping(what, answer)
        missing = [name for name in names if name not in mapping]
        if missing:
            raise ProtocolError(f"{what}/{self.testid}", f"no values for {', '.join(missing)}")
        try:
            return {name: [float(value) for value in mapping[name]] for name in names}
        except (TypeError, ValueError) as error:
            raise ProtocolError(f"{what}/{self.testid}", f"a value is not a number ({error})") from error


def _user_agent() -> str:
    try:
        return f"thermoforce-mpc/{version('thermoforce-mpc')}"
    except PackageNotFoundError:
        return "thermoforce-mpc"
