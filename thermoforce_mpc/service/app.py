"""The REST interface: paths, envelope and status codes of the BOPTEST service (a WSGI application).

Each endpoint of one test stands here with the JSON schemas of request and reply, and the OpenAPI document made of them.
"""

from __future__ import annotations

import functools
import io
import json
import logging
import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any

from flask import Flask, Request, Response, request
from werkzeug.exceptions import HTTPException, MethodNotAllowed, NotFound

from thermoforce_mpc.boundary.forecast_error import MAX_HORIZON_H
from thermoforce_mpc.data import Period
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP
from thermoforce_mpc.plants.embedded.emulator import Emulator
from thermoforce_mpc.service.access import HostNames, Rate, Refusal, check_authorization
from thermoforce_mpc.service.points import PointInfo, ServedPoints, served_points
from thermoforce_mpc.service.sessions import LEAST_STEP_S, LEVELS, MOST_STEP_S, Reply, Session, Sessions, UnknownTestid
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

    add("get", "/version", "Version of the service", _reply_schema(_object({"version": _TEXT}, "version")))
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
            add(endpoint.method.lower(), path, endpoint.summary, _reply_schema(endpoint.payload), endpoint.body)
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
        refused = _reply_schema({"type": "null"})
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


def _reply_schema(payload: Schema) -> Schema:
    return _reply(status={"type": "integer"}, message=_TEXT, payload=payload)


_UNKNOWN = _reply(errors={"type": "array", "items": {"type": "object", "required": ["value", "msg"]}})


_LOG = logging.getLogger(__name__)
# Deepest nesting of a JSON body: the deepest that is allowed anywhere is a list in an object.
_MOST_DEPTH = 8
_MOST_SAID = 500


@dataclass(frozen=True)
class ServiceLimits:
    """Bounds of the service."""

    most_tests: int = 8  # at a time
    tests_each: int | None = None  # started by one address; None: all
    idle_s: float = 900.0  # without requests until a test is dropped, s
    lifetime_s: float = 7 * 86400.0  # until a test is dropped in any case, s
    most_bytes: int = 1_000_000  # of a request body
    per_second: float = 500.0  # requests from one address; twice as many in a burst


def create_app(
    make_plant: Callable[[], Emulator],
    limits: ServiceLimits | None = None,
    *,
    testcase: str = HEAT_PUMP.name,
    token: str | None = None,
    names: Iterable[str] = (),
) -> Flask:
    """WSGI application of the service: plants of `make_plant`, of `testcase`.

    `token`: what every request needs (None: nothing). `names`: by which it may be asked, besides addresses and
    localhost.
    """
    limits = limits or ServiceLimits()
    lock, first_plant = threading.Lock(), functools.cache(make_plant)

    def period(name: str) -> Period:
        """A scored window, of one plant for all tests: finding it can take the simulation of a year."""
        with lock:
            return first_plant().period(name)

    sessions = Sessions(
        lambda: Session(make_plant(), period),
        most=limits.most_tests,
        each=limits.tests_each,
        idle_s=limits.idle_s,
        lifetime_s=limits.lifetime_s,
    )
    app = Flask(__name__, static_folder=None)
    app.config["MAX_CONTENT_LENGTH"] = limits.most_bytes
    app.url_map.merge_slashes = False
    rate, own = Rate(limits.per_second), HostNames(names, "--name")
    points = served_points(testcase)
    described = document(points, token=token is not None)

    @app.before_request
    def admit() -> None:
        rate.admit(_client())
        own.check(request.headers)
        if token:
            check_authorization(request.headers.get("Authorization"), token)

    @app.get("/openapi.json")
    def openapi() -> Response:
        return _json(200, described)

    @app.get("/version")
    def version() -> Response:
        return _envelope(200, "The version of this service.", {"version": f"{VERSION}+thermoforce-mpc"})

    _serve_tests(app, sessions, testcase)
    for endpoint in endpoints(points):
        _serve_endpoint(app, sessions, endpoint)
    _answer_errors(app)
    return app


def _serve_tests(app: Flask, sessions: Sessions, testcase: str) -> None:
    """Routes that list the test case, and that start, ask for and stop a test of it."""

    @app.get("/testcases")
    @app.get(f"/testcases/{NAMESPACE}")
    def testcases() -> Response:
        return _json(200, [{"testcaseid": testcase}])

    @app.post("/testcases/<name>/select")
    @app.post("/testcases/<name>/select<how>")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select<how>")
    def select(name: str, how: str = "") -> Response:
        if name != testcase:
            return _envelope(404, f"No test case {name[:80]!r}; this service offers {testcase}.", None)
        return _json(200, {"testid": sessions.select(_client())})

    @app.get("/status/<testid>")
    def status(testid: str) -> Response:
        sessions.check(testid)
        return _json(200, "Running")

    @app.put("/stop/<testid>")
    def stop(testid: str) -> Response:
        sessions.stop(testid)
        return Response("OK", 200, mimetype="text/plain")


