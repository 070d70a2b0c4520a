"""Endpoints of one test, with the JSON schemas of request and reply, and the OpenAPI document made from them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.boundary.forecast_error import MAX_HORIZON_H
from thermoforce_mpc.service.points import PointInfo, ServedPoints
from thermoforce_mpc.service.scenario import LEVELS
from thermoforce_mpc.service.sessions import LEAST_STEP_S, MOST_STEP_S, Reply, Session
from thermoforce_mpc.version import VERSION

Schema = dict[str, Any]

_NUMBER_OR_NULL: Schema = {"type": ["number", "null"]}
_TEXT: Schema = {"type": "string"}


def _object(properties: Mapping[str, Schema], *required: str, closed: bool = False) -> Schema:
    schema: Schema = {"type": "object", "properties": dict(properties)}
    if required:
        schema["required"] = list(required)
    return schema | ({"additionalProperties": False} if closed else {})


def _reply(**properties: Schema) -> Schema:
    return _object(properties, *properties, closed=True)


def _each(value: Schema, **more: str) -> Schema:
    return {"type": "object", "additionalProperties": value, **more}


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


_LIMITS = {"Minimum": _NUMBER_OR_NULL, "Maximum": _NUMBER_OR_NULL}
_POINT = _object(
    {"Description": _TEXT, "Unit": {"type": ["string", "null"]}} | _LIMITS, "Description", "Unit", closed=True
)
_STATE = _each(
    _NUMBER_OR_NULL, description="value of each measurement and input, and time, s; empty after the end of the scenario"
)
_SERIES = _each({"type": "array", "items": _NUMBER_OR_NULL})
_ERROR = f"forecast error; with one, a horizon of at most {MAX_HORIZON_H} h"
_SCENARIO: dict[str, Schema] = {
    "electricity_price": {"type": ["string", "null"], "enum": [None, "", "constant", "dynamic", "highly_dynamic"]},
    "temperature_uncertainty": _nothing(f"of TDryBul: {_ERROR}"),
    "solar_uncertainty": _nothing(f"of HGloHor: {_ERROR}"),
    "seed": {"type": ["number", "null"], "minimum": 0, "multipleOf": 1, "description": "null or 0: none"},
}
_STEP = {"step": _number("control step, s", LEAST_STEP_S, MOST_STEP_S)}
_WARMUP = {"start_time": _number("s since 1 January", 0.0), "warmup_period": _number("s", 0.0)}
_START = _WARMUP | {"final_time": {"type": ["number", "null"], "description": "end of the test, s since 1 January"}}
_SWITCH: Schema = {"enum": [0, 1, True, False, "0", "1", "true", "false", None]}


def _input(name: str, info: PointInfo) -> Schema:
    if name.endswith("_activate"):
        return _SWITCH | {"description": info.description}
    number = _number(info.description)
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


def _listing(verb: str, points: Mapping[str, PointInfo], *, limits: bool = True) -> Endpoint:
    what = verb.replace("_", " ")
    reply = Reply(f"The {what}.", {name: info.as_json(limits=limits) for name, info in points.items()})
    return Endpoint("GET", verb, lambda *_: reply, what.capitalize(), _each(_POINT))


_SUMMARY = "Key performance indicators since the end of the warm-up"


def endpoints(points: ServedPoints) -> tuple[Endpoint, ...]:
    """The endpoints of a test of a test case."""
    name = points.case.name
    told = Reply("The name of the test case.", {"name": name})
    inputs = _object({name: _input(name, info) for name, info in points.inputs.items()}, closed=True)
    periods: Schema = {"type": ["string", "null"], "enum": [None, "", *points.case.periods]}
    scenario = _SCENARIO | {"time_period": periods}
    scenario_set = _reply(**(scenario | {"time_period": {"anyOf": [_STATE, {"type": "null"}]}}))
    ahead = {
        "point_names": _names(points.forecasts, "forecast points"),
        "horizon": _number("s", 0.0),
        "interval": _number("s", 1.0),
    }
    past = {
        "point_names": _names({**points.measurements, **points.inputs}, "measurements and inputs"),
        "start_time": _number("s since 1 January; the text '-inf' for the first sample"),
        "final_time": _number("s since 1 January; the text 'inf' for the last sample"),
    }
    return (
        Endpoint("GET", "name", lambda *_: told, "Name of the test case", _reply(name={"const": name})),
        _listing("inputs", points.inputs),
        _listing("measurements", points.measurements),
        _listing("forecast_points", points.forecasts, limits=False),
        Endpoint("GET", "step", lambda s, _: s.step(), "Control step, s", {"type": "number"}),
        Endpoint(
            "PUT",
            "step",
            Session.set_step,
            "Set the control step",
            _reply(step={"type": "number"}),
            _object(_STEP, "step"),
        ),
        Endpoint("GET", "scenario", lambda s, _: s.scenario(), "Scenario in force", _reply(**scenario)),
        Endpoint(
            "PUT",
            "scenario",
            Session.set_scenario,
            "Change the scenario; a time period initialises the test",
            scenario_set,
            _object(scenario),
        ),
        Endpoint(
            "PUT",
            "initialize",
            Session.initialize,
            "Start at a time of the year after a warm-up under native control",
            _STATE,
            _object(_START, *_WARMUP),
        ),
        Endpoint(
            "POST",
            "advance",
            Session.advance,
            "Simulate one step with the given inputs; others keep their values",
            _STATE,
            inputs,
        ),
        Endpoint("PUT", "forecast", Session.forecast, "Forecast from now on", _SERIES, _object(ahead, *ahead)),
        Endpoint("PUT", "results", Session.results, "Recorded values between two times", _SERIES, _object(past, *past)),
        Endpoint("GET", "kpi", lambda s, _: s.kpi(), _SUMMARY, _each(_NUMBER_OR_NULL)),
    )


# Namespace of BOPTEST's own test cases.
NAMESPACE = "ibpsa"
FORMS = ("multipart/form-data", "application/x-www-form-urlencoded")
_REASONS = {
    400: "invalid value or test id, see `message` or `errors`",
    401: "the token is missing or wrong",
    403: "asked by a name that the service has not, or by a page of another site",
    404: "no such test case or path",
    413: "the body is too long",
    429: "too many requests a second, requests of one test at a time, or tests",
}


def document(points: ServedPoints, *, token: bool) -> dict[str, Any]:
    """The OpenAPI document of a service that needs a token, or none."""
    paths: dict[str, dict[str, Any]] = {}

    def add(
        method: str, path: str, summary: str, answer: Schema, body: Schema | None = None, kind: str = "application/json"
    ) -> None:
        names = re.findall(r"{(\w+)}", path)
        paths.setdefault(path, {})[method] = _operation(summary, answer, token, names, body, kind)

    add("get", "/version", "Version of the service", _envelope(_object({"version": _TEXT}, "version")))
    add("get", "/openapi.json", "This document", {"type": "object"})
    add("get", "/status/{testid}", "Status of a test", {"const": "Running"})
    add("put", "/stop/{testid}", "End a test", {"const": "OK"}, kind="text/plain")
    for prefix in ("/testcases", f"/testcases/{NAMESPACE}"):
        listed: Schema = {"type": "array", "items": {"type": "object", "required": ["testcaseid"]}}
        add("get", prefix, "Test cases offered", listed)
        for end in ("", "{how}"):
            chosen = _object({"testid": _TEXT}, "testid")
            add("post", f"{prefix}/{{name}}/select{end}", "Start a test", chosen, {"type": "object"})
    for endpoint in endpoints(points):
        for path in (f"/{endpoint.verb}/{{testid}}", f"/{endpoint.verb}"):
            add(endpoint.method.lower(), path, endpoint.summary, _envelope(endpoint.payload), endpoint.body)
    specification: dict[str, Any] = {
        "openapi": "3.1.0",
        "info": {
            "title": f"{points.case.name} by thermoforce-mpc",
            "version": VERSION,
            "description": "The embedded plant behind BOPTEST's protocol. Paths without a test id are those of BOPTEST "
            "before 0.7, where a service ran one test.",
        },
        "paths": paths,
    }
    if token:
        specification["components"] = {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}}
        specification["security"] = [{"token": []}]
    return specification


def _operation(
    summary: str, answer: Schema, token: bool, names: Sequence[str], body: Schema | None, kind: str
) -> dict[str, Any]:
    responses: dict[str, Any] = {"200": _response("done", answer, kind)}
    statuses = [403, 429, *([401] if token else []), *([413] if body is not None else [])]
    # Paths without a test id use the one test of such clients; only a body can be wrong there.
    statuses += [400] if "testid" in names or body is not None else []
    statuses += [404] if "name" in names else []
    for status in sorted(statuses):
        refused = _envelope({"type": "null"})
        schema = {"anyOf": [refused, _UNKNOWN]} if status == 400 else refused
        responses[str(status)] = _response(_REASONS[status], schema)
    operation: dict[str, Any] = {"summary": summary, "responses": responses}
    if names:
        operation["parameters"] = [{"name": name, "in": "path", "required": True, "schema": _TEXT} for name in names]
    if body is not None:
        operation["requestBody"] = {
            "required": bool(body.get("required")),
            "content": {kind: {"schema": body} for kind in ("application/json", *FORMS)},
        }
    return operation


def _response(description: str, schema: Schema, kind: str = "application/json") -> dict[str, Any]:
    return {"description": description, "content": {kind: {"schema": schema}}}


def _envelope(payload: Schema) -> Schema:
    return _reply(status={"type": "integer"}, message=_TEXT, payload=payload)


_UNKNOWN = _reply(errors={"type": "array", "items": {"type": "object", "required": ["value", "msg"]}})
