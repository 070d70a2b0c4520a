"""Endpoints of one test: method, name, what answers, and the JSON schemas of request and reply."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.boundary.forecast_error import MAX_HORIZON_H
from thermoforce_mpc.service.points import FORECAST_POINTS, INPUTS, MEASUREMENT_POINTS
from thermoforce_mpc.service.scenario import LEVELS
from thermoforce_mpc.service.session import LEAST_STEP_S, MOST_STEP_S, PERIODS, Reply, Session

TESTCASE = "bestest_hydronic_heat_pump"
Schema = dict[str, Any]

_NUMBER_OR_NULL: Schema = {"type": ["number", "null"]}


def _object(properties: Mapping[str, Schema], required: tuple[str, ...] = (), *, closed: bool = False) -> Schema:
    schema: Schema = {"type": "object", "properties": dict(properties)}
    if required:
        schema["required"] = list(required)
    return schema | ({"additionalProperties": False} if closed else {})


def _number(description: str, low: float | None = None, high: float | None = None) -> Schema:
    """A number, or text that is one: older clients send forms."""
    number: Schema = {"type": "number"}
    number |= {} if low is None else {"minimum": low}
    number |= {} if high is None else {"maximum": high}
    return {
        "anyOf": [number, {"type": "string", "pattern": r"^[0-9]{1,9}(\.[0-9]{1,6})?$"}],
        "description": description,
    }


def _names(points: Mapping[str, Any], what: str) -> Schema:
    name: Schema = {"type": "string", "enum": [*points, "time"]}
    return {"anyOf": [{"type": "array", "items": name}, name], "description": f"names of {what}"}


def _nothing(description: str) -> Schema:
    return {"type": ["string", "null"], "enum": [None, "", "none", *LEVELS], "description": description}


_POINT = _object(
    {
        "Description": {"type": "string"},
        "Unit": {"type": ["string", "null"]},
        "Minimum": _NUMBER_OR_NULL,
        "Maximum": _NUMBER_OR_NULL,
    },
    ("Description", "Unit"),
    closed=True,
)
_POINTS: Schema = {"type": "object", "additionalProperties": _POINT}
_STATE: Schema = {
    "type": "object",
    "additionalProperties": _NUMBER_OR_NULL,
    "description": "value of each measurement and input, and time, s; empty after the end of the scenario",
}
_SERIES: Schema = {"type": "object", "additionalProperties": {"type": "array", "items": _NUMBER_OR_NULL}}
_STEP = _number("control step, s", LEAST_STEP_S, MOST_STEP_S)
_PRICE: Schema = {"type": ["string", "null"], "enum": [None, "", "constant", "dynamic", "highly_dynamic"]}
_PERIOD: Schema = {"type": ["string", "null"], "enum": [None, "", *PERIODS]}
_SEED: Schema = {"type": ["number", "null"], "minimum": 0, "multipleOf": 1, "description": "null or 0: none"}
_ERROR = f"forecast error; with one, a horizon of at most {MAX_HORIZON_H} h"
_SCENARIO = {
    "electricity_price": _PRICE,
    "time_period": _PERIOD,
    "temperature_uncertainty": _nothing(f"of TDryBul: {_ERROR}"),
    "solar_uncertainty": _nothing(f"of HGloHor: {_ERROR}"),
    "seed": _SEED,
}
_SWITCH: Schema = {"enum": [0, 1, True, False, "0", "1", "true", "false", None]}


def _input(name: str) -> Schema:
    if name.endswith("_activate"):
        return _SWITCH | {"description": INPUTS[name].description}
    number = _number(INPUTS[name].description)
    return {"anyOf": [*number.pop("anyOf"), {"type": "null"}], **number}


@dataclass(frozen=True)
class Endpoint:
    """`body`: schema of the request's body, None if it is ignored; `payload`: schema of the reply's payload."""

    method: str
    verb: str
    answer: Callable[[Session, Mapping[str, Any]], Reply]
    summary: str
    payload: Schema
    body: Schema | None = None


ENDPOINTS: tuple[Endpoint, ...] = (
    Endpoint(
        "GET",
        "name",
        lambda s, _: Reply("The name of the test case.", {"name": TESTCASE}),
        "Name of the test case",
        _object({"name": {"const": TESTCASE}}, ("name",), closed=True),
    ),
    Endpoint("GET", "inputs", lambda s, _: s.inputs(), "Inputs", _POINTS),
    Endpoint("GET", "measurements", lambda s, _: s.measurements(), "Measurements", _POINTS),
    Endpoint("GET", "forecast_points", lambda s, _: s.forecast_points(), "Forecast points", _POINTS),
    Endpoint("GET", "step", lambda s, _: s.step(), "Control step, s", {"type": "number"}),
    Endpoint(
        "PUT",
        "step",
        Session.set_step,
        "Set the control step",
        _object({"step": {"type": "number"}}, ("step",), closed=True),
        _object({"step": _STEP}, ("step",)),
    ),
    Endpoint(
        "GET",
        "scenario",
        lambda s, _: s.scenario(),
        "Scenario in force",
        _object(_SCENARIO, tuple(_SCENARIO), closed=True),
    ),
    Endpoint(
        "PUT",
        "scenario",
        Session.set_scenario,
        "Change the scenario; a time period initialises the test",
        _object(
            _SCENARIO | {"time_period": {"anyOf": [_STATE, {"type": "null"}]}},
            tuple(_SCENARIO),
            closed=True,
        ),
        _object(_SCENARIO),
    ),
    Endpoint(
        "PUT",
        "initialize",
        Session.initialize,
        "Start at a time of the year after a warm-up under native control",
        _STATE,
        _object(
            {
                "start_time": _number("s since 1 January", 0.0),
                "warmup_period": _number("s", 0.0),
                "final_time": {"type": ["number", "null"], "description": "end of the test, s since 1 January"},
            },
            ("start_time", "warmup_period"),
        ),
    ),
    Endpoint(
        "POST",
        "advance",
        Session.advance,
        "Simulate one step with the given inputs; others keep their values",
        _STATE,
        _object({name: _input(name) for name in INPUTS}, closed=True),
    ),
    Endpoint(
        "PUT",
        "forecast",
        Session.forecast,
        "Forecast from now on",
        _SERIES,
        _object(
            {
                "point_names": _names(FORECAST_POINTS, "forecast points"),
                "horizon": _number("s", 0.0),
                "interval": _number("s", 1.0),
            },
            ("point_names", "horizon", "interval"),
        ),
    ),
    Endpoint(
        "PUT",
        "results",
        Session.results,
        "Recorded values between two times",
        _SERIES,
        _object(
            {
                "point_names": _names({**MEASUREMENT_POINTS, **INPUTS}, "measurements and inputs"),
                "start_time": _number("s since 1 January"),
                "final_time": _number("s since 1 January"),
            },
            ("point_names", "start_time", "final_time"),
        ),
    ),
    Endpoint(
        "GET",
        "kpi",
        lambda s, _: s.kpi(),
        "Key performance indicators since the end of the warm-up",
        {"type": "object", "additionalProperties": _NUMBER_OR_NULL},
    ),
)