def _serve_endpoint(app: Flask, sessions: Sessions, endpoint: Endpoint) -> None:
    """Routes of an endpoint of tests, with a test id and without."""

    def answer(testid: str | None = None) -> Response:
        body = _body(request) if endpoint.body is not None else {}
        # Up to BOPTEST 0.6 a container ran one test case, and paths had no test id.
        with sessions.using(sessions.lone(_client()) if testid is None else testid) as session:
            reply = endpoint.answer(session, body)
        return _envelope(200, reply.message, reply.payload)

    for path in (f"/{endpoint.verb}", f"/{endpoint.verb}/<testid>"):
        app.add_url_rule(path, f"{endpoint.method} {path}", answer, methods=[endpoint.method])


def _answer_errors(app: Flask) -> None:
    """Answers to requests that are refused, and to those that fail."""

    @app.errorhandler(Refusal)
    def refused(error: Refusal) -> Response:
        answer = _envelope(error.status, error.message, None)
        if error.status == 429:
            answer.headers["Retry-After"] = "1"
        if error.status == 401:
            answer.headers["WWW-Authenticate"] = "Bearer"
        return answer

    @app.errorhandler(UnknownTestid)
    def unknown(error: UnknownTestid) -> Response:
        testid = str(error)[:80]
        item = {"value": testid, "msg": f"Invalid testid: {testid}", "param": "testid", "location": "params"}
        return _json(400, {"errors": [item]})

    @app.errorhandler(HTTPException)
    def http_error(error: HTTPException) -> Response:
        attempt = f"{request.method} {request.path[:80]}"
        if isinstance(error, NotFound):
            return _envelope(404, f"{attempt}: no such endpoint; /openapi.json lists all.", None)
        if isinstance(error, MethodNotAllowed):
            methods = [name for name in error.valid_methods or () if name not in ("HEAD", "OPTIONS")]
            answer = _envelope(405, f"{attempt}: use {' or '.join(sorted(methods))}.", None)
            answer.headers["Allow"] = ", ".join(error.valid_methods or ())
            return answer
        return _envelope(error.code or 500, error.description or error.name, None)

    @app.errorhandler(Exception)
    def internal(error: Exception) -> Response:
        app.logger.exception("%s %s failed", request.method, request.path)
        # What happened is in the log: an error's text may show more of this machine than a client should see.
        return _envelope(500, f"Internal error ({type(error).__name__}); the service's log has more.", None)


def _client() -> str:
    return request.remote_addr or ""


def _body(request: Request) -> dict[str, Any]:
    """Values of the request body: a JSON object, or a form (older clients). BOPTEST ignores any other, so do we."""
    text = request.get_data()
    if text and request.mimetype not in ("application/json", *FORMS):
        kind = request.mimetype or "none"
        _LOG.warning("%s: a body of type %.80r is ignored; send application/json", request.path[:80], kind)
        return {}
    if not text.strip():
        return {}
    if request.mimetype in FORMS:
        return _form(request, text)
    try:
        body = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Refusal(400, f"The body is not JSON: {error}.") from error
    if not isinstance(body, dict):
        raise Refusal(400, f"The body is a JSON {type(body).__name__}; expected an object.")
    if _deeper(body, _MOST_DEPTH):
        raise Refusal(400, f"The body nests deeper than {_MOST_DEPTH} levels; expected values and lists.")
    return body


def _deeper(value: Any, levels: int) -> bool:
    below = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels < 0 or any(_deeper(item, levels - 1) for item in below if isinstance(item, dict | list))


def _form(request: Request, text: bytes) -> dict[str, Any]:
    """Fields of a form. Parsed here since Flask treats a malformed form as an empty one."""
    parser = request.make_form_data_parser()
    parser.silent, parser.stream_factory = False, _no_file
    try:
        _, fields, _files = parser.parse(io.BytesIO(text), request.mimetype, len(text), request.mimetype_params)
    except ValueError as error:
        raise Refusal(400, f"The body is not the form ({request.mimetype}) it says it is: {error}.") from error
    if not fields:
        raise Refusal(400, f"The body is a form ({request.mimetype}) without a field.")
    return {key: values if len(values) > 1 else values[0] for key, values in fields.lists()}


def _no_file(*_: Any, **__: Any) -> IO[bytes]:
    raise ValueError("a file is not allowed as a value")


def _envelope(status: int, message: str, payload: Any) -> Response:
    if status != 200 and len(message) > _MOST_SAID:
        # What was wrong in a request is repeated to its sender, but not all of it.
        message = f"{message[:_MOST_SAID]} …"
    return _json(status, {"status": status, "message": message, "payload": payload})


def _json(status: int, content: Any) -> Response:
    return Response(json.dumps(_whole(content), allow_nan=False), status, mimetype="application/json")


def _whole(content: Any) -> Any:
    """`content` with whole floats as integers: BOPTEST's replies pass through JavaScript (3600, not 3600.0)."""
    if isinstance(content, float):
        return int(content) if content.is_integer() else content
    if isinstance(content, dict):
        return {key: _whole(value) for key, value in content.items()}
    if isinstance(content, list):
        # Long series are lists of numbers: avoid one call per item.
        return [
            (int(item) if item.is_integer() else item) if isinstance(item, float) else _whole(item) for item in content
        ]
    return content
