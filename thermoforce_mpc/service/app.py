"""The REST interface: paths, envelope and status codes of the BOPTEST service (a WSGI application)."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Callable, Mapping
from typing import IO, Any

from flask import Flask, Request, Response, request
from werkzeug.exceptions import HTTPException

from thermoforce_mpc.data import Period
from thermoforce_mpc.plants.embedded import EmbeddedPlant
from thermoforce_mpc.service.refusal import Refusal
from thermoforce_mpc.service.session import Reply, Session
from thermoforce_mpc.service.sessions import Sessions, UnknownTestid
from thermoforce_mpc.version import VERSION

TESTCASE = "bestest_hydronic_heat_pump"
# Namespace of BOPTEST's own test cases.
NAMESPACE = "ibpsa"

_FORMS = ("multipart/form-data", "application/x-www-form-urlencoded")
_Endpoint = Callable[[Session, Mapping[str, Any]], Reply]
_ENDPOINTS: dict[tuple[str, str], _Endpoint] = {
    ("GET", "name"): lambda s, _: Reply("The name of the test case.", {"name": TESTCASE}),
    ("GET", "inputs"): lambda s, _: s.inputs(),
    ("GET", "measurements"): lambda s, _: s.measurements(),
    ("GET", "forecast_points"): lambda s, _: s.forecast_points(),
    ("GET", "step"): lambda s, _: s.step(),
    ("PUT", "step"): Session.set_step,
    ("GET", "scenario"): lambda s, _: s.scenario(),
    ("PUT", "scenario"): Session.set_scenario,
    ("PUT", "initialize"): Session.initialize,
    ("POST", "advance"): Session.advance,
    ("PUT", "forecast"): Session.forecast,
    ("PUT", "results"): Session.results,
    ("GET", "kpi"): lambda s, _: s.kpi(),
}


def create_app(
    make_plant: Callable[[], EmbeddedPlant], *, most_tests: int = 8, idle_s: float = 900.0, most_bytes: int = 1_000_000
) -> Flask:
    """WSGI application of the service.

    Args:
        make_plant: builds the plant of a new test.
        most_tests: largest number of tests at a time.
        idle_s: time without requests after which a test is dropped, s.
        most_bytes: longest request body, bytes.
    """
    windows = _Windows(make_plant)
    sessions = Sessions(lambda: Session(make_plant(), windows.period), most=most_tests, idle_s=idle_s)
    app = Flask(__name__)
    app.config["MAX_CONTENT_LENGTH"] = most_bytes

    @app.get("/version")
    def version() -> Response:
        return _envelope(200, "The version of this service.", {"version": f"{VERSION}+thermoforce-mpc"})

    @app.get("/testcases")
    @app.get(f"/testcases/{NAMESPACE}")
    def testcases() -> Response:
        return _json(200, [{"testcaseid": TESTCASE}])

    @app.post("/testcases/<name>/select")
    @app.post("/testcases/<name>/select-async")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select")
    @app.post(f"/testcases/{NAMESPACE}/<name>/select-async")
    def select(name: str) -> Response:
        if name != TESTCASE:
            return _envelope(404, f"No test case {name!r}; this service offers {TESTCASE}.", None)
        return _json(200, {"testid": sessions.select()})

    @app.get("/status/<testid>")
    def status(testid: str) -> Response:
        sessions.check(testid)
        return _json(200, "Running")

    @app.put("/stop/<testid>")
    def stop(testid: str) -> Response:
        sessions.stop(testid)
        return Response("OK", 200, mimetype="text/plain")

    @app.route("/<verb>", methods=["GET", "PUT", "POST"])
    @app.route("/<verb>/<testid>", methods=["GET", "PUT", "POST"])
    def endpoint(verb: str, testid: str | None = None) -> Response:
        answer = _ENDPOINTS.get((request.method, verb))
        if answer is None:
            methods = [method for method, known in _ENDPOINTS if known == verb]
            reason = f"use {' or '.join(methods)}" if methods else "no such endpoint"
            return _envelope(405 if methods else 404, f"{request.method} /{verb}: {reason}.", None)
        body = _body(request)
        # Up to BOPTEST 0.6 a container ran one test case, and paths had no test id.
        with sessions.using(sessions.lone() if testid is None else testid) as session:
            reply = answer(session, body)
        return _envelope(200, reply.message, reply.payload)

    @app.errorhandler(Refusal)
    def refused(error: Refusal) -> Response:
        return _envelope(error.status, error.message, None)

    @app.errorhandler(UnknownTestid)
    def unknown(error: UnknownTestid) -> Response:
        testid = str(error)
        item = {"value": testid, "msg": f"Invalid testid: {testid}", "param": "testid", "location": "params"}
        return _json(400, {"errors": [item]})

    @app.errorhandler(HTTPException)
    def http_error(error: HTTPException) -> Response:
        return _envelope(error.code or 500, error.description or error.name, None)

    @app.errorhandler(Exception)
    def internal(error: Exception) -> Response:
        app.logger.exception("%s %s failed", request.method, request.path)
        return _envelope(500, f"Internal error: {type(error).__name__}: {error}", None)

    return app


class _Windows:
    """Scored windows of the weather year, shared by all tests: finding one can take the simulation of a year."""

    def __init__(self, make_plant: Callable[[], EmbeddedPlant]) -> None:
        self._make_plant = make_plant
        self._plant: EmbeddedPlant | None = None
        self._lock = threading.Lock()

    def period(self, name: str) -> Period:
        with self._lock:
            if self._plant is None:
                self._plant = self._make_plant()
            return self._plant.period(name)


def _body(request: Request) -> dict[str, Any]:
    """Values of the request body: a JSON object, or a form (older clients)."""
    text = request.get_data()
    if not text.strip():
        return {}
    if request.mimetype in _FORMS:
        return _form(request, text)
    try:
        body = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Refusal(400, f"The body is not JSON: {error}.") from error
    if not isinstance(body, dict):
        raise Refusal(400, f"The body is a JSON {type(body).__name__}; expected an object.")
    return body


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
