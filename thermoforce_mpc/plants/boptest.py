"""The real plant: a test of a BOPTEST service behind the `Plant` protocol. Kelvin ends here."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from types import TracebackType

import numpy as np

from boptest_client import BoptestClient, BoptestError, RequestRejected, TransportConfig, UnknownTest
from thermoforce_mpc.configuration import suggestion
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.testcase import PRICES, Price, TestCase
from thermoforce_mpc.types import DAY_S, Array, Boundary, History, Measurement, Period, PlantInfo

_KELVIN = 273.15
# BOPTEST initialises a scenario's time period with this much of the embedded control.
_SCENARIO_WARMUP_S = 7 * DAY_S
_SCENARIO_LENGTH_S = 14 * DAY_S
_NAMED_PERIODS = ("peak_heat_day", "typical_heat_day")
_CLOCK_TOLERANCE_S = 1.0


class BoptestPlant:
    """One test case on a service. The test is stopped when the plant is closed."""

    def __init__(self, url: str, testcase: TestCase, *, config: TransportConfig | None = None) -> None:
        """Select the test case and check that every point of `testcase` exists there.

        Raises:
            ConfigError: the service does not offer the test case, or lacks a point that the YAML file names.
            PlantError: the service cannot be reached or failed.
        """
        self.testcase = testcase
        self._start_of: dict[str, float] = {}
        self._price: Price = "constant"
        self._step_s = math.nan
        self._now_s = self._begin_s = 0.0
        with _failures():
            try:
                self._client = BoptestClient(url, testcase.name, config=config)
            except (RequestRejected, UnknownTest) as error:
                raise ConfigError(f"testcase '{testcase.name}' is not offered by {url}: {error.message}") from error
        try:
            with _failures():
                self._check_points()
                self._version = self._client.version()
        except BaseException:
            self._client.stop()
            raise

    @property
    def info(self) -> PlantInfo:
        """Which service and version this is; versions differ in results and must not be mixed."""
        return PlantInfo(
            kind="boptest",
            testcase=self.testcase.name,
            description=f"BOPTEST service at {self._client.url}, version {self._version}",
            weather="the test case's own weather",
            version=self._version,
            details={"url": self._client.url, "testid": self._client.testid},
        )

    def period(self, name: str) -> Period:
        """The scored window of the service's scenario, or of a start day; asking for a scenario initialises it.

        Raises:
            InputError: neither a scenario nor a day of the year.
            PlantError: the service failed.
        """
        try:
            day = float(name)
        except ValueError:
            if name not in _NAMED_PERIODS:
                raise InputError(f"period '{name}': expected {', '.join(_NAMED_PERIODS)} or a start day") from None
            if name not in self._start_of:
                self._start_of[name] = self._initialize_scenario(name, self._price).time_s
            return Period(name, self._start_of[name], _SCENARIO_LENGTH_S, _SCENARIO_WARMUP_S)
        if not 0.0 <= day < 365.0:
            raise InputError(f"period '{name}': a start day lies between 0 and 365")
        return Period(f"day {day:g}", day * DAY_S)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` after `warmup_s` of the embedded control.

        Where the times are those of a scenario's window, the official scenario is set.
        """
        if price not in PRICES:
            raise InputError(f"unknown tariff '{price}'; known: {', '.join(PRICES)}")
        self._price = next(known for known in PRICES if known == price)
        self._begin_s = max(start_s - warmup_s, 0.0)
        for name, scenario_start in self._start_of.items():
            if scenario_start == start_s and warmup_s == _SCENARIO_WARMUP_S:
                return self._initialize_scenario(name, price)
        with _failures():
            self._client.set_scenario(electricity_price=price)
            points = self._client.initialize(start_s, warmup_s)
        return self._at_rest(points, start_s)

    def advance(self, u: float | None, duration_s: float) -> Measurement:
        """Hold `u` in [0, 1] (None: nothing is overwritten) for `duration_s`.

        Raises:
            InputError: `u` or `duration_s` is not a number the plant can take.
            PlantError: the service failed, or its scenario is over.
        """
        if u is not None and not (math.isfinite(u) and 0.0 <= u <= 1.0):
            raise InputError(f"level of {u!r}: expected a number from 0 to 1, or None")
        if not (math.isfinite(duration_s) and duration_s > 0):
            raise InputError(f"step of {duration_s!r} s: expected a positive number")
        actuator = self.testcase.actuator
        inputs = {} if u is None else {f"{actuator.point}_u": actuator.value(u), f"{actuator.point}_activate": 1.0}
        before = self._now_s
        with _failures():
            if duration_s != self._step_s:
                self._client.set_step(duration_s)
                self._step_s = duration_s
            points = self._client.advance(inputs)
            if not points:
                raise PlantError(f"the service's scenario ended at day {before / DAY_S:g}: nothing more to simulate")
            self._now_s = float(points.get("time", before + duration_s))
            moved = self._now_s - before
            if abs(moved - duration_s) > _CLOCK_TOLERANCE_S:
                raise PlantError(f"the service advanced by {moved:g} s instead of {duration_s:g} s")
            past = self._recorded(before, self._now_s)
        return self._measurement(
            points,
            u=math.nan if u is None else u,
            power_W=_mean(past, self.testcase.measurements.electric_power, before, self._now_s),
            heat_W=_mean(past, self.testcase.measurements.heat, before, self._now_s),
        )

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Boundary conditions from now to `horizon_s` ahead every `interval_s`, as the service forecasts them."""
        f = self.testcase.forecast
        names = [
            f.outdoor_temperature, f.solar, f.occupancy, f.lower, f.upper, f.price[self._price], f.emission,
        ]  # fmt: skip
        with _failures():
            data = self._client.forecast(names, horizon_s, interval_s)
        values = [np.array(data[name]) for name in names]
        return Boundary(
            time_s=np.array(data["time"]),
            T_out_C=values[0] - _KELVIN,
            solar_W_m2=values[1],
            occupancy=values[2],
            lower_C=values[3] - _KELVIN,
            upper_C=values[4] - _KELVIN,
            price_per_kWh=values[5],
            emission_kg_per_kWh=values[6],
        )

    def past(self, step_s: float) -> History:
        """What the service recorded since the start of the warm-up, at `step_s`.

        The level of the embedded control is no point of the service, so `u` is NaN there; where the heat is measured
        that suffices. Without measured heat, only the present instant is returned.
        """
        m = self.testcase.measurements
        n = math.floor((self._now_s - self._begin_s) / step_s + 1e-9) if m.heat else 0
        edges: Array = self._now_s - np.arange(float(n), -1.0, -1.0) * step_s
        with _failures():
            record = self._recorded(edges[0], edges[-1], sampled=True)
        time_s = record["time"]
        if n and time_s[0] > edges[0] + _CLOCK_TOLERANCE_S + step_s:
            # The service kept less than was asked for: use what there is.
            edges = edges[edges >= time_s[0]]
            n = edges.size - 1

        def at_edges(point: str) -> Array:
            return np.interp(edges, time_s, record[point])

        def means(points: Sequence[str]) -> Array:
            return np.array([_mean(record, points, a, b) for a, b in pairwise(edges)])

        return History(
            time_s=edges,
            T_zone_C=at_edges(m.zone_temperature) - _KELVIN,
            T_out_C=at_edges(m.outdoor_temperature) - _KELVIN,
            solar_W_m2=at_edges(m.solar),
            u=np.full(n, math.nan),
            power_W=means(m.electric_power),
            heat_W=means(m.heat),
        )

    def kpis(self) -> dict[str, float]:
        """The service's own KPIs since the end of the warm-up; those a test case does not have are left out."""
        with _failures():
            found = self._client.kpi()
        return {name: value for name, value in found.items() if value is not None}

    def close(self) -> None:
        """Stop the test at the service; safe to call twice."""
        self._client.stop()

    def __enter__(self) -> BoptestPlant:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _initialize_scenario(self, name: str, price: str) -> Measurement:
        with _failures():
            answer = self._client.set_scenario(time_period=name, electricity_price=price)
            points = answer.get("time_period")
            if not isinstance(points, dict) or "time" not in points:
                raise PlantError(f"the service did not say where scenario '{name}' starts (it answered {answer!r})")
        start_s = float(points["time"])
        self._begin_s = max(start_s - _SCENARIO_WARMUP_S, 0.0)
        return self._at_rest({key: float(value) for key, value in points.items()}, start_s)

    def _at_rest(self, points: dict[str, float], start_s: float) -> Measurement:
        """The measurement right after an initialisation: nothing has been averaged yet."""
        self._now_s = start_s
        self._step_s = math.nan  # initialising may have put the service's own step back
        return self._measurement(points, math.nan, math.nan, math.nan)

    def _measurement(self, points: dict[str, float], u: float, power_W: float, heat_W: float) -> Measurement:
        m = self.testcase.measurements
        return Measurement(
            time_s=self._now_s,
            T_zone_C=points.get(m.zone_temperature, math.nan) - _KELVIN,
            T_out_C=points.get(m.outdoor_temperature, math.nan) - _KELVIN,
            solar_W_m2=points.get(m.solar, math.nan),
            u=u,
            power_W=power_W,
            heat_W=heat_W,
            points=points,
        )

    def _recorded(self, start_s: float, final_s: float, *, sampled: bool = False) -> dict[str, Array]:
        """Recorded series between two times: powers and heat, and with `sampled` the sampled signals too."""
        m = self.testcase.measurements
        names = [*m.electric_power, *m.heat]
        if sampled:
            names += [m.zone_temperature, m.outdoor_temperature, m.solar]
        data = self._client.results(names, start_s, final_s)
        if not data["time"]:
            raise PlantError(f"the service recorded nothing between {start_s:g} s and {final_s:g} s")
        return {name: np.array(values) for name, values in data.items()}

    def _check_points(self) -> None:
        """Every point the test case file names must exist at the service."""
        t = self.testcase
        m, f = t.measurements, t.forecast
        inputs = set(self._client.inputs())
        measured = set(self._client.measurements())
        forecast = set(self._client.forecast_points())
        wanted = [
            ("actuator.point", f"{t.actuator.point}_u", inputs),
            ("actuator.point", f"{t.actuator.point}_activate", inputs),
            ("measurements.zone_temperature", m.zone_temperature, measured),
            ("measurements.outdoor_temperature", m.outdoor_temperature, measured),
            ("measurements.solar", m.solar, measured),
            *(("measurements.electric_power", name, measured) for name in m.electric_power),
            *(("measurements.heat", name, measured) for name in m.heat),
            ("forecast.outdoor_temperature", f.outdoor_temperature, forecast),
            ("forecast.solar", f.solar, forecast),
            ("forecast.occupancy", f.occupancy, forecast),
            ("forecast.lower", f.lower, forecast),
            ("forecast.upper", f.upper, forecast),
            *((f"forecast.price.{key}", name, forecast) for key, name in f.price.items()),
            ("forecast.emission", f.emission, forecast),
        ]
        wrong = [
            f"{key}: the service has no point '{name}'{suggestion(name, known)}"
            for key, name, known in wanted
            if name not in known
        ]
        if wrong:
            raise ConfigError(f"test case '{t.name}' does not fit the service:\n  " + "\n  ".join(wrong))


@contextlib.contextmanager
def _failures() -> Iterator[None]:
    """Turn the client's errors into this package's, keeping the service's words."""
    try:
        yield
    except BoptestError as error:
        raise PlantError(f"BOPTEST service: {error}") from error


def _mean(record: dict[str, Array], points: Sequence[str], start_s: float, end_s: float) -> float:
    """Time mean of the sum of `points` between two times; NaN when there are no points or no samples.

    Each sample stands for the time since the one before it: at a switch, the sample at the start of the interval still
    belongs to the action before.
    """
    if not points:
        return math.nan
    time_s = record["time"]
    total = np.sum([record[name] for name in points], axis=0)
    inside = (time_s > start_s + 1e-6) & (time_s <= end_s + 1e-6)
    if not inside.any():
        return math.nan
    stretches = np.diff(np.concatenate([[start_s], time_s[inside]]))
    return float(np.sum(stretches * total[inside]) / np.sum(stretches))
